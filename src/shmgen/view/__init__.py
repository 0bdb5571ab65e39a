"""Shows live regions on Textual screens, in a terminal or a browser. Needs the extra `view`."""
