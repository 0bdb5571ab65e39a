"""Turns what the user asks for into a closed Schema: finds definitions, reads them, follows what they hold.

schema asks library for messages; library looks in folders, then in the store; parser reads what was found.
Another place (a sourced ROS) is another function that returns a Catalogue; another language (.idl) another parser.
"""

from shmgen.definitions.library import Sources
from shmgen.definitions.schema import available, load

__all__ = ["Sources", "available", "load"]
