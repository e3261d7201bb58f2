"""What the documents say is so."""
import doctest
from pathlib import Path
import re

from diffdrive_ros.core.parameter_specs import ODOMETRY, ParameterSpec, SIMULATOR
import pytest
import yaml

TOP = Path(__file__).resolve().parents[1]
README = (TOP / 'README.md').read_text()


@pytest.mark.parametrize('document', ['README.md', 'doc/kinematics.md'])
def test_the_python_in_a_document_gives_what_it_says(document: str) -> None:
    """Each >>> is run."""
    failed, tried = doctest.testfile(str(TOP / document), module_relative=False)
    assert tried > 0
    assert failed == 0


@pytest.mark.parametrize('specs', [ODOMETRY, SIMULATOR])
def test_the_readme_has_every_parameter(specs: tuple[ParameterSpec, ...]) -> None:
    """And none that is not there: see the next test."""
    names = {spec.name.rpartition('.')[2] for spec in specs}
    assert {name for name in names if f'`{name}`' not in README} == set()


def test_the_readme_marks_the_parameters_that_may_be_set_at_run_time() -> None:
    """With the star of its table."""
    rows = dict(re.findall(r'^\| `(\w+)`( \*)? \|', README, flags=re.MULTILINE))
    specs = {spec.name: spec for spec in ODOMETRY}
    assert rows.keys() <= specs.keys()
    assert {name for name, star in rows.items() if star} == {
        name for name, spec in specs.items() if spec.live and '.' not in name}


def test_the_readme_gives_the_defaults() -> None:
    """As a parameter file would have them."""
    rows = dict(re.findall(r'^\| `(\w+)`(?: \*)? \| `?([^|`]+?)`? \|', README, flags=re.MULTILINE))
    specs = {spec.name: spec for spec in ODOMETRY if spec.name in rows}
    assert len(specs) > 15
    for name, spec in specs.items():
        said = yaml.safe_load(re.sub(r'^(\d+)e', r'\1.0e', rows[name]))
        assert repr(said) == repr(spec.default), name


def test_the_parameter_file_to_copy_has_only_valid_parameters() -> None:
    """Those of the node, in their types and by their rules."""
    content = yaml.safe_load((TOP / 'config' / 'robot.yaml').read_text())
    specs = {spec.name: spec for spec in ODOMETRY}
    for name, value in content['/**/odometry']['ros__parameters'].items():
        specs[name].check(value)
