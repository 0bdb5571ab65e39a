"""Describe how a target derives its names, and report names that collide.

Each target lists its reserved words in its own package (`python/names.py` and so on). The pipeline runs these checks
for every requested target, so that no target can omit them.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Collection, Iterable, Sequence
from typing import NamedTuple

from shmgen.core.diagnostics import Report, Span
from shmgen.core.model import Call, Layout, Layouts, Role, Topic, TypeName


class ClaimedName(NamedTuple):
    """A name that a message occupies in a target: a `name` of a `kind`, such as "class" or "file".

    `space` is the name space, such as a C++ namespace. Two messages must not occupy the same name of one kind in one
    space. The exception is two claims with the same `owner`, such as a package whose namespace the messages share. If
    `is_derived` is true, the name is derived from another name of the message. A collision of derived names is not
    reported if the original names already collide.
    """

    kind: str
    name: str
    space: str = ""
    owner: str = ""
    is_derived: bool = False


class Names(NamedTuple):
    """The rules by which a target derives its names from the user's names.

    * `title`: the target's name in diagnostics.
    * `member`, `constant`: functions that return a valid name for a field and for a constant.
    * `claims(layout, package)`: a function that returns the names of a message's types, files and macros. These names
      must be unique among all messages.
    * `fold`: a function that returns the same text for two names if the language does not distinguish the names. If the
      language ignores case, `fold` returns the name in upper case.
    * `own`: the type, file and macro names that the target itself uses.
    * `own_constants`: the constants that the target adds to each message.
    * `constants_apart`: True if a constant and a field of a message may have the same name.
    * `use`: a function that returns the name of a topic, service or action. None if the target generates no such name.
    """

    title: str
    member: Callable[[str], str]
    constant: Callable[[str], str]
    claims: Callable[[Layout, str], Iterable[ClaimedName]]
    fold: Callable[[str], str] = str
    own: Collection[str] = ()
    own_constants: Collection[str] = ()
    constants_apart: bool = False
    use: Callable[[str], str] | None = None


def words(text: str) -> frozenset[str]:
    """Return the words of a text, separated by blanks, such as the reserved words of a target."""
    return frozenset(text.split())


def file_stem(name: TypeName) -> str:
    """Return the file name without its extension, in the lower case of rosidl: `JointState` -> `joint_state`.

    `SetBool_Request` becomes `set_bool_request`.
    """
    return re.sub(r"(?<=[a-z0-9])(?=[A-Z])|(?<=[A-Za-z0-9])(?=[A-Z][a-z])", "_", name.name).lower()


def check(
    layouts: Layouts,
    package: str,
    uses: Iterable[Topic | Call],
    names: Names,
    keys: Sequence[str],
    report: Report,
) -> None:
    """Report all names in `layouts` and `uses` that collide in a target.

    The diagnostic is SHM203, or SHM204 for a collision with a name that shmgen adds. `keys` are the target's keys. The
    hint suggests removing these keys from `targets` in shmgen.toml.
    """
    quoted = " and ".join(f'"{key}"' for key in keys)
    way_out = f"rename one of them, or remove {quoted} from `targets` in shmgen.toml"
    _check_messages(layouts, package, names, way_out, report)
    for layout in layouts.values():
        _check_members(layout, names, way_out, report)
    _check_uses(uses, names, way_out, report)


def _check_messages(layouts: Layouts, package: str, names: Names, way_out: str, report: Report) -> None:
    own = {names.fold(name) for name in names.own}
    all_claims = [(layout, claim) for layout in layouts.values() for claim in names.claims(layout, package)]
    kinds = {kind: number for number, kind in enumerate(dict.fromkeys(claim.kind for _, claim in all_claims))}
    seen: dict[tuple[str, str, str], tuple[Layout, ClaimedName]] = {}
    reported: set[tuple[TypeName, TypeName]] = set()
    for layout, claim in sorted(all_claims, key=lambda pair: kinds[pair[1].kind]):
        span, name, folded = layout.message.span, layout.name, names.fold(claim.name)
        if folded in own:
            fault = f"{name} becomes the {claim.kind} `{claim.name}`, a name that shmgen itself adds in {names.title}"
            report.error("SHM204", fault, span, hint="rename the message")
        space = names.fold(claim.space), claim.kind, folded
        other, first = seen.setdefault(space, (layout, claim))
        if first is claim or (claim.is_derived and (other.name, name) in reported):
            continue
        if (first.owner or str(other.name)) != (claim.owner or str(name)):
            reported.add((other.name, name))
            case = "" if claim.name == first.name else ", which ignores case"
            fault = f"{other.name} and {name} both become the {claim.kind} `{claim.name}` in {names.title}{case}"
            report.error("SHM203", fault, span, hint=way_out)


class _Named(NamedTuple):
    """The `name` of a field or constant, and its form in the target, `target_name`. Collisions are reported at `span`.

    `role` is the purpose of a name that the generator adds, or `""` for a name from the user.
    """

    name: str
    target_name: str
    role: str
    span: Span


def _members(layout: Layout, names: Names) -> list[_Named]:
    return [
        _Named(
            slot.name,
            names.member(slot.name),
            "" if slot.role is Role.DATA else f"{slot.role.value} field",
            slot.field.span.at(slot.field.name) if slot.field else layout.message.span,
        )
        for slot in layout.slots
    ]


def _constants(layout: Layout, names: Names) -> list[_Named]:
    own = [_Named(name, names.constant(name), "constant", layout.message.span) for name in names.own_constants]
    return own + [_Named(one.name, names.constant(one.name), "", one.span) for one in layout.message.constants]


def _check_members(layout: Layout, names: Names, way_out: str, report: Report) -> None:
    """Report the fields and constants of one message whose names collide in a target."""
    first: dict[tuple[bool, str], _Named] = {}
    all_named = [(named, False) for named in _members(layout, names)]
    all_named += [(named, names.constants_apart) for named in _constants(layout, names)]
    for named, apart in all_named:
        other = first.setdefault((apart, names.fold(named.target_name)), named)
        if other is named or report.is_enough(named.span.path):
            continue
        theirs, ours = (named, other) if other.role else (other, named)
        if ours.role:
            report.error(
                "SHM204",
                f"`{theirs.name}` clashes with the {ours.role} `{ours.name}` that shmgen adds",
                theirs.span,
                field=f"{layout.name.short}.{theirs.name}",
                hint=f"rename `{theirs.name}` in the definition",
            )
        else:
            report.error(
                "SHM203",
                f"`{other.name}` and `{named.name}` become the same name in {names.title}{_why(other, named, names)}",
                named.span,
                field=f"{layout.name.short}.{named.name}",
                hint=way_out,
            )


def _why(one: _Named, other: _Named, names: Names) -> str:
    if names.fold(one.name) == names.fold(other.name):
        return ", which ignores case"
    for named in (one, other):
        if named.target_name != named.name:
            return f": `{named.name}` becomes `{named.target_name}`"
    return ""


def _check_uses(uses: Iterable[Topic | Call], names: Names, way_out: str, report: Report) -> None:
    seen: dict[str, Topic | Call] = {}
    for use in uses if names.use else ():
        assert names.use
        name = names.use(use.name)
        other = seen.setdefault(names.fold(name), use)
        if other is not use:
            case = ", which ignores case" if names.fold("a") == names.fold("A") else ""
            fault = f"{_describe(other)} and {_describe(use)} both become `{name}` in {names.title}{case}"
            report.error("SHM203", fault, use.span, hint=way_out)


def _describe(use: Topic | Call) -> str:
    kind = "topic" if isinstance(use, Topic) else "service" if use.type.kind == "srv" else "action"
    return f"{kind} {use.name}"
