"""The command line: one file for each family of commands. The only room that knows click."""
