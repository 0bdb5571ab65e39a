"""Proves that the headers for C touch no memory but theirs: Frama-C's Eva goes through harnesses in C, one a part."""
