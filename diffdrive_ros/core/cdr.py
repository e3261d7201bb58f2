"""
Messages as the bytes that DDS carries: JointState in, Odometry and TFMessage out.

The encoding is OMG's CDR, version 1: four bytes that name the byte order, then the fields, each
aligned to its size, counted from behind those four. A string is its length, its characters and a
zero; a sequence is its length and its elements. To read the few values that are wanted, and to
patch the few that change, costs a tenth of what the conversion from and to messages does.
"""
from collections import deque
from collections.abc import Callable, Collection, Iterable, Sequence
from math import sqrt
from struct import calcsize, Struct, unpack_from
from typing import Any

from diffdrive_ros.core.odometry import Estimate, Triangle, UNKNOWN_VARIANCE
from diffdrive_ros.core.quaternion import quaternion_of_heading

# Rows and columns of x, y and yaw in a message's covariance of x, y, z, roll, pitch, yaw.
PLANAR = 0, 1, 5

END_OF_TIME_NS = 2**31 * 1_000_000_000  # of a stamp, whose seconds are of 32 bits with a sign
BEFORE_ITS_END = 'must be before 2038'

PREAMBLE = 4  # bytes
AFTER_STAMP = PREAMBLE + 8
BYTE_ORDERS = {b'\0\0': '>', b'\0\1': '<'}
LITTLE_ENDIAN = b'\0\1\0\0'

# More drivers than this that share joint_states in turn have their layouts learned again.
MOST_LAYOUTS = 8

Diagonal = Sequence[float] | None
"""The variances of a pose or a twist in space: x, y, z, roll, pitch, yaw."""


class WireError(ValueError):
    """A payload is not what it should be."""


JointReading = tuple[tuple[str, ...], tuple[float, ...], tuple[float, ...], int, tuple[str, ...]]
"""
What a JointState says: names, positions, velocities of the wanted joints, stamp [ns], all names.

The wanted joints are in the order of the message. There are fewer positions or velocities than
names, if the message has too few.
"""


_Layout = tuple[
    int, Callable[[bytes], tuple[Any, ...]], tuple[Any, ...], Callable[[bytes], tuple[int, int]],
    Callable[[bytes], tuple[float, ...]], Callable[[bytes], tuple[float, ...]],
    tuple[str, ...], tuple[str, ...]]
"""
Where a JointState has what, for all that have the same frame, joints and counts.

The size; what returns all that has to be the same, and what that is: the byte order, the head and
the count of each sequence; what returns the stamp, the wanted positions and velocities; the wanted
names and all. The head is the frame and the names with their lengths, and what fills up between
them. That may be anything; a message with other fillings has another layout, which costs time
only. A plain tuple, for it is unpacked with each message.
"""

_NOTHING = Struct('').unpack_from
NO_LAYOUT: _Layout = (-1, _NOTHING, (), Struct('iI').unpack_from, _NOTHING, _NOTHING, (), ())


class JointStateReader:
    """
    Reads the wanted joints out of JointState payloads, in any order, of either byte order.

    A payload with the layout of one that was seen is read at known places. Any other is looked
    through from its beginning to its end, and nothing outside it is ever read.
    """

    def __init__(self, wanted: Collection[str]) -> None:
        self._wanted = frozenset(wanted)
        self._layouts: deque[_Layout] = deque(maxlen=MOST_LAYOUTS)
        self._last = NO_LAYOUT

    def read(self, payload: bytes) -> JointReading:
        """Return what a payload says; raises WireError if it is malformed."""
        size, fixed_of, fixed, stamp_of, positions_of, velocities_of, names, all_names = self._last
        if len(payload) != size or fixed_of(payload) != fixed:
            self._last = self._layout_of(payload)
            return self.read(payload)
        seconds, nanoseconds = stamp_of(payload)
        stamp_ns = seconds * 1_000_000_000 + nanoseconds
        if stamp_ns >= END_OF_TIME_NS:
            raise WireError(f'stamp = {seconds} s + {nanoseconds} ns: {BEFORE_ITS_END}')
        return names, positions_of(payload), velocities_of(payload), stamp_ns, all_names

    def _layout_of(self, payload: bytes) -> _Layout:
        for layout in self._layouts:
            size, fixed_of, fixed, *_ = layout
            if len(payload) == size and fixed_of(payload) == fixed:
                return layout
        layout = self._learn(payload)
        self._layouts.appendleft(layout)
        return layout

    def _learn(self, payload: bytes) -> _Layout:
        scan = Scan(payload, at=AFTER_STAMP)
        scan.string()
        all_names = tuple([scan.string() for _ in range(scan.count())])
        wanted = [index for index, name in enumerate(all_names) if name in self._wanted]
        fixed = [(0, 'H'), (AFTER_STAMP, f'{scan.at - AFTER_STAMP}s')]
        sequences = []
        for _ in 'position', 'velocity', 'effort':
            count = scan.count()
            fixed.append((scan.at - 4, 'I'))
            start = scan.doubles(count)
            sequences.append([(start + 8 * index, 'd') for index in wanted if index < count])
        order = scan.byte_order
        positions, velocities, _ = sequences
        fixed_of = _struct(order, fixed).unpack_from
        return (
            len(payload), fixed_of, fixed_of(payload),
            _struct(order, [(PREAMBLE, 'i'), (PREAMBLE + 4, 'I')]).unpack_from,
            _struct(order, positions).unpack_from, _struct(order, velocities).unpack_from,
            tuple([all_names[index] for index in wanted]), all_names)


class Scan:
    """
    Goes through a payload field by field, and never beyond its end.

    Every step raises WireError for what cannot stand there.
    """

    def __init__(self, payload: bytes, at: int = PREAMBLE) -> None:
        byte_order = BYTE_ORDERS.get(bytes(payload[:2]))
        if byte_order is None:
            raise WireError(f'encoding {payload[:2].hex()}: must be 0000 or 0001')
        self.byte_order = byte_order
        self.at = at
        self._payload = payload

    def count(self) -> int:
        """Return the count that stands here, and go behind it."""
        count: int = self._values('I', 4, 'a count')[0]
        return count

    def stamp_ns(self) -> int:
        """Return the time [ns] that stands here, and go behind it."""
        seconds, nanoseconds = self._values('iI', 4, 'a stamp')
        return int(seconds) * 1_000_000_000 + int(nanoseconds)

    def pose(self) -> tuple[float, float, float, float, float, float, float]:
        """Return the Pose that stands here: x, y, z, quaternion x, y, z, w; and go behind it."""
        x, y, z, q_x, q_y, q_z, q_w = self._values('7d', 8, 'a pose')
        return x, y, z, q_x, q_y, q_z, q_w

    def string(self) -> str:
        """Return the text that stands here, and go behind it."""
        size = self.count()
        start = self.at
        self._advance(size, 'a text')
        if size and self._payload[self.at - 1]:
            raise WireError(f'a text ends at byte {self.at} without a zero: must end with one')
        return self._payload[start:max(start, self.at - 1)].decode(errors='replace')

    def doubles(self, count: int) -> int:
        """Return where so many doubles begin, and go behind them."""
        if count:
            self._align(8)
        start = self.at
        self._advance(8 * count, 'a sequence')
        return start

    def _values(self, kind: str, size: int, what: str) -> tuple[Any, ...]:
        """Return values of a kind of struct, aligned to a size, and go behind them."""
        self._align(size)
        start, form = self.at, self.byte_order + kind
        self._advance(calcsize(form), what)
        return unpack_from(form, self._payload, start)

    def _align(self, size: int) -> None:
        self.at += -(self.at - PREAMBLE) % size

    def _advance(self, size: int, what: str) -> None:
        end = self.at + size
        if end > len(self._payload):
            raise WireError(
                f'{what} ends at byte {end} of {len(self._payload)}: must end within the message')
        self.at = end


def _struct(byte_order: str, fields: Iterable[tuple[int, str]]) -> Struct:
    """Return a struct that has each field at its place."""
    form, end = byte_order, 0
    for start, code in fields:
        form += f'{start - end}x{code}'
        end = start + calcsize(byte_order + code)
    return Struct(form)


# Of doubles; an x is a byte that stays zero. Of those in space, the ones in the plane are wanted.
_POSE = 'dd24xdd'  # x, y, z; the rotation's x, y, z, w
_TWIST = 'd32xd'  # linear x, y, z; angular x, y, z
_UNUSED = Struct('<' '16xd24x' '24xd16x' '32xd8x')  # the middle rows of a covariance of six
_COVARIANCE = 'dd24xd' 'dd24xd' f'{_UNUSED.size}s' 'dd24xd'


class OdometryWriter:
    """Writes Odometry payloads; the diagonals, where given, stand in for the covariances."""

    def __init__(
        self, odom_frame: str, base_frame: str, pose_variances: Diagonal = None,
        twist_variances: Diagonal = None,
    ) -> None:
        self._frames = _frames(len(LITTLE_ENDIAN) + 8, odom_frame, base_frame)
        self._pack = Struct(
            f'<4siI{len(self._frames)}s' + _POSE + _COVARIANCE + _TWIST + _COVARIANCE).pack
        self._pose_covariance, self._pose_unused = _of_diagonal(pose_variances)
        self._twist_covariance, self._twist_unused = _of_diagonal(twist_variances)

    def write(self, stamp_ns: int, estimate: Estimate) -> bytes:
        """Return the payload of an estimate."""
        (x, y, theta), pose_covariance, (linear, angular), twist_covariance = estimate
        if self._pose_covariance is not None:
            pose_covariance = self._pose_covariance
        xx, xy, xt, yy, yt, tt = pose_covariance
        if not (xx <= UNKNOWN_VARIANCE and yy <= UNKNOWN_VARIANCE and tt <= UNKNOWN_VARIANCE):
            xx, xy, xt, yy, yt, tt = _capped(xx, xy, xt, yy, yt, tt)
        if self._twist_covariance is not None:
            twist_covariance = self._twist_covariance
        vv, vs, vw, ss, sw, ww = twist_covariance
        if not (vv <= UNKNOWN_VARIANCE and ss <= UNKNOWN_VARIANCE and ww <= UNKNOWN_VARIANCE):
            vv, vs, vw, ss, sw, ww = _capped(vv, vs, vw, ss, sw, ww)
        seconds = stamp_ns // 1_000_000_000
        q_z, q_w = quaternion_of_heading(theta)
        return self._pack(  # not more than 30 arguments, for more would go by way of a list
            LITTLE_ENDIAN, seconds, stamp_ns - seconds * 1_000_000_000, self._frames,
            x, y, q_z, q_w,
            xx, xy, xt, xy, yy, yt, self._pose_unused, xt, yt, tt,
            linear, angular,
            vv, vs, vw, vs, ss, sw, self._twist_unused, vw, sw, ww)


class TransformWriter:
    """Writes TFMessage payloads of one transform."""

    def __init__(self, odom_frame: str, base_frame: str) -> None:
        self._before = LITTLE_ENDIAN + Struct('<I').pack(1)  # transform
        self._frames = _frames(len(self._before) + 8, odom_frame, base_frame)
        self._pack = Struct(f'<8siI{len(self._frames)}s' + _POSE).pack

    def write(self, stamp_ns: int, x: float, y: float, theta: float) -> bytes:
        """Return the payload of the transform to a pose."""
        seconds = stamp_ns // 1_000_000_000
        q_z, q_w = quaternion_of_heading(theta)
        return self._pack(
            self._before, seconds, stamp_ns - seconds * 1_000_000_000, self._frames,
            x, y, q_z, q_w)


def _frames(start: int, *names: str) -> bytes:
    """Return strings as they stand from a multiple of four on, filled up to where doubles may."""
    text = b''
    for name in names:
        characters = name.encode() + b'\0'
        text += bytes(-len(text) % 4) + Struct('<I').pack(len(characters)) + characters
    return text + bytes(-(start - PREAMBLE + len(text)) % 8)


def _of_diagonal(variances: Diagonal) -> tuple[Triangle | None, bytes]:
    """Return the covariance in the plane, and the rows of z, roll and pitch as bytes."""
    if variances is None:
        return None, _UNUSED.pack(UNKNOWN_VARIANCE, UNKNOWN_VARIANCE, UNKNOWN_VARIANCE)
    x, y, z, roll, pitch, yaw = (variance or UNKNOWN_VARIANCE for variance in variances)
    return (x, 0.0, 0.0, y, 0.0, yaw), _UNUSED.pack(z, roll, pitch)


def _capped(xx: float, xy: float, xt: float, yy: float, yt: float, tt: float) -> Triangle:
    """Return a covariance scaled to variances of UNKNOWN_VARIANCE at most; it stays one."""
    limit = UNKNOWN_VARIANCE
    x, y, theta = (sqrt(limit / max(variance, limit)) for variance in (xx, yy, tt))
    return (min(xx, limit), xy * x * y, xt * x * theta, min(yy, limit), yt * y * theta,
            min(tt, limit))
