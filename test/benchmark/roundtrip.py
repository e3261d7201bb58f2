"""
Drive the robots of one candidate; print the costs as JSON.

Its argument is JSON too: commands (a list of [arguments, environment], one a process), namespaces
(of the robots in them), rate [Hz], settling and seconds (before and during the measurement), and
check (whether the poses are checked).
"""
import json
import statistics
import sys
import time

from driver import Driver, Node, pose_error, stamp_of


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
        received = {}
        for moment, payload in answers:
            received.setdefault(stamp_of(payload), moment)
        latencies += [received[stamp] - times[index] for stamp, times in sent.items()
                      if stamp in received]
        if task['check']:
            wrong.append(pose_error(first[index], answers[-1][1]))
    latencies.sort()
    if not latencies:
        sys.exit('no answer')
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
