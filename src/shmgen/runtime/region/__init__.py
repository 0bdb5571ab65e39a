"""Open, claim, lock and read a region in shared memory."""
