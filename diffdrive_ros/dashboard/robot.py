"""The robot as all pages see it: what was heard of it, its tracks, its geometry, its driver."""
from collections.abc import Sequence
import itertools
import math
from typing import Any

from diffdrive_ros.core.odometry_config import diff_drive, wheel_names
from diffdrive_ros.core.parameter_specs import checked_values, GEOMETRY
from diffdrive_ros.core.quaternion import heading_of_quaternion
from diffdrive_ros.dashboard import ellipse, remote_parameters
from diffdrive_ros.dashboard.dashboard_node import DashboardNode, NoAnswerError
from diffdrive_ros.dashboard.remote_parameters import RemoteParameter
from diffdrive_ros.dashboard.teleop import Pilot, Twist
from diffdrive_ros.dashboard.trajectory import Track
from diffdrive_ros.node import clock
from std_srvs.srv import SetBool, Trigger

RECENT = 1.0  # [s] that a message stands for the robot as it is
DIAGNOSTICS_SILENT = 3.0  # [s] after which a status, which comes once a second, is an old one
PATIENCE = 3.0  # [s] until a node that is no odometry is asked again what it is
SLOWEST_ODOM = 2.0  # [Hz] to drive by, and not to be taken for silent between two
LONGEST_TIMEOUT = 2.0  # [s] that a robot may drive on when this computer fails
DISABLED = 'disabled by ~/enable'
HOLDS = DISABLED, 'no usable joint_states', '/clock stands still'  # as /diagnostics has them

Pose = tuple[float, float, float]


class DashboardRobot:
    """One robot, seen through a node; used from one thread."""

    def __init__(self, node: DashboardNode) -> None:
        self.node = node
        self.pilot = Pilot()
        self.tracks = {'odom': Track(), 'truth': Track()}
        self.drive = diff_drive(checked_values(GEOMETRY, {}))
        self.parameters: list[RemoteParameter] = []
        self.is_silent = True
        self.is_simulated = False
        self.other_commanders: Sequence[str] = ()
        self.odom: Pose | None = None
        self.truth: Pose | None = None
        self.wheels: tuple[float, float] | None = None
        self.ellipse: tuple[float, float, float] | None = None
        self.arrivals = 0
        """How often somebody began to publish odom: it may be another robot each time."""
        self._is_known = False
        self._forgotten = 0
        self._strange = ''
        self._learned_at = 0.0
        self._news_from = 0.0  # [s] what the node told before tells of before
        self._enabling = 0
        self._stopped = 0  # the arrival that was made to hold the wheels last
        self._refused: str | None = None
        self._frame = 'odom'
        self._joints: tuple[tuple[str, ...], tuple[str, ...]] = ((), ())
        self._directions = (1.0, 1.0)

    def publish(self, twist: Twist | None) -> None:
        """Publish what the pilot decided."""
        if twist is not None:
            self.node.command(twist)

    def look(self) -> None:
        """Take in what has been heard."""
        odom, truth = self.node.odom, self.node.truth
        was_silent, self.is_silent = self.is_silent, odom.age > self._longest_gap
        has_newcomers = self.node.newcomers_on_odom()
        if has_newcomers or self.is_silent != was_silent:
            self._forget()  # it may be another process, which was started with other parameters
        if has_newcomers:
            self.odom = None
            self.arrivals += 1
            self._news_from = clock.steady()
        # Before anything is opened: whatever is wrong with a message, the stop is not missed.
        has_held = self._has_held()
        if reason := self.reason_not_to_drive or has_held:
            self.publish(self.pilot.disarm(reason))
        if not self.is_silent:
            message = odom.message
            self.odom = pose_of(message) or self.odom
            if self.odom:
                self.tracks['odom'].add(*self.odom[:2])
            self._frame = message.header.frame_id
            covariance = message.pose.covariance
            self.ellipse = ellipse.of_covariance(
                [[covariance[0], covariance[1]], [covariance[6], covariance[7]]])
        self.truth = None
        if truth.age < RECENT:
            self.truth = pose_of(truth.message)
            if self.truth:
                self.tracks['truth'].add(*self.truth[:2])
        self.wheels = self._wheel_speeds()

    def look_around(self) -> None:
        """Take in who is there; slower than what they say."""
        self.is_simulated = self.node.is_simulated()
        self.other_commanders = self.node.other_commanders()

    @property
    def twist(self) -> Twist | None:
        """Return how the robot moves by its odometry, if it tells."""
        if self.node.odom.age > RECENT:
            return None
        measured = self.node.odom.message.twist.twist
        return measured.linear.x, measured.angular.z

    @property
    def asked(self) -> Twist | None:
        """Return the newest command, whoever gave it, if it is one of now."""
        commands = self.node.commands
        if commands is None or commands.age > RECENT:
            return None
        message = commands.message
        twist = message.twist if self.node.is_stamped else message
        return twist.linear.x, twist.angular.z

    @property
    def applied(self) -> Twist | None:
        """Return the twist that the node has the wheels do, if it tells."""
        if self.node.applied.age > RECENT:
            return None
        twist = self.node.applied.message.twist
        return twist.linear.x, twist.angular.z

    @property
    def hold(self) -> str:
        """Return why the node holds the wheels, if it does by its last word."""
        if not self.tells:
            return ''
        return hold_in(self.node.diagnostics[self.node.commands_status][1])

    @property
    def tells(self) -> bool:
        """Return whether the node's last word on its commands is one of now."""
        heard_at, _ = self.node.diagnostics.get(self.node.commands_status, (-math.inf, None))
        return (heard_at >= self._news_from
                and clock.steady() - heard_at <= DIAGNOSTICS_SILENT)

    @property
    def is_disabled(self) -> bool:
        """Return whether the node holds the wheels because somebody asked it to."""
        return DISABLED in self.hold

    @property
    def reason_not_to_drive(self) -> str:
        """Return why no page may drive this robot, if so."""
        waits_for_command = self._is_known and self.odom is None and self.value('open_loop')
        if self.is_silent and not waits_for_command:
            return 'odom is silent'
        if not self._is_known:
            return self._strange or 'its parameters are not known yet'
        if self._is_slow:
            return f'its publish_rate is below {SLOWEST_ODOM:g} Hz, too slow to drive by'
        timeout = float(self.value('cmd_vel_timeout'))
        if not timeout:
            return 'its cmd_vel_timeout is 0, so that nothing would stop it if this computer fails'
        if not timeout <= LONGEST_TIMEOUT:
            return (f'its cmd_vel_timeout is {timeout:g} s, above {LONGEST_TIMEOUT:g} s: so long '
                    'it would drive on if this computer fails')
        return ''

    def value(self, name: str) -> Any:
        """Return the value of a parameter as it was learned last, or None."""
        return next((each.value for each in self.parameters if each.name == name), None)

    @property
    def needs_to_learn(self) -> bool:
        """Return whether the parameters are not known, or not as they are now."""
        if self._learned_at <= self.node.parameters_changed_at:
            return True
        if self._strange:
            return clock.steady() - self._learned_at > PATIENCE
        return not self._is_known

    async def learn(self) -> None:
        """Read the parameters of the node, and what follows from them; raises NoAnswerError."""
        before, forgotten, strange = clock.steady(), self._forgotten, ''
        try:
            learned = await remote_parameters.read_all(self.node.ask)
            if self._forgotten == forgotten:
                self._take(learned)
        except KeyError as error:
            strange = f'it has no parameter {error}'
        except (TypeError, ValueError) as error:
            strange = str(error)
        if self._forgotten != forgotten:
            return  # that was a process that is no more
        self._is_known, self._learned_at = not strange, before
        self._strange = strange and f'{self.node.watched} is another node than odometry: {strange}'
        if strange:
            raise NoAnswerError(self._strange)

    async def set_parameter(self, name: str, text: str) -> str:
        """Set a parameter to what a person wrote; return why not, or nothing."""
        kind = next(each.kind for each in self.parameters if each.name == name)
        reason = await remote_parameters.write(self.node.ask, name, kind, text)
        try:
            await self.learn()
        except NoAnswerError:  # it was set all the same, and is read again before one drives
            self._forget()
        return reason

    async def enable(self, is_enabled: bool) -> str:
        """Have the node drive the wheels, or hold them at zero; return its word."""
        asked_at, arrivals = clock.steady(), self.arrivals
        self._enabling += 1
        try:
            answer = await self.node.ask('enable', SetBool.Request(data=is_enabled))
        finally:
            self._enabling -= 1
        self._news_from = max(self._news_from, asked_at)
        self._stopped = 0 if is_enabled else arrivals
        return str(answer.message)

    async def keep_stopped(self) -> None:
        """Have a node hold the wheels that does not know of the stop: it was started after it."""
        if not self.pilot.is_stopped or self._enabling:
            return
        if self.arrivals != self._stopped or (self.tells and not self.is_disabled):
            await self.enable(False)

    async def release(self, stops: int) -> str:
        """Let the node and the pages drive again, unless stop is pressed more often than that."""
        if self.pilot.stops == stops:
            word = await self.enable(True)
            if self.pilot.stops == stops:
                self.pilot.resume()
                return word
        return await self.enable(False)

    async def reset(self) -> str:
        """Set odometry to zero; return the node's word."""
        answer = await self.node.ask('reset_odometry', Trigger.Request())
        for track in self.tracks.values():
            track.clear()
        return str(answer.message)

    def set_pose(self, pose: Sequence[float]) -> None:
        """Set odometry to a pose."""
        x, y, theta = pose
        self.node.set_pose(x, y, theta, self._frame)

    def _take(self, learned: list[RemoteParameter]) -> None:
        """Take in the parameters of the node, and what follows from them."""
        self.parameters = learned
        values = {each.name: each.value for each in learned}
        for name in ('cmd_vel_timeout', 'publish_rate'):
            float(values[name])  # numbers, as the reasons not to drive take for granted
        self.drive = diff_drive(values)
        self._joints = wheel_names(values)
        self._directions = (
            float(values['left_wheel_direction']), float(values['right_wheel_direction']))
        self.node.prepare(bool(values['enable_stamped_cmd_vel']))

    @property
    def _is_slow(self) -> bool:
        return self._is_known and 0.0 < float(self.value('publish_rate')) < SLOWEST_ODOM

    @property
    def _longest_gap(self) -> float:
        """Return how long odom may be away before it is silent [s]."""
        return RECENT + 1.0 / float(self.value('publish_rate')) if self._is_slow else RECENT

    def _forget(self) -> None:
        self._is_known, self._strange = False, ''
        self._forgotten += 1

    def _has_held(self) -> str:
        """Return why the node holds the wheels, or held them since the last look, if so."""
        reason = self.hold
        for status in self.node.told_of_commands():  # none is missed, however short it was
            refused = next((each.value for each in status.values if each.key == 'inhibited'), '0')
            if self._refused not in (None, refused):
                reason = reason or 'the node refused a command'
            self._refused = refused
            reason = reason or hold_in(status)
        return reason

    def _wheel_speeds(self) -> tuple[float, float] | None:
        """Return the mean speed of each side, forward positive [rad/s]; by odom if need be."""
        told = self.node.joints.speeds([*itertools.chain(*self._joints)], RECENT)
        sides = [[told[name] for name in names if name in told] for names in self._joints]
        if all(sides):
            left, right = (
                direction * sum(side) / len(side)
                for side, direction in zip(sides, self._directions, strict=True))
            return left, right
        twist = self.twist
        if twist is None:
            return None
        left, right = map(float, self.drive.wheel_speeds(*twist))
        return left, right


def hold_in(status: Any) -> str:
    """Return why the wheels are held by a status of the commands of the node, if they are."""
    return ', '.join(hold for hold in HOLDS if hold in status.message)


def pose_of(message: Any) -> Pose | None:
    """Return the pose of an Odometry message, theta in [-pi, pi]; None if it is not finite."""
    position, q = message.pose.pose.position, message.pose.pose.orientation
    theta = heading_of_quaternion(q.x, q.y, q.z, q.w)
    if not all(map(math.isfinite, (position.x, position.y, theta))):
        return None
    return position.x, position.y, theta
