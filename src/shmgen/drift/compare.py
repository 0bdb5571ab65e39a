"""Compares two locks: what became of every message and setting, in words, meaning first."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from dataclasses import replace

from shmgen.core.diagnostics import Diagnostic, Span
from shmgen.drift.findings import Change, Finding, Severity
from shmgen.drift.lockfile import LISTS, Block, Entry, Lock, short

SIZE = "size"


def compare(old: Lock, new: Lock, shown: str) -> list[Finding]:
    """The way from `old` to `new`, messages in order of name; `shown` is what diagnostics call the lock."""
    settings = _settings(old.settings, new.settings, shown)
    told = [_message(name, old, new, shown) for name in sorted({*old.messages, *new.messages})]
    found = [finding for finding in (*told, settings) if finding]
    moved = [finding for finding in found if finding.severity is Severity.COSMETIC and finding.changes]
    if len(moved) < 2:
        return found
    changes = tuple(change for finding in moved for change in finding.changes)
    message = f"{len(moved)} messages come from another place, and are the same"
    together = Finding(Severity.COSMETIC, Diagnostic("SHM402", message, Span(shown)), changes)
    return [*(finding for finding in found if finding not in moved), together]


def _message(name: str, old: Lock, new: Lock, shown: str) -> Finding | None:
    said = short(name)
    before, after = old.messages.get(name), new.messages.get(name)
    if before is None:
        assert after is not None
        return _finding("SHM402", Severity.COMPATIBLE, f"{said} is new", shown, (), after.origin)
    if after is None:
        asked = name in old.requested
        severity = Severity.BREAKING if asked else Severity.COSMETIC
        return _finding("SHM401" if asked else "SHM402", severity, f"{said} is gone", shown, (), "")
    if before.digest != after.digest:
        changes = (*_fields(before, after, old, new), *_units(before, after), *_values(before, after))
        changes += _number(SIZE, before.size, after.size)
        hint = f"old and new programs refuse each other (digest {before.digest[:4]}… / {after.digest[:4]}…)"
        message = f"layout of {said} changed"
        return _finding("SHM401", Severity.BREAKING, message, shown, changes, after.origin, hint)
    return _same_layout(name, before, after, old, new, shown)


def _same_layout(name: str, before: Block, after: Block, old: Lock, new: Lock, shown: str) -> Finding | None:
    said, origin = short(name), after.origin
    if (name in old.requested) > (name in new.requested):
        return _finding("SHM401", Severity.BREAKING, f"{said} is only a part of others now", shown, (), origin)
    if (name in old.requested) < (name in new.requested):
        return _finding("SHM402", Severity.COMPATIBLE, f"{said} is asked for now", shown, (), origin)
    changes = (*_fields(before, after, old, new), *_values(before, after))
    if units := _units(before, after):
        hint = "old and new programs still take each other's samples"
        return _finding(
            "SHM410", Severity.BREAKING, f"units of {said} changed", shown, (*units, *changes), origin, hint
        )
    if changes:
        message = f"{said} changed, its layout did not"
        return _finding("SHM402", Severity.COMPATIBLE, message, shown, changes, origin)
    if before.text != after.text and before.text:
        change = Change("text", ("text",), "comments, spacing or order of constants changed")
        message = f"{said} changed, its layout did not"
        return _finding("SHM402", Severity.COMPATIBLE, message, shown, (change,), origin)
    if before.origin != after.origin:
        change = Change(said, ("origin",), f"{before.origin} -> {origin}")
        message = f"{said} comes from another place, and is the same"
        return _finding("SHM402", Severity.COSMETIC, message, shown, (change,), origin)
    return None


def _fields(
    before: Block, after: Block, old: Lock, new: Lock, prefix: str = "", start: tuple[int, int] = (0, 0)
) -> tuple[Change, ...]:
    """What became of the fields; inside a nested message only what moved within it, by its place in the whole."""
    renamed = _renamed(before.fields, after.fields)
    changes: list[Change] = []
    for name, entry in after.fields.items():
        former = before.fields.get(renamed.get(name, name))
        at = start[1] + entry.offset
        if former is None:
            changes.append(Change(prefix + name, ("appeared",), f"appeared at {at}, {entry.spelled}", None, at))
            continue
        was = start[0] + former.offset
        words = dict(_words(former, entry, (was, at), old, new))
        if name in renamed:
            words = {"renamed": f"renamed from {former.name}"} | words
        if words:
            changes.append(Change(prefix + name, tuple(words), ", ".join(words.values()), was, at))
        if former.type == entry.type and (inner := _nested(entry.type, old, new)):
            many = "" if entry.count is None else "[]"
            changes += _fields(*inner, old, new, f"{prefix}{name}{many}.", (was, at))
    for name, entry in before.fields.items():
        if name not in after.fields and name not in renamed.values():
            at = start[0] + entry.offset
            changes.append(Change(prefix + name, ("vanished",), f"vanished from {at}, was {entry.spelled}", at, None))
    return tuple(changes)


def _words(before: Entry, after: Entry, places: tuple[int, int], old: Lock, new: Lock) -> Iterable[tuple[str, str]]:
    """Kind -> words."""
    if before.offset != after.offset:
        yield "moved", f"moved {places[0]} -> {places[1]}"
    sorts = [(entry.count is None, entry.is_sequence, _bare(entry.type)) for entry in (before, after)]
    if sorts[0] != sorts[1]:
        yield "retyped", f"retyped {before.spelled} -> {after.spelled}"
        return
    if before.count != after.count:
        yield "count", f"count {before.count} -> {after.count}"
    if before.type != after.type:
        yield "capacity", f"capacity {_capacity(before.type)} -> {_capacity(after.type)}"
    meanings = [_encoding(entry.type, lock.settings) for entry, lock in ((before, old), (after, new))]
    if meanings[0] != meanings[1]:
        yield "encoded", f"stored as {meanings[1]}, was {meanings[0]}"
    if inner := _nested(after.type, old, new):
        sizes = [block.size for block in inner]
        if sizes[0] != sizes[1]:
            yield "size", f"{'grew' if sizes[0] < sizes[1] else 'shrank'} {sizes[0]} -> {sizes[1]}"


def _renamed(before: Mapping[str, Entry], after: Mapping[str, Entry]) -> dict[str, str]:
    """New name -> old name, of fields that are what stood at the same place under a name now gone."""
    gone = {replace(entry, name=""): name for name, entry in before.items() if name not in after}
    come = {name: replace(entry, name="") for name, entry in after.items() if name not in before}
    return {name: gone[place] for name, place in come.items() if place in gone}


def _values(before: Block, after: Block) -> tuple[Change, ...]:
    """Constants, and the defaults of fields that stayed."""
    changes: list[Change] = []
    for name in {**before.constants, **after.constants}:
        was, now = before.constants.get(name), after.constants.get(name)
        if was is None:
            changes.append(Change(name, ("constant",), f"constant appeared, {now}"))
        elif now is None:
            changes.append(Change(name, ("constant",), f"constant vanished, was {was}"))
        elif was != now:
            same = now.removeprefix(f"{was.partition(' ')[0]} ")  # the type need not be said twice
            changes.append(Change(name, ("constant",), f"constant {was} -> {same}"))
    for name in {**before.defaults, **after.defaults}:
        was, now = before.defaults.get(name, "none"), after.defaults.get(name, "none")
        if was != now and name in before.fields and name in after.fields:
            changes.append(Change(name, ("default",), f"default {was} -> {now}"))
    return tuple(changes)


def _units(before: Block, after: Block) -> tuple[Change, ...]:
    pairs = [(name, was, after.units[name]) for name, was in before.units.items() if name in after.units]
    return tuple(Change(name, ("unit",), f"[{was}] -> [{now}]") for name, was, now in pairs if was != now)


def _settings(old: Mapping[str, object], new: Mapping[str, object], shown: str) -> Finding | None:
    tables = [{**settings, **_listed(settings)} for settings in (old, new)]
    changes: list[Change] = []
    severity = Severity.COMPATIBLE
    for key in {**tables[0], **tables[1]}:
        was, now = (_setting(table.get(key)) for table in tables)
        if key in LISTS or was == now:
            continue
        changes.append(Change(key, ("setting",), f"{was} -> {now}"))
        if " " in key and was != "none":
            severity = Severity.BREAKING
    return _finding("SHM409", severity, "the configuration changed", shown, tuple(changes), "") if changes else None


def _listed(settings: Mapping[str, object]) -> dict[str, str]:
    """`topic /robot/pose` -> `to_plc geometry_msgs/Pose depth 1`, `service /cell/start` -> `plc std_srvs/SetBool`."""
    listed: dict[str, str] = {}
    for key in LISTS:
        lines = settings.get(key, [])
        parts = [str(line).split(maxsplit=2) for line in lines] if isinstance(lines, list) else []
        kind = key.removesuffix("s")
        listed |= {f"{kind} {part[1]}": f"{part[0]} {part[2]}" for part in parts if len(part) == 3}
    return listed


def _setting(value: object) -> str:
    if value is None:
        return "none"
    return " ".join(map(str, value)) if isinstance(value, list) else str(value)


def _finding(
    code: str, severity: Severity, message: str, shown: str, changes: tuple[Change, ...], origin: str, hint: str = ""
) -> Finding:
    width = max((len(change.field) for change in changes), default=0)
    details = tuple(f"{change.field:<{width}}   {change.text}" for change in changes)
    return Finding(severity, Diagnostic(code, message, Span(shown), hint=hint, details=details), changes, origin)


def _number(name: str, before: int, after: int) -> tuple[Change, ...]:
    return () if before == after else (Change(name, (name,), f"{before} -> {after}"),)


def _nested(type_: str, old: Lock, new: Lock) -> tuple[Block, Block] | None:
    """Both blocks of a message held by value, if it has changed."""
    before, after = old.messages.get(type_), new.messages.get(type_)
    return (before, after) if before and after and before.digest != after.digest else None


_BOUND = re.compile(r"<=(\d+)")


def _bare(type_: str) -> str:
    return _BOUND.sub("", type_)


def _capacity(type_: str) -> str:
    found = _BOUND.search(type_)
    return found[1] if found else "none"


def _encoding(type_: str, settings: Mapping[str, object]) -> object:
    """What the settings make of it: of `bool` USINT or BOOL, of `time` TIME or LTIME, of `string` utf-8 or latin-1."""
    keys = {"bool": "bool", "time": "time", "duration": "time", "string": "encoding"}
    return settings.get(keys.get(_bare(type_), ""))
