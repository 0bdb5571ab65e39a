"""Structured Text: DUTs, lists of constants, and a pair of function blocks for each message."""
