"""Detect drift: write and read layout.lock, compare two versions of the file, and format the findings."""
