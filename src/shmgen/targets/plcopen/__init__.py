"""PLCopen XML, which holds the Structured Text for import into an IDE."""
