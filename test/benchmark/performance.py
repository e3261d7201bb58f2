"""Tables and picture of the measurements: doc/performance.md and doc/performance.png."""
from dataclasses import dataclass
import os
from pathlib import Path
import platform
import re
from statistics import median

import numpy as np

DOC = Path(__file__).resolve().parents[2] / 'doc'
BEGIN, END = '<!-- measured: begin -->', '<!-- measured: end -->'
PICTURE = (
    '![CPU and latency of the round trip, CPU of many robots, time of the core](performance.png)')

FLOOR, NODE, TYPICAL = 'floor (C)', 'odometry', 'typical node'
CANDIDATES = FLOOR, NODE, TYPICAL
EACH, SHARED = 'a process each', 'one process'
COLORS = {FLOOR: '0.45', NODE: 'tab:blue', TYPICAL: 'tab:orange'}


@dataclass(frozen=True)
class Results:
    """Round trips by rate and candidate, rounds of robots by their number, starts and core."""

    rounds: int
    seconds: float
    load: float  # of the machine before the start
    round_trips: dict[int, dict[str, list[dict]]]
    robots: dict[int, dict[str, list[dict]]]
    starts: dict[str, list[float]]
    core: dict[int, dict[str, dict]]


def tables(results: Results) -> str:
    """Return all figures, in Markdown."""
    return '\n\n'.join([
        _caveats(results), _round_trips(results), _robots(results), _starts(results),
        _core(results)])


def write(text: str, results: Results) -> None:
    """Write the tables between the marks of the document, and draw the picture."""
    document = DOC / 'performance.md'
    before, _, rest = document.read_text().partition(BEGIN)
    _, _, after = rest.partition(END)
    document.write_text(f'{before}{BEGIN}\n{PICTURE}\n\n{text}\n{END}{after}')
    draw(results, DOC / 'performance.png')


def _caveats(results: Results) -> str:
    model = re.search(r'model name\s*: (.*)', Path('/proc/cpuinfo').read_text())
    noise = max(
        max(each['cpu_us'] for each in rounds) / min(each['cpu_us'] for each in rounds)
        for by_name in results.round_trips.values() for rounds in by_name.values())
    varied = '' if results.rounds == 1 else (
        ' CPU a message of the same candidate differed between rounds by a factor of up to '
        f'{noise:.2f}: trust the ratios that far.')
    return (
        f'Measured on {os.cpu_count()} cores of {model[1] if model else platform.machine()}, '
        f'Linux {platform.release().split("-")[0]}, Python {platform.python_version()}, numpy '
        f'{np.__version__}, {os.environ.get("RMW_IMPLEMENTATION", "the default RMW")}. '
        f'Medians over {results.rounds} rounds of {results.seconds:g} s; the driver ran on the '
        f'same cores; the load before was {results.load:.1f}.{varied}')


def _round_trips(results: Results) -> str:
    lines = _header(
        'Hz', '', 'answered', 'CPU a message [µs]', 'of floor', 'of typical', 'p50 [µs]',
        'of floor', 'p99 [µs]', 'of typical', 'memory [MB]', 'of typical')
    for rate, by_name in results.round_trips.items():
        floor, typical = by_name.get(FLOOR), by_name[TYPICAL]
        for name, rounds in by_name.items():
            cpu, p50, p99, memory = (
                _of(rounds, key) for key in ('cpu_us', 'p50_us', 'p99_us', 'rss_mb'))
            lines.append(_row(
                f'{rate:,}', name, f'{100.0 * _of(rounds, "answered"):.2f} %',
                f'{cpu:.1f}', _ratio(cpu, floor, 'cpu_us'), _ratio(cpu, typical, 'cpu_us'),
                f'{p50:,.0f}', _ratio(p50, floor, 'p50_us'),
                f'{p99:,.0f}', _ratio(p99, typical, 'p99_us'),
                f'{memory:.1f}', _ratio(memory, typical, 'rss_mb')))
    return '\n'.join(lines)


def _robots(results: Results) -> str:
    lines = _header(
        'robots at 50 Hz', '', 'answered', 'CPU of all [% of a core]', 'of one robot',
        'CPU a robot [%]', 'p50 [µs]', 'p99 [µs]', 'memory of all [MB]')
    for count, by_way in results.robots.items():
        for way, rounds in by_way.items():
            share = _share(count, rounds)
            one = _share(1, results.robots[1][way])
            lines.append(_row(
                str(count), way, f'{100.0 * _of(rounds, "answered"):.2f} %', f'{share:.2f}',
                f'{share / one:.2f}', f'{share / count:.2f}', f'{_of(rounds, "p50_us"):,.0f}',
                f'{_of(rounds, "p99_us"):,.0f}', f'{_of(rounds, "rss_mb"):,.0f}'))
    return '\n'.join(lines)


def _starts(results: Results) -> str:
    starts = len(results.starts[NODE])
    lines = _header(f'{starts} starts', 'to the first odom [s]', 'of typical', 'from', 'to')
    typical = median(results.starts[TYPICAL])
    for name, seconds in results.starts.items():
        lines.append(_row(
            name, f'{median(seconds):.2f}', f'{median(seconds) / typical:.2f}',
            f'{min(seconds):.2f}', f'{max(seconds):.2f}'))
    return '\n'.join(lines)


def _core(results: Results) -> str:
    lines = _header(
        'samples', 'numpy: sin, cos, 3 cumsum [ns]', '`integrate` [ns]', 'of numpy',
        'memory [bytes]', '`integrate_chunks` [ns]', 'of numpy', 'memory [bytes]')
    for size, by_work in results.core.items():
        reference = by_work['numpy']['ns']
        cells = [f'{size:,}', f'{reference:.1f}']
        for work in 'integrate', 'integrate_chunks':
            ns, grown = by_work[work]['ns'], by_work[work]['bytes']
            cells += [f'{ns:.1f}', f'{ns / reference:.2f}', f'{grown:.1f}']
        lines.append(_row(*cells))
    lines += ['', *_header(
        'samples', '`Odometry.update` [µs]', 'memory [bytes]', 'and read-out [µs]',
        'memory [bytes]')]
    for size, by_work in results.core.items():
        if 'update' in by_work:
            cells = [f'{size:,}']
            for work in 'update', 'update and read-out':
                ns, grown = by_work[work]['ns'], by_work[work]['bytes']
                cells += [f'{ns * 1e-3:.2f}', f'{grown:.1f}']
            lines.append(_row(*cells))
    return '\n'.join([
        *lines, '', 'All by the sample. Memory is by how much the process grew at its peak, '
        'beyond the wheel angles.'])


def draw(results: Results, path: Path) -> None:
    """Draw the content of the tables."""
    import matplotlib as mpl
    mpl.use('Agg')
    from matplotlib import pyplot as plt

    figure, ((cpu, latency), (robots, core)) = plt.subplots(
        2, 2, figsize=(11.0, 8.0), layout='constrained')
    names = list(next(iter(results.round_trips.values())))
    _bars(cpu, results, names, 'cpu_us')
    cpu.set(title='CPU of the node, a message', ylabel='µs', ylim=(0.0, None))
    cpu.legend(frameon=False, loc='upper right')
    _bars(latency, results, names, 'p50_us', 'p99_us')
    latency.set(title='Round trip: median, and 99 % (line)', ylabel='µs', yscale='log',
                ylim=(50.0, None))
    _draw_robots(robots, results)
    _draw_core(core, results)
    for axes in cpu, latency, robots, core:
        axes.spines[['top', 'right']].set_visible(False)
        axes.grid(axis='y', alpha=0.3)
        axes.set_axisbelow(True)
    figure.savefig(path, dpi=110)
    plt.close(figure)


def _bars(axes: object, results: Results, names: list[str], key: str, upper: str = '') -> None:
    """Draw medians by rate, with the range over the rounds, or up to another figure."""
    places, width = np.arange(len(results.round_trips)), 0.8 / len(names)
    for index, name in enumerate(names):
        rounds = [by_name[name] for by_name in results.round_trips.values()]
        heights = np.array([_of(each, key) for each in rounds])
        if upper:
            low, high = heights, [_of(each, upper) for each in rounds]
        else:
            low, high = ([choose(one[key] for one in each) for each in rounds]
                         for choose in (min, max))
        axes.bar(
            places + (index - 0.5 * (len(names) - 1)) * width, heights, 0.94 * width, label=name,
            color=COLORS[name], yerr=[heights - low, high - heights],
            error_kw={'elinewidth': 1.0, 'ecolor': '0.15'})
    axes.set_xticks(places, [f'{rate:,} Hz' for rate in results.round_trips])


def _draw_robots(axes: object, results: Results) -> None:
    counts = list(results.robots)
    for way, color in ((EACH, 'tab:purple'), (SHARED, 'tab:blue')):
        shares = [_share(count, results.robots[count][way]) for count in counts]
        axes.plot(counts, shares, 'o-', color=color, label=way)
    one = _share(1, results.robots[1][SHARED])
    axes.plot([0, counts[-1]], [0.0, one * counts[-1]], ':', color='0.15', zorder=3,
              label='one robot, so many times')
    axes.set(title='CPU of robots at 50 Hz', xlabel='robots', ylabel='% of a core',
             xlim=(0, None), ylim=(0.0, None), xticks=counts)
    axes.legend(frameon=False)


def _draw_core(axes: object, results: Results) -> None:
    for work, label, color in (
            ('update and read-out', 'Odometry.update and read-out', 'tab:red'),
            ('update', 'Odometry.update', 'tab:orange'),
            ('integrate', 'integrate', 'tab:blue'),
            ('integrate_chunks', 'integrate_chunks', 'tab:cyan'),
            ('numpy', 'numpy: sin, cos, 3 cumsum', '0.45')):
        sizes = [size for size, by_work in results.core.items() if work in by_work]
        axes.plot(sizes, [results.core[size][work]['ns'] for size in sizes], 'o-', color=color,
                  label=label, markersize=4.0)
    axes.set(title='The core, a sample', xlabel='samples', ylabel='ns', xscale='log',
             yscale='log')
    axes.legend(frameon=False, fontsize='small', loc='center right')


def _share(robots: int, rounds: list[dict]) -> float:
    """Return the CPU of a number of robots at 50 Hz [% of a core]."""
    return median(each['cpu_us'] * each['answered'] for each in rounds) * 50.0 * robots * 1e-4


def _of(rounds: list[dict], key: str) -> float:
    return median(each[key] for each in rounds)


def _ratio(value: float, rounds: list[dict] | None, key: str) -> str:
    if not rounds:
        return ''
    ratio = value / _of(rounds, key)
    return f'{ratio:.2f}' if ratio >= 0.1 else f'{ratio:.1g}'


def _header(*titles: str) -> list[str]:
    return [_row(*titles), '|' + '---|' * len(titles)]


def _row(*cells: str) -> str:
    return f'| {" | ".join(cells)} |'
