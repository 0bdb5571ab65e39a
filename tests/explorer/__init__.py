"""Explores all schedules of the shipped endpoints of a region, in C and in Structured Text: see README.md."""
