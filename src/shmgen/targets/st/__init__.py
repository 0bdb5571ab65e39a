"""Structured Text: DUTs, constants, and a pair of function blocks for each message."""
