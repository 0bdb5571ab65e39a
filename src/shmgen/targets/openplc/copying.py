"""Generate the C statements that copy a message between its C structure and the program's variable.

The compilers STruC++ and matiec do not store a structure with the layout of the region, so each field is copied
separately. Only the valid elements of a sequence are copied.
"""

from __future__ import annotations

from collections.abc import Iterator

from shmgen.core.model import Layout, Layouts, Ref, Role
from shmgen.targets.c.names import c_member
from shmgen.targets.counts import bound, counts
from shmgen.targets.openplc.compiler import Compiler
from shmgen.targets.openplc.names import member

_INDENT = "    "


def copies(layout: Layout, layouts: Layouts, compiler: Compiler, plc: str, c: str, *, to_plc: bool) -> list[str]:
    """Return the C statements that copy a message between the C structure `c` and the program's variable `plc`.

    If `to_plc` is true, the statements copy from `c` to `plc`, otherwise from `plc` to `c`.
    """
    return list(_copies(layout, layouts, compiler, (plc, c), to_plc, 0))


def _copies(
    layout: Layout, layouts: Layouts, compiler: Compiler, owners: tuple[str, str], to_plc: bool, depth: int
) -> Iterator[str]:
    counted = counts(layout)
    leaf = compiler.leaf_in if to_plc else compiler.leaf_out
    for slot in layout.slots:
        if slot.role is Role.PADDING:
            continue
        plc, c = f"{owners[0]}.{member(slot.name).upper()}", f"{owners[1]}{c_member(slot.name)}"
        if slot.count is not None:
            index = f"i{depth}"
            limit = str(slot.count)
            if slot.name in counted:  # the program's count is not yet checked
                own = counted[slot.name]
                limit = f"{limit} && {index} < {owners[1]}{c_member(own.name)}"
                assert bound(own) == slot.count
            yield f"for (uint32_t {index} = 0; {index} < {limit}; {index}++) {{"
            plc, c = compiler.element(plc, index), f"{c}[{index}]"
        indent = "" if slot.count is None else _INDENT
        if isinstance(slot.type, Ref):
            inner = layouts[slot.type.name]
            for line in _copies(inner, layouts, compiler, (plc, f"{c}."), to_plc, depth + 1):
                yield indent + line
        else:
            yield indent + leaf(plc, c, slot.type, layout.options)
        if slot.count is not None:
            yield "}"
