"""The protocol in Promela, and what spin has to find in it: nothing, or a planted fault."""
