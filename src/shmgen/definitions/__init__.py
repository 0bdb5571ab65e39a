"""Finds and reads definitions, and all that they hold: a closed Schema of what the user asks for.

schema asks library for messages; library looks in folders, then in the environment or the store; parser reads .msg,
.srv and .action, idl reads .idl. Another place is another function that returns a Catalogue, another language another
parser.
"""

from shmgen.definitions.library import Library, Sources, open_library
from shmgen.definitions.schema import load, load_from, load_usable

__all__ = ["Library", "Sources", "load", "load_from", "load_usable", "open_library"]
