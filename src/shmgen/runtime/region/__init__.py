"""What opens, claims, locks and reads a region in shared memory."""
