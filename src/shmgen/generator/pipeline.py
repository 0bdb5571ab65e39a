"""The whole tool in one place: definitions, bounds, layout, targets, render, one pure function after another.

.msg .srv .action --definitions--> Schema --bounds--> Schema --layout--> Layouts
                  --targets--> Outputs --render--> {path: text}
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace

from shmgen import definitions
from shmgen.config import Config, entries
from shmgen.core.diagnostics import Diagnostic, Report
from shmgen.core.fast_dataclass import dataclass
from shmgen.core.model import Layouts, Output, Schema, TypeName, TypeOptions
from shmgen.drift import lockfile
from shmgen.generator import bounds, layout, resolve
from shmgen.targets import TARGETS, Job, Options, RenderedFile, Target, naming


def library(config: Config) -> definitions.Library:
    """All definitions in reach, for who asks more than once: what is read is then read once. Raises Rejected."""
    return definitions.open_library(_sources(config), Report())


def read(config: Config, requests: Iterable[str], opened: definitions.Library | None = None) -> Schema:
    """The messages asked for and all they hold. Raises Rejected."""
    return definitions.load_from(opened or library(config), requests, Report())


def lay_out(config: Config, requests: Iterable[str], opened: definitions.Library | None = None) -> Layouts:
    """The same with every byte in its place. Raises Rejected."""
    opened = opened or library(config)
    schema = read(config, requests, opened)
    if config.skip_unbounded:
        schema = _bounded(config, schema, opened)
    schema = bounds.apply(schema, config.bounds, Report(), opened.known)
    also = (message.name for message in schema.messages if str(message.name) in config.linked)
    schema = replace(schema, requested=schema.requested.union(also))  # or it were written again, and as less
    return layout.lay_out(schema, _types(config, schema), config.max_region, Report())


def _types(config: Config, schema: Schema) -> TypeOptions:
    """With the names that an imported PLC project has for messages, unless shmgen.toml says not to take them."""
    if config.types.names == "ros":
        return config.types
    own = tuple((message.name, message.plc.partition(" ")[0]) for message in schema.messages if message.plc)
    return replace(config.types, own=own)


def generate(config: Config, requests: Iterable[str], opened: definitions.Library | None = None) -> dict[str, str]:
    """{path: text} of all targets, and of layout.lock; what the configuration uses comes along. Raises Rejected."""
    return printed(config, lay_out(config, dict.fromkeys([*requests, *config.types_used]), opened))


def printed(config: Config, layouts: Layouts) -> dict[str, str]:
    """The same of what is laid out already."""
    report = Report()
    texts = printed_by(TARGETS, config.targets, job_of(config, layouts, report), report)
    texts = {path: text for path, text in sorted(texts.items()) if not _is_linked(path, text, config)}
    return texts | {lockfile.LOCK: lockfile.write(layouts, texts, settings(config))}


def _is_linked(path: str, text: str, config: Config) -> bool:
    """Whether a compiler, or who imports Structured Text, finds it where another run has written it."""
    has_one_for_each_type = path.startswith(("c/", "cpp/", "cpp_ros1/", "cpp_ros2/", "st/"))
    return has_one_for_each_type and path in config.linked and config.linked[path] == lockfile.sha256(text)


def skippable(config: Config, requests: Iterable[str]) -> tuple[Schema, Schema]:
    """What is asked for, and what of it needs no more bounds than [bounds] has. Raises Rejected."""
    opened = library(config)
    schema = read(config, requests, opened)
    return schema, _bounded(config, schema, opened)


def _bounded(config: Config, schema: Schema, opened: definitions.Library) -> Schema:
    """Without what lacks a bound, unless the configuration uses it by name, or nothing were left."""
    used = read(config, config.types_used, opened).requested
    left = bounds.without_unbounded(schema, config.bounds, used)
    return left if left.requested else schema


def printed_by(targets: Sequence[Target], keys: Sequence[str], job: Job, report: Report) -> dict[str, str]:
    """{path: text} of those of `targets` that `keys` name, as they were planned. Raises Rejected."""
    waiting = _wanted(targets, keys)
    for target in waiting:
        _check_names(target, waiting, job, report)
    done: dict[str, tuple[RenderedFile, ...]] = {}
    while waiting:
        ready = [target for target in waiting if done.keys() >= set(target.after)]
        planned = {target.key: _planned(target, waiting, replace(job, printed=done), report) for target in ready}
        report.stop_if_any()

        from shmgen.generator.render import render  # jinja2 takes longer to load than all that is before it

        texts = render(output for outputs in planned.values() for output in outputs)
        for key, outputs in planned.items():
            done[key] = tuple(RenderedFile(output, texts[output.path]) for output in outputs)
        waiting = [target for target in waiting if target.key not in done]
    return {one.output.path: one.text for key in keys for one in done[key] if not one.output.piece}


def _planned(target: Target, waiting: Sequence[Target], job: Job, report: Report) -> list[Output]:
    """Without pieces where nobody waits for them."""
    are_wanted = any(target.key in other.after for other in waiting)
    return [output for output in target.room().plan(job, report) if are_wanted or not output.piece]


def _wanted(targets: Sequence[Target], keys: Sequence[str]) -> list[Target]:
    """In the order of `targets`, where each stands behind the one it is `after`."""
    wanted = set(keys)
    for target in reversed(targets):
        if target.key in wanted:
            wanted.update(target.after)
    return [target for target in targets if target.key in wanted]


def _check_names(target: Target, wanted: Sequence[Target], job: Job, report: Report) -> None:
    if names := target.room().NAMES:
        keys = [target.key, *(other.key for other in wanted if target.key in other.after)]
        naming.check(job.layouts, job.package, job.uses, names, keys, report)


def job_of(config: Config, layouts: Layouts, report: Report) -> Job:
    """What the targets get of a configuration. Reports SHM502: a topic, service or action whose type is none."""
    options = Options(
        regions=config.regions,
        distribution=config.distribution,
        beside=config.runtime == "beside",
        task_interval=config.task_interval,
        ros_package=config.ros_package,
        node=config.bridge.node,
        sources=tuple(resolve.sources(config, report)),
        configuration=config.document,
    )
    return Job(
        layouts,
        config.package,
        tuple(resolve.topics(config, layouts, report)),
        tuple(resolve.services(config, layouts, report)),
        tuple(resolve.actions(config, layouts, report)),
        options,
    )


@dataclass(frozen=True, slots=True)
class Item:
    """One message of the inventory: its size in bytes, or the keys that [bounds] lacks for it.

    `faults` are what else `generate` would say against it; `defaulted` are the keys that `default` answers for. Without
    size and keys its definition, or that of what it holds, is at fault.
    """

    name: TypeName
    size: int | None
    unbounded: tuple[str, ...]
    faults: tuple[Diagnostic, ...] = ()
    defaulted: tuple[str, ...] = ()


def inventory(config: Config, asked: str | None = None) -> list[Item]:
    """Every message in reach, or what one request stands for, whatever is wrong with some of them.

    Raises Rejected: the request stands for nothing, or there is nowhere to look.
    """
    opened = library(config)
    requests = [asked] if asked else dict.fromkeys(name.package for name in opened.known())
    schema, broken = definitions.load_usable(opened, requests, Report())
    names = sorted({*schema.requested, *broken})
    by_default = bounds.defaulted(schema, config.bounds)
    missing = bounds.unbounded(schema, config.bounds)
    mappable = tuple(message for message in schema.messages if not missing[message.name])
    bounded = bounds.apply(Schema(mappable), config.bounds, Report())
    all_sizes = layout.lay_out(bounded, _types(config, bounded), config.max_region, Report())
    layouts = {name: replace(it, requested=name in schema.requested) for name, it in all_sizes.items()}
    faults = _faults(config, layouts)
    return [
        Item(name, layouts[name].size, (), faults[name], by_default.get(name, ()))
        if name in layouts
        else Item(name, None, missing.get(name, ()), broken.get(name, ()))
        for name in names
    ]


def _faults(config: Config, layouts: Layouts) -> dict[TypeName, tuple[Diagnostic, ...]]:
    """What stops each message, or one that it holds: its region is too large, or its names do not fit the targets."""
    report = Report()
    for target in _wanted(TARGETS, config.targets):
        _check_names(target, TARGETS, Job(layouts, config.package), report)
    faults: dict[TypeName, tuple[Diagnostic, ...]] = {}
    for name, laid_out in layouts.items():
        size = Report()
        layout.check_size(laid_out, config.max_region, size)
        own = [found for found in report.diagnostics if found.span.path == laid_out.message.span.path]
        held = [found for inner in laid_out.dependencies for found in faults[inner] if found.code != "SHM303"]
        faults[name] = tuple(dict.fromkeys([*size.diagnostics, *own, *held]))
    return faults


def _sources(config: Config) -> definitions.Sources:
    return definitions.Sources(config.path, config.source, config.root, config.places)


def settings(config: Config) -> dict[str, object]:
    """What of the configuration gives the bytes and files their shape, beside the bounds seen in the slots."""
    return {
        "source": config.source,
        "targets": list(config.targets),
        "package": config.package,
        **({"distribution": config.distribution} if config.distribution else {}),
        **({"runtime": config.runtime} if config.runtime != "installed" else {}),
        **({"ros_package": config.ros_package} if config.ros_package else {}),
        "bool": config.types.bool,
        "time": config.types.time,
        **({"names": "ros"} if config.types.names == "ros" else {}),
        "encoding": config.types.encoding,
        "overflow": config.types.overflow,
        "topics": [f"{topic.direction} {topic.topic} {topic.type} depth {topic.depth}" for topic in config.topics],
        **({"services": [_spelled(it.service, it) for it in config.services]} if config.services else {}),
        **({"actions": [_spelled(it.action, it) for it in config.actions]} if config.actions else {}),
        "task_interval": config.task_interval,
        **_regions(config),
        **({"skip_unbounded": True} if config.skip_unbounded else {}),
    }


def _regions(config: Config) -> dict[str, object]:
    """What is said under [regions]."""
    mode, group, sync = config.regions.mode, config.regions.group, config.regions.sync
    said = {"mode": f"{mode:04o}" if mode is not None else "", "group": group, "sync": sync if sync != "lock" else ""}
    return {key: value for key, value in said.items() if value}


def _spelled(name: str, entry: entries.ServiceEntry | entries.ActionEntry) -> str:
    """One line of layout.lock, the server first. A timeout is the bridge's, and shapes nothing here."""
    return f"{entry.server} {name} {entry.type}"
