"""README.md and doc/: examples run, links resolve, tables are those of the code."""
import ast
from collections.abc import Iterator
import configparser
import doctest
from importlib import metadata
import math
from pathlib import Path
import re
import shlex
import signal
import subprocess
import sys
import types

from diffdrive_ros.core.parameter_specs import (
    checked_values,
    missing_geometry,
    ODOMETRY,
    ParameterSpec,
    SIMULATOR,
)
import pytest
from rclpy.parameter import get_parameter_value
from support import parameter_tables
from support.documents import anchors, Block, blocks, commands, links, PAGES, TOP
from support.station import Station, wait_until
import yaml

SPECS = {'odometry': ODOMETRY, 'simulator': SIMULATOR}
TOOLS = {'calibrate': 'tools.calibrate', 'replay': 'tools.replay', 'demo': 'demo.main',
         'dashboard': 'dashboard.main'}
LANGUAGES = {'console', 'ini', 'pycon', 'python', 'sh', 'text', 'xml', 'yaml'}

# How commands begin, and what runs them.
RUN_BY = {
    'make ': 'Makefile',
    'colcon build': '.ci/colcon',
    'ros2 run diffdrive_ros': 'test/checks/ros2_cli.sh',
    'ros2 param set': 'test/checks/ros2_cli.sh',
    'ros2 topic': 'test/checks/ros2_cli.sh',
    'ros2 service call': 'test/checks/ros2_cli.sh',
    'source install/setup.bash': 'test/checks/ros2_cli.sh',
    'calibrate ': 'test/tools/test_calibrate.py',
    'replay ': 'test/tools/test_replay_tool.py',
    'dashboard ': 'test/dashboard/test_server.py',
    'demo': 'test/demo/test_demo.py',
    'fastdds discovery': 'test/node/test_two_machines.py',
    'export ROS_DISCOVERY_SERVER': 'test/node/test_two_machines.py',
    'pip install': '.ci/environment',
    'python3 -m venv': '.ci/environment',
    'PYTHONPATH=test .venv/bin/python -m support.parameter_tables': 'test/test_documents.py',
    '.venv/bin/python test/support/optiodom.py': 'test/calibration/test_optiodom_calibration.py',
    '../.venv/bin/calibrate ': 'test/tools/test_calibrate.py',
    'cat ': 'test/tools/test_calibrate.py',
}
# Those that need a robot, root, a network or another package.
NOT_RUN = (
    'cd ', 'git clone', 'rosdep install', 'journalctl', 'mkdir ', 'ros2 bag record',
    'ros2 launch', 'ros2 run ros_gz_bridge', 'ros2 run teleop_twist_keyboard',
    'ros2 run twist_mux', 'sudo ', 'source /opt/ros')


@pytest.mark.parametrize('page', PAGES)
def test_internal_links_resolve(page: str) -> None:
    """Files exist, and headings too."""
    for target in links(page):
        file, _, anchor = target.partition('#')
        path = ((TOP / page).parent / file).resolve() if file else TOP / page
        assert path.exists(), target
        if anchor:
            assert anchor in anchors(path.relative_to(TOP).as_posix()), target


def test_readme_is_an_overview() -> None:
    """What one looks up stands in doc/."""
    assert len((TOP / 'README.md').read_text().splitlines()) <= 150


def test_every_page_is_linked_from_the_index() -> None:
    """And the index from README.md."""
    pages = {page for page in PAGES if page.startswith('doc/')} - {'doc/README.md'}
    assert {f'doc/{target}' for target in links('doc/README.md')} >= pages


@pytest.mark.parametrize(
    'page', [page for page in PAGES if page.startswith('doc/')])
def test_page_opens_with_its_readers(page: str) -> None:
    """The first paragraph names them."""
    assert (TOP / page).read_text().split('\n\n')[1].startswith('For ')


@pytest.mark.parametrize('block', blocks(), ids=lambda block: block.page)
def test_block_has_a_known_language(block: Block) -> None:
    """It decides how the block is tested."""
    assert block.language in LANGUAGES, block.text


@pytest.mark.parametrize('page', sorted({
    block.page for block in blocks('python', 'pycon') if '>>>' in block.text}))
def test_doctests_pass(page: str) -> None:
    """Each >>> is run."""
    failed, tried = doctest.testfile(str(TOP / page), module_relative=False)
    assert tried > 0
    assert failed == 0


@pytest.mark.parametrize(
    'block', [block for block in blocks('python', 'pycon') if '>>>' not in block.text
              and block.page != 'doc/driver.md'], ids=lambda block: block.page)
def test_launch_files_start_executables(block: Block, monkeypatch: pytest.MonkeyPatch) -> None:
    """With stand-ins for launch, which is not on PyPI; test_documented_driver runs the driver."""
    launch, actions = types.ModuleType('launch'), types.ModuleType('launch_ros.actions')
    launch.LaunchDescription = list
    actions.Node = dict
    monkeypatch.setitem(sys.modules, 'launch', launch)
    monkeypatch.setitem(sys.modules, 'launch_ros', types.ModuleType('launch_ros'))
    monkeypatch.setitem(sys.modules, 'launch_ros.actions', actions)
    names: dict = {}
    exec(compile(block.text, block.page, 'exec'), names)
    nodes = names['generate_launch_description']()
    ours = [node for node in nodes if node['package'] == 'diffdrive_ros']
    assert ours
    for node in ours:
        assert node['executable'] in executables()


def executables() -> set[str]:
    """Return the names of the package's console scripts."""
    return {entry.name for entry in metadata.distribution('diffdrive_ros').entry_points}


@pytest.mark.parametrize('block', blocks('yaml'), ids=lambda block: block.page)
def test_parameters_in_yaml_are_valid(block: Block) -> None:
    """Of a node of this package: name, type and rule; of any other: it parses."""
    for specs, values in parameters_of_ours(yaml.safe_load(block.text)):
        assert values.keys() <= {spec.name for spec in specs}
        checked_values(specs, values)


def parameters_of_ours(content: object) -> Iterator[tuple[tuple[ParameterSpec, ...], dict]]:
    """Yield the specs and the values of each of this package's nodes in a file."""
    if isinstance(content, dict):
        for key, value in content.items():
            specs = SPECS.get(key.rpartition('/')[2])
            if specs:
                yield specs, value['ros__parameters']


@pytest.mark.parametrize('block', blocks('yaml'), ids=lambda block: block.page)
def test_documented_files_of_odometry_have_a_geometry(block: Block) -> None:
    """Else the node refuses them."""
    for specs, values in parameters_of_ours(yaml.safe_load(block.text)):
        assert specs is not ODOMETRY or missing_geometry(values) is None


def test_config_file_has_only_valid_parameters() -> None:
    """config/robot.yaml is there to be copied."""
    content = yaml.safe_load((TOP / 'config' / 'robot.yaml').read_text())
    (specs, values), = parameters_of_ours(content)
    assert specs is ODOMETRY
    checked_values(specs, values)


@pytest.mark.parametrize(('page', 'name'), parameter_tables.tables())
def test_parameter_tables_are_those_of_the_code(page: str, name: str) -> None:
    """Run support.parameter_tables to write them."""
    text = (TOP / 'doc' / page).read_text()
    table = parameter_tables.tables()[page, name]
    assert parameter_tables.with_table(text, name, table) == text


def test_readme_rows_of_parameters_have_default_and_star() -> None:
    """Those that it shows, as in node.md."""
    readme = (TOP / 'README.md').read_text()
    rows = re.findall(r'^\| `([\w.]+)`( \\?\*)? \| `?([^|`]+?)`? \|', readme, flags=re.MULTILINE)
    specs = {spec.name: spec for spec in ODOMETRY}
    shown = [row for row in rows if row[0] in specs]
    assert len(shown) >= 8
    for name, star, default in shown:
        value = yaml.safe_load(re.sub(r'^(\d+)e', r'\1.0e', default))
        assert repr(value) == repr(specs[name].default), name
        assert bool(star) is specs[name].live, name


def test_make_targets_exist() -> None:
    """All that follow the word make in code."""
    targets = set(re.findall(r'^([a-z]+):.*## ', (TOP / 'Makefile').read_text(), re.MULTILINE))
    for page in PAGES:
        named = re.findall(r'(?:`|^)make ([a-z]+)', (TOP / page).read_text(), re.MULTILINE)
        assert set(named) <= targets, page


def test_commands_are_run_by_a_test_or_named() -> None:
    """What no test or check runs is in NOT_RUN, with the reason above it."""
    for command in commands():
        runner = next((file for begin, file in RUN_BY.items() if command.startswith(begin)), None)
        assert runner or command.startswith(NOT_RUN), command
        assert not runner or (TOP / runner).exists(), runner


@pytest.mark.parametrize('tool', TOOLS)
def test_documented_options_exist(tool: str) -> None:
    """Those after the tool's name in a command, before --ros-args."""
    used: dict[str, set[str]] = {}
    for command in commands():
        words = shlex.split(command.split('--ros-args')[0])
        if words[:1] == ['make']:
            words = [words[1], *(word for word in words if word.startswith('ARGS='))]
            words = shlex.split(' '.join(words).replace('ARGS=', ''))
        if words and words[0].rpartition('/')[2] == tool:
            first = words[1] if len(words) > 1 and re.fullmatch(r'[a-z][a-z-]*', words[1]) else ''
            used.setdefault(first, set()).update(
                word for word in words if re.fullmatch(r'--[a-z-]+', word))
    assert used or tool == 'demo'
    for subcommand, options in used.items():
        arguments = [subcommand] if subcommand else []
        output = subprocess.run(
            [sys.executable, '-m', f'diffdrive_ros.{TOOLS[tool]}', *arguments, '--help'],
            capture_output=True, text=True, check=True).stdout
        assert options <= set(re.findall(r'--[a-z-]+', output)), (subcommand, options)


KEYS = re.compile(
    r'^\| (?:`\w+` )?\| ((?:`[^`]+`(?:, )?)+) \|', re.MULTILINE)


def test_diagnostics_keys_are_those_of_the_code() -> None:
    """Each is a literal in the code, and each that is counted there is in the table."""
    page = (TOP / 'doc' / 'node.md').read_text().partition('## What do the diagnostics')[2]
    documented = {key for cell in KEYS.findall(page) for key in re.findall(r'`([^`]+)`', cell)}
    assert len(documented) > 20
    files = [path for folder in ('core', 'node')
             for path in (TOP / 'diffdrive_ros' / folder).glob('*.py')]
    literals = {node.value for file in files for node in ast.walk(ast.parse(file.read_text()))
                if isinstance(node, ast.Constant) and isinstance(node.value, str)}
    assert documented <= literals
    assert counted() <= documented


def counted() -> set[str]:
    """Return what feedback and commands count, by the literals that index their counters."""
    found = set()
    for file in ('core/wheel_feedback.py', 'core/wheel_commander.py', 'node/command_loop.py'):
        text = (TOP / 'diffdrive_ros' / file).read_text()
        found |= set(re.findall(r"(?:_count\(|counts\[|_events\.add\(\s*)'([^']+)'", text))
    assert found
    return found


def test_labels_of_the_dashboard_exist() -> None:
    """Those in italics."""
    page = (TOP / 'doc' / 'dashboard.md').read_text()
    labels = re.findall(r'(?<!\*)\*([A-Z][^*]+)\*(?!\*)', page)
    assert len(labels) >= 4
    folder = TOP / 'diffdrive_ros' / 'dashboard'
    source = ''.join(path.read_text() for path in folder.rglob('*.*') if path.suffix != '.pyc')
    assert [label for label in labels if label not in source] == []


def test_systemd_unit_starts_the_node_itself(tmp_path: Path, station: Station) -> None:
    """What systemd starts becomes the node, which SIGINT ends; in a workspace made for it."""
    block, = blocks('ini')
    unit = configparser.ConfigParser(interpolation=None)
    unit.optionxform = str
    unit.read_string(block.text)
    program = re.search(r'exec (\S+)', unit['Service']['ExecStart'])[1]
    workspace, name = re.fullmatch(
        r'(.*)/install/diffdrive_ros/lib/diffdrive_ros/(\w+)', program).groups()
    home = workspace.rpartition('/')[0]
    assert name in executables()
    executable = tmp_path / program.removeprefix(home + '/')
    executable.parent.mkdir(parents=True)
    executable.write_text(
        f'#!{sys.executable}\nfrom diffdrive_ros.node.odometry_node import main\nmain()\n')
    executable.chmod(0o755)
    (tmp_path / workspace.removeprefix(home + '/') / 'install' / 'setup.bash').touch()
    (tmp_path / 'robot.yaml').write_text((TOP / 'config' / 'robot.yaml').read_text())
    command = shlex.split(unit['Service']['ExecStart'].replace(home, str(tmp_path)))
    process = subprocess.Popen(
        command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)
    try:
        wait_until(lambda: 'odometry' in station.node.get_node_names())
        process.send_signal(signal.Signals[unit['Service']['KillSignal']])
        output = process.communicate(timeout=10.0)[0]
    finally:
        process.kill()
    assert process.returncode == 0, output


def test_nan_on_the_command_line_needs_its_dot() -> None:
    """As node.md has it, for ros2 param set, which reads values by this function."""
    assert math.isnan(get_parameter_value('.nan').double_value)
    assert get_parameter_value('nan').string_value == 'nan'
