"""Test the CDR reader and writers: equal to the serialization of rclpy, byte for byte."""
import math
import struct

from diffdrive_ros.core.cdr import JointStateReader, OdometryWriter, TransformWriter, WireError
from diffdrive_ros.core.kinematics import DiffDrive
from diffdrive_ros.core.odometry import Odometry
from geometry_msgs.msg import TransformStamped
from hypothesis import given, strategies as st
from nav_msgs.msg import Odometry as OdometryMessage
import numpy as np
import pytest
from rclpy.serialization import deserialize_message, serialize_message
from sensor_msgs.msg import JointState

JOINTS = ('front_left', 'rear_right', 'ĺ')  # the last one is of two bytes

numbers = st.floats(allow_nan=True, allow_infinity=True)
names = st.lists(st.sampled_from((*JOINTS, 'arm', '', 'front_lef', 'front_left2')), max_size=9)
stamps = st.tuples(st.integers(-2**31, 2**31 - 6), st.integers(0, 2**32 - 1))


@st.composite
def joint_states(draw: st.DrawFn) -> JointState:
    """Draw any message, with sequences of any lengths."""
    message = JointState(
        name=draw(names), position=draw(st.lists(numbers, max_size=9)),
        velocity=draw(st.lists(numbers, max_size=9)), effort=draw(st.lists(numbers, max_size=3)))
    message.header.stamp.sec, message.header.stamp.nanosec = draw(stamps)
    message.header.frame_id = draw(st.sampled_from(('', 'base', 'arm_base', 'ĺ')))
    return message


def payload(message: JointState, order: str = '<', fill: int = 0) -> bytes:
    """Return a serialized message in either byte order, with the padding bytes set to fill."""
    body = bytearray()

    def add(code: str, *values: object) -> None:
        size = struct.calcsize(order + code)
        body.extend([fill] * (-len(body) % size))
        for value in values:
            body.extend(struct.pack(order + code, value))

    def add_text(text: str) -> None:
        characters = text.encode() + b'\0'
        add('I', len(characters))
        body.extend(characters)

    add('i', message.header.stamp.sec)
    add('I', message.header.stamp.nanosec)
    add_text(message.header.frame_id)
    add('I', len(message.name))
    for name in message.name:
        add_text(name)
    for sequence in message.position, message.velocity, message.effort:
        add('I', len(sequence))
        if sequence:
            add('d', *sequence)
    return (b'\0\0\0\0' if order == '>' else b'\0\1\0\0') + bytes(body)


def expected(message: JointState) -> tuple:
    """Return the expected reading of the joints."""
    ours = [index for index, name in enumerate(message.name) if name in JOINTS]
    return (
        tuple(message.name[i] for i in ours),
        tuple(message.position[i] for i in ours if i < len(message.position)),
        tuple(message.velocity[i] for i in ours if i < len(message.velocity)),
        message.header.stamp.sec * 10**9 + message.header.stamp.nanosec,
        tuple(message.name))


def same(got: tuple, wanted: tuple) -> bool:
    """Return whether two readings are equal; NaN is equal to NaN."""
    return repr(got) == repr(wanted)


@given(joint_states())
def test_oracle_writes_what_rclpy_writes(message: JointState) -> None:
    """The oracle in either byte order equals rclpy in its own, except padding bytes."""
    theirs = serialize_message(message)
    zeros, ones = payload(message), payload(message, fill=255)
    assert 0 <= len(theirs) - len(zeros) < 32  # spare capacity
    for ours, filled, byte in zip(zeros, ones, theirs, strict=False):
        assert ours == byte or filled == 255
    assert same(expected(deserialize_message(zeros, JointState)), expected(message))


@given(st.lists(joint_states(), min_size=1, max_size=12), st.data())
def test_reading_equals_rclpy(
        messages: list[JointState], data: st.DataObject) -> None:
    """Layouts repeat and change, in either byte order, with any padding."""
    reader = JointStateReader(JOINTS)
    for message in messages:
        order, fill = data.draw(st.sampled_from('<>')), data.draw(st.sampled_from((0, 1, 255)))
        assert same(reader.read(payload(message, order, fill)), expected(message))
        moved = JointState(
            header=message.header, name=message.name, position=message.position[::-1],
            velocity=message.velocity, effort=message.effort)
        moved.header.stamp.nanosec ^= 12345
        assert same(reader.read(payload(moved, order, fill)), expected(moved))


@given(joint_states())
def test_payload_of_rclpy_is_read(message: JointState) -> None:
    """Its padding bytes are undefined."""
    assert same(JointStateReader(JOINTS).read(serialize_message(message)), expected(message))


@given(joint_states(), st.sampled_from('<>'), st.data())
def test_truncated_payload_is_rejected(
        message: JointState, order: str, data: st.DataObject) -> None:
    """At any byte, also with the layout cached; the whole message is still read afterwards."""
    whole = payload(message, order)
    reader = JointStateReader(JOINTS)
    reader.read(whole)
    cut = whole[:data.draw(st.integers(0, len(whole) - 1))]
    with pytest.raises(WireError, match=r'must (be|end)'):
        reader.read(cut)
    assert same(reader.read(whole), expected(message))


@given(joint_states(), st.data())
def test_corrupt_bytes_are_read_or_rejected(message: JointState, data: st.DataObject) -> None:
    """A cached layout does not change what is read of a corrupt message."""
    wrong = bytearray(payload(message))
    reader = JointStateReader(JOINTS)
    reader.read(bytes(wrong))
    for _ in range(data.draw(st.integers(1, 4))):
        wrong[data.draw(st.integers(0, len(wrong) - 1))] = data.draw(st.integers(0, 255))
    try:
        got = reader.read(bytes(wrong))
    except WireError:
        return
    assert same(JointStateReader(JOINTS).read(bytes(wrong)), got)
    assert len(got[0]) == sum(name in JOINTS for name in got[4])


def test_stamp_out_of_range_is_rejected() -> None:
    """The nanoseconds overflow the last second of the type."""
    message = JointState(name=['front_left'], position=[1.0])
    message.header.stamp.sec, message.header.stamp.nanosec = 2**31 - 1, 10**9
    with pytest.raises(WireError, match=r'^stamp = 2147483647 s \+ 1000000000 ns: must be before'):
        JointStateReader(JOINTS).read(payload(message))


def test_string_without_terminator_is_rejected() -> None:
    """Its last character is not part of the name."""
    whole = payload(JointState(name=['front_left'], position=[1.0]))
    with pytest.raises(WireError, match='without a zero: must end with one'):
        JointStateReader(JOINTS).read(whole.replace(b'left\0', b'leftX'))


def test_counts_beyond_the_payload_are_rejected_with_offset() -> None:
    """A count of 4 * 10^9 costs neither time nor memory."""
    whole = payload(JointState(name=['front_left'], position=[1.0]))
    wrong_length = whole.replace(struct.pack('<I', 11), struct.pack('<I', 2**32 - 1))
    with pytest.raises(WireError, match=r'^a text ends at byte 4294967\d+ of \d+: must end with'):
        JointStateReader(JOINTS).read(wrong_length)
    many = whole[:20] + struct.pack('<I', 2**32 - 1) + whole[24:]
    with pytest.raises(WireError, match='must end within the message'):
        JointStateReader(JOINTS).read(many)


@pytest.mark.parametrize('preamble', [b'\0\2\0\0', b'\0\7\0\0', b'\1\1\0\0', b'PK\3\4'])
def test_unsupported_encoding_is_rejected(preamble: bytes) -> None:
    """Parameter lists and XCDR version 2 have another layout."""
    whole = payload(JointState(name=['front_left'], position=[1.0]))
    reader = JointStateReader(JOINTS)
    reader.read(whole)
    with pytest.raises(WireError, match=f'^encoding {preamble[:2].hex()}: must be 0000 or 0001'):
        reader.read(preamble + whole[4:])


frames = st.sampled_from(('odom', 'o', '', 'robot1/odom', 'ĺ', 'x' * 255))
finite = st.floats(-1e5, 1e5)
variance = st.floats(0.0, 1e5)
nanoseconds = st.integers(0, 2**31 * 10**9 - 1)


@st.composite
def estimates(draw: st.DrawFn) -> tuple:
    """Draw an estimate as Odometry gives it."""
    pose = draw(st.tuples(finite, finite, finite))
    covariances = [
        (draw(variance), draw(finite), draw(finite), draw(variance), draw(finite), draw(variance))
        for _ in range(2)]
    return pose, covariances[0], draw(st.tuples(finite, finite)), covariances[1]


def rotation(theta: float) -> tuple[float, float]:
    """Return z and w of the rotation by a heading [rad]."""
    z, w = math.sin(0.5 * theta), math.cos(0.5 * theta)
    return (z, w) if w >= 0.0 else (-z, -w)


@given(finite)
def test_written_quaternion_has_w_not_negative(theta: float) -> None:
    """Each heading has two quaternions; by convention, w >= 0 is written."""
    estimate = (0.0, 0.0, theta), (1.0, 0.0, 0.0, 1.0, 0.0, 1.0)
    message = deserialize_message(
        OdometryWriter('o', 'b').write(0, (*estimate, (0.0, 0.0), estimate[1])), OdometryMessage)
    z, w = message.pose.pose.orientation.z, message.pose.pose.orientation.w
    assert w >= 0.0
    assert math.remainder(2.0 * math.atan2(z, w) - theta, 2.0 * math.pi) == pytest.approx(
        0.0, abs=1e-9)


def as_message(stamp_ns: int, odom: str, base: str, estimate: tuple) -> OdometryMessage:
    """Return the message of an estimate, filled field by field."""
    (x, y, theta), pose_covariance, (linear, angular), twist_covariance = estimate
    message = OdometryMessage(child_frame_id=base)
    message.header.frame_id = odom
    message.header.stamp.sec, message.header.stamp.nanosec = divmod(stamp_ns, 10**9)
    pose, twist = message.pose.pose, message.twist.twist
    pose.position.x, pose.position.y = x, y
    pose.orientation.z, pose.orientation.w = rotation(theta)
    twist.linear.x, twist.angular.z = linear, angular
    for part, covariance in (message.pose, pose_covariance), (message.twist, twist_covariance):
        matrix = np.diag([0.0, 0.0, 1e6, 1e6, 1e6, 0.0])
        for value, (row, column) in zip(
                covariance, [(0, 0), (0, 1), (0, 5), (1, 1), (1, 5), (5, 5)], strict=True):
            matrix[row, column] = matrix[column, row] = value
        part.covariance = matrix.ravel()
    return message


def is_written(written: bytes, message: object) -> bool:
    """Return whether bytes are those of a message, except the padding bytes of rclpy."""
    theirs = serialize_message(message)
    return deserialize_message(written, type(message)) == message and len(written) <= len(theirs)


@given(nanoseconds, frames, frames, estimates())
def test_odometry_equals_rclpy(
        stamp_ns: int, odom: str, base: str, estimate: tuple) -> None:
    """Read by rclpy, every field is what a message filled by hand has."""
    written = OdometryWriter(odom, base).write(stamp_ns, estimate)
    assert is_written(written, as_message(stamp_ns, odom, base, estimate))


@given(nanoseconds, estimates())
def test_odometry_without_padding_equals_rclpy_byte_for_byte(
        stamp_ns: int, estimate: tuple) -> None:
    """With frames of three characters and of eleven, rclpy leaves no byte undefined."""
    written = OdometryWriter('map', 'robot1/base').write(stamp_ns, estimate)
    theirs = serialize_message(as_message(stamp_ns, 'map', 'robot1/base', estimate))
    assert written == theirs[:len(written)]


def test_given_diagonal_is_written() -> None:
    """Zeros stand for what is not known."""
    writer = OdometryWriter('odom', 'base', (1.0, 2.0, 3.0, 4.0, 5.0, 6.0), (0.0, 7.0, *[0.0] * 4))
    message = deserialize_message(
        writer.write(5, Odometry(DiffDrive(0.317, 0.0471, 0.0533)).estimate()), OdometryMessage)
    assert np.array_equal(
        np.reshape(message.pose.covariance, (6, 6)), np.diag([1.0, 2.0, 3.0, 4.0, 5.0, 6.0]))
    assert np.array_equal(
        np.reshape(message.twist.covariance, (6, 6)), np.diag([1e6, 7.0, 1e6, 1e6, 1e6, 1e6]))


@given(st.tuples(*[st.floats(0.0, 1e150)] * 3), st.tuples(*[st.floats(-0.99, 0.99)] * 3))
def test_variances_are_capped_and_correlations_stay(
        deviations: tuple, tilts: tuple) -> None:
    """The covariance stays invertible, as filters need it."""
    factor = np.array([[1.0, 0.0, 0.0], [tilts[0], 1.0, 0.0], [tilts[1], tilts[2], 1.0]])
    factor /= np.linalg.norm(factor, axis=1)[:, np.newaxis]
    matrix = factor @ factor.T * np.multiply.outer(deviations, deviations)
    upper = tuple(matrix[np.triu_indices(3)].tolist())
    estimate = (0.0, 0.0, 0.0), upper, (0.0, 0.0), (1.0, 0.0, 0.0, 1.0, 0.0, 1.0)
    message = deserialize_message(OdometryWriter('o', 'b').write(0, estimate), OdometryMessage)
    got = np.reshape(message.pose.covariance, (6, 6))[np.ix_((0, 1, 5), (0, 1, 5))]
    assert np.diag(got) == pytest.approx(np.minimum(np.diag(matrix), 1e6), rel=1e-9)
    assert np.linalg.eigvalsh(got).min() >= -1e-9 * got.max()
    scale = np.sqrt(np.outer(np.diag(got), np.diag(got)))
    assert got == pytest.approx(factor @ factor.T * scale, rel=1e-6, abs=1e-9)


@given(nanoseconds, frames, frames, finite, finite, finite)
def test_transform_equals_rclpy(
        stamp_ns: int, odom: str, base: str, x: float, y: float, theta: float) -> None:
    """A TFMessage is a count and transforms; rclpy writes the one transform."""
    written = TransformWriter(odom, base).write(stamp_ns, x, y, theta)
    transform = TransformStamped(child_frame_id=base)
    transform.header.frame_id = odom
    transform.header.stamp.sec, transform.header.stamp.nanosec = divmod(stamp_ns, 10**9)
    translation, quaternion = transform.transform.translation, transform.transform.rotation
    translation.x, translation.y = x, y
    quaternion.z, quaternion.w = rotation(theta)
    assert is_tf_message(written, transform)


def is_tf_message(written: bytes, transform: TransformStamped) -> bool:
    """Return whether bytes are a TFMessage of one transform; with tf2_msgs, by rclpy's reading."""
    try:
        from tf2_msgs.msg import TFMessage
    except ImportError:
        return written[:8] == b'\0\1\0\0\1\0\0\0' and len(written) % 8 == 4
    return deserialize_message(written, TFMessage) == TFMessage(transforms=[transform])


@given(st.lists(st.tuples(*[st.floats(-3.0, 3.0)] * 2), max_size=15), st.integers(1, 4))
def test_estimate_has_the_values_of_the_arrays(steps: list, window: int) -> None:
    """Plain floats for the message equal the arrays of the properties."""
    odometry = Odometry(DiffDrive(0.317, 0.0471, 0.0533), window=window)
    left = right = 0.0
    for k, (by_left, by_right) in enumerate(steps):
        left, right = left + by_left, right + by_right
        odometry.update(left, right, k * 20_000_001)
    pose, pose_covariance, twist, twist_covariance = odometry.estimate()
    assert pose == tuple(odometry.pose)
    assert (twist[0], 0.0, twist[1]) == tuple(odometry.twist)
    for covariance, matrix in (
            (pose_covariance, odometry.pose_covariance),
            (twist_covariance, odometry.twist_covariance)):
        assert covariance == tuple(matrix[np.triu_indices(3)].tolist())
