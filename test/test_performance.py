"""Test the tables of the benchmark, with artificial figures."""
from pathlib import Path

from benchmark import performance
from benchmark.performance import BEGIN, CANDIDATES, EACH, END, NODE, SHARED, TYPICAL
import pytest


def rounds(scale: float) -> list[dict]:
    """Return three rounds of round trips; scale is that of the median."""
    return [
        {'answered': 1.0, 'cpu_us': 100.0 * each, 'p50_us': 300.0 * each, 'p99_us': 900.0 * each,
         'rss_mb': 60.0 * each, 'wrong': ''}
        for each in (0.9 * scale, 4.0 * scale, scale)]


@pytest.fixture
def results() -> performance.Results:
    """Return results whose candidates differ by factors of two."""
    return performance.Results(
        rounds=3, seconds=10.0, load=0.0,
        round_trips={rate: dict(zip(CANDIDATES, map(rounds, (1.0, 2.0, 4.0)), strict=True))
                     for rate in (200, 3000)},
        robots={count: {EACH: rounds(1.0), SHARED: rounds(0.5)} for count in (1, 20)},
        starts={NODE: [1.0, 9.0, 2.0], TYPICAL: [4.0, 4.0, 5.0]},
        core={10**3: {work: {'ns': 40.0, 'bytes': 24.0} for work in (
            'numpy', 'integrate', 'integrate_chunks', 'update', 'update and read-out')},
            10**7: {work: {'ns': 50.0, 'bytes': 24.0} for work in (
                'numpy', 'integrate', 'integrate_chunks')}})


def test_ratios_are_those_of_medians(results: performance.Results) -> None:
    """Ratios to the floor and the typical node; those of robots are to one robot."""
    text = performance.tables(results)
    assert '| 200 | odometry | 100.00 % | 200.0 | 2.00 | 0.50 | 600 | 2.00 |' in text
    assert '| 20 | one process | 100.00 % | 5.00 | 20.00 | 0.25 |' in text
    assert '| odometry | 2.00 | 0.50 | 1.00 | 9.00 |' in text


def test_ratio_without_floor_is_empty(results: performance.Results) -> None:
    """The floor needs a compiler."""
    for by_name in results.round_trips.values():
        del by_name[CANDIDATES[0]]
    assert '| 200 | odometry | 100.00 % | 200.0 |  | 0.50 |' in performance.tables(results)


def test_write_replaces_figures_and_keeps_other_text(
        results: performance.Results, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The text before and after the marks is kept."""
    monkeypatch.setattr(performance, 'DOC', tmp_path)
    document = tmp_path / 'performance.md'
    document.write_text(f'before\n{BEGIN}\nold\n{END}\nafter\n')
    performance.write('new', results)
    assert document.read_text() == (
        f'before\n{BEGIN}\n{performance.PICTURE}\n\nnew\n{END}\nafter\n')
    assert (tmp_path / 'performance.png').stat().st_size > 10_000
    real = (Path(performance.__file__).parents[2] / 'doc' / 'performance.md').read_text()
    assert real.count(BEGIN) == real.count(END) == 1
