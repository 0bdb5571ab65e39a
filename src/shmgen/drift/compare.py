"""Compare two versions of layout.lock, and describe in words how each message and setting changed.

The messages whose definitions were edited come first.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from dataclasses import replace

from shmgen.core.diagnostics import Diagnostic, Span
from shmgen.drift.findings import Change, Finding, Severity
from shmgen.drift.lockfile import LISTS, Block, Entry, Lock, short


def compare(old: Lock, new: Lock, place: str) -> list[Finding]:
    """Return a finding for each difference between two layout.lock files. `place` is their path for diagnostics.

    Findings about messages are sorted by message name. If a message changed only because it contains a changed message,
    its finding comes after the findings about the other messages.
    """
    settings = _settings(old.settings, new.settings, place)
    names = sorted({*old.messages, *new.messages})
    messages = [replace(it, name=short(name)) for name in names if (it := _message(name, old, new, place))]
    findings = sorted(messages, key=lambda finding: bool(finding.causes)) + ([settings] if settings else [])
    moved = [finding for finding in findings if finding.severity is Severity.COSMETIC and finding.changes]
    if len(moved) < 2:
        return findings
    changes = tuple(change for finding in moved for change in finding.changes)
    message = f"{len(moved)} messages have another origin, but did not change"
    together = Finding(Severity.COSMETIC, Diagnostic("SHM402", message, Span(place)), changes)
    return [*(finding for finding in findings if finding not in moved), together]


def _message(name: str, old: Lock, new: Lock, place: str) -> Finding | None:
    short_name = short(name)
    before, after = old.messages.get(name), new.messages.get(name)
    if before is None:
        assert after is not None
        return _finding("SHM402", Severity.COMPATIBLE, f"{short_name} is new", place, origin=after.origin)
    if after is None:
        was_requested = name in old.requested
        severity = Severity.BREAKING if was_requested else Severity.COSMETIC
        return _finding("SHM401" if was_requested else "SHM402", severity, f"{short_name} was removed", place)
    if before.digest != after.digest:
        meanings, values = _values(before, after)
        changes = (*_fields(before, after, old, new), *meanings, *values)
        if before.size != after.size:
            changes += (Change("size", ("size",), f"{before.size} -> {after.size}"),)
        hint = f"old and new programs refuse each other (digest {before.digest[:4]}… / {after.digest[:4]}…)"
        message = f"layout of {short_name} changed"
        finding = _finding("SHM401", Severity.BREAKING, message, place, changes, after.origin, hint)
        return replace(finding, causes=_causes(before, after, old, new))
    return _same_layout(name, before, after, old, new, place)


def _same_layout(name: str, before: Block, after: Block, old: Lock, new: Lock, place: str) -> Finding | None:
    short_name, origin = short(name), after.origin
    if (name in old.requested) > (name in new.requested):
        message = f"{short_name} is no longer requested, but other messages contain it"
        return _finding("SHM401", Severity.BREAKING, message, place, origin=origin)
    if (name in old.requested) < (name in new.requested):
        return _finding("SHM402", Severity.COMPATIBLE, f"{short_name} is now requested", place, origin=origin)
    meanings, values = _values(before, after)
    changes = (*_fields(before, after, old, new), *values)
    if meanings:
        hint = "old and new programs accept each other's samples, but interpret the same bytes differently"
        message = f"meaning of {short_name} changed"
        return _finding("SHM410", Severity.BREAKING, message, place, (*meanings, *changes), origin, hint)
    if not changes and before.text != after.text and before.text:
        changes = (Change("text", ("text",), "comments, spacing or order of constants changed"),)
    if changes:
        message = f"{short_name} changed, but its layout did not"
        return _finding("SHM402", Severity.COMPATIBLE, message, place, changes, origin)
    if before.origin != after.origin:
        change = Change(short_name, ("origin",), f"{before.origin} -> {origin}")
        message = f"{short_name} has another origin, but did not change"
        return _finding("SHM402", Severity.COSMETIC, message, place, (change,), origin)
    return None


def _fields(
    before: Block, after: Block, old: Lock, new: Lock, prefix: str = "", start: tuple[int, int] = (0, 0)
) -> tuple[Change, ...]:
    """Return the changes of a message's fields, including the fields of nested messages.

    A nested field has moved only if its offset in the nested message changed. Reported offsets count from the start of
    the outer message. `start` has the old and the new offset of the nested message, in bytes.
    """
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
    """Yield each change of a field as two texts: its kind, such as `moved`, and a description, such as `moved 8 -> 12`.

    `places` contains the old and the new offset, which only the description of a move prints.
    """
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
    """Map the name of each renamed field to its old name.

    A new field counts as renamed if a removed field had the same type and offset.
    """
    removed = {replace(entry, name=""): name for name, entry in before.items() if name not in after}
    added = {name: replace(entry, name="") for name, entry in after.items() if name not in before}
    return {name: removed[place] for name, place in added.items() if place in removed}


def _values(before: Block, after: Block) -> tuple[tuple[Change, ...], tuple[Change, ...]]:
    """Return the changes of units, constants and defaults, in two groups.

    The changes of the first group give the same bytes another meaning. The changes of the second group do not.
    """
    units = [(name, was, after.units[name]) for name, was in before.units.items() if name in after.units]
    changes = [(Change(name, ("unit",), f"[{was}] -> [{now}]"), True) for name, was, now in units if was != now]
    changes += [*_constants(before, after), *_defaults(before, after)]
    meanings = tuple(change for change, has_new_meaning in changes if has_new_meaning)
    return meanings, tuple(change for change, has_new_meaning in changes if not has_new_meaning)


def _constants(before: Block, after: Block) -> Iterable[tuple[Change, bool]]:
    """Yield each new, removed or changed constant, with True if its value changed.

    If a constant is new or removed, or if only its type changed, yield False.
    """
    for name in {**before.constants, **after.constants}:
        was, now = before.constants.get(name), after.constants.get(name)
        if was is None:
            yield Change(name, ("constant",), f"constant appeared, {now}"), False
        elif now is None:
            yield Change(name, ("constant",), f"constant vanished, was {was}"), False
        elif was != now:
            (type_, _, old_value), (_, _, new_value) = was.partition(" "), now.partition(" ")
            new_text = now.removeprefix(f"{type_} ")  # print an unchanged type once
            yield Change(name, ("constant",), f"constant {was} -> {new_text}"), old_value != new_value


def _defaults(before: Block, after: Block) -> Iterable[tuple[Change, bool]]:
    """Yield each changed default of the fields in both blocks, with True if the change has an effect.

    The change has no effect if a default of zero was added or removed, because fields without a default are zero.
    """
    for name in {**before.defaults, **after.defaults}:
        was, now = before.defaults.get(name, "none"), after.defaults.get(name, "none")
        if was != now and name in before.fields and name in after.fields:
            is_still_zero = "none" in (was, now) and bool(_ZERO.fullmatch(was) and _ZERO.fullmatch(now))
            yield Change(name, ("default",), f"default {was} -> {now}"), not is_still_zero


_ZERO = re.compile(r'none|false|""|[-0., \[\]]*|\[(?:false(?:, )?|"", )*(?:"")?\]')
"""The spellings in layout.lock of the value that a field without a default has."""


def _causes(before: Block, after: Block, old: Lock, new: Lock) -> tuple[str, ...]:
    """Return the short names of the nested messages that caused all changes of a message.

    Return an empty tuple if the definition of the message itself was edited.
    """
    if before.text != after.text or before.fields.keys() != after.fields.keys():
        return ()
    pairs = [(former, after.fields[name]) for name, former in before.fields.items()]
    own = {kind for pair in pairs for kind, _ in _words(*pair, (0, 0), old, new)}
    inner = {entry.type: _nested(entry.type, old, new) for _, entry in pairs}
    if not own <= {"moved", "size"}:
        return ()
    causes_of_parts = [_causes(*blocks, old, new) or (short(name),) for name, blocks in inner.items() if blocks]
    return tuple(dict.fromkeys(cause for causes in causes_of_parts for cause in causes))


def _settings(old: Mapping[str, object], new: Mapping[str, object], place: str) -> Finding | None:
    tables = [{**settings, **_lines_by_name(settings)} for settings in (old, new)]
    changes: list[Change] = []
    severity = Severity.COMPATIBLE
    for key in {**tables[0], **tables[1]}:
        was, now = (_setting(table.get(key)) for table in tables)
        if key in LISTS or was == now:
            continue
        changes.append(Change(key, ("setting",), f"{was} -> {now}"))
        if " " in key and was != "none":
            severity = Severity.BREAKING
    return _finding("SHM409", severity, "the configuration changed", place, tuple(changes)) if changes else None


def _lines_by_name(settings: Mapping[str, object]) -> dict[str, str]:
    """Return a line for each topic, service and action in the settings of a layout.lock, by its kind and name.

    For example, `service /cell/start` -> `plc std_srvs/SetBool`.
    """
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
    code: str,
    severity: Severity,
    message: str,
    place: str,
    changes: tuple[Change, ...] = (),
    origin: str = "",
    hint: str = "",
) -> Finding:
    width = max((len(change.field) for change in changes), default=0)
    details = tuple(f"{change.field:<{width}}   {change.text}" for change in changes)
    return Finding(severity, Diagnostic(code, message, Span(place), hint=hint, details=details), changes, origin)


def _nested(type_: str, old: Lock, new: Lock) -> tuple[Block, Block] | None:
    """Return the old and new block of a nested message, or None if the message did not change."""
    before, after = old.messages.get(type_), new.messages.get(type_)
    return (before, after) if before and after and before.digest != after.digest else None


_BOUND = re.compile(r"<=(\d+)")


def _bare(type_: str) -> str:
    return _BOUND.sub("", type_)


def _capacity(type_: str) -> str:
    match = _BOUND.search(type_)
    return match[1] if match else "none"


def _encoding(type_: str, settings: Mapping[str, object]) -> object:
    """Return the value of the setting that decides how a type is encoded, or None if no setting does.

    For example, `bool` is USINT or BOOL, `time` is TIME or LTIME, and `string` is utf-8 or latin-1.
    """
    keys = {"bool": "bool", "time": "time", "duration": "time", "string": "encoding"}
    return settings.get(keys.get(_bare(type_), ""))
