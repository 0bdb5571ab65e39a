"""The parts of generated classes: fields, arrays, strings, times, and the checks of their values."""
