"""
Who holds the wheel, and which of its commands are driven.

Pages in browsers send beats: what their keys and joystick ask for right now. A beat is driven once
and never repeated, so that the robot moves only as long as beats come. Each carries the moment of
the newest picture that its page has drawn: commands that waited somewhere on their way, and those
of a driver who does not see the robot as it is, are old. Moments are of a steady clock [s].
"""
from dataclasses import dataclass
import math

LONGEST_SILENCE = 0.3  # [s] between two beats of a robot in motion; below the usual timeouts
OLDEST_SIGHT = 0.4  # [s] since the picture that a person saw

Twist = tuple[float, float]
"""Forward speed [m/s] and turn rate [rad/s]."""
STOP: Twist = (0.0, 0.0)


@dataclass(frozen=True)
class Beat:
    """
    What a page asks for; number grows from beat to beat, sight is when its picture was sent.

    lost: its controls were taken out of the driver's hands, who may hold them still. may_drive:
    whether the robot may be driven, and by this page.
    """

    number: int
    sight: float
    twist: Twist
    lost: bool = False
    may_drive: bool = True


@dataclass
class _Seat:
    """A page: its last beat, and whether its controls were at rest since it may last drive."""

    number: int = -1
    is_armed: bool = False
    is_held: bool = False
    complaint: str = ''


class Pilot:
    """
    Decides on each beat; the methods return the twist to publish now, or None for nothing.

    One page drives. A free wheel goes to the first that asks for motion; one that is taken
    changes hands by take alone. After anything but the driver's own wish kept them from being
    driven, controls have to come back to rest before they count.
    """

    def __init__(self) -> None:
        self.driver: str | None = None
        """The page that drives."""
        self.is_stopped = False
        """Whether somebody pressed stop; nothing is driven until resume."""
        self.stops = 0
        """How often somebody pressed it."""
        self._seats: dict[str, _Seat] = {}
        self._moving_since: float | None = None

    @property
    def is_moving(self) -> bool:
        """Return whether the last twist was no stop."""
        return self._moving_since is not None

    def complaint(self, page: str) -> str:
        """Return why what a page asked for was not driven, or no longer, for a person to read."""
        seat = self._seats.get(page, _Seat())
        return seat.complaint or ('keys or joystick were held before' if seat.is_held else '')

    def beat(self, page: str, beat: Beat, now: float) -> Twist | None:
        """Take a beat of a page."""
        seat = self._seats.setdefault(page, _Seat())
        if beat.number <= seat.number:  # came twice, or was overtaken
            return None
        seat.number = beat.number
        if beat.lost:
            seat.complaint = 'this page was left, or held up'
        if not all(map(math.isfinite, (*beat.twist, beat.sight))):
            return self._trip(page, 'a command that is not finite')
        if beat.twist != STOP and not beat.may_drive:
            return self._pass_over(page)
        if beat.twist == STOP:  # a rest is one, however old the picture is
            seat.is_armed, seat.is_held = True, False
            return self._halt() if page == self.driver else None
        if not _is_fresh(beat.sight, now):
            return self._trip(page, 'the connection is slow')
        if self.is_stopped or not seat.is_armed or self.driver not in (None, page):
            return self._pass_over(page)
        self.driver = page
        seat.complaint = ''
        self._moving_since = now
        return beat.twist

    def sees(self, sight: float, stops: int, now: float) -> bool:
        """
        Return whether a page shows how things stand, so that a click on it means what it does.

        sight is when its newest picture was sent, stops how often stop had been pressed then.
        """
        return stops == self.stops and _is_fresh(sight, now)

    def distrust(self, page: str) -> Twist | None:
        """Take note of a beat of a page that cannot be understood."""
        self._seats.setdefault(page, _Seat())
        return self._trip(page, 'this page says what cannot be understood')

    def watch(self, now: float) -> Twist | None:
        """Stop a robot whose driver has fallen silent; to be called all the time."""
        if self.driver and self._moving_since is not None and (
                now - self._moving_since > LONGEST_SILENCE):
            return self._trip(self.driver, 'the page fell silent')
        return None

    def take(self, page: str) -> Twist | None:
        """Give the wheel to a page, whoever has it."""
        self._seats.setdefault(page, _Seat()).is_armed = False
        self.driver = page
        return self._halt()

    def leave(self, page: str) -> Twist | None:
        """Free the wheel if a page has it; the page itself is forgotten."""
        self._seats.pop(page, None)
        if page != self.driver:
            return None
        self.driver = None
        return self._halt()

    def stop(self) -> Twist:
        """Stop, whoever asks for it and whoever drives, until resume."""
        self.is_stopped = True
        self.stops += 1
        for seat in self._seats.values():
            seat.is_armed, seat.complaint = False, ''
        self._halt()
        return STOP

    def disarm(self, complaint: str) -> Twist | None:
        """Stop a robot that may not be driven now; every page has to come to rest again."""
        if self.driver and self.is_moving:
            self._seats[self.driver].complaint = complaint
        for seat in self._seats.values():
            seat.is_armed = False
        return self._halt()

    def resume(self) -> None:
        """Let commands be driven again."""
        self.is_stopped = False

    def _trip(self, page: str, complaint: str) -> Twist | None:
        self._seats[page].complaint = complaint
        self._seats[page].is_armed = False
        return self._halt() if page == self.driver else None

    def _pass_over(self, page: str) -> Twist | None:
        self._seats[page].is_held = True
        self._seats[page].is_armed = False
        return self._halt() if page == self.driver else None

    def _halt(self) -> Twist | None:
        if self._moving_since is None:
            return None
        self._moving_since = None
        return STOP


def _is_fresh(sight: float, now: float) -> bool:
    return 0.0 <= now - sight <= OLDEST_SIGHT
