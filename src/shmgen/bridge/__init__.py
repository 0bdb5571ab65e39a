"""`shmgen bridge`: one process carries all topics, services and actions of shmgen.toml between ROS and regions."""
