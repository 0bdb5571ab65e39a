"""What generated classes are made of: fields, arrays, strings, times, and the checks of their values."""
