"""The backend for ROS 2, through rclpy."""
