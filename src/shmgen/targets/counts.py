"""Find the counts in a message. A reader compares each count with its bound before it uses the count."""

from __future__ import annotations

from shmgen.core.model import Layout, Layouts, Ref, Role, Sequence, Slot


def holds_counts(layout: Layout, layouts: Layouts) -> bool:
    """Return True if the message or a message in its fields has a sequence."""
    return any(
        slot.role is Role.COUNT or (isinstance(slot.type, Ref) and holds_counts(layouts[slot.type.name], layouts))
        for slot in layout.slots
    )


def bound(count: Slot) -> int:
    """Return the bound of a sequence, from the layout entry (Slot) of the sequence's count."""
    assert count.field is not None, "each count belongs to a field"
    assert isinstance(count.field.type, Sequence)
    assert count.field.type.capacity is not None, "bounds come before layout"
    return count.field.type.capacity


def counts(layout: Layout) -> dict[str, Slot]:
    """Map the name of each sequence in a message to the layout entry (Slot) of its count."""
    return {slot.field.name: slot for slot in layout.slots if slot.role is Role.COUNT and slot.field}
