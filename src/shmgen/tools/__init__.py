"""What a person at a terminal wants to know of live regions in /dev/shm, and says into them."""
