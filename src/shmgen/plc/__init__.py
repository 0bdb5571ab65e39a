"""Imports data types of a PLC project as message definitions that hold the same bytes.

sources opens files, declarations reads Structured Text, types knows what ROS has for a type, messages writes .msg.
"""
