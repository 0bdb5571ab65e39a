"""Turns live regions in /dev/shm into what a person at a terminal wants to know, and a person's words into samples."""
