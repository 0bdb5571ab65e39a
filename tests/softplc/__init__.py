"""A stand-in for a PLC, for tests and demos: Structured Text to C++ to a library that Python drives. See README.md."""

from tests.softplc.build import CompileError, compile_st
from tests.softplc.plc import Block, Plc, Trap, View
from tests.softplc.reading import Unsupported

__all__ = ["Block", "CompileError", "Plc", "Trap", "Unsupported", "View", "compile_st"]
