"""The syntax tree of an .idl file, by rosidl_parser, wherever that is installed."""

from __future__ import annotations

import sys
from importlib import import_module
from importlib.machinery import PathFinder
from importlib.util import find_spec, module_from_spec
from typing import Any

from shmgen.core.diagnostics import Span
from shmgen.definitions.annotations import Text
from shmgen.definitions.tokens import Wrong

LARGEST = 2**14
"""Characters: some seconds. VehicleCommand of px4_msgs, the largest known, has 8,000 without its comments."""

DEBIAN = "/usr/lib/python3/dist-packages"
"""Where python3-rosidl is, which only Debian's own Python sees."""


def syntax_tree(code: str, text: Text) -> Any:
    """A lark.Tree; its words know their `start_pos` in `code`, and `text` is shown. Raises Wrong: SHM001, 003, 008."""
    # One blank of many is enough, and much faster.
    kept = [index for index, sign in enumerate(code) if not (sign.isspace() and code[index - 1 : index].isspace())]
    if len(kept) > LARGEST:
        what = f"{len(kept):,} characters of .idl; to read {LARGEST:,} takes seconds"
        raise Wrong("SHM001", what, Span(text.lines[0].path))
    parser = _parser(text)
    try:
        tree = parser.get_ast_from_idl_string("".join(code[index] for index in kept))
    except Exception as error:  # lark's own are not to be had without importing it
        place = getattr(error, "pos_in_stream", None)
        if isinstance(place, int) and 0 <= place < len(kept):
            what = "rosidl_parser expects something else here"
            raise text.token(kept[place], code[kept[place]]).wrong("SHM003", what) from None
        what = f"rosidl_parser expects more, or cannot read this ({type(error).__name__})"
        raise text.token(len(text.whole), "").wrong("SHM003", what) from None
    for word in words(tree):
        word.start_pos = kept[word.start_pos]
    return tree


def words(tree: Any) -> list[Any]:
    """All in it, however deep, in order of place."""
    found = {id(child): child for node in tree.iter_subtrees() for child in node.children if isinstance(child, str)}
    return sorted(found.values(), key=lambda word: word.start_pos)


def _parser(text: Text) -> Any:
    try:
        here = find_spec("rosidl_parser")
        # The wheel, on a Python that puts its folder where it does not look, leaves an empty package behind.
        if (here is None or not here.origin) and (spec := PathFinder.find_spec("rosidl_parser", [DEBIAN])):
            assert spec.loader
            sys.modules["rosidl_parser"] = module_from_spec(spec)
            spec.loader.exec_module(sys.modules["rosidl_parser"])
        return import_module("rosidl_parser.parser")
    except ImportError as error:
        hint = "source a ROS 2, type `pip install ros-rosidl-parser` there, or `apt install python3-rosidl`"
        if error.name == "lark":
            hint = "rosidl_parser needs it: type `pip install lark` there"
        hint += "; a .msg, .srv or .action beside the .idl would be read instead"
        raise Wrong(
            "SHM008", f"what reads .idl is not in {sys.prefix}: {error}", Span(text.lines[0].path), hint
        ) from None
