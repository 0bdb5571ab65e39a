"""Turns messages into bytes on the wire and back: CDR, ROS 1's format, and straight from bytes to bytes."""
