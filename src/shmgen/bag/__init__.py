"""What turns the samples of live regions into ROS 2 bags (MCAP), and bags into samples again."""
