"""shmgen: from ROS message definitions to shared-memory bridge code for CODESYS and ROS."""

__version__ = "0.1.0"
