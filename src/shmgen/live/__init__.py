"""Access to live regions, for tools and bridge: list them, find their processes, and make classes for them."""
