"""C++17 conversions between the classes of the target cpp and the messages of roscpp or rclcpp."""
