"""Proves that the C headers access only their own memory: Eva of Frama-C analyses C harnesses, one for each part."""
