"""Format the table of types and the list of available messages, as text or JSON."""

from __future__ import annotations

import json

from shmgen.core.model import Clock, Scalar, TypeOptions
from shmgen.core.plural import counted
from shmgen.generator.layout import CLOCK
from shmgen.generator.pipeline import Item
from shmgen.show.table import aligned
from shmgen.targets.c.text import element as c_element
from shmgen.targets.st.names import iec_element


def type_table(options: TypeOptions) -> str:
    """Return a text table with the IEC 61131-3 type, the C type and the size in bytes of each ROS type."""
    lines = [("ROS", "IEC 61131-3", "C", "bytes")]
    for scalar in Scalar:
        also = {Scalar.UINT8: "uint8, char, byte", Scalar.INT8: "int8 (ROS 1: byte)"}.get(scalar, scalar.value)
        lines.append((also, iec_element(scalar, options), c_element(scalar, options), str(scalar.size)))
    for clock in Clock:
        size = CLOCK[options.time][0]
        lines.append((clock.value, iec_element(clock, options), c_element(clock, options), str(size)))
    lines += [
        ("string, string<=n", "STRING(n)", "char[n+1]", "n+1"),
        ("wstring, wstring<=n", "WSTRING(n)", "uint16_t[n+1]", "2(n+1)"),
        ("T[N]", "ARRAY[0..N-1] OF T", "T[N]", ""),
        ("T[<=N], T[] with a bound", "UDINT and ARRAY[0..N-1] OF T", "uint32_t and T[N]", ""),
        ("package/Type", "ST_package_Type", "shm_package_Type", ""),
    ]
    return "".join(f"{line}\n" for line in aligned(lines))


def inventory(entries: list[Item], machine: bool, default: int | None = None) -> str:
    """Return a text with one line for each message: its size, the fields that need a bound, or its errors.

    If `machine` is true, return JSON instead. `default` is the key `default` of [bounds] in shmgen.toml: the maximum
    number of elements of a sequence without a bound of its own. None means that the key is missing.
    """
    if machine:
        data = [
            {
                "type": str(entry.name),
                "size": entry.size,
                "unbounded": entry.unbounded,
                "faults": [{"code": fault.code, "message": fault.message} for fault in entry.diagnostics],
                "defaulted": entry.defaulted,
            }
            for entry in entries
        ]
        return json.dumps(data, indent=2) + "\n"
    width = max((len(entry.name.short) for entry in entries), default=0)
    lines = [f"{entry.name.short:<{width}}  {_status(entry)}" for entry in entries]
    ready = sum(entry.size is not None and not entry.diagnostics for entry in entries)
    lines += ["", f"{ready} of {len(entries)} can be generated."]
    stopped = [key for entry in entries for key in entry.unbounded]
    if stopped:
        lines.append(f'Add lines under [bounds] in shmgen.toml, such as "{stopped[0]}" = 8')
    if default:
        lines.append(f"* bound {default} from the key default under [bounds]")
    codes = sorted({fault.code for entry in entries for fault in entry.diagnostics})
    if codes:
        lines.append("Run " + " or ".join(f"`shmgen explain {code}`" for code in codes) + " for details")
    return "\n".join(lines) + "\n"


_KEYS_SHOWN = 3


def _status(entry: Item) -> str:
    if entry.diagnostics and entry.size is None:
        first, *others = entry.diagnostics
        where = f"{first.span.path}:{first.span.line}" if first.span.line else first.span.path
        return f"{first.code} {where}: {first.message}" + (f" and {len(others)} more" if others else "")
    if entry.diagnostics:
        return "; ".join(f"{fault.code} {fault.field}: {fault.message}" for fault in entry.diagnostics)
    if entry.size is not None:
        size = f"{counted(entry.size, 'byte'):>15}"
        return f"{size}  * {_first_keys(entry.defaulted)}" if entry.defaulted else size
    return f"needs a bound for {_first_keys(entry.unbounded)}"


def _first_keys(keys: tuple[str, ...]) -> str:
    more = f" and {len(keys) - _KEYS_SHOWN} more" if len(keys) > _KEYS_SHOWN else ""
    return ", ".join(keys[:_KEYS_SHOWN]) + more
