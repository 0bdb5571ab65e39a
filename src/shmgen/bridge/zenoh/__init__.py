"""The backend for ROS 2 with rmw_zenoh, through the package eclipse-zenoh."""
