"""The whole tool in one place: definitions, bounds, layout, targets, render, one pure function after another.

.msg .srv .action --definitions--> Schema --bounds--> Schema --layout--> Layouts
                  --targets--> Outputs --render--> {path: text}
"""

from __future__ import annotations

import re
from collections import deque
from collections.abc import Iterable
from dataclasses import dataclass, replace

from shmgen import bounds, definitions, layout
from shmgen.config import Config, entries
from shmgen.diagnostics import Diagnostic, Report, Span
from shmgen.drift import lockfile
from shmgen.model import Action, Layouts, Output, Schema, Service, Topic, TypeName
from shmgen.targets import interfaces
from shmgen.targets.c import target as c
from shmgen.targets.plcopen import target as plcopen
from shmgen.targets.python import project
from shmgen.targets.python import target as python
from shmgen.targets.ros import target as ros_package
from shmgen.targets.st import target as st


def library(config: Config) -> definitions.Library:
    """All definitions in reach, for who asks more than once: what is read is then read once. Raises Rejected."""
    return definitions.open_library(_sources(config), Report())


def read(config: Config, requests: Iterable[str], opened: definitions.Library | None = None) -> Schema:
    """The messages asked for and all they hold. Raises Rejected."""
    return definitions.load_from(opened or library(config), requests, Report())


def lay_out(config: Config, requests: Iterable[str], opened: definitions.Library | None = None) -> Layouts:
    """The same with every byte in its place. Raises Rejected."""
    opened = opened or library(config)
    schema = bounds.apply(read(config, requests, opened), config.bounds, Report(), opened.known)
    return layout.lay_out(schema, config.types, config.max_region, Report())


def generate(config: Config, requests: Iterable[str]) -> dict[str, str]:
    """{path: text} of all targets, and of layout.lock; what the configuration uses comes along. Raises Rejected."""
    return printed(config, lay_out(config, dict.fromkeys([*requests, *config.types_used])))


def printed(config: Config, layouts: Layouts) -> dict[str, str]:
    """The same of what is laid out already."""
    report = Report()
    outputs = list(_plan(config, layouts, report))
    report.stop_if_any()

    from shmgen.render import render  # jinja2 takes longer to load than all that is before it

    texts = render(outputs)
    code = {path: text for path, text in texts.items() if path.startswith("st/")}
    if "plcopen" in config.targets:
        texts |= render(plcopen.plan(code, config.task_interval))
    if "st" not in config.targets:
        texts = {path: text for path, text in texts.items() if path not in code}
    return texts | {lockfile.LOCK: lockfile.write(layouts, texts, _settings(config))}


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
            report.error("SHM502", f"{service.type} is no service", span, hint="name a .srv file: package/srv/Name")


def actions(config: Config, layouts: Layouts, report: Report) -> Iterable[Action]:
    """As topics()."""
    known = {found.short: found for found in interfaces.actions(layouts)}
    for action in config.actions:
        if found := known.get(action.type.replace("/action/", "/")):
            yield Action(action.action, found, action.server == "plc", action.span)
        else:
            span = config.places.get(action.type, action.span)
            report.error("SHM502", f"{action.type} is no action", span, hint="name a .action file: package/action/Name")


@dataclass(frozen=True, slots=True)
class Entry:
    """One message of the inventory: its size in bytes, or the keys that [bounds] lacks for it.

    `faults` are what else `generate` would say against it.
    """

    name: TypeName
    size: int | None
    unbounded: tuple[str, ...]
    faults: tuple[Diagnostic, ...] = ()


def inventory(config: Config, package: str | None = None) -> list[Entry]:
    """Every message in reach, or those of one package. Raises Rejected."""
    sources = _sources(config)
    names = [name for name in definitions.available(sources) if package in (None, name.package)]
    requests = [str(name) for name in names] or [str(package)]
    schema = definitions.load(requests, sources, Report())
    missing = bounds.unbounded(schema, config.bounds)
    mappable = tuple(message for message in schema.messages if not missing[message.name])
    bounded = bounds.apply(Schema(mappable), config.bounds, Report())
    layouts = layout.lay_out(bounded, config.types, config.max_region, Report())
    faults = _faults(config, layouts)
    return [
        Entry(name, layouts[name].size, (), faults[name]) if name in layouts else Entry(name, None, missing[name])
        for name in names
    ]


def _faults(config: Config, layouts: Layouts) -> dict[TypeName, tuple[Diagnostic, ...]]:
    """What stops each message, or one that it holds: its region is too large, or its names do not fit the targets."""
    report = Report()
    deque(_plan(replace(config, topics=()), layouts, report), maxlen=0)  # planned for what it reports
    faults: dict[TypeName, tuple[Diagnostic, ...]] = {}
    for name, laid_out in layouts.items():
        size = Report()
        layout.check_size(laid_out, config.max_region, size)
        own = [found for found in report.diagnostics if found.span.path == laid_out.message.span.path]
        held = [found for inner in laid_out.dependencies for found in faults[inner] if found.code != "SHM303"]
        faults[name] = tuple(dict.fromkeys([*size.diagnostics, *own, *held]))
    return faults


def _sources(config: Config) -> definitions.Sources:
    return definitions.Sources(config.path, config.source, config.root)


def _plan(config: Config, layouts: Layouts, report: Report) -> Iterable[Output]:
    if "python" in config.targets:
        yield from python.plan(layouts, report, config.package, config.regions)
        if config.distribution:
            yield project.plan(config.distribution, config.package)
    if "st" in config.targets or "plcopen" in config.targets:  # the latter holds the texts of the former
        carried = tuple(topics(config, layouts, report))
        called = tuple(services(config, layouts, report))
        acted = tuple(actions(config, layouts, report))
        yield from st.plan(layouts, report, carried, called, acted, locks=config.regions.sync == "lock")
    if "c" in config.targets:
        yield from c.plan(layouts, report, config.package)
    for ros in ("ros1", "ros2"):
        if ros in config.targets:
            yield from _ros_package(ros, config, layouts, report)


def _ros_package(ros: str, config: Config, layouts: Layouts, report: Report) -> Iterable[Output]:
    """Reports SHM504 where there is nothing to carry."""
    carried = [topic.type for topic in topics(config, layouts, report)]
    carried += [service.type for service in services(config, layouts, report)]
    if not carried:
        hint = "list [[topics]] or [[services]] in shmgen.toml"
        report.error("SHM504", f"the target {ros} has nothing to carry", Span("shmgen.toml"), hint=hint)
        return
    version = config.distribution.partition(" ")[2]
    package = ros_package.Package(
        config.ros_package or ros_package.default_name(config.package),
        version if re.fullmatch(r"\d+\.\d+\.\d+", version) else "0.1.0",
        config.bridge.node,
        (),
    )
    yield from ros_package.plan(ros, package, config.text, layouts, carried)


def _settings(config: Config) -> dict[str, object]:
    """What of the configuration gives the bytes and files their shape, beside the bounds seen in the slots."""
    return {
        "source": config.source,
        "targets": list(config.targets),
        "package": config.package,
        **({"distribution": config.distribution} if config.distribution else {}),
        **({"ros_package": config.ros_package} if config.ros_package else {}),
        "bool": config.types.bool,
        "time": config.types.time,
        "encoding": config.types.encoding,
        "overflow": config.types.overflow,
        "topics": [f"{topic.direction} {topic.topic} {topic.type} depth {topic.depth}" for topic in config.topics],
        **({"services": [_spelled(it.service, it) for it in config.services]} if config.services else {}),
        **({"actions": [_spelled(it.action, it) for it in config.actions]} if config.actions else {}),
        "task_interval": config.task_interval,
        **_regions(config),
    }


def _regions(config: Config) -> dict[str, object]:
    """What is said under [regions]."""
    mode, group, sync = config.regions.mode, config.regions.group, config.regions.sync
    said = {"mode": f"{mode:04o}" if mode is not None else "", "group": group, "sync": sync if sync != "lock" else ""}
    return {key: value for key, value in said.items() if value}


def _spelled(name: str, entry: entries.Service | entries.Action) -> str:
    """One line of layout.lock, the server first. A timeout is the bridge's, and shapes nothing here."""
    return f"{entry.server} {name} {entry.type}"
