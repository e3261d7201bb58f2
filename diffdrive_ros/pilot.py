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
OLDEST_SIGHT = 0.4  # [s] since the picture that a driver saw

Twist = tuple[float, float]
"""Forward speed [m/s] and turn rate [rad/s]."""
STOP: Twist = (0.0, 0.0)


@dataclass(frozen=True)
class Beat:
    """
    What a page asks for; number grows from beat to beat, sight is when its picture was sent.

    lost: its controls were taken out of the driver's hands, who may hold them still.
    """

    number: int
    sight: float
    twist: Twist
    lost: bool = False


@dataclass
class _Seat:
    """A page: its last beat, and whether its controls were at rest since it may last drive."""

    number: int = -1
    is_armed: bool = False
    complaint: str = ''


class Pilot:
    """
    Decides on each beat; the methods return the twist to publish now, or None for nothing.

    One page drives. A free wheel goes to the first that asks for motion; one that is taken
    changes hands by take alone. After a stop that was not the driver's own wish, controls have to
    come back to rest before they count.
    """

    def __init__(self) -> None:
        self.driver: str | None = None
        """The page that drives."""
        self.is_stopped = False
        """Whether somebody pressed stop; nothing is driven until resume."""
        self._seats: dict[str, _Seat] = {}
        self._moving_since: float | None = None

    @property
    def is_moving(self) -> bool:
        """Return whether the last twist was no stop."""
        return self._moving_since is not None

    def complaint(self, page: str) -> str:
        """Return why what a page asked for was not driven, or no longer, for a person to read."""
        return self._seats[page].complaint if page in self._seats else ''

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
        if not 0.0 <= now - beat.sight <= OLDEST_SIGHT:
            return self._trip(page, 'the connection is slow') if beat.twist != STOP else (
                self._halt() if page == self.driver else None)
        if beat.twist == STOP:
            seat.is_armed = True
            return self._halt() if page == self.driver else None
        if self.driver is None and seat.is_armed:
            self.driver = page
        if page != self.driver or not seat.is_armed or self.is_stopped:
            return None
        seat.complaint = ''
        self._moving_since = now
        return beat.twist

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
        for seat in self._seats.values():
            seat.is_armed, seat.complaint = False, ''
        self._halt()
        return STOP

    def resume(self) -> None:
        """Let commands be driven again."""
        self.is_stopped = False

    def _trip(self, page: str, complaint: str) -> Twist | None:
        self._seats[page].is_armed = False
        self._seats[page].complaint = complaint
        return self._halt() if page == self.driver else None

    def _halt(self) -> Twist | None:
        if self._moving_since is None:
            return None
        self._moving_since = None
        return STOP
