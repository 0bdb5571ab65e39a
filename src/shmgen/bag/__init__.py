"""Records the samples of live regions into ROS 2 bags (MCAP), and plays bags into regions."""
