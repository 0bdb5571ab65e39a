"""The backend for ROS 1, by rospy."""
