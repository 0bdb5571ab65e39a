"""Resolves names in shmgen.toml: the types of topics, services and actions, and the user's own source files."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator

from shmgen.config import Config, document
from shmgen.config.entries import CallEntry
from shmgen.core.diagnostics import Report, Span
from shmgen.core.model import Call, Layouts, Topic
from shmgen.definitions.folders import shorten
from shmgen.targets import Source, interfaces


def topics(config: Config, layouts: Layouts, report: Report) -> Iterable[Topic]:
    """Yield the configured topics with their message types. Reports SHM502 if a type is a service or action."""
    for topic in config.topics:
        message_type = next((name for name in layouts if topic.type in (str(name), name.short)), None)
        if message_type:
            yield Topic(topic.topic, message_type, topic.direction == "to_plc", topic.depth, topic.span)
        else:  # `layouts` contains every requested type, so this type is a service or action in parts
            message = f"{topic.type} is not a message"
            span = config.places.get(topic.type, topic.span)
            report.error(
                "SHM502", message, span, hint="list a service under [[services]], and an action under [[actions]]"
            )


def services(config: Config, layouts: Layouts, report: Report) -> Iterable[Call]:
    """Yield the configured services with their types. Reports SHM502 if a type is not a service."""
    return _calls(config, config.services, layouts, "a service", "a .srv", report)


def actions(config: Config, layouts: Layouts, report: Report) -> Iterable[Call]:
    """Yield the configured actions with their types. Reports SHM502 if a type is not an action."""
    return _calls(config, config.actions, layouts, "an action", "an .action", report)


def _calls(
    config: Config, entries: Iterable[CallEntry], layouts: Layouts, what: str, ending: str, report: Report
) -> Iterator[Call]:
    """Yield the service or action of each entry whose type is generated. Report all other entries.

    `what` and `ending` are for the error, such as "a service" and "a .srv".
    """
    kind = ending.rpartition(".")[2]
    by_name = {name.short: name for name in interfaces.complete(layouts) if name.kind == kind}
    for entry in entries:
        if type_ := by_name.get(entry.type.replace(f"/{kind}/", "/")):
            yield Call(entry.name, type_, entry.server == "plc", entry.timeout, entry.span)
        else:
            span = config.places.get(entry.type, entry.span)
            hint = f"write the name of {ending} file: package/{kind}/Name"
            report.error("SHM502", f"{entry.type} is not {what}", span, hint=hint)


_COMMENT_OR_STRING = r"(?s)\(\*.*?\*\)|//[^\n]*|'(?:\$.|[^'$\n])*'"
_UNIT = r"(?im)^[ \t]*(PROGRAM|CONFIGURATION)[ \t]+(\w+)"


def sources(config: Config, report: Report) -> Iterable[Source]:
    """Yield the user's own files of Structured Text, which `sources` in [plc] lists.

    Reports SHM203 if a file has a CONFIGURATION or two programs have one name. Raises Rejected if a file cannot be read
    (SHM001, SHM002).
    """
    program_names = {"PRG_ROS"}
    for path in config.sources:
        printed_path = shorten(path, config.root)
        text = document.contents(path, printed_path, report, "correct `sources` under [plc] in shmgen.toml")
        plain = re.sub(_COMMENT_OR_STRING, lambda remark: re.sub(r"[^\n]", " ", remark[0]), text)
        programs = []
        for match in re.finditer(_UNIT, plain):
            line, start = plain.count("\n", 0, match.start(2)), match.start(2) - plain.rfind("\n", 0, match.start(2))
            place = Span(printed_path, line + 1, start, len(match[2]), text.splitlines()[line])
            if match[1].upper() == "CONFIGURATION":
                hint = "remove it: shmgen generates tasks and globals, and the task calls each PROGRAM"
                report.error("SHM203", f"{match[2]} is a CONFIGURATION, but shmgen generates one", place, hint=hint)
            elif match[2].upper() in program_names:
                report.error("SHM203", f"two programs are called {match[2]}", place, hint="rename one of them")
            program_names.add(match[2].upper())
            programs.append(match[2])
        yield Source(text.rstrip("\n"), tuple(programs))
