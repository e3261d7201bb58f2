"""
CSV files: logs, the end poses of squares, and poses as CSV or as TUM's text.

A log has the header stamp,left,right or stamp,left,right,x,y,theta: stamps [s] that increase,
wheel angles [rad], continuous and increasing as the robot drives forward, and a pose of the
reference [m, m, rad]. Wheels or pose may be empty in a row, so that each has its own rate.
"""
from collections.abc import Iterable, Iterator, Sequence
import csv
import math
from pathlib import Path

from diffdrive_ros.core.quaternion import quaternion_of_heading
from diffdrive_ros.core.validation import Array, UserError
from diffdrive_ros.core.wheel_feedback import WheelSample
from diffdrive_ros.tools.bags import StampedPose
import numpy as np

MAX_STAMP_S = 9e9  # nanoseconds have to fit into 64 bits
MAX_ANGLE_RAD = 1e9  # a double resolves a microradian up to there

COLUMNS = ['stamp', 'left', 'right']
COLUMNS_WITH_REFERENCE = [*COLUMNS, 'x', 'y', 'theta']


# Reading

def read_csv(path: Path) -> tuple[list[WheelSample], list[StampedPose] | None]:
    """Return the samples of the wheels, and the poses if there are columns; raises UserError."""
    samples: list[WheelSample] = []
    poses: list[StampedPose] = []
    row: list[str] = []
    for where, row in _rows(path, COLUMNS, COLUMNS_WITH_REFERENCE):
        stamp_ns = _stamp_ns(row[0], where)
        if row[1].strip() or row[2].strip():
            left, right = _numbers(row[1:3], where)
            if max(abs(left), abs(right)) > MAX_ANGLE_RAD:
                raise UserError(
                    f'{where}: {row[1]},{row[2]}: must be within {MAX_ANGLE_RAD:g} rad')
            if samples and stamp_ns <= samples[-1].stamp_ns:
                raise UserError(
                    f'{where}: stamp {row[0]} is not later than the one before: stamps of the '
                    'wheels must increase')
            samples.append(WheelSample(left, right, stamp_ns))
        if any(field.strip() for field in row[3:]):
            x, y, theta = _numbers(row[3:], where)
            poses.append(StampedPose(stamp_ns, '', '', (x, y, theta)))
    return samples, poses if len(row) == len(COLUMNS_WITH_REFERENCE) else None


def read_end_errors(path: Path) -> dict[str, Array]:
    """Return the end errors of squares by direction, cw and ccw, (N, 2); raises UserError."""
    errors: dict[str, list[list[float]]] = {'cw': [], 'ccw': []}
    for where, row in _rows(path, ['direction', 'x', 'y']):
        if row[0] not in errors:
            raise UserError(f'{where}: direction = {row[0]}: must be cw or ccw')
        errors[row[0]].append(_numbers(row[1:], where))
    for direction, found in errors.items():
        if not found:
            raise UserError(f'{path}: has no {direction}: squares of both directions are needed')
    return {direction: np.array(found) for direction, found in errors.items()}


def _rows(path: Path, *headers: list[str]) -> Iterator[tuple[str, list[str]]]:
    """Yield the rows of a CSV, each with its line number, the header checked; raises UserError."""
    try:
        with path.open(newline='', encoding='utf-8-sig') as file:
            rows = csv.reader(_whole_lines(path, file))
            header = [name.strip() for name in next(rows, [])]
            if header not in headers:
                raise UserError(
                    f'{path}: the header is {",".join(header) or "missing"}, must be '
                    + ' or '.join(','.join(each) for each in headers))
            for row in rows:
                where = f'{path}, line {rows.line_num}'
                if not ''.join(row).strip():
                    continue
                if len(row) != len(header):
                    raise UserError(f'{where}: {len(row)} columns, must be {len(header)}')
                yield where, row
    except (UnicodeDecodeError, csv.Error) as error:
        raise UserError(f'{path}: {error}') from None


def _whole_lines(path: Path, file: Iterable[str]) -> Iterator[str]:
    """Yield the lines of a file; raises UserError if the last one has no end."""
    for line in file:
        if not line.endswith(('\n', '\r')):  # its last number may lack digits
            raise UserError(
                f'{path}: the last line does not end: was it cut off? If it is whole, end it '
                'with a newline')
        yield line


def _stamp_ns(text: str, where: str) -> int:
    """Return seconds as integer nanoseconds, to the last digit."""
    seconds = _numbers([text], where)[0]
    if not abs(seconds) <= MAX_STAMP_S:
        raise UserError(f'{where}: stamp {text[:40]}: must be within {MAX_STAMP_S:g} s')
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
        raise UserError(f'{where}: {",".join(texts)[:80]!r}: must be finite numbers')
    return numbers


# Writing

def write_csv(path: Path, stamps_ns: Sequence[int], poses: Array) -> None:
    """Write poses, (N, 3), as a CSV: stamp,x,y,theta."""
    with path.open('w', newline='', encoding='utf-8') as file:
        file.write('stamp,x,y,theta\n')
        for stamp_ns, pose in zip(stamps_ns, poses.tolist(), strict=True):
            file.write(','.join([_seconds(stamp_ns), *(f'{value:.9g}' for value in pose)]) + '\n')


def write_tum(path: Path, stamps_ns: Sequence[int], poses: Array) -> None:
    """Write poses, (N, 3), as TUM's text: stamp x y z q_x q_y q_z q_w."""
    with path.open('w', encoding='utf-8') as file:
        for stamp_ns, (x, y, theta) in zip(stamps_ns, poses.tolist(), strict=True):
            q_z, q_w = quaternion_of_heading(theta)
            file.write(
                f'{_seconds(stamp_ns)} {x:.9f} {y:.9f} 0 0 0 {q_z:.9f} {q_w:.9f}\n')


def _seconds(stamp_ns: int) -> str:
    return f'{stamp_ns // 10**9}.{stamp_ns % 10**9:09d}'
