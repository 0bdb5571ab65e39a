"""Serialization of messages: CDR, direct conversion of samples to ROS 1 and ROS 2 bytes, and type hashes."""
