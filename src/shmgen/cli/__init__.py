"""The command line: one file for each family of commands. Only this folder imports click."""
