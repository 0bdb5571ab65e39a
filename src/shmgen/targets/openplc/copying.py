"""Generate the C statements that copy a message between its C structure and the program's variable.

The compilers STruC++ and matiec do not store a structure with the layout of the region, so each field is copied
separately. Only the valid elements of a sequence are copied.
"""

from __future__ import annotations

from collections.abc import Iterator

from shmgen.core.model import Layout, Layouts, Ref, Role
from shmgen.targets.c.names import c_member
from shmgen.targets.counts import counts
from shmgen.targets.openplc.compiler import Compiler
from shmgen.targets.openplc.names import member


def copies(
    layout: Layout, layouts: Layouts, compiler: Compiler, plc: str, c: str, *, to_plc: bool, depth: int = 0
) -> Iterator[str]:
    """Yield the C statements that copy a message between the C structure `c` and the program's variable `plc`.

    If `to_plc` is true, the statements copy from `c` to `plc`, otherwise from `plc` to `c`. `depth` is the number of
    messages around this message.
    """
    counted = counts(layout)
    leaf = compiler.leaf_in if to_plc else compiler.leaf_out
    index = f"i{depth}"
    for slot in layout.slots:
        if slot.role is Role.PADDING:
            continue
        variable, field = f"{plc}.{member(slot.name).upper()}", f"{c}{c_member(slot.name)}"
        if slot.count is not None:
            variable, field = compiler.element(variable, index), f"{field}[{index}]"
        if isinstance(slot.type, Ref):
            inner = layouts[slot.type.name]
            lines = copies(inner, layouts, compiler, variable, f"{field}.", to_plc=to_plc, depth=depth + 1)
        else:
            lines = iter([leaf(variable, field, slot.type, layout.options)])
        if slot.count is None:
            yield from lines
        else:
            # The program's count is not yet checked.
            used = f" && {index} < {c}{c_member(counted[slot.name].name)}" if slot.name in counted else ""
            yield f"for (uint32_t {index} = 0; {index} < {slot.count}{used}; {index}++) {{"
            yield from (f"    {line}" for line in lines)
            yield "}"
