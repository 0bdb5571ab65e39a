"""Prints rates, lists and curves of live topics."""
