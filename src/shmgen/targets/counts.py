"""Finds the counts in a message, which a reader compares with their bounds before it uses them."""

from __future__ import annotations

from shmgen.core.model import Layout, Layouts, Ref, Role, Sequence, Slot


def holds_counts(layout: Layout, layouts: Layouts) -> bool:
    """Whether the message has a sequence, here or further in."""
    return any(
        slot.role is Role.COUNT or (isinstance(slot.type, Ref) and holds_counts(layouts[slot.type.name], layouts))
        for slot in layout.slots
    )


def bound(count: Slot) -> int:
    """How many elements there may be."""
    assert count.field is not None, "a count is that of a field"
    assert isinstance(count.field.type, Sequence)
    assert count.field.type.capacity is not None, "bounds come before layout"
    return count.field.type.capacity


def counts(layout: Layout) -> dict[str, Slot]:
    """The count of each sequence by the field's name."""
    return {slot.field.name: slot for slot in layout.slots if slot.role is Role.COUNT and slot.field}
