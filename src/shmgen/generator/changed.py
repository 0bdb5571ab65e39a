"""Writes only what follows from definitions that have changed since a former run.

Those are printed from the messages that changed and those that hold them, and put between the rest of what is made of
all messages. Where more than that hangs on a change, such as a name that others have too, all is to be generated.
"""

from __future__ import annotations

import re
from collections.abc import Collection, Iterable, Mapping
from dataclasses import replace
from pathlib import Path

from shmgen import definitions
from shmgen.config import Config
from shmgen.core import write
from shmgen.core.diagnostics import Rejected
from shmgen.core.model import TypeName
from shmgen.drift.lockfile import LOCK, sha256
from shmgen.generator import pipeline

_APART = {"python", "st", "plcopen", "c"}
"""Targets whose files are each of one message, service or action, or of their names alone, but for this one."""
_XML = "plcopen/shmgen.xml"


def texts(config: Config, folder: Path, edited: Collection[str]) -> dict[str, str] | None:
    """{path: text} of what differs; None if all is to be generated, or something is wrong.

    This shmgen wrote `folder` with this configuration for the definitions that there are, but for the content of those
    in the files `edited`.
    """
    if not _APART.issuperset(config.targets) or config.skip_unbounded or config.linked:
        return None
    lock, opened = _content(folder, LOCK), pipeline.library(config)
    head, blocks, files = _parts(lock)
    names = _affected(edited, blocks, opened)
    if names is None or not _are_alone(names.values(), blocks):
        return None
    asked = set(re.findall('^    "(.+)",$', head, re.MULTILINE))
    try:
        found = pipeline.lay_out(config, [*names, *config.types_used], opened) if names else {}
        layouts = {name: replace(layout, requested=str(name) in asked) for name, layout in found.items()}
        made = pipeline.printed(config, layouts) if layouts else {LOCK: lock}
    except Rejected:
        return None
    _, new, _ = _parts(made.pop(LOCK))
    if any(layout.options.own for layout in layouts.values()) or any(
        _held(new[name]) != _held(blocks[name]) for name in names
    ):
        return None
    if _XML in made:
        kept = _content(folder, _XML)
        whole = _inserted(kept, made.pop(_XML)) if sha256(kept) == files[_XML] else None
        if whole is None:
            return None
        made[_XML] = whole
    hashes = {path: sha256(text) for path, text in made.items() if not path.endswith("/__init__.py")}
    made = {path: made[path] for path, hashed in hashes.items() if hashed != files.get(path)}
    if not made.keys() <= files.keys():
        return None
    blocks |= {name: new[name] for name in names}
    files |= {path: hashes[path] for path in made}
    listed = "".join(f'"{path}" = "{hashed}"\n' for path, hashed in files.items())
    whole = "".join([head, *blocks.values(), "[files]\n", listed])
    return made | ({LOCK: whole} if whole != lock else {})


def _content(folder: Path, path: str) -> str:
    return (write.current(folder, path) or b"").decode(errors="replace")


def _parts(lock: str) -> tuple[str, dict[str, str], dict[str, str]]:
    """What stands above the messages, the text of each, and the SHA-256 of each file."""
    rest, _, listed = lock.partition("[files]\n")
    head, *blocks = rest.split('[messages."')
    files = re.findall('^"(.+)" = "(.+)"$', listed, re.MULTILINE)
    return head, {block.partition('"')[0]: f'[messages."{block}' for block in blocks}, dict(files)


def _held(block: str) -> set[str]:
    """The messages that one holds, as layout.lock has it."""
    return set(re.findall(r'^    "\d+ \S+ (\w+/\w+/\w+)', block, re.MULTILINE))


def _affected(
    edited: Iterable[str], blocks: Mapping[str, str], opened: definitions.Library
) -> dict[str, TypeName] | None:
    """Those of `blocks` that the edited files define, those that hold one, and what is defined together with them."""
    packages = (package for found in opened.folders for packages in found.values() for package in packages)
    defined = {str(it.content): it.messages for package in packages for it in package.definitions.values()}
    if any(file not in defined or file.endswith(".action") for file in edited):  # ROS 1 makes more of an action
        return None
    holders: dict[str, list[str]] = {}
    for name, block in blocks.items():
        for inner in _held(block):
            holders.setdefault(inner, []).append(name)
    names: dict[str, TypeName] = {}
    waiting = [str(name) for file in edited for name in defined[file]]
    while waiting:
        name = waiting.pop()
        if name in blocks and name not in names:
            names[name] = TypeName(*name.split("/"))
            definition = opened.definition(names[name])
            waiting += [*holders.get(name, ()), *map(str, definition.messages if definition else ())]
    return names


def _are_alone(names: Iterable[TypeName], blocks: Iterable[str]) -> bool:
    """Whether no name that is made of one of these and of a constant can be that of something else."""
    mine = [f"{name.package}_{name.name}_".upper() for name in names]
    others = [f"{package}_{name}_".upper() for package, _, name in (block.split("/") for block in blocks)]
    return not any(
        one != other and (one.startswith(other) or other.startswith(one)) for one in mine for other in others
    )


_OBJECT = re.compile('<(dataType|pou|globalVars) name="\\w+"')
_LISTED = re.compile("^ {12}<Object .*?^ {12}</Object>\n", re.DOTALL | re.MULTILINE)


def _inserted(whole: str, part: str) -> str | None:
    """PLCopen XML with each object of `part` in the place of the one of its name; None where the IDE shows others."""
    shown = whole[whole.rfind("<ProjectStructure>") :]
    if not all(listed in shown for listed in _LISTED.findall(part, part.rfind("<ProjectStructure>"))):
        return None
    pieces, done = [], 0
    for found in _OBJECT.finditer(part):
        end = f"</{found[1]}>"
        begin = whole.find(found[0], done)  # they are in the same order
        if begin < 0:
            return None
        pieces += [whole[done:begin], part[found.start() : part.index(end, found.start())]]
        done = whole.index(end, begin)
    return "".join([*pieces, whole[done:]])
