"""OpenPLC v4: one library file (`.stlib`) of its compiler STruC++, and what matiec shares with it."""
