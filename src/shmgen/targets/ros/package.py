"""Turns the topics and services of shmgen.toml into a ROS package that starts `shmgen bridge` for them."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from typing import NamedTuple

from shmgen.diagnostics import Report, Span
from shmgen.model import Layouts, Message, Output
from shmgen.targets import Job

_PARTS = {"msg": ("",), "srv": ("_Request", "_Response"), "action": ("_Goal", "_Result", "_Feedback")}


class Package(NamedTuple):
    """`dependencies` are packages of messages."""

    name: str
    version: str
    node: str
    dependencies: tuple[str, ...]


class Text(NamedTuple):
    """A file that is handed on as it is."""

    text: str


def plan(ros: str, files: Sequence[tuple[str, str]], job: Job, report: Report) -> Iterator[Output]:
    """`<ros>/<name>/` with its `files`, each a path and a template. Reports SHM504 where there is nothing to carry.

    The text of shmgen.toml comes along; its `path` becomes a folder of the package, which gets the definitions.
    """
    carried = {topic.type.package for topic in job.topics} | {service.type.package for service in job.services}
    if not carried:
        hint = "list [[topics]] or [[services]] in shmgen.toml"
        report.error("SHM504", f"the target {ros} has nothing to carry", Span("shmgen.toml"), hint=hint)
        return
    options = job.options
    version = options.distribution.partition(" ")[2]
    package = Package(
        options.ros_package or default_name(job.package),
        version if re.fullmatch(r"\d+\.\d+\.\d+", version) else "0.1.0",
        options.node,
        tuple(sorted(carried)),
    )
    root = f"{ros}/{package.name}"
    for file, template in files:
        yield Output(f"{root}/{file.format(package.name)}", f"ros/{template}", package)
    definitions = dict(_definitions(job.layouts))
    configuration = _relocated(options.configuration, bool(definitions))
    yield Output(f"{root}/config/shmgen.toml", "ros/shmgen.toml.j2", Text(configuration))
    for path, text in definitions.items():
        yield Output(f"{root}/config/msgs/{path}", "ros/text.j2", Text(text.rstrip("\n")))


def default_name(package: str) -> str:
    """`shm_msgs` -> `shm_msgs_bridge`, within REP 144."""
    words = re.findall("[a-z0-9]+", package.lower())
    return "_".join([*words, "bridge"])


_PATH = re.compile(r"^path\s*=\s*\[[^\]]*\].*\n?", re.MULTILINE)


def _relocated(configuration: str, has_definitions: bool) -> str:
    """The same, but that `path` is where the package has the definitions."""
    top, table, rest = re.match(r"(?s)(.*?)(^\[|\Z)(.*)", configuration, re.MULTILINE).groups()  # type: ignore[union-attr]
    line = 'path = ["msgs"]  # the definitions, copied beside this file\n' if has_definitions else ""
    return (line + _PATH.sub("", top) + table + rest).rstrip("\n")


def _definitions(layouts: Layouts) -> Iterator[tuple[str, str]]:
    """Path and text of each file that is not of a built-in store."""
    found: dict[tuple[str, str, str], dict[str, Message]] = {}
    for name, layout in layouts.items():
        for part in _PARTS[name.kind]:
            if name.name.endswith(part) and not layout.message.origin.startswith("built-in"):
                bare = name.name.removesuffix(part)
                found.setdefault((name.package, name.kind, bare), {})[part] = layout.message
    for (package, kind, bare), parts in sorted(found.items()):
        if len(parts) == len(_PARTS[kind]):
            texts = dict.fromkeys(parts[part].text.rstrip("\n") for part in _PARTS[kind])
            yield f"{package}/{kind}/{bare}.{kind}", "\n---\n".join(texts) + "\n"
