"""The bridge: ROS topics and services to regions and back, in one process for all of shmgen.toml."""
