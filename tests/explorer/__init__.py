"""Goes through all schedules of the shipped ends of a region, in C and in Structured Text: see README.md."""
