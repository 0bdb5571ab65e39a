"""Report SHM305 for each field that an open compiler, STruC++ or matiec, cannot represent."""

from __future__ import annotations

from collections.abc import Iterator

from shmgen.core.diagnostics import Report
from shmgen.core.model import Clock, Layout, Layouts, Slot, String
from shmgen.targets.openplc.compiler import Compiler


def check(layouts: Layouts, compiler: Compiler, key: str, report: Report) -> None:
    for layout in layouts.values():
        for slot in layout.slots:
            for fault, hint in _faults(slot, layout, compiler):
                assert slot.field, "padding holds anything"
                span = slot.field.span.at(slot.field.name)
                if not report.is_enough(span.path):
                    where = f"{layout.name.short}.{slot.name}"
                    hint = f'{hint}, or remove "{key}" from `targets` in shmgen.toml'
                    report.error("SHM305", f"{fault} {compiler.title}", span, field=where, hint=hint)


def _faults(slot: Slot, layout: Layout, compiler: Compiler) -> Iterator[tuple[str, str]]:
    match slot.type:
        case String(wide=True):
            yield "WSTRING does not exist in", "change the type to `string` in the definition"
        case String(capacity, _) if (capacity or 0) > compiler.longest:
            most = f"{compiler.longest} bytes"
            yield f"{capacity} bytes are more than {most}, the limit of a STRING in", f"lower the bound to {most}"
        case Clock() if layout.options.time == "LTIME":
            yield "LTIME does not exist in", 'set time = "TIME" or "struct" in shmgen.toml'
