"""The map: sends frames of the robot to one browser, as fast as it draws them."""
from collections.abc import Mapping
from typing import Any

from diffdrive_ros.dashboard.elements import PageElement
from diffdrive_ros.dashboard.robot import DashboardRobot

MAX_PENDING_FRAMES = 6  # sent and not drawn yet; a browser that draws nothing gets no more
SLOW_PERIOD_S = 1.0  # of the frames for such a browser


class RobotMap(
        PageElement, component='static/robot_map.js', dependencies=['static/map_drawing.js']):
    """The map of a robot; events drag and follow."""

    def __init__(self, robot: DashboardRobot) -> None:
        super().__init__(
            'Map of the robot. Drag it, turn it by the tip of its arrow, drag the arrows of its '
            'wheels; the panel Kinematics does the same by the keyboard.')
        self._robot = robot
        self._sent_at = self._drawn_at = 0.0
        self._pending = 0
        self._sent_points = dict.fromkeys(robot.trajectories, (-1, 0))

    def send_frame(self, now: float) -> None:
        """Send the frame of a moment, unless too many are pending."""
        if self._pending >= MAX_PENDING_FRAMES and now - self._sent_at < SLOW_PERIOD_S:
            return
        robot, drive = self._robot, self._robot.parameters.drive
        self._sent_at = now
        self._pending += 1
        self.run_method('show', {
            'frameTime': now * 1e3, 'stopCount': robot.teleop.stop_count,
            'isSilent': robot.is_silent, 'odom': robot.odom or (0.0, 0.0, 0.0),
            'groundTruth': robot.ground_truth, 'ellipse': robot.ellipse, 'wheels': robot.wheels,
            'trajectories': self._new_points(), 'wheelSeparation': drive.wheel_separation})

    def acknowledge(self, frame_time: float, is_visible: bool) -> None:
        """Record the newest frame that the browser has drawn, from a heartbeat."""
        if frame_time > self._drawn_at:
            self._drawn_at, self._pending = frame_time, 0
        elif is_visible:
            self._pending = min(self._pending, MAX_PENDING_FRAMES - 1)

    def set_texts(self, texts: Mapping[str, str]) -> None:
        """Update texts by the labels of their elements."""
        self.run_method('setTexts', texts)

    def draw_dragged(self, pose: Any, wheels: Any) -> None:
        """Draw a pose and wheel speeds in place of those of the robot."""
        self.run_method('drawDragged', pose, wheels)

    def draw_measured(self) -> None:
        """Draw the robot as it is measured."""
        self.run_method('drawMeasured')

    def _new_points(self) -> dict[str, Any]:
        """Return what was added to the trajectories since the last frame, by their names."""
        added = {}
        for name, trajectory in self._robot.trajectories.items():
            version, count = self._sent_points[name]
            start = count if version == trajectory.version else 0
            self._sent_points[name] = trajectory.version, len(trajectory.points)
            if start != len(trajectory.points) or not start:
                added[name] = {'from': start, 'points': [
                    (round(x, 4), round(y, 4), int(is_start))
                    for x, y, is_start in trajectory.points[start:]]}
        return added
