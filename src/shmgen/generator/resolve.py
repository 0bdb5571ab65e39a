"""Finds the types of the topics, services and actions that shmgen.toml lists among the layouts."""

from __future__ import annotations

from collections.abc import Iterable

from shmgen.config import Config
from shmgen.core.diagnostics import Report
from shmgen.core.model import Action, Layouts, Service, Topic
from shmgen.targets import interfaces


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
