"""
Drive the robots of one candidate for a while; print what it cost, as JSON.

Its argument is JSON too: commands (a list of [arguments, environment], one a process), namespaces
(of the robots in them), rate [Hz], settling and seconds (before and while it counts), and check
(whether the poses have to be right).
"""
import json
import statistics
import sys
import time

from driver import Driver, Node, stamp_of, what_is_wrong


def main() -> None:
    """Measure one round."""
    task = json.loads(sys.argv[1])
    nodes = [Node(*command) for command in task['commands']]
    driver = Driver(task['namespaces'], task['rate'])
    try:
        driver.wait_for_answers(5, pause=0.05)
        time.sleep(task['settling'])
        first = [answers[0][1] for answers in driver.answers]
        before = sum(node.seconds for node in nodes)
        sent = driver.drive(task['seconds'])
        spent = sum(node.seconds for node in nodes) - before
        resident = sum(node.resident for node in nodes)
    finally:
        for node in nodes:
            node.end()
        driver.close()
    latencies, wrong = [], []
    for index, answers in enumerate(driver.answers):
        heard = {}
        for moment, payload in answers:
            heard.setdefault(stamp_of(payload), moment)
        latencies += [heard[stamp] - times[index] for stamp, times in sent.items()
                      if stamp in heard]
        if task['check']:
            wrong.append(what_is_wrong(first[index], answers[-1][1]))
    latencies.sort()
    if not latencies:
        sys.exit('nothing was answered')
    print(json.dumps({
        'answered': len(latencies) / (len(sent) * len(driver.answers)),
        'cpu_us': spent / len(latencies) * 1e6,
        'p50_us': statistics.median(latencies) * 1e6,
        'p99_us': latencies[int(0.99 * (len(latencies) - 1))] * 1e6,
        'rss_mb': resident,
        'wrong': ', '.join(filter(None, wrong)),
    }))


if __name__ == '__main__':
    main()
