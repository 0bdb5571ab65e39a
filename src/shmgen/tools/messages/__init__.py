"""Reads, writes and prints single messages."""
