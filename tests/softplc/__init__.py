"""A stand-in for a PLC, for tests and demos: Structured Text to C++ to a library that Python drives. See README.md."""

from tests.softplc.build import compile_st
from tests.softplc.online_change import online_change
from tests.softplc.plc import Block, Plc, Trap, View
from tests.softplc.reading import CompileError, Unsupported

__all__ = ["Block", "CompileError", "Plc", "Trap", "Unsupported", "View", "compile_st", "online_change"]
