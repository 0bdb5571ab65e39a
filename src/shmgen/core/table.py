"""The version of the table of fields that each generated Python class contains (docs/layout.md).

A new scalar type needs a change in eight files:

* core/model.py: the `Scalar`, its size, range and IEC type
* core/type_hash.py: its number
* runtime/messages/steps.py and runtime/extension/table.c: its codes
* runtime/messages/fields.py: its name in ctypes
* targets/c/text.py and targets/cpp/members.py: its type in C and C++
* core/table.py: VERSION
"""

VERSION = 1
"""Increase this number with each change after which an older runtime would misread a table."""
