"""PLCopen XML with the generated Structured Text, for import into an IDE."""
