"""Which other nodes take part, as the dashboard observes them; over DDS."""
from collections.abc import Callable

from diffdrive_ros.dashboard.dashboard_node import DashboardNode
from diffdrive_ros.node.odometry_node import OdometryNode
from geometry_msgs.msg import Twist
import pytest
from rclpy.node import Node
from sensor_msgs.msg import JointState
from support.station import Station, wait_until


def test_other_commanders_are_found_also_by_the_same_name(
        station: Station, node: DashboardNode) -> None:
    """A second dashboard on the same robot is one."""
    node.advertise_commands(False)
    wait_until(lambda: node.get_publishers_info_by_topic('cmd_vel'))
    assert node.other_commanders() == []
    others = [DashboardNode(context=station.context), Node('teleop', context=station.context)]
    others[0].advertise_commands(False)
    others[1].create_publisher(Twist, 'cmd_vel', 1)
    wait_until(lambda: node.other_commanders() == ['/dashboard', '/teleop'])
    for other in others:
        other.destroy_node()


@pytest.mark.parametrize(('name', 'namespace', 'topic'), [
    ('odometry', '/', '/cmd_vel'), ('odometry', '/robot2', '/cmd_vel'),
    ('simulator', '/', '/wheel_commands'), ('simulator', '/robot2', '/wheel_commands'),
    ('motor_driver', '/', '/wheel_commands')])
def test_robot_is_simulated_without_any_other_subscriber(
        station: Station, make: Callable[..., OdometryNode], node: DashboardNode,
        name: str, namespace: str, topic: str) -> None:
    """Of any name, in any namespace."""
    make()
    simulator = Node('simulator', context=station.context)
    simulator.create_subscription(JointState, 'wheel_commands', print, 1)
    wait_until(node.is_simulated)
    other = Node(name, namespace=namespace, context=station.context)
    kind = Twist if topic == '/cmd_vel' else JointState
    other.create_subscription(kind, topic, print, 1)
    wait_until(lambda: not node.is_simulated())
    other.destroy_node()
    simulator.destroy_node()


@pytest.mark.parametrize(('interface', 'others'), [
    ('per_wheel', []), ('none', ['/odometry2']), ('joint_state', ['/odometry2'])])
def test_robot_is_real_if_other_nodes_may_command_the_wheels(
        station: Station, make: Callable[..., OdometryNode], node: DashboardNode,
        interface: str, others: list[str]) -> None:
    """Or if the commands go elsewhere, as on a topic for each wheel."""
    odometry = make(wheel_command_type=interface)
    simulator = station.add(Node('simulator', context=station.context))
    simulator.create_subscription(JointState, 'wheel_commands', print, 1)
    for name in others:
        other = station.add(Node(name.strip('/'), context=station.context))
        other.create_publisher(JointState, 'wheel_commands', 1)
    names = [odometry.get_fully_qualified_name()] if interface == 'joint_state' else []
    wait_until(lambda: node._subscriber_names('wheel_commands') == ['/simulator']
               and node._subscriber_names('cmd_vel') == ['/odometry']
               and node._publisher_names('wheel_commands') == names + others)
    assert not node.is_simulated()
