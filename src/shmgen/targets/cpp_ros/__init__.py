"""C++17: from the classes of the target cpp to the messages of roscpp or rclcpp, and back."""
