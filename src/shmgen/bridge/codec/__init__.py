"""Messages as bytes on the wire: CDR, ROS 1's format, and straight from bytes to bytes."""
