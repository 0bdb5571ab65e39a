"""Generate the method with which a block rejects a received sample if one of the sample's counts exceeds its bound.

A faulty peer or damaged memory can contain a count of 9 for an array of 8 elements. A loop up to this count would
access memory outside the array.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

from shmgen.core.model import Layout, Layouts, Ref, Role
from shmgen.targets.counts import bound, counts, holds_counts
from shmgen.targets.st import names

_INDENT = "    "


class Check(NamedTuple):
    """A method of a block that checks the counts in a message. `of` is the variable that contains the message.

    `variables` and `lines` are finished lines of Structured Text.
    """

    name: str
    of: str
    variables: tuple[str, ...]
    lines: tuple[str, ...]


def checks(layout: Layout, layouts: Layouts, name: str, of: str) -> tuple[Check, ...]:
    """Return the method `name`, which checks the counts in the variable `of`, as a tuple with one element.

    Return an empty tuple if the message has no counts.
    """
    if not holds_counts(layout, layouts):
        return ()
    lines = (f"{name} := TRUE;", *_refusals(layout, layouts, of, name, 1))
    loops = sorted({line.split()[1] for line in lines if line.lstrip().startswith("FOR ")})
    return (Check(name, of, tuple(f"{index} : UDINT;" for index in loops), lines),)


def _refusals(layout: Layout, layouts: Layouts, owner: str, name: str, depth: int) -> Iterator[str]:
    """Yield statements that set the result of the method `name` to FALSE if a count exceeds its bound.

    The statements first check the counts outside arrays, including nested messages. Only if these counts are valid, the
    statements check the elements of arrays up to the count.
    """
    conditions = list(_too_many(layout, layouts, owner))
    loops = list(_loops(layout, layouts, owner, name, depth))
    if not conditions:
        yield from loops
        return
    yield f"IF {conditions[0]}"
    yield from (f"{_INDENT}OR {condition}" for condition in conditions[1:])
    yield from ("THEN", f"{_INDENT}{name} := FALSE;")
    if loops:
        yield "ELSE"
        yield from (f"{_INDENT}{line}" for line in loops)
    yield "END_IF"


def _too_many(layout: Layout, layouts: Layouts, owner: str) -> Iterator[str]:
    for slot in layout.slots:
        member = f"{owner}.{names.st_member(slot.name)}"
        if slot.role is Role.COUNT:
            yield f"{member} > {bound(slot)}"
        elif isinstance(slot.type, Ref) and slot.count is None:
            yield from _too_many(layouts[slot.type.name], layouts, member)


def _loops(layout: Layout, layouts: Layouts, owner: str, name: str, depth: int) -> Iterator[str]:
    counted = counts(layout)
    for slot in layout.slots:
        if not isinstance(slot.type, Ref) or not holds_counts(inner := layouts[slot.type.name], layouts):
            continue
        member = f"{owner}.{names.st_member(slot.name)}"
        if slot.count is None:
            yield from _loops(inner, layouts, member, name, depth)
            continue
        last = f"{owner}.{names.st_member(counted[slot.name].name)}" if slot.name in counted else str(slot.count)
        yield f"FOR udi{depth} := 1 TO {last} DO"
        element = f"{member}[udi{depth} - 1]"
        yield from (f"{_INDENT}{line}" for line in _refusals(inner, layouts, element, name, depth + 1))
        yield "END_FOR"
