"""
Check that the tests detect the loss of each behaviour of doc/known_issues.md.

    make mutants                   # all of them
    make mutants ARGS='7 23'       # rows 7 and 23
    make mutants ARGS='--tenth 3'  # every tenth patch from the third on; 13 is the same

A patch test/checks/mutants/ROW-NAME.patch is applied to a copy of the package, and the tests
named in that row are run against it. One of them has to fail by an assertion: a patch that
breaks an import proves nothing.
"""
import argparse
from collections.abc import Iterable
import os
from pathlib import Path
import re
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from xml.etree import ElementTree

TOP = Path(__file__).resolve().parents[2]
TIMEOUT_S = 180.0  # of the tests of one row, and of all without a patch
ASSERTIONS = 'AssertionError', 'assert ', 'Failed: DID NOT RAISE'


class MutantError(Exception):
    """A mutant proves nothing; the message has the reason in one line."""


def tests_of_rows() -> dict[int, list[str]]:
    """Return the tests in doc/known_issues.md, by the number of the row."""
    text = (TOP / 'doc' / 'known_issues.md').read_text()
    return {int(number): tests
            for number, row in re.findall(r'^\| (\d+) \|(.*)$', text, flags=re.MULTILINE)
            if (tests := re.findall(r'`(test/[\w/]+\.py::\w+)`', row))}


def mutants() -> list[tuple[int, Path]]:
    """Return row and file of every patch."""
    files = sorted((TOP / 'test' / 'checks' / 'mutants').glob('*.patch'))
    return [(int(file.name.split('-')[0]), file) for file in files]


def apply(patch: str, top: Path) -> None:
    """Apply a unified diff to the files in a folder, at any line that has its context."""
    for file in re.split(r'^--- .*\n', patch, flags=re.MULTILINE)[1:]:
        name, *hunks = re.split(r'^@@ .*\n', file, flags=re.MULTILINE)
        path = top / name.split()[1].partition('/')[2]
        text = path.read_text()
        for hunk in hunks:
            lines = hunk.splitlines(keepends=True)
            old = ''.join(line[1:] for line in lines if line[0] in ' -')
            new = ''.join(line[1:] for line in lines if line[0] in ' +')
            if text.count(old) != 1:
                raise MutantError(f'does not apply: {path.name} has its lines {text.count(old)}x')
            text = text.replace(old, new)
        path.write_text(text)


def failures(tests: Iterable[str], top: Path) -> dict[str, str]:
    """Return the first of the tests that does not pass in a copy, with the reason."""
    report = top / 'report.xml'
    report.unlink(missing_ok=True)
    process = subprocess.Popen(
        [sys.executable, '-m', 'pytest', '-q', '-x', '-p', 'no:cacheprovider',
         f'--junitxml={report}', *tests],
        cwd=top, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True,
        start_new_session=True,  # so that processes of the tests end with them
        env=os.environ | {'PYTHONPATH': str(top), 'PYTHONDONTWRITEBYTECODE': '1'})
    try:
        output, _ = process.communicate(timeout=TIMEOUT_S)
    except subprocess.TimeoutExpired:
        raise MutantError(f'took longer than {TIMEOUT_S:g} s') from None
    finally:
        if process.poll() is None:
            os.killpg(process.pid, signal.SIGKILL)
            process.communicate()
    if process.returncode not in (0, 1):
        raise MutantError(f'pytest could not run: {output.strip().splitlines()[-1]}')
    return {case.get('name', ''): ' '.join(result.get('message', '').split())
            for case in ElementTree.parse(report).iter('testcase')
            for result in case if result.tag in ('failure', 'error', 'skipped')}


def failing_test(patch: Path, tests: Iterable[str], top: Path) -> str:
    """Return the test that fails by an assertion when a patch is applied to a copy."""
    copy(top)
    apply(patch.read_text(), top)
    names = subprocess.run(
        [sys.executable, '-m', 'ruff', 'check', '--isolated', '--quiet', '--select', 'F821',
         'diffdrive_ros'], cwd=top, stdout=subprocess.PIPE, text=True)
    if names.returncode:
        raise MutantError(f'has names that are not defined: {names.stdout.strip()}')
    found = failures(tests, top)
    for test, reason in found.items():
        if reason.startswith(ASSERTIONS):
            return test
    raise MutantError(f'fails otherwise: {next(iter(found.values()))}' if found else 'survives')


def copy(top: Path) -> None:
    """Replace the copy of the package and the tests in a folder."""
    for name in 'diffdrive_ros', 'test':
        shutil.rmtree(top / name, ignore_errors=True)
        shutil.copytree(TOP / name, top / name, ignore=shutil.ignore_patterns('__pycache__'))
    shutil.copy(TOP / 'pyproject.toml', top)


def invalid_patches(top: Path) -> list[str]:
    """Return the patches that do not apply to a copy, with the reasons."""
    found = []
    for _, patch in mutants():
        copy(top)
        try:
            apply(patch.read_text(), top)
        except (MutantError, OSError) as error:
            found.append(f'{patch.name}: {error}')
    return found


def main() -> int:
    """Run the mutants; return the exit code."""
    parser = argparse.ArgumentParser(prog='mutants', description=__doc__.strip().split('\n')[0])
    parser.add_argument('rows', metavar='ROW', nargs='*', type=int, help='all if none is given')
    parser.add_argument(
        '--tenth', type=int, metavar='N', help='of these, every tenth from the N-th on')
    arguments = parser.parse_args()
    rows, tenth = arguments.rows, arguments.tenth
    tests = tests_of_rows()
    chosen = [(row, patch) for row, patch in mutants() if not rows or row in rows]
    if tenth is not None:
        chosen = chosen[(tenth - 1) % 10::10]
    if not chosen:
        parser.error('no patch has such a number')
    passed = 0
    with tempfile.TemporaryDirectory() as folder:
        top = Path(folder)
        if found := invalid_patches(top):
            print('\n'.join(found))
            return 1
        copy(top)
        named = dict.fromkeys(test for row, _ in chosen for test in tests[row])
        try:
            broken = failures(named, top)
        except MutantError as error:
            broken = {'the suite': str(error)}
        for test, reason in broken.items():
            print(f'{test} does not pass as it is: {reason}')
            return 1
        for row, patch in chosen:
            started_at = time.monotonic()
            try:
                verdict = failing_test(patch, tests[row], top)
                passed += 1
            except MutantError as error:
                verdict = f'NOT CAUGHT: {error}'
            seconds = time.monotonic() - started_at
            print(f'{patch.stem:28} {seconds:5.1f} s  {verdict}', flush=True)
    print(f'{passed} passed, {len(chosen) - passed} failed')
    return 0 if passed == len(chosen) else 1


if __name__ == '__main__':
    sys.exit(main())
