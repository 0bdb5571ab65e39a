r"""Turns the comments of a definition into the documentation of its message, fields and constants.

* The block of comments at the top is the message's; so is one below blank lines, if a blank line follows it.
* A block directly above a declaration, and the comment behind it, are the declaration's. An indented comment line
  below a comment continues it. Any other block is a heading, and belongs to nobody.
* `[m/s]` in a comment is a unit, if it is the only one; it is then taken out of the text.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from textwrap import dedent


def assign(lines: Sequence[str], behind: Mapping[int, str]) -> tuple[str, dict[int, str]]:
    """The documentation of the message, and of each declaration: `behind` maps its line to the comment in it."""
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


def unit_of(doc: str) -> tuple[str, str]:
    """The documentation without its unit, and the unit: "speed [m/s]" -> "speed", "m/s"."""
    units = set(_UNIT.findall(doc))
    if len(units) != 1:
        return doc, ""
    lines = (line.rstrip() for line in _UNIT.sub("", doc).split("\n"))
    return "\n".join(lines).strip(), units.pop()


def own_of(doc: str) -> tuple[str, str]:
    """The documentation without what a PLC calls it, and that: "speed (PLC: rSpeed)" -> "speed", "rSpeed".

    `shmgen import` writes it; of a type that is spelled otherwise too it says `rSpeed : ARRAY[1..3] OF REAL`.
    """
    found = _OWN.search(doc)
    if found is None:
        return doc, ""
    rest = doc[: found.start()] + doc[found.end() :]
    return "\n".join(line.rstrip() for line in rest.split("\n")).strip("\n"), found[1]


_OWN = re.compile(r"[ \t]*\(PLC: ([A-Za-z_]\w*(?: : [^()\n]*(?:\([^()\n]*\))?)?)\)")

# A letter, degree, percent or micro sign first: `[0, 1]`, `[3]`, `[0-1]` are no units. `name[i]` has an index, and
# `[-]` stands where a unit would: of no dimension.
_UNIT = re.compile(r"[ \t]?\[((?![ijkn]\])[A-Za-z°µμΩ%(][^\s\[\],:=_]{0,30}(?: per [a-z]{1,10})?|-)\]")


def _top(lines: Sequence[str]) -> tuple[str, int]:
    """The block at the top, and the line behind it."""
    start = 0
    while start < len(lines) and not lines[start].strip(" \t"):
        start += 1
    end = start
    while end < len(lines) and lines[end].lstrip(" \t").startswith("#"):
        end += 1
    if start > 0 and end < len(lines) and lines[end].strip(" \t"):
        return "", start
    return _tidy(lines[start:end]), end


def _tidy(comments: Sequence[str]) -> str:
    """Without hashes, the common indent, and empty lines at either end."""
    stripped = [comment.strip(" \t").lstrip("#").rstrip() for comment in comments]
    while stripped and not stripped[-1]:
        stripped.pop()
    return dedent("\n".join(stripped)).strip("\n")
