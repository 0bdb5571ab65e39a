"""Import the data types of a PLC project as message definitions with the same bytes.

The module `sources` opens files. `declarations` parses Structured Text, and `exports` parses XML. `types` maps PLC
types to ROS types, and `messages` writes .msg files.
"""
