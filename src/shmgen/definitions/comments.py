r"""Turn the comments of a definition into the documentation of its message, fields and constants.

* The comment block at the top documents the message. If blank lines precede the block, a blank line must follow too.
* A comment block directly above a declaration, and the comment after the declaration, document the declaration.
* An indented comment line below a comment continues the comment.
* Any other comment block is a heading and documents nothing.
* A unit in brackets such as `[m/s]` is removed from the text, if the comment has only one unit.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from textwrap import dedent
from typing import NamedTuple


def assign(lines: Sequence[str], behind: Mapping[int, str]) -> tuple[str, dict[int, str]]:
    """Return the documentation of the message, and a map from each declaration's line index to its documentation.

    `behind` maps the line index of each declaration to the comment after the declaration, or `""`.
    """
    message, first = _top(lines)
    documented: dict[int, list[str]] = {}
    above: list[str] = []
    last: list[str] | None = None
    for index in range(first, len(lines)):
        line = lines[index]
        comment = line.lstrip(" \t")
        if index in behind:
            documented[index] = last = [*above, behind[index]]
            above = []
        elif not comment:
            above, last = [], None
        elif last and last[-1] and line != comment and not above:
            last.append(comment)
        else:
            above.append(comment)
    return message, {index: _tidy(texts) for index, texts in documented.items()}


def split_unit(doc: str) -> tuple[str, str]:
    """Split a comment into its text and its unit: "speed [m/s]" -> "speed", "m/s"."""
    units = set(_UNIT.findall(doc))
    if len(units) != 1:
        return doc, ""
    lines = (line.rstrip() for line in _UNIT.sub("", doc).split("\n"))
    return "\n".join(lines).strip(), units.pop()


class PlcNote(NamedTuple):
    """The note in brackets that `shmgen import` writes into a comment, to keep the name and the type in the PLC.

    Examples are `(PLC: rSpeed)` and `(PLC: rSpeed : ARRAY[1..3] OF REAL)`. `name` is the name in the PLC, followed by
    the PLC's type if shmgen would generate another PLC type from the ROS type. `align` is the alignment of a field in
    bytes. `pack` is the pack_mode of a structure.
    """

    name: str = ""
    align: int = 1
    pack: int = 8


def split_plc_note(doc: str) -> tuple[str, PlcNote]:
    """Split a comment into its text and the note that `shmgen import` wrote into the comment."""
    note = _PLC_NOTE.search(doc)
    if note is None:
        return doc, PlcNote()
    rest = doc[: note.start()] + doc[note.end() :]
    text = "\n".join(line.rstrip() for line in rest.split("\n")).strip("\n")
    return text, PlcNote(note["name"], int(note["align"] or 1), int(note["pack"] or 8))


_PLC_NOTE = re.compile(
    r"[ \t]*\(PLC: (?P<name>[^\W\d]\w*(?: : [^()\n]*?(?:\([^()\n]*\))?)?)"
    r"(?:, align (?P<align>[248])|, pack_mode (?P<pack>[124]))?\)"
)

# A unit begins with a letter, degree, percent or micro sign, so `[0, 1]`, `[3]` and `[0-1]` are not units. The index in
# `name[i]` is not a unit. `[-]` marks a value without dimension.
_UNIT = re.compile(r"[ \t]?\[((?![ijkn]\])[A-Za-z°µμΩ%(][^\s\[\],:=_]{0,30}(?: per [a-z]{1,10})?|-)\]")


def _top(lines: Sequence[str]) -> tuple[str, int]:
    """Return the text of the comment block at the top, and the index of the line after the block."""
    bare = [line.strip(" \t") for line in lines]
    start = next((index for index, line in enumerate(bare) if line), len(bare))
    end = next((index for index in range(start, len(bare)) if not bare[index].startswith("#")), len(bare))
    if start > 0 and end < len(bare) and bare[end]:
        return "", start
    return _tidy(lines[start:end]), end


def _tidy(comments: Sequence[str]) -> str:
    """Return the comments without hashes, common indent, and empty lines at either end."""
    stripped = [comment.strip(" \t").lstrip("#").rstrip() for comment in comments]
    return dedent("\n".join(stripped)).strip("\n")
