"""
Start the candidates repeatedly, alternating; print the seconds to the first odom as JSON.

Its argument is JSON too: candidates (a name each, and [arguments, environment]) and starts.
"""
import json
import sys
import time

from driver import Driver, Node


def seconds_to_answer(driver: Driver, command: list) -> float:
    """Return the time from the start of a node to its first answer [s]; end it then."""
    driver.wait_for_no_subscribers()
    driver.answers[0].clear()
    start = time.perf_counter()
    node = Node(*command)
    try:
        driver.wait_for_answers(1, pause=0.005)
    finally:
        node.end()
    return driver.answers[0][0][0] - start


def main() -> None:
    """Measure the starts."""
    task = json.loads(sys.argv[1])
    driver = Driver([''], 200.0)
    seconds = {name: [] for name in task['candidates']}
    try:
        for _ in range(task['starts']):
            for name, command in task['candidates'].items():
                seconds[name].append(seconds_to_answer(driver, command))
    finally:
        driver.close()
    print(json.dumps(seconds))


if __name__ == '__main__':
    main()
