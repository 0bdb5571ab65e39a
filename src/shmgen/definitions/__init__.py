"""Find and read definitions: the requested messages, and all messages that they contain, become one Schema.

The module `schema` requests messages from `library`. The library searches the folders of the user with `folders`, then
a sourced ROS with `environment`, or the built-in definitions with `store`. `parser` reads .msg, .srv and .action files,
and `idl` reads .idl files. To search a new source, write a function that returns a Catalogue. To read a new language,
write a parser.
"""

from shmgen.definitions.library import Library, Sources, open_library
from shmgen.definitions.schema import load, load_usable

__all__ = ["Library", "Sources", "load", "load_usable", "open_library"]
