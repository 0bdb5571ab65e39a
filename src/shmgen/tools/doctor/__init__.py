"""Looks for what is wrong with regions and their users, and removes what nobody uses."""
