"""
Logs: a rosbag2 folder, .mcap or .db3, or a CSV; the only file that opens them.

A CSV has the header stamp,left,right or stamp,left,right,x,y,theta: seconds that grow, wheel
angles [rad], continuous and growing as the robot drives forward, and a pose of the reference
[m, m, rad]. Wheels or pose may be empty in a row, so that each has a rate of its own. Of a bag,
wheels come from JointStates by name, and poses from Odometry, PoseStamped,
PoseWithCovarianceStamped or TF, by topic; what else is in it is passed over unread.
"""
from collections.abc import Iterable, Iterator, Mapping, Sequence
import csv
from dataclasses import dataclass
import math
from pathlib import Path
import struct
import tempfile
from typing import TYPE_CHECKING

from diffdrive_ros.core.cdr import JointStateReader, PLANAR, WireError
from diffdrive_ros.core.odometry import UNKNOWN_VARIANCE
from diffdrive_ros.core.quaternion import quaternion_of_heading
from diffdrive_ros.core.replay import Trajectory
from diffdrive_ros.core.validation import Array
from diffdrive_ros.core.wheel_feedback import WheelFeedback, WheelSample
from diffdrive_ros.tools.log_messages import JOINTS, POSES, SeenPose
import numpy as np
import numpy.typing as npt

if TYPE_CHECKING:
    from rosbags.interfaces import Connection

BAGS = ('.mcap', '.db3')
LATEST = 9e9  # [s], of a stamp: nanoseconds have to fit into 64 bits
LARGEST_ANGLE = 1e9  # [rad]; finer than a microradian up to there

COLUMNS = ['stamp', 'left', 'right']
WITH_REFERENCE = [*COLUMNS, 'x', 'y', 'theta']


class LogError(ValueError):
    """A log cannot be read, or has not what is asked for; the message says it in one line."""


@dataclass(frozen=True)
class Wanted:
    """What to read of a bag: topics, and the child frame if the reference is on TF."""

    wheels: str = 'joint_states'
    reference: str | None = None
    reference_child: str | None = None


@dataclass(frozen=True)
class Log:
    """The samples of the wheels, as the node would take them, and the reference, if wanted."""

    path: Path
    samples: list[WheelSample]
    reference: Trajectory | None

    @property
    def name(self) -> str:
        """Return the name by which people know the log."""
        return self.path.stem

    def wheels(self) -> tuple[npt.NDArray[np.int64], Array, Array]:
        """
        Return stamps [ns], left and right angles [rad], (N,), stamps growing.

        Raises LogError if time starts again in the log: then a stamp does not say when.
        """
        for sample in self.samples:
            if sample.time_reset_ns is not None:
                raise LogError(
                    f'{self.path}: time starts again at {sample.time_reset_ns * 1e-9:.3f} s: cut '
                    'the log there')
        stamps = np.array([sample.stamp_ns for sample in self.samples])
        angles = np.array([(sample.left, sample.right) for sample in self.samples])
        keep = np.concatenate([[True], stamps[1:] > np.maximum.accumulate(stamps)[:-1]])
        return stamps[keep], angles[keep, 0], angles[keep, 1]


def read(path: Path, feedback: WheelFeedback, wanted: Wanted | None = None) -> Log:
    """
    Return a log; feedback is how the node hears its wheels, and says what was wrong with them.

    Raises LogError.
    """
    wanted = wanted or Wanted()
    if not path.exists():
        raise LogError(f'{path}: no such file or folder')
    if path.is_dir() and not (path / 'metadata.yaml').is_file():
        raise LogError(f'{path}: is no rosbag2 folder: it has no metadata.yaml')
    if path.is_dir() or path.suffix in BAGS:
        samples, poses = _read_bag(path, feedback, wanted)
    elif path.suffix == '.csv':
        samples, poses = _read_csv(path)
    else:
        raise LogError(f'{path}: must be a rosbag2 folder, .mcap, .db3 or .csv')
    if len(samples) < 2:
        complaint = f': {feedback.warning}' if feedback.warning else ''
        raise LogError(
            f'{path}: {len(samples)} samples of all wheels, must be 2 or more{complaint}')
    return Log(path, samples, _trajectory(path, poses) if poses is not None else None)


# CSV

_Poses = list[SeenPose]


def _read_csv(path: Path) -> tuple[list[WheelSample], _Poses | None]:
    samples: list[WheelSample] = []
    poses: _Poses = []
    rows = _rows(path, COLUMNS, WITH_REFERENCE)
    _, header = next(rows)
    for where, row in rows:
        stamp_ns = _stamp_ns(row[0], where)
        if row[1].strip() or row[2].strip():
            left, right = _numbers(row[1:3], where)
            if max(abs(left), abs(right)) > LARGEST_ANGLE:
                raise LogError(f'{where}: {row[1]},{row[2]}: must be within {LARGEST_ANGLE:g} rad')
            if samples and stamp_ns <= samples[-1].stamp_ns:
                raise LogError(
                    f'{where}: stamp {row[0]} is not later than the one before: stamps of the '
                    'wheels must grow')
            samples.append(WheelSample(left, right, stamp_ns))
        if any(field.strip() for field in row[3:]):
            x, y, theta = _numbers(row[3:], where)
            poses.append(SeenPose(stamp_ns, '', '', (x, y, theta)))
    return samples, poses if header == WITH_REFERENCE else None


def read_ends(path: Path) -> dict[str, Array]:
    """Return the ends of squares by their direction, cw and ccw, (N, 2); raises LogError."""
    ends: dict[str, list[list[float]]] = {'cw': [], 'ccw': []}
    rows = _rows(path, ['direction', 'x', 'y'])
    next(rows)
    for where, row in rows:
        if row[0] not in ends:
            raise LogError(f'{where}: the direction is {row[0]}, must be cw or ccw')
        ends[row[0]].append(_numbers(row[1:], where))
    for direction, found in ends.items():
        if not found:
            raise LogError(f'{path}: has no {direction}: squares of both directions are needed')
    return {direction: np.array(found) for direction, found in ends.items()}


def _rows(path: Path, *headers: list[str]) -> Iterator[tuple[str, list[str]]]:
    """Yield the rows of a CSV, each with where it is, the header first; raises LogError."""
    try:
        with path.open(newline='', encoding='utf-8-sig') as file:
            rows = csv.reader(_whole_lines(path, file))
            header = [name.strip() for name in next(rows, [])]
            if header not in headers:
                raise LogError(
                    f'{path}: the header is {",".join(header) or "missing"}, must be '
                    + ' or '.join(','.join(each) for each in headers))
            yield str(path), header
            for row in rows:
                where = f'{path}, line {rows.line_num}'
                if not ''.join(row).strip():
                    continue
                if len(row) != len(header):
                    raise LogError(f'{where}: {len(row)} columns, must be {len(header)}')
                yield where, row
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise LogError(f'{path}: {error}') from None


def _whole_lines(path: Path, file: Iterable[str]) -> Iterator[str]:
    """Yield the lines of a file; raises LogError if the last one has no end."""
    for line in file:
        if not line.endswith(('\n', '\r')):  # its last number may lack digits
            raise LogError(
                f'{path}: the last line does not end: was it cut off? If it is whole, end it '
                'with a newline')
        yield line


def _stamp_ns(text: str, where: str) -> int:
    """Return seconds as integer nanoseconds, to the last digit."""
    seconds = _numbers([text], where)[0]
    if not abs(seconds) <= LATEST:
        raise LogError(f'{where}: stamp {text[:40]}: must be within {LATEST:g} s')
    whole, _, fraction = text.strip().partition('.')
    if whole.isdecimal() and (fraction.isdecimal() or not fraction):
        return int(whole) * 10**9 + int(fraction[:9].ljust(9, '0'))
    return round(seconds * 1e9)


def _numbers(texts: Sequence[str], where: str) -> list[float]:
    try:
        numbers = [float(text) for text in texts]
    except ValueError:
        numbers = [math.nan]
    if not all(map(math.isfinite, numbers)):
        raise LogError(f'{where}: {",".join(texts)[:80]!r}: must be finite numbers')
    return numbers


# Bags

def _read_bag(
    path: Path, feedback: WheelFeedback, wanted: Wanted,
) -> tuple[list[WheelSample], _Poses | None]:
    samples: list[WheelSample] = []
    poses: _Poses | None = None if wanted.reference is None else []
    with _Bag(path) as bag:
        wheels = bag.connections_of(wanted.wheels, [JOINTS])
        reference = bag.connections_of(
            wanted.reference, list(POSES)) if wanted.reference is not None else []
        joints = JointStateReader((*feedback.left_names, *feedback.right_names))
        heard: set[str] = set()
        readers = {connection.id: POSES[connection.msgtype] for connection in reference}
        for connection, received_ns, data in bag.messages([*wheels, *reference]):
            try:
                if connection.id in readers:
                    poses = [] if poses is None else poses
                    poses.extend(readers[connection.id](data))
                    continue
                names, positions, velocities, stamp_ns, all_names = joints.read(data)
            except WireError as error:
                raise LogError(
                    f'{path}: a message on {connection.topic}: {error}') from None
            # As the node does: without a stamp, the time of receipt stands in.
            sample = feedback.update(names, positions, velocities, stamp_ns or received_ns)
            if sample:
                samples.append(sample)
            else:
                heard.update(all_names)
    if not samples:
        joints_of_wheels = {*feedback.left_names, *feedback.right_names}
        missing = sorted(joints_of_wheels - heard or joints_of_wheels)
        raise LogError(
            f'{path}: no sample of {", ".join(missing)} on '
            f'{wanted.wheels}'
            + (f': {feedback.warning}' if feedback.warning else '')
            + f'; its joints are {", ".join(sorted(heard)) or "none"}')
    if poses is not None:
        poses = _of_one_child(path, wanted, poses)
    return samples, poses


class _Bag:
    """A bag, opened: what it has, in words of people; every error of its reader is a LogError."""

    def __init__(self, path: Path) -> None:
        self._path = path

    def __enter__(self) -> '_Bag':
        try:
            from rosbags.rosbag2 import Reader
        except ImportError:
            raise LogError(
                f'{self._path}: rosbags is needed to read bags: pip install rosbags') from None
        self._reader: Reader = self._guarded(Reader, self._path)
        self._guarded(self._reader.open)
        return self

    def __exit__(self, *_: object) -> None:
        self._reader.close()

    def connections_of(self, topic: str, types: Sequence[str]) -> 'list[Connection]':
        """Return the connections of a topic, with or without its first slash."""
        found = [
            connection for connection in self._reader.connections
            if connection.topic.strip('/') == topic.strip('/') and connection.msgtype in types]
        if not found:
            has = sorted({
                f'{connection.topic} ({connection.msgtype.rpartition("/")[2]})'
                for connection in self._reader.connections})
            kinds = ' or '.join(kind.rpartition('/')[2] for kind in types)
            raise LogError(
                f'{self._path}: no {kinds} on {topic}; it has {", ".join(has) or "no topic"}')
        return found

    def messages(
        self, connections: 'Sequence[Connection]',
    ) -> 'Iterator[tuple[Connection, int, bytes]]':
        """Yield connection, time of receipt [ns] and bytes."""
        messages = iter(self._reader.messages(connections))
        while (message := self._guarded(next, messages, None)) is not None:
            yield message

    def _guarded(self, function, *arguments):  # type: ignore[no-untyped-def]
        # What a damaged file makes of its reader: its own errors, and those of its parsers.
        try:
            return function(*arguments)
        except (KeyboardInterrupt, MemoryError):
            raise
        except Exception as error:
            detail = ' '.join(str(error).split()) or type(error).__name__
            repair = ' (mcap recover saves what is whole)' * (
                self._path.suffix == '.mcap' or any(self._path.glob('*.mcap')))
            raise LogError(
                f'{self._path}: cannot be read as a bag, was it cut off?{repair} {detail}'
            ) from None


def _of_one_child(path: Path, wanted: Wanted, poses: _Poses) -> _Poses:
    """Return the poses of the child frame that is wanted, or of the only one."""
    children = {(pose.frame, pose.child) for pose in poses}
    asked = {
        (frame, child) for frame, child in children
        if wanted.reference_child in (None, child)}
    if not poses:
        raise LogError(f'{path}: no message on {wanted.reference}')
    if len(asked) != 1:
        listed = ', '.join(f'{child or "-"} in {frame}' for frame, child in sorted(children))
        which = f'{wanted.reference_child} is none' if wanted.reference_child else 'name one'
        raise LogError(
            f'{path}: {wanted.reference} has poses of several frames, {which} of {listed}')
    (only,) = asked
    return [pose for pose in poses if (pose.frame, pose.child) == only]


def _trajectory(path: Path, poses: _Poses) -> Trajectory:
    """Return the poses in the order of their stamps, without those that are none."""
    finite = {pose.stamp_ns: pose for pose in poses if all(map(math.isfinite, pose.pose))}
    if len(finite) < 2:
        raise LogError(f'{path}: the reference has {len(finite)} poses, must be 2 or more')
    stamps = sorted(finite)
    array = np.array([finite[stamp].pose for stamp in stamps])
    array[:, 2] = np.unwrap(array[:, 2])
    return Trajectory(np.array(stamps), array, finite[stamps[0]].frame)


# Out

def write_csv(path: Path, columns: Mapping[str, Array], stamps_ns: Sequence[int]) -> None:
    """Write columns, with their stamps [s] before them, as a CSV."""
    with path.open('w', newline='', encoding='utf-8') as file:
        rows = csv.writer(file, lineterminator='\n')
        rows.writerow(['stamp', *columns])
        for stamp_ns, values in zip(stamps_ns, zip(*columns.values(), strict=True), strict=True):
            rows.writerow([_seconds(stamp_ns), *(f'{value:.9g}' for value in values)])


def write_tum(path: Path, stamps_ns: Sequence[int], poses: Array) -> None:
    """Write poses as TUM's text: stamp x y z q_x q_y q_z q_w."""
    with path.open('w', encoding='utf-8') as file:
        for stamp_ns, (x, y, theta) in zip(stamps_ns, poses.tolist(), strict=True):
            q_z, q_w = quaternion_of_heading(theta)
            file.write(
                f'{_seconds(stamp_ns)} {x:.9f} {y:.9f} 0 0 0 {q_z:.9f} {q_w:.9f}\n')


def write_odometry(
    path: Path, stamps_ns: Sequence[int], poses: Array, twists: Array, pose_covariances: Array,
    twist_covariances: Array, odom_frame: str, base_frame: str,
) -> None:
    """Write Odometry on /odom as an .mcap, that of the node, message by message."""
    values = np.zeros((len(stamps_ns), 7 + 36 + 6 + 36))
    values[:, 0:2] = poses[:, :2]
    values[:, 5], values[:, 6] = np.sin(poses[:, 2] / 2.0), np.cos(poses[:, 2] / 2.0)
    values[:, 43], values[:, 44], values[:, 48] = twists.T
    for begin, covariances in ((7, pose_covariances), (49, twist_covariances)):
        wide = np.zeros((len(stamps_ns), 6, 6))
        wide[:, (2, 3, 4), (2, 3, 4)] = UNKNOWN_VARIANCE
        wide[np.ix_(range(len(stamps_ns)), PLANAR, PLANAR)] = covariances
        values[:, begin:begin + 36] = wide.reshape(-1, 36)
    frames = _padded(_padded(_string(odom_frame), 4) + _string(base_frame), 8)
    with _Writer(path, {'/odom': 'nav_msgs/msg/Odometry'}) as writer:
        for stamp_ns, row in zip(stamps_ns, values, strict=True):
            writer.write('/odom', stamp_ns, frames + row.astype('<f8').tobytes())


def _string(text: str) -> bytes:
    data = text.encode() + b'\0'
    return struct.pack('<I', len(data)) + data


def _seconds(stamp_ns: int) -> str:
    return f'{stamp_ns // 10**9}.{stamp_ns % 10**9:09d}'


class _Writer:
    """An .mcap; rosbags writes folders, of which the one file is taken."""

    def __init__(self, path: Path, topics: Mapping[str, str]) -> None:
        self._path, self._topics = path, topics

    def __enter__(self) -> '_Writer':
        try:
            from rosbags.rosbag2 import StoragePlugin, Writer
            from rosbags.typesys import get_typestore, Stores
        except ImportError:
            raise LogError(
                f'{self._path}: rosbags is needed to write it: pip install rosbags') from None
        self._folder = tempfile.TemporaryDirectory(dir=self._path.resolve().parent)
        self._writer = Writer(
            Path(self._folder.name) / 'bag', version=9, storage_plugin=StoragePlugin.MCAP)
        self._writer.open()
        self._connections = {
            topic: self._writer.add_connection(
                topic, kind, typestore=get_typestore(Stores.ROS2_JAZZY))
            for topic, kind in self._topics.items()}
        return self

    def write(self, topic: str, stamp_ns: int, body: bytes) -> None:
        """Write one message, stamped and received then; body is what follows its stamp."""
        head = b'\0\1\0\0' + struct.pack('<iI', *divmod(stamp_ns, 10**9))
        self._writer.write(self._connections[topic], stamp_ns, head + body)

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        self._writer.close()
        if kind is None:
            (Path(self._folder.name) / 'bag' / 'bag.mcap').replace(self._path)
        self._folder.cleanup()


class DriveWriter(_Writer):
    """An .mcap of a drive: JointStates, and a reference as PoseStamped."""

    def __init__(self, path: Path, wheels: str, reference: str) -> None:
        super().__init__(path, {wheels: JOINTS, reference: 'geometry_msgs/msg/PoseStamped'})
        self._wheels, self._reference = wheels, reference

    def __enter__(self) -> 'DriveWriter':
        super().__enter__()
        return self

    def write_joints(self, stamp_ns: int, names: Sequence[str], positions: Array) -> None:
        """Write a JointState with positions [rad]."""
        body = _string('')
        body = _padded(body, 4) + struct.pack('<I', len(names))
        for name in names:
            body = _padded(body, 4) + _string(name)
        body = _padded(body, 4) + struct.pack('<I', len(names))
        body = _padded(body, 8) + positions.astype('<f8').tobytes() + struct.pack('<II', 0, 0)
        self.write(self._wheels, stamp_ns, body)

    def write_pose(self, stamp_ns: int, frame: str, pose: tuple[float, float, float]) -> None:
        """Write a PoseStamped of a pose in the plane."""
        x, y, theta = pose
        body = _padded(_string(frame), 8) + struct.pack(
            '<7d', x, y, 0.0, 0.0, 0.0, *quaternion_of_heading(theta))
        self.write(self._reference, stamp_ns, body)


def _padded(body: bytes, size: int) -> bytes:
    """Return bytes filled up for what is aligned to a size; the stamp before them takes 8."""
    return body + b'\0' * (-len(body) % size)
