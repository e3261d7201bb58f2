"""The arrows between the folders of the package, as doc/architecture.md draws them."""
import ast
from collections.abc import Iterable, Iterator
from graphlib import TopologicalSorter
import os
from pathlib import Path
import re
import subprocess
import sys

import diffdrive_ros
import pytest

PACKAGE = Path(diffdrive_ros.__file__).parent
ROS = re.compile(
    r'(rcl|ros(?!bags)|ament|tf2|builtin_interfaces|unique_identifier|.*_(msgs|srvs)$)')

# Folder: the folders and the third parties that it may import; 'ros' is every package of ROS.
ARROWS = {
    '': ({'core'}, set()),
    'core': (set(), {'numpy'}),
    'node': ({'core'}, {'numpy', 'ros'}),
    'calibration': ({'core'}, {'numpy', 'scipy'}),
    'tools': ({'calibration', 'core'}, {
        'matplotlib', 'numpy', 'rich', 'rosbags', 'threadpoolctl', 'yaml'}),
    'dashboard': ({'node', 'core'}, {'fastapi', 'nicegui', 'numpy', 'ros', 'starlette'}),
    'demo': ({'node', 'tools', 'core'}, {'numpy', 'rich', 'ros'}),
}
# Of the standard library, what has a clock, a file or a process.
NOT_IN_CORE = {'asyncio', 'datetime', 'io', 'os', 'pathlib', 'socket', 'subprocess', 'time'}

LONGEST = 400  # lines
# Online and batch odometry share their steps.
MAY_BE_LONGER = {'core.odometry'}

FILES = {
    '.'.join(path.relative_to(PACKAGE).with_suffix('').parts): path
    for path in sorted(PACKAGE.rglob('*.py'))}

BLOCK_ROS = f"""
import importlib, re, sys

ROS = re.compile({ROS.pattern!r})


class NoRos:
    def find_spec(self, name, path=None, target=None):
        if ROS.match(name.partition('.')[0]):
            raise ModuleNotFoundError(f'{{name}} is blocked')


sys.meta_path.insert(0, NoRos())
for name in 'rclpy', 'builtin_interfaces.msg', 'rcl_interfaces.msg', 'sensor_msgs', 'tf2_ros':
    try:
        importlib.import_module(name)
    except ModuleNotFoundError as error:
        assert str(error).endswith('is blocked')
    else:
        raise AssertionError(f'{{name}} is not blocked')
"""

DRIVE_A_CIRCLE = """
from math import pi

from diffdrive_ros import DiffDrive, Odometry
from diffdrive_ros.core.wheel_commander import WheelCommander
from diffdrive_ros.core.wheel_feedback import WheelFeedback

drive = DiffDrive(0.317, 0.0471, 0.0533)
commander, odometry = WheelCommander(drive, timeout=0.5), Odometry(drive)
feedback = WheelFeedback(left_names=['l'], right_names=['r'])
commander.accept(2.0 * pi, 2.0 * pi, 0)
sent = commander.step(0)
for tenths in range(11):
    angles = [sent.left * tenths / 10.0, sent.right * tenths / 10.0]
    sample = feedback.update(['l', 'r'], angles, [], tenths * 10**8)
    odometry.update(sample.left, sample.right, sample.stamp_ns)
print(*odometry.pose.round(9) + 0.0)
"""


def imports(module: str) -> Iterator[str]:
    """Yield the full name of each import in a module, inside functions and TYPE_CHECKING too."""
    for node in ast.walk(ast.parse(FILES[module].read_text(encoding='utf-8'))):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            assert not node.level, 'imports are absolute'
            yield from (f'{node.module}.{alias.name}' for alias in node.names)


def own_modules(names: Iterable[str]) -> set[str]:
    """Return the modules of the package among the names of imports."""
    inside = [name.partition('.')[2] for name in names if name.startswith('diffdrive_ros.')]
    return {name if name in FILES else name.rpartition('.')[0] for name in inside}


def folder_of(module: str) -> str:
    """Return the folder of a module, '' for the package itself."""
    return module.rpartition('.')[0]


@pytest.mark.parametrize('module', FILES)
def test_module_imports_only_what_its_folder_may(module: str) -> None:
    folders, third_parties = ARROWS[folder_of(module)]
    names = list(imports(module))
    used = {folder_of(own) for own in own_modules(names)}
    assert used - {folder_of(module)} <= folders
    packages = {name.partition('.')[0] for name in names} - {'diffdrive_ros'}
    others = packages - set(sys.stdlib_module_names)
    assert {'ros' if ROS.match(name) else name for name in others} <= third_parties
    if folder_of(module) == 'core':
        assert not packages & NOT_IN_CORE


def test_modules_have_no_import_circle() -> None:
    graph = {module: own_modules(imports(module)) for module in FILES}
    assert len(list(TopologicalSorter(graph).static_order())) >= len(FILES)


def test_simulation_shares_no_code_with_odometry() -> None:
    assert own_modules(imports('core.simulation')) == {'core.validation'}


@pytest.mark.parametrize('module', FILES)
def test_file_is_short_enough_to_read(module: str) -> None:
    lines = len(FILES[module].read_text(encoding='utf-8').splitlines())
    assert lines <= LONGEST or module in MAY_BE_LONGER


def test_core_and_tools_import_where_ros_is_blocked() -> None:
    modules = [module for module in FILES
               if folder_of(module) in ('core', 'calibration', 'tools')]
    code = ''.join(f'import diffdrive_ros.{module}\n' for module in modules)
    path = os.pathsep.join(filter(None, [str(PACKAGE.parent), os.environ.get('PYTHONPATH')]))
    output = subprocess.run(
        [sys.executable, '-c', BLOCK_ROS + code + DRIVE_A_CIRCLE], check=True, timeout=60,
        text=True, stdout=subprocess.PIPE, env={**os.environ, 'PYTHONPATH': path}).stdout
    assert output.split() == ['0.0', '0.0', '6.283185307']


def test_public_names_are_all_that_the_package_exports() -> None:
    for name in diffdrive_ros.__all__:
        assert hasattr(diffdrive_ros, name)
    public = {name for name in vars(diffdrive_ros) if not name.startswith('_')}
    folders = {folder for folder in ARROWS if folder}
    assert public - folders == set(diffdrive_ros.__all__)
