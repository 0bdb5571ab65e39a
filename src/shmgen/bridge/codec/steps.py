"""The steps by which the bytes of a layout become those that ROS sends, and become its bytes again."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from typing import Literal, NamedTuple, TypeAlias

from shmgen.core.model import Clock, Layout, Layouts, Ref, Role, Scalar, Slot, String, assert_never

Code: TypeAlias = Literal["numbers", "bools", "texts", "wide texts", "clocks", "stamp", "messages", "filler"]
"""Of a stamp: a time that ROS's now may stand for where it is zero."""
CODES: tuple[Code, ...] = ("numbers", "bools", "texts", "wide texts", "clocks", "stamp", "messages", "filler")
UNITS = {"TIME": "milliseconds", "LTIME": "nanoseconds", "struct": "seconds_nanoseconds"}
"""What the functions in `values` call a time in the region."""
KINDS = [(clock, units) for clock in Clock for units in UNITS]
"""Of a time: a step has the place in this list."""


class Step(NamedTuple):
    """Elements that lie one behind the other, from byte `at` of the message that they are part of.

    Each has `size` bytes in the region. They are `most`, or as many as the uint32 at byte `count_at` says, unless that
    is -1. The next `inner` steps are those of each element, which is a message. `kind` is that of a time, or whether a
    text is Latin-1.
    """

    code: Code
    at: int
    size: int
    most: int = 1
    count_at: int = -1
    inner: int = 0
    kind: int = 0


def steps_of(layout: Layout, layouts: Layouts, stamp: tuple[str, ...] = ()) -> tuple[Step, ...]:
    """In ROS's order. `stamp` are the names of the fields that lead to the stamp, if there is one."""
    return tuple(_joined(_Taking(layouts, layout, stamp).apart()))


@dataclass(frozen=True, slots=True)
class _Taking:
    """A layout that is taken apart; its first byte is `base` bytes behind that of the one it is part of."""

    layouts: Layouts
    layout: Layout
    stamp: tuple[str, ...]
    base: int = 0

    def apart(self) -> Iterator[Step]:
        count_at = -1
        for slot in self.layout.slots:
            match slot.role:
                case Role.COUNT:
                    count_at = self.base + slot.offset
                case Role.FILLER:
                    yield Step("filler", self.base + slot.offset, 1)
                case Role.DATA:
                    yield from self._field(slot, count_at)
                    count_at = -1
                case Role.PADDING:
                    pass
                case _:
                    assert_never(slot.role)

    def _field(self, slot: Slot, count_at: int) -> Iterator[Step]:
        at, size, most = self.base + slot.offset, slot.element_size, 1 if slot.count is None else slot.count
        options = self.layout.options
        match slot.type:
            case Scalar.BOOL:
                yield Step("bools", at, size, most, count_at)
            case Scalar():
                yield Step("numbers", at, size, most, count_at)
            case Clock() as clock:
                code: Code = "stamp" if self.stamp == (slot.name,) else "clocks"
                yield Step(code, at, size, most, count_at, kind=KINDS.index((clock, options.time)))
            case String(_, wide):
                latin = options.encoding == "latin-1" and not wide
                yield Step("wide texts" if wide else "texts", at, size, most, count_at, kind=int(latin))
            case Ref(name):
                below = self.stamp[1:] if self.stamp[:1] == (slot.name,) else ()
                inner = replace(self, layout=self.layouts[name], stamp=below, base=at)
                if slot.count is None:
                    yield from inner.apart()
                else:
                    found = tuple(_joined(replace(inner, stamp=(), base=0).apart()))
                    yield Step("messages", at, size, most, count_at, len(found))
                    yield from found
            case _:
                assert_never(slot.type)


def _joined(steps: Iterable[Step]) -> Iterator[Step]:
    """Numbers of one size that lie side by side as one step."""
    former: Step | None = None
    inside = 0  # so many of the next steps are those of an element, and joined already
    for step in steps:
        plain = step.code == "numbers" and step.count_at < 0 and not inside
        if former and plain and (former.size, former.at + former.size * former.most) == (step.size, step.at):
            former = former._replace(most=former.most + step.most)
            continue
        if former:
            yield former
        former = step if plain else None
        if not plain:
            yield step
        inside = inside - 1 if inside else step.inner
    if former:
        yield former
