"""C headers that assert every offset and size."""
