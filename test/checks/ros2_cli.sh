#!/usr/bin/env bash
# Check the package by the commands of a ROS user: colcon build, ros2 run, teleoperation, echo,
# param. Needs ros2 and colcon on the PATH; it prints each command after a $.
set -euo pipefail
set -m # background jobs get process groups of their own, and Ctrl-C can be sent to one

for tool in ros2 colcon; do
  command -v "$tool" > /dev/null || { echo "$tool is not on the PATH"; exit 1; }
done

package=$(cd "$(dirname "$0")/../.." && pwd)
workspace=$(mktemp -d)
export ROS_DOMAIN_ID=${ROS_DOMAIN_ID:-94} ROS_AUTOMATIC_DISCOVERY_RANGE=LOCALHOST
export PYTHONUNBUFFERED=1

finish() {
  for job in $(jobs -p); do kill -INT -- "-$job" 2> /dev/null || true; done
  wait || true
  ros2 daemon stop > /dev/null 2>&1 || true
  rm -rf "$workspace"
}
trap finish EXIT

show() {
  echo "\$ $*"
  "$@"
}

# Show a command's output, and fail unless it has a line that matches.
expect() {
  local pattern=$1 output
  shift
  echo "\$ $*"
  output=$("$@" 2>&1) || true
  echo "$output"
  grep -Eq -- "$pattern" <<< "$output" || { echo "FAILED: nothing like '$pattern'"; exit 1; }
}

mkdir "$workspace/src"
ln -s "$package" "$workspace/src/diffdrive_ros"
cd "$workspace"
expect '1 package finished' colcon build --packages-select diffdrive_ros
# shellcheck disable=SC1091
set +u && source install/setup.bash && set -u

ros2 daemon stop > /dev/null
ros2 daemon start > /dev/null
expect 'odometry' ros2 pkg executables diffdrive_ros

echo '$ ros2 run diffdrive_ros simulator &'
ros2 run diffdrive_ros simulator &
echo '$ ros2 run diffdrive_ros odometry &'
ros2 run diffdrive_ros odometry > odometry.log 2>&1 &
node=$!
echo "\$ ros2 topic pub --rate 10 /cmd_vel geometry_msgs/msg/Twist '{linear: {x: 0.2}, angular: {z: 0.5}}' &"
ros2 topic pub --rate 10 /cmd_vel geometry_msgs/msg/Twist \
  '{linear: {x: 0.2}, angular: {z: 0.5}}' > /dev/null &
until ros2 node list | grep -q /odometry; do sleep 0.5; done

expect 'x: 0\.(19|20)' ros2 topic echo --once --no-arr /odom
expect 'velocity' ros2 topic echo --once /wheel_commands
expect 'wheel_separation$' ros2 param list /odometry
expect 'FULL distance' ros2 param describe /odometry wheel_separation
expect '0.16' ros2 param get /odometry wheel_separation
expect 'successful' ros2 param set /odometry left_wheel_radius_multiplier 1.01
expect 'successful' ros2 param set /odometry cmd_vel_timeout 1
expect 'must be from 0.1 to 10' ros2 param set /odometry left_wheel_radius_multiplier -- -1.0
expect 'read-only' ros2 param set /odometry wheel_radius 0.05
expect 'successful' ros2 param set /odometry max_wheel_speed .nan
expect 'Setting parameter failed' ros2 param set /odometry max_wheel_speed nan
expect '/cmd_vel: geometry_msgs/msg/Twist' ros2 node info /odometry
expect 'success=True' ros2 service call /odometry/reset_odometry std_srvs/srv/Trigger
expect 'success=True' ros2 service call /odometry/enable std_srvs/srv/SetBool '{data: false}'
expect 'success=True' ros2 service call /odometry/enable std_srvs/srv/SetBool '{data: true}'

echo '$ cat odometry.log'
cat odometry.log
grep -q 'example robot' odometry.log
kill -INT -- "-$node"
wait "$node"
echo 'Ctrl-C ended odometry with exit code 0'
grep -q Traceback odometry.log && { echo 'FAILED: a traceback'; exit 1; }

# As a service starts and stops it: ros2 run would not forward SIGTERM.
echo '$ install/diffdrive_ros/lib/diffdrive_ros/odometry --ros-args --params-file robot.yaml &'
install/diffdrive_ros/lib/diffdrive_ros/odometry \
  --ros-args --params-file "$package/config/robot.yaml" > odometry.log 2>&1 &
node=$!
until ros2 node list | grep -q /odometry; do sleep 0.5; done
kill -TERM "$node"
wait "$node"
echo 'SIGTERM ended odometry with exit code 0'
echo 'all of it works'
