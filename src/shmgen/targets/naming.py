"""What a target says of its names, and the checks of them: names that meet are reported, whoever prints them.

A target's own words stand in its room (`python/names.py` and so on). The checks are done by the pipeline for every
target that is asked for, so that none can forget one.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Collection, Iterable, Sequence
from typing import NamedTuple

from shmgen.core.diagnostics import Report, Span
from shmgen.core.fast_dataclass import dataclass
from shmgen.core.model import Action, Layout, Layouts, Role, Service, Topic, TypeName


class ClaimedName(NamedTuple):
    """What a message becomes in a target: `what` it is ("class", "file"), its name, and the space it must be alone in.

    `of` is what it stands for where that is not the one message, such as its package. `follows`: it is made of another
    of the message's names, and where those of two messages meet nobody wants to hear of it as well.
    """

    what: str
    name: str
    space: str = ""
    of: str = ""
    follows: bool = False


@dataclass(frozen=True, slots=True)
class Names:
    """What a target, called `title` in diagnostics, does to names.

    `member` and `constant` give a field and a constant a name that the language accepts. `made(layout, package)` is all
    that a message takes of spaces that it shares with other messages: types, files, macros. `fold` maps names that the
    language takes for one to one. `own` are the target's names in those spaces, `own_constants` those beside the
    constants of each message. With `constants_apart` a constant may be called as a field, as it has another space.
    `use` names what stands for a topic, service or action, where there is such a thing.
    """

    title: str
    member: Callable[[str], str]
    constant: Callable[[str], str]
    made: Callable[[Layout, str], Iterable[ClaimedName]]
    fold: Callable[[str], str] = str
    own: Collection[str] = ()
    own_constants: Collection[str] = ()
    constants_apart: bool = False
    use: Callable[[str], str] | None = None


def words(text: str) -> frozenset[str]:
    """A list of words as it stands in a room."""
    return frozenset(text.split())


def file_stem(name: TypeName) -> str:
    """`JointState` -> `joint_state`, `SetBool_Request` -> `set_bool_request`: lower case, as rosidl names files."""
    return re.sub(r"(?<=[a-z0-9])(?=[A-Z])|(?<=[A-Za-z0-9])(?=[A-Z][a-z])", "_", name.name).lower()


def check(
    layouts: Layouts,
    package: str,
    uses: Iterable[Topic | Service | Action],
    names: Names,
    keys: Sequence[str],
    report: Report,
) -> None:
    """Reports all names of `layouts` and `uses` that meet in a target: SHM203, or SHM204 where one is shmgen's.

    `keys` are what the user leaves out of `targets` in shmgen.toml to be rid of the target.
    """
    quoted = " and ".join(f'"{key}"' for key in keys)
    way_out = f"rename one of them, or leave {quoted} out of `targets` in shmgen.toml"
    _check_messages(layouts, package, names, way_out, report)
    for layout in layouts.values():
        members = [names.member(slot.name) for slot in layout.slots]
        declared = (*names.own_constants, *(constant.name for constant in layout.message.constants))
        constants = [names.constant(name) for name in declared]
        for space in (members, constants) if names.constants_apart else (members + constants,):
            if len(set(map(names.fold, space))) < len(space):
                _check_one(layout, names, way_out, report)
                break
    _check_uses(uses, names, way_out, report)


def _check_messages(layouts: Layouts, package: str, names: Names, way_out: str, report: Report) -> None:
    own = {names.fold(name) for name in names.own}
    all_made = [(layout, made) for layout in layouts.values() for made in names.made(layout, package)]
    kinds = {what: number for number, what in enumerate(dict.fromkeys(made.what for _, made in all_made))}
    seen: dict[tuple[str, str, str], tuple[Layout, ClaimedName]] = {}
    told: set[tuple[TypeName, TypeName]] = set()
    for layout, made in sorted(all_made, key=lambda found: kinds[found[1].what]):
        place, name, folded = layout.message.span, layout.name, names.fold(made.name)
        if folded in own:
            fault = f"{name} becomes the {made.what} `{made.name}`, which shmgen adds in {names.title}"
            report.error("SHM204", fault, place, hint="rename the message")
        space = names.fold(made.space), made.what, folded
        other, first = seen.setdefault(space, (layout, made))
        if first is made or (made.follows and (other.name, name) in told):
            continue
        if (first.of or str(other.name)) != (made.of or str(name)):
            told.add((other.name, name))
            case = "" if made.name == first.name else ", which ignores case"
            fault = f"{other.name} and {name} both become the {made.what} `{made.name}` in {names.title}{case}"
            report.error("SHM203", fault, place, hint=way_out)


class _Named(NamedTuple):
    """A name and what it becomes; `role` says what the generator has it for, and is empty where it is the user's."""

    name: str
    made: str
    role: str
    span: Span


def _members(layout: Layout, names: Names) -> list[_Named]:
    return [
        _Named(
            slot.name,
            names.member(slot.name),
            "" if slot.role is Role.DATA else f"{slot.role.value} member",
            slot.field.span.at(slot.field.name) if slot.field else layout.message.span,
        )
        for slot in layout.slots
    ]


def _constants(layout: Layout, names: Names) -> list[_Named]:
    own = [_Named(name, names.constant(name), "constant", layout.message.span) for name in names.own_constants]
    return own + [_Named(one.name, names.constant(one.name), "", one.span) for one in layout.message.constants]


def _check_one(layout: Layout, names: Names, way_out: str, report: Report) -> None:
    """A message in which some meet, which is rare, and sooner seen than where they stand."""
    first: dict[tuple[bool, str], _Named] = {}
    all_named = [(named, False) for named in _members(layout, names)]
    all_named += [(named, names.constants_apart) for named in _constants(layout, names)]
    for named, apart in all_named:
        other = first.setdefault((apart, names.fold(named.made)), named)
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
                f"`{other.name}` and `{named.name}` are one name in {names.title}{_why(other, named, names)}",
                named.span,
                field=f"{layout.name.short}.{named.name}",
                hint=way_out,
            )


def _why(one: _Named, other: _Named, names: Names) -> str:
    if names.fold(one.name) == names.fold(other.name):
        return ", which ignores case"
    for named in (one, other):
        if named.made != named.name:
            return f": `{named.name}` becomes `{named.made}`"
    return ""


def _check_uses(uses: Iterable[Topic | Service | Action], names: Names, way_out: str, report: Report) -> None:
    seen: dict[str, Topic | Service | Action] = {}
    for use in uses if names.use else ():
        assert names.use
        name = names.use(use.name)
        other = seen.setdefault(names.fold(name), use)
        if other is not use:
            case = ", which ignores case" if names.fold("a") == names.fold("A") else ""
            fault = f"{_shown(other)} and {_shown(use)} are both `{name}` in {names.title}{case}"
            report.error("SHM203", fault, use.span, hint=way_out)


def _shown(use: Topic | Service | Action) -> str:
    return f"{type(use).__name__.lower()} {use.name}"
