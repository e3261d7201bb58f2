"""The core stands on numpy alone, and its modules on each other in one direction."""
import ast
import os
from pathlib import Path
import subprocess
import sys

import diffdrive_ros
import pytest

PACKAGE = Path(diffdrive_ros.__file__).parent

# What each module of the core may stand on, besides numpy and the standard library.
CORE = {
    'core.validation': set(),
    'core.se2': {'core.validation'},
    'core.kinematics': {'core.validation', 'core.se2'},
    'core.odometry': {'core.validation', 'core.se2', 'core.kinematics'},
    'calibration.linearization': {'core.validation', 'core.se2', 'core.kinematics',
                                  'core.odometry'},
    'calibration.end_pose': {'core.validation', 'core.se2', 'core.kinematics',
                             'calibration.linearization'},
    'core.evaluation': {'core.validation', 'core.se2'},
    'core.replay': {'core.validation', 'core.se2', 'core.evaluation', 'core.odometry_config',
                    'core.wheel_feedback'},
    'core.wheel_feedback': {'core.validation', 'core.se2', 'core.kinematics'},
    'node.throttled_warning': set(),
    'node.nonblocking_output': set(),
    'core.lateness': set(),
    'core.axis_limits': {'core.validation'},
    'core.wheel_commander': {'core.validation', 'core.se2', 'core.kinematics', 'core.axis_limits'},
    'core.parameter_specs': {'core.validation', 'core.se2', 'core.kinematics', 'core.odometry'},
    'core.odometry_config': {
        'core.validation', 'core.se2', 'core.kinematics', 'core.odometry', 'core.wheel_feedback',
        'core.axis_limits', 'core.parameter_specs', 'core.wheel_commander'},
    'core.quaternion': set(),
    'core.cdr': {'core.validation', 'core.se2', 'core.kinematics', 'core.odometry',
                 'core.quaternion'},
    'core.stamp_thinning': set(),
    # The judge of the odometry shares no code with it.
    'core.simulation': {'core.validation'},
    # What the dashboard decides, without ROS and without a browser.
    'node.clock': set(),
    'dashboard.teleop': set(),
    'dashboard.trajectory': set(),
    'dashboard.equations': {'core.validation', 'core.se2', 'core.kinematics'},
    'dashboard.access_control': set(),
}
# The tools for logs, which may need these besides; the core may need none of it.
OFFLINE = {
    'calibration.model': ({'core.validation', 'core.kinematics', 'core.odometry', 'core.replay',
                           'core.wheel_feedback'}, set()),
    'calibration.covariance': ({'core.validation', 'calibration.linearization'}, {'scipy'}),
    'calibration.residuals': ({'core.validation', 'core.se2', 'core.kinematics', 'core.odometry',
                               'calibration.model', 'calibration.linearization',
                               'calibration.covariance'}, set()),
    'calibration.initial_guess': ({'core.validation', 'core.se2', 'core.kinematics',
                                   'core.odometry', 'calibration.model',
                                   'calibration.residuals'}, {'scipy'}),
    'calibration.likelihood': ({'core.validation', 'calibration.covariance',
                                'calibration.residuals'}, {'scipy'}),
    'calibration.outliers': ({'calibration.covariance', 'calibration.likelihood',
                              'calibration.model', 'calibration.residuals'}, {'scipy'}),
    'calibration.fit': ({'core.validation', 'core.se2', 'core.kinematics', 'core.odometry',
                         'calibration.initial_guess', 'calibration.covariance',
                         'calibration.likelihood', 'calibration.model', 'calibration.outliers',
                         'calibration.residuals'}, set()),
    'calibration.cross_validation': ({'core.validation', 'core.kinematics', 'core.replay',
                                      'core.odometry_config', 'calibration.fit',
                                      'calibration.model'}, set()),
    'calibration.node_parameters': ({'core.kinematics', 'core.odometry_config',
                                     'calibration.end_pose', 'calibration.model'}, set()),
    'tools.bags': ({'core.validation', 'core.wheel_feedback', 'core.cdr', 'core.odometry_config',
                    'core.quaternion', 'core.stamp_thinning'}, {'rosbags'}),
    'tools.csv_logs': ({'core.validation', 'core.wheel_feedback', 'core.quaternion', 'tools.bags'},
                       set()),
    'tools.logs': ({'core.validation', 'core.wheel_feedback', 'core.replay', 'tools.bags',
                    'tools.csv_logs'}, set()),
    'tools.parameter_file': ({'core.kinematics', 'core.odometry_config', 'core.parameter_specs',
                              'core.validation'}, {'yaml'}),
    'tools.pool': ({'core.validation'}, {'rich', 'threadpoolctl'}),
    'tools.command_line': ({'core.validation', 'tools.bags'}, set()),
    'tools.reports': (
        {'core.evaluation', 'core.kinematics', 'core.replay', 'calibration.covariance',
         'calibration.cross_validation', 'calibration.end_pose', 'calibration.model',
         'tools.parameter_file'}, set()),
    'tools.plots': (
        {'core.validation', 'core.se2', 'core.evaluation', 'core.replay', 'core.wheel_feedback',
         'calibration.cross_validation', 'calibration.model'}, {'matplotlib'}),
    'tools.replay': (
        {'core.validation', 'core.evaluation', 'core.odometry_config', 'core.replay', 'tools.bags',
         'tools.command_line', 'tools.csv_logs', 'tools.logs', 'tools.parameter_file',
         'tools.plots', 'tools.reports'}, set()),
    'tools.calibrate': (
        {'core.validation', 'calibration.fit', 'calibration.end_pose', 'calibration.model',
         'calibration.cross_validation', 'calibration.node_parameters', 'tools.bags',
         'tools.command_line', 'tools.csv_logs', 'tools.logs', 'tools.parameter_file',
         'tools.plots', 'tools.pool', 'tools.reports'}, {'rich'}),
}


def file_of(module):
    """Return the file of a module of the package."""
    return PACKAGE.joinpath(*module.split('.')).with_suffix('.py')


def own_of(names):
    """Return the modules of the package among the names of imports."""
    return {'.'.join(name.split('.')[1:3]) for name in names if name.startswith('diffdrive_ros.')}


MODULES = [name for name in CORE if file_of(name).exists()]

WITHOUT_ROS = """
import importlib, re, sys

ROS = re.compile(r'(rcl|ros|ament|tf2|builtin_interfaces|unique_identifier|.*_(msgs|srvs)$)')


class NoRos:
    def find_spec(self, name, path=None, target=None):
        if ROS.match(name.partition('.')[0]):
            raise ModuleNotFoundError(f'{name} is not to be had here')


sys.meta_path.insert(0, NoRos())
for name in 'rclpy', 'builtin_interfaces.msg', 'rcl_interfaces.msg', 'sensor_msgs', 'tf2_ros':
    try:
        importlib.import_module(name)
    except ModuleNotFoundError as error:
        assert str(error).endswith('not to be had here')
    else:
        raise AssertionError(f'{name} could be imported after all')
"""

DRIVE_A_CIRCLE = """
from math import pi

from diffdrive_ros.core.wheel_commander import WheelCommander
from diffdrive_ros.core.wheel_feedback import WheelFeedback
from diffdrive_ros.core.kinematics import DiffDrive
from diffdrive_ros.core.odometry import Odometry

drive = DiffDrive(0.317, 0.0471, 0.0533)
path, odometry = WheelCommander(drive, timeout=0.5), Odometry(drive)
feedback = WheelFeedback(left_names=['l'], right_names=['r'])
path.accept(2.0 * pi, 2.0 * pi, 0)
sent = path.step(0)
for tenths in range(11):
    angles = [sent.left * tenths / 10.0, sent.right * tenths / 10.0]
    sample = feedback.update(['l', 'r'], angles, [], tenths * 10**8)
    odometry.update(sample.left, sample.right, sample.stamp_ns)
print(*odometry.pose.round(9) + 0.0)
"""


def run_without_ros(code):
    """Run code in a Python where nothing of ROS can be imported; return what it prints."""
    path = os.pathsep.join(filter(None, [str(PACKAGE.parent), os.environ.get('PYTHONPATH')]))
    return subprocess.run(
        [sys.executable, '-c', WITHOUT_ROS + code], check=True, timeout=60, text=True,
        stdout=subprocess.PIPE, env={**os.environ, 'PYTHONPATH': path}).stdout


def imports_of(module):
    """Return the full names of what a module of the package imports, wherever it does so."""
    names = set()
    for node in ast.walk(ast.parse(file_of(module).read_text(encoding='utf-8'))):
        if isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            origin = '.'.join(filter(None, ['diffdrive_ros' * bool(node.level), node.module]))
            names |= {f'{origin}.{alias.name}' for alias in node.names}
    return names


def test_the_core_drives_a_circle_where_ros_cannot_be_imported():
    code = ''.join(f'import diffdrive_ros.{module}\n' for module in MODULES) + DRIVE_A_CIRCLE
    assert run_without_ros(code).split() == ['0.0', '0.0', '6.283185307']


@pytest.mark.parametrize('module', MODULES)
def test_arrows_between_the_modules_go_one_way(module):
    own = own_of(imports_of(module))
    assert own <= CORE[module]


@pytest.mark.parametrize('module', OFFLINE)
def test_the_tools_for_logs_stand_on_the_core_and_need_no_ros(module):
    imports = imports_of(module)
    own = own_of(imports)
    others = {name.partition('.')[0] for name in imports} - {'diffdrive_ros'}
    may_stand_on, may_need = OFFLINE[module]
    assert own <= may_stand_on
    assert others <= {'numpy', *sys.stdlib_module_names} | may_need


@pytest.mark.parametrize('module', MODULES)
def test_the_core_needs_numpy_and_nothing_else(module):
    others = {name.partition('.')[0] for name in imports_of(module)} - {'diffdrive_ros'}
    assert others <= {'numpy', *sys.stdlib_module_names}
