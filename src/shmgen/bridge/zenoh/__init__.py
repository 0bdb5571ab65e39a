"""The backend for ROS 2 on rmw_zenoh, by eclipse-zenoh."""
