"""OpenPLC v4: a library file (`.stlib`) for its compiler STruC++.

The compiler matiec has a target of its own in the module `matiec`, which uses most of the other modules too.
"""
