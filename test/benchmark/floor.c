/* The floor of a round trip: what rcl and DDS cost for a JointState in and an Odometry out.
 *
 * No executor, no Python and no mathematics: the typed messages of C, taken and published as they
 * are. A node that does its work comes near to this at best; bytes instead may save a little. */
#include <signal.h>

#include <nav_msgs/msg/odometry.h>
#include <rcl/rcl.h>
#include <rosidl_runtime_c/string_functions.h>
#include <sensor_msgs/msg/joint_state.h>

static volatile sig_atomic_t is_over = 0;

static void end(int number) {
  (void)number;
  is_over = 1;
}

int main(int count, char **arguments) {
  signal(SIGTERM, end);

  rcl_allocator_t allocator = rcl_get_default_allocator();
  rcl_init_options_t options = rcl_get_zero_initialized_init_options();
  rcl_context_t context = rcl_get_zero_initialized_context();
  if (rcl_init_options_init(&options, allocator)) return 1;
  if (rcl_init(count, (const char *const *)arguments, &options, &context)) return 1;

  rcl_node_t node = rcl_get_zero_initialized_node();
  rcl_node_options_t node_options = rcl_node_get_default_options();
  if (rcl_node_init(&node, "floor", "", &context, &node_options)) return 1;

  /* Reliable is rcl's default; the depth is that of everything in this benchmark. */
  rcl_publisher_t publisher = rcl_get_zero_initialized_publisher();
  rcl_publisher_options_t publisher_options = rcl_publisher_get_default_options();
  publisher_options.qos.depth = 1000;
  if (rcl_publisher_init(
          &publisher, &node, ROSIDL_GET_MSG_TYPE_SUPPORT(nav_msgs, msg, Odometry), "odom",
          &publisher_options)) return 1;

  rcl_subscription_t subscription = rcl_get_zero_initialized_subscription();
  rcl_subscription_options_t subscription_options = rcl_subscription_get_default_options();
  subscription_options.qos.depth = 1000;
  if (rcl_subscription_init(
          &subscription, &node, ROSIDL_GET_MSG_TYPE_SUPPORT(sensor_msgs, msg, JointState),
          "joint_states", &subscription_options)) return 1;

  rcl_wait_set_t waiting = rcl_get_zero_initialized_wait_set();
  if (rcl_wait_set_init(&waiting, 1, 0, 0, 0, 0, 0, &context, allocator)) return 1;

  sensor_msgs__msg__JointState joints;
  nav_msgs__msg__Odometry odom;
  if (!sensor_msgs__msg__JointState__init(&joints) || !nav_msgs__msg__Odometry__init(&odom)) return 1;
  rosidl_runtime_c__String__assign(&odom.header.frame_id, "odom");
  rosidl_runtime_c__String__assign(&odom.child_frame_id, "base_link");

  while (!is_over) {
    if (rcl_wait_set_clear(&waiting)) return 1;
    if (rcl_wait_set_add_subscription(&waiting, &subscription, NULL)) return 1;
    if (rcl_wait(&waiting, RCL_MS_TO_NS(500)) != RCL_RET_OK) continue;
    rmw_message_info_t info;
    while (rcl_take(&subscription, &joints, &info, NULL) == RCL_RET_OK) {
      odom.header.stamp = joints.header.stamp;
      odom.pose.pose.position.x = joints.position.data[0];
      if (rcl_publish(&publisher, &odom, NULL)) return 1;
    }
  }

  if (rcl_wait_set_fini(&waiting) || rcl_subscription_fini(&subscription, &node)) return 1;
  if (rcl_publisher_fini(&publisher, &node) || rcl_node_fini(&node)) return 1;
  return rcl_shutdown(&context);
}
