"""The Python package: ctypes classes with their publishers and subscribers."""
