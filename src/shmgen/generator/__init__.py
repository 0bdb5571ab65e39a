"""Turns definitions and a configuration into the text of every generated file."""
