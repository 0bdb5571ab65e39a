"""The words that all rooms share: messages, diagnostics, the bytes of a region."""
