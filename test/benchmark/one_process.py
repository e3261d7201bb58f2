"""
Run the odometry of several robots in one process: with one context, and one executor for all.

Its argument is JSON: the parameters by namespace.
"""
import json
import signal
import sys

from diffdrive_ros.node.odometry_node import OdometryNode
from diffdrive_ros.node.rclpy_internals import make_executor
import rclpy
from rclpy.parameter import Parameter
from rclpy.signals import SignalHandlerOptions


def main() -> None:
    """Spin until SIGTERM."""
    over = []
    signal.signal(signal.SIGTERM, lambda number, frame: over.append(number))
    rclpy.init(args=[], signal_handler_options=SignalHandlerOptions.NO)
    executor = make_executor()
    nodes = [
        OdometryNode(namespace=namespace, parameter_overrides=[
            Parameter(name, value=value) for name, value in parameters.items()])
        for namespace, parameters in json.loads(sys.argv[1]).items()]
    for node in nodes:
        executor.add_node(node)
    while not over:
        executor.spin_once(timeout_sec=0.5)
    for node in nodes:
        executor.remove_node(node)
        node.destroy_node()
    rclpy.try_shutdown()


if __name__ == '__main__':
    main()
