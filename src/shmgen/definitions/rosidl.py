"""Parse an .idl file into a syntax tree, with the rosidl_parser of the sourced ROS, of pip or of Debian."""

from __future__ import annotations

import sys
from importlib import import_module
from importlib.machinery import PathFinder
from importlib.util import find_spec, module_from_spec
from typing import Any

from shmgen.core.diagnostics import Span
from shmgen.definitions import syntax_hints
from shmgen.definitions.annotations import Text
from shmgen.definitions.tokens import DefinitionError

LARGEST = 2**14
"""The largest number of characters in a file, each run of blanks counted as one. Parsing then takes some seconds.

px4_msgs/VehicleCommand has 8,000.
"""

DEBIAN = "/usr/lib/python3/dist-packages"
"""The folder of Debian's package python3-rosidl. Only Debian's own Python searches this folder."""


def syntax_tree(code: str, text: Text) -> Any:
    """Parse `code` into a lark.Tree. `start_pos` of each word in the tree is the word's position in `code`.

    Errors show lines of `text`. Raises DefinitionError if the code is too long (SHM001) or invalid (SHM003), or if
    rosidl_parser is missing (SHM008).
    """
    # Collapse each run of blanks to one blank: parsing becomes much faster.
    indexes = [index for index, sign in enumerate(code) if not (sign.isspace() and code[index - 1 : index].isspace())]
    if len(indexes) > LARGEST:
        what = f"{len(indexes):,} characters, but the limit of an .idl file is {LARGEST:,}"
        raise DefinitionError("SHM001", what, Span(text.lines[0].path))
    parser = _parser(text)
    try:
        tree = parser.get_ast_from_idl_string("".join(code[index] for index in indexes))
    except Exception as error:  # the exceptions of lark exist only once lark is imported
        place = getattr(error, "pos_in_stream", None)
        if isinstance(place, int) and 0 <= place < len(indexes):
            what = "rosidl_parser rejects this text"
            fault = text.token(indexes[place], code[indexes[place]])
            hint = syntax_hints.idl_hint(fault.line.text, "".join(code[index] for index in indexes[:place]))
            raise fault.error("SHM003", what, hint) from None
        what = f"rosidl_parser rejects the end of the file ({type(error).__name__})"
        hint = "close each module and each structure by `};`"
        raise text.token(len(text.whole), "").error("SHM003", what, hint) from None
    for word in words(tree):
        word.start_pos = indexes[word.start_pos]
    return tree


def words(tree: Any) -> list[Any]:
    """Return all words in a tree, in order of position."""
    by_id = {id(child): child for node in tree.iter_subtrees() for child in node.children if isinstance(child, str)}
    return sorted(by_id.values(), key=lambda word: word.start_pos)


def _parser(text: Text) -> Any:
    try:
        here = find_spec("rosidl_parser")
        # Some Pythons install the wheel into a folder that they do not search, and then find only an empty package.
        if (here is None or not here.origin) and (spec := PathFinder.find_spec("rosidl_parser", [DEBIAN])):
            assert spec.loader
            sys.modules["rosidl_parser"] = module_from_spec(spec)
            spec.loader.exec_module(sys.modules["rosidl_parser"])
        return import_module("rosidl_parser.parser")
    except ImportError as error:
        hint = "source ROS 2, or type `pip install ros-rosidl-parser` or `apt install python3-rosidl`"
        if error.name == "lark":
            hint = "type `pip install lark`: rosidl_parser requires lark"
        hint += "\nor put the same definition as .msg, .srv or .action beside the .idl file"
        raise DefinitionError(
            "SHM008",
            f"rosidl_parser, which reads .idl files, cannot be loaded in {sys.prefix}: {error}",
            Span(text.lines[0].path),
            hint,
        ) from None
