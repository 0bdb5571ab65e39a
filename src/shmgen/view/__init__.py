"""What shows live regions on screens of Textual, in a terminal or a browser: needs the extra `view`."""
