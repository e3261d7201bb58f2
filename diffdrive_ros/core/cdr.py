"""
CDR payloads: read JointState, write Odometry and TFMessage.

The encoding is OMG's CDR, version 1: a preamble of four bytes with the byte order, then the
fields, each aligned to its size relative to the end of the preamble. A string is its length, its
characters and a zero. A sequence is its length and its elements.

These are hot paths. Reading the required values and packing the changing ones costs a tenth of
rclpy's conversion from and to messages; test_reading_equals_rclpy and
test_odometry_equals_rclpy in test_cdr.py hold both equal.
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

STAMP_END_NS = 2**31 * 1_000_000_000  # the seconds of a stamp are a signed integer of 32 bits
STAMP_RULE = 'must be before 2038'

PREAMBLE_BYTES = 4
AFTER_STAMP_BYTES = PREAMBLE_BYTES + 8
BYTE_ORDERS = {b'\0\0': '>', b'\0\1': '<'}
LITTLE_ENDIAN = b'\0\1\0\0'

# If more drivers share joint_states, their layouts are parsed again each time.
MAX_LAYOUTS = 8

Diagonal = Sequence[float] | None
"""Variances of a pose or a twist: x, y, z, roll, pitch, yaw."""


class WireError(ValueError):
    """A malformed payload; the message has the fault and its place."""


JointReading = tuple[tuple[str, ...], tuple[float, ...], tuple[float, ...], int, tuple[str, ...]]
"""
Names, positions and velocities of the selected joints, stamp [ns], all names.

The joints are in the order of the message. If the message has too few positions or velocities,
there are fewer than names.
"""


_Layout = tuple[
    int, Callable[[bytes], tuple[Any, ...]], tuple[Any, ...], Callable[[bytes], tuple[int, int]],
    Callable[[bytes], tuple[float, ...]], Callable[[bytes], tuple[float, ...]],
    tuple[str, ...], tuple[str, ...]]
"""
The layout of all JointState payloads with the same frame, joints and counts.

Size; reader of the constant bytes, and their value (byte order, header, count of each sequence);
readers of stamp, selected positions and selected velocities; selected names; all names. The header
is frame and names with their lengths and padding. Padding may be any bytes: another padding is
another layout, which costs time only. A plain tuple, because each message unpacks it.
"""

_EMPTY = Struct('').unpack_from
NO_LAYOUT: _Layout = (-1, _EMPTY, (), Struct('iI').unpack_from, _EMPTY, _EMPTY, (), ())


class JointStateReader:
    """
    Reads the selected joints of JointState payloads, in any order, of either byte order.

    A payload of a cached layout is read at fixed offsets; _parse is the general path, and never
    reads beyond the end. test_reading_equals_rclpy holds both equal to rclpy.
    """

    def __init__(self, joints: Collection[str]) -> None:
        self._joints = frozenset(joints)
        self._layouts: deque[_Layout] = deque(maxlen=MAX_LAYOUTS)
        self._last_layout = NO_LAYOUT

    def read(self, payload: bytes) -> JointReading:
        """Return the reading of a payload; raises WireError if it is malformed."""
        (size, fixed_of, fixed, stamp_of, positions_of, velocities_of, names,
         all_names) = self._last_layout
        if len(payload) != size or fixed_of(payload) != fixed:
            self._last_layout = self._layout_of(payload)
            return self.read(payload)
        seconds, nanoseconds = stamp_of(payload)
        stamp_ns = seconds * 1_000_000_000 + nanoseconds
        if stamp_ns >= STAMP_END_NS:
            raise WireError(f'stamp = {seconds} s + {nanoseconds} ns: {STAMP_RULE}')
        return names, positions_of(payload), velocities_of(payload), stamp_ns, all_names

    def _layout_of(self, payload: bytes) -> _Layout:
        for layout in self._layouts:
            size, fixed_of, fixed, *_ = layout
            if len(payload) == size and fixed_of(payload) == fixed:
                return layout
        layout = self._parse(payload)
        self._layouts.appendleft(layout)
        return layout

    def _parse(self, payload: bytes) -> _Layout:
        scan = Scan(payload, at=AFTER_STAMP_BYTES)
        scan.string()
        all_names = tuple([scan.string() for _ in range(scan.count())])
        selected = [index for index, name in enumerate(all_names) if name in self._joints]
        fixed = [(0, 'H'), (AFTER_STAMP_BYTES, f'{scan.at - AFTER_STAMP_BYTES}s')]
        sequences = []
        for _ in 'position', 'velocity', 'effort':
            count = scan.count()
            fixed.append((scan.at - 4, 'I'))
            start = scan.doubles(count)
            sequences.append([(start + 8 * index, 'd') for index in selected if index < count])
        order = scan.byte_order
        positions, velocities, _ = sequences
        fixed_of = _struct(order, fixed).unpack_from
        return (
            len(payload), fixed_of, fixed_of(payload),
            _struct(order, [(PREAMBLE_BYTES, 'i'), (PREAMBLE_BYTES + 4, 'I')]).unpack_from,
            _struct(order, positions).unpack_from, _struct(order, velocities).unpack_from,
            tuple([all_names[index] for index in selected]), all_names)


class Scan:
    """
    Reads a payload field by field, never beyond its end.

    Each method reads the next field and raises WireError if it is malformed.
    """

    def __init__(self, payload: bytes, at: int = PREAMBLE_BYTES) -> None:
        byte_order = BYTE_ORDERS.get(bytes(payload[:2]))
        if byte_order is None:
            raise WireError(f'encoding {payload[:2].hex()}: must be 0000 or 0001')
        self.byte_order = byte_order
        self.at = at
        self._payload = payload

    def count(self) -> int:
        """Return the next count."""
        count: int = self._values('I', 4, 'a count')[0]
        return count

    def stamp_ns(self) -> int:
        """Return the next stamp [ns]."""
        seconds, nanoseconds = self._values('iI', 4, 'a stamp')
        return int(seconds) * 1_000_000_000 + int(nanoseconds)

    def pose(self) -> tuple[float, float, float, float, float, float, float]:
        """Return the next Pose: x, y, z, quaternion x, y, z, w."""
        x, y, z, q_x, q_y, q_z, q_w = self._values('7d', 8, 'a pose')
        return x, y, z, q_x, q_y, q_z, q_w

    def string(self) -> str:
        """Return the next string."""
        size = self.count()
        start = self.at
        self._advance(size, 'a text')
        if size and self._payload[self.at - 1]:
            raise WireError(f'a text ends at byte {self.at} without a zero: must end with one')
        return self._payload[start:max(start, self.at - 1)].decode(errors='replace')

    def doubles(self, count: int) -> int:
        """Return the offset of the next doubles, and skip them."""
        if count:
            self._align(8)
        start = self.at
        self._advance(8 * count, 'a sequence')
        return start

    def _values(self, kind: str, size: int, what: str) -> tuple[Any, ...]:
        """Return the next values of a struct format, aligned to a size."""
        self._align(size)
        start, form = self.at, self.byte_order + kind
        self._advance(calcsize(form), what)
        return unpack_from(form, self._payload, start)

    def _align(self, size: int) -> None:
        self.at += -(self.at - PREAMBLE_BYTES) % size

    def _advance(self, size: int, what: str) -> None:
        end = self.at + size
        if end > len(self._payload):
            raise WireError(
                f'{what} ends at byte {end} of {len(self._payload)}: must end within the message')
        self.at = end


def _struct(byte_order: str, fields: Iterable[tuple[int, str]]) -> Struct:
    """Return a struct with each field at its offset."""
    form, end = byte_order, 0
    for start, code in fields:
        form += f'{start - end}x{code}'
        end = start + calcsize(byte_order + code)
    return Struct(form)


# Struct formats; x is a byte of zero. Only the planar components are written.
_POSE = 'dd24xdd'  # x, y, z; the rotation's x, y, z, w
_TWIST = 'd32xd'  # linear x, y, z; angular x, y, z
_UNUSED = Struct('<' '16xd24x' '24xd16x' '32xd8x')  # the middle rows of a covariance of six
_COVARIANCE = 'dd24xd' 'dd24xd' f'{_UNUSED.size}s' 'dd24xd'


class OdometryWriter:
    """Writes Odometry payloads; given diagonals replace the covariances."""

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
        return self._pack(  # at most 30 arguments: with more, CPython builds a list
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
    """Return strings from an aligned offset on, padded to the alignment of doubles."""
    text = b''
    for name in names:
        characters = name.encode() + b'\0'
        text += bytes(-len(text) % 4) + Struct('<I').pack(len(characters)) + characters
    return text + bytes(-(start - PREAMBLE_BYTES + len(text)) % 8)


def _of_diagonal(variances: Diagonal) -> tuple[Triangle | None, bytes]:
    """Return the planar covariance, and the rows of z, roll and pitch as bytes."""
    if variances is None:
        return None, _UNUSED.pack(UNKNOWN_VARIANCE, UNKNOWN_VARIANCE, UNKNOWN_VARIANCE)
    x, y, z, roll, pitch, yaw = (variance or UNKNOWN_VARIANCE for variance in variances)
    return (x, 0.0, 0.0, y, 0.0, yaw), _UNUSED.pack(z, roll, pitch)


def _capped(xx: float, xy: float, xt: float, yy: float, yt: float, tt: float) -> Triangle:
    """Return a covariance scaled to variances up to UNKNOWN_VARIANCE; correlations stay."""
    limit = UNKNOWN_VARIANCE
    x, y, theta = (sqrt(limit / max(variance, limit)) for variance in (xx, yy, tt))
    return (min(xx, limit), xy * x * y, xt * x * theta, min(yy, limit), yt * y * theta,
            min(tt, limit))
