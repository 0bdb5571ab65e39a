"""The backend for ROS 1, through rospy."""
