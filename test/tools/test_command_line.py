"""The shell of the tools: errors of the input are one line, a bug keeps its traceback."""
from diffdrive_ros.core.validation import UserError
from diffdrive_ros.tools import example
from diffdrive_ros.tools.command_line import run_tool
import numpy as np
import pytest


def raise_it(error):
    """Raise an error."""
    raise error


@pytest.mark.parametrize(('error', 'line'), [
    (UserError('x = 1: must be 2'), 'tool: x = 1: must be 2'),
    (FileNotFoundError(2, 'No such file or directory', 'a.csv'),
     "tool: [Errno 2] No such file or directory: 'a.csv'"),
    (ModuleNotFoundError("No module named 'yaml'", name='yaml'),
     'tool: yaml is needed: pip install pyyaml'),
    (KeyboardInterrupt(), 'tool: interrupted'),
])
def test_expected_errors_are_one_line(error, line):
    with pytest.raises(SystemExit) as ended:
        run_tool('tool', lambda: raise_it(error))
    assert ended.value.code == line


@pytest.mark.parametrize('error', [
    ValueError('operands could not be broadcast'), np.linalg.LinAlgError('singular'),
    ModuleNotFoundError("No module named 'diffdrive_ros.x'", name='diffdrive_ros.x')])
def test_bugs_keep_their_traceback(error):
    with pytest.raises(type(error)):
        run_tool('tool', lambda: raise_it(error))


def test_ctrl_c_in_the_example_is_one_line(monkeypatch, tmp_path):
    def interrupted(folder):
        raise KeyboardInterrupt

    monkeypatch.setattr(example, 'run', interrupted)
    with pytest.raises(SystemExit, match='example: interrupted'):
        example.main(['--folder', str(tmp_path)])
