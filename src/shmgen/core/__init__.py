"""Definitions that all packages of shmgen use: messages, diagnostics, and the bytes of a region."""
