"""Commands on live regions in /dev/shm: inspect, publish, call, and check."""
