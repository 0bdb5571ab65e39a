"""Finds problems of regions and their processes, and removes files that no process uses."""
