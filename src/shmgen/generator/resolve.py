"""Finds what shmgen.toml names: the types of topics, services and actions among the layouts, the user's own sources."""

from __future__ import annotations

import re
from collections.abc import Iterable

from shmgen.config import Config, document
from shmgen.core.diagnostics import Report, Span
from shmgen.core.model import Action, Layouts, Service, Topic
from shmgen.definitions.folders import shorten
from shmgen.targets import Source, interfaces


def topics(config: Config, layouts: Layouts, report: Report) -> Iterable[Topic]:
    """Those of the configuration with their types found among `layouts`. Reports SHM502."""
    for topic in config.topics:
        found = next((name for name in layouts if topic.type in (str(name), name.short)), None)
        if found:
            yield Topic(topic.topic, found, topic.direction == "to_plc", topic.depth, topic.span)
        else:  # the layouts hold every type asked for, so this one came as its parts
            message = f"{topic.type} is several messages, and a topic carries one"
            span = config.places.get(topic.type, topic.span)
            report.error("SHM502", message, span, hint="list a service under [[services]], an action under [[actions]]")


def services(config: Config, layouts: Layouts, report: Report) -> Iterable[Service]:
    """As topics()."""
    known = {found.short: found for found in interfaces.services(layouts)}
    for service in config.services:
        if found := known.get(service.type.replace("/srv/", "/")):
            yield Service(service.service, found, service.server == "plc", service.timeout, service.span)
        else:
            span = config.places.get(service.type, service.span)
            report.error("SHM502", f"{service.type} is not a service", span, hint="name a .srv file: package/srv/Name")


def actions(config: Config, layouts: Layouts, report: Report) -> Iterable[Action]:
    """As topics()."""
    known = {found.short: found for found in interfaces.actions(layouts)}
    for action in config.actions:
        if found := known.get(action.type.replace("/action/", "/")):
            yield Action(action.action, found, action.server == "plc", action.timeout, action.span)
        else:
            span = config.places.get(action.type, action.span)
            report.error(
                "SHM502", f"{action.type} is not an action", span, hint="name a .action file: package/action/Name"
            )


_REMARK = r"(?s)\(\*.*?\*\)|//[^\n]*|'(?:\$.|[^'$\n])*'"
_UNIT = r"(?im)^[ \t]*(PROGRAM|CONFIGURATION)[ \t]+(\w+)"


def sources(config: Config, report: Report) -> Iterable[Source]:
    """The files of [plc] sources. Raises Rejected: SHM001, SHM002. Reports SHM203."""
    called = {"PRG_ROS"}
    for path in config.sources:
        shown = shorten(path, config.root)
        text = document.contents(path, shown, report, "[plc] sources in shmgen.toml names it")
        plain = re.sub(_REMARK, lambda remark: re.sub(r"[^\n]", " ", remark[0]), text)
        programs = []
        for found in re.finditer(_UNIT, plain):
            line, start = plain.count("\n", 0, found.start(2)), found.start(2) - plain.rfind("\n", 0, found.start(2))
            place = Span(shown, line + 1, start, len(found[2]), text.splitlines()[line])
            if found[1].upper() == "CONFIGURATION":
                hint = "leave it out: tasks and globals are generated, and the task calls each PROGRAM"
                report.error("SHM203", f"{found[2]} is a second configuration", place, hint=hint)
            elif found[2].upper() in called:
                report.error("SHM203", f"there are two programs {found[2]}", place, hint="rename one")
            called.add(found[2].upper())
            programs.append(found[2])
        yield Source(text.rstrip("\n"), tuple(programs))
