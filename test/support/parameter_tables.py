"""
The parameter tables of the documents, made from core/parameter_specs.py.

Run as a script to write them: PYTHONPATH=test .venv/bin/python -m support.parameter_tables
"""
from collections.abc import Sequence
import math
from pathlib import Path
import re

from diffdrive_ros.core.parameter_specs import GEOMETRY, ODOMETRY, ParameterSpec, SIMULATOR

DOC = Path(__file__).resolve().parents[2] / 'doc'


def default_text(value: object) -> str:
    """Return a default as a parameter file has it."""
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, float):
        if math.isnan(value):
            return '.nan'
        return f'{value:.1e}' if 0.0 < value < 1e-3 else str(value)  # YAML wants the point
    if isinstance(value, list):
        return f'[{", ".join(map(default_text, value))}]'
    return "''" if value == '' else str(value)


def rows(specs: Sequence[ParameterSpec]) -> str:
    """Return a table of parameters, in Markdown; a star marks what may be set at run time."""
    lines = ['| parameter | default | unit | meaning | rule |', '|---|---|---|---|---|']
    for spec in specs:
        star = ' \\*' if spec.live else ''
        description = spec.description.replace('<', '&lt;')
        lines.append(f'| `{spec.name}`{star} | `{default_text(spec.default)}` | {spec.unit} | '
                     f'{description} | {spec.rule.text} |')
    return '\n'.join(lines)


def limit_rows() -> str:
    """Return the table of the limits, which are the same on both axes."""
    lines = ['| `linear.x.` and `angular.z.` | default | unit | meaning |', '|---|---|---|---|']
    linear, angular = ([spec for spec in ODOMETRY if spec.name.startswith(axis)]
                       for axis in ('linear.x.', 'angular.z.'))
    for spec, other in zip(linear, angular, strict=True):
        units = ', '.join(filter(None, [spec.unit, other.unit]))
        lines.append(f'| `{spec.name.removeprefix("linear.x.")}` \\* | '
                     f'`{default_text(spec.default)}` | {units} | {spec.description} |')
    return '\n'.join(lines)


def tables() -> dict[tuple[str, str], str]:
    """Return each table by the page and the name of its markers."""
    geometry = {spec.name for spec in GEOMETRY}
    return {
        ('node.md', 'parameters'): rows([spec for spec in ODOMETRY if '.' not in spec.name]),
        ('node.md', 'limits'): limit_rows(),
        ('simulator.md', 'parameters'): rows(
            [spec for spec in SIMULATOR if spec.name not in geometry]),
    }


def with_table(text: str, name: str, table: str) -> str:
    """Return the text of a page with a table between its markers."""
    begin, end = f'<!-- {name}: begin -->', f'<!-- {name}: end -->'
    assert text.count(begin) == text.count(end) == 1, name
    return re.sub(f'{begin}.*?{end}', lambda match: f'{begin}\n{table}\n{end}', text,
                  flags=re.DOTALL)


def main() -> None:
    """Write the tables into the documents."""
    for (page, name), table in tables().items():
        path = DOC / page
        path.write_text(with_table(path.read_text(), name, table))


if __name__ == '__main__':
    main()
