"""Shows layouts to people: as tables, JSON and drawings."""
