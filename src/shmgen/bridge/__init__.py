"""Turns ROS topics and services into regions and back, in one process for all of shmgen.toml."""
