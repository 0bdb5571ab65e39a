"""ROS packages that start the bridge."""
