"""The backend for ROS 2, by rclpy."""
