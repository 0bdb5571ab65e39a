"""The whole generator as a sequence of pure functions: definitions, bounds, layout, targets and rendering.

.msg .srv .action --definitions--> Schema --bounds--> Schema --layout--> Layouts
                  --targets--> Outputs --render--> {path: text}
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence, Set
from typing import NamedTuple

from shmgen import definitions
from shmgen.config import Config
from shmgen.config.entries import CallEntry
from shmgen.core.diagnostics import Diagnostic, Report
from shmgen.core.model import Layouts, Output, Schema, TypeName, TypeOptions
from shmgen.drift import lockfile
from shmgen.generator import bounds, layout, resolve
from shmgen.generator.render import render
from shmgen.targets import TARGETS, Job, Options, RenderedFile, Target, naming


def library(config: Config) -> definitions.Library:
    """Open all definitions. Share the library to read each file once. Raises Rejected if a folder is missing."""
    sources = definitions.Sources(config.path, config.source, config.root, config.places)
    return definitions.open_library(sources, Report())


def read(config: Config, requests: Iterable[str], opened: definitions.Library | None = None) -> Schema:
    """Read the requested messages and their dependencies. Raises Rejected if a definition is missing or invalid."""
    return definitions.load(opened or library(config), requests, Report())


def lay_out(config: Config, requests: Iterable[str], opened: definitions.Library | None = None) -> Layouts:
    """Lay out the requested messages and their dependencies. Raises Rejected if a definition or bound has an error."""
    opened = opened or library(config)
    schema = read(config, requests, opened)
    if config.skip_unbounded:
        schema = _drop_unbounded(config, schema, opened)
    schema = bounds.apply(schema, config.bounds, Report(), opened.known)
    also = (message.name for message in schema.messages if str(message.name) in config.linked)
    # Linked messages stay requested; otherwise they would be regenerated without their publisher and subscriber.
    schema = schema._replace(requested=schema.requested.union(also))
    return layout.lay_out(schema, _types(config, schema), config.max_region, Report())


def _types(config: Config, schema: Schema) -> TypeOptions:
    """Return the configured type options. If `names` is not "ros", add the type names of an imported PLC project."""
    if config.types.names == "ros":
        return config.types
    own = tuple((message.name, message.plc.partition(" ")[0]) for message in schema.messages if message.plc)
    return config.types._replace(own=own)


def generate(config: Config, requests: Iterable[str], opened: definitions.Library | None = None) -> dict[str, str]:
    """Generate the requested messages. Return the text of all targets' files and of layout.lock, by path.

    Types that the configuration uses are generated as well. Raises Rejected if the input has errors.
    """
    return render_layouts(config, lay_out(config, dict.fromkeys([*requests, *config.types_used]), opened))


def render_layouts(config: Config, layouts: Layouts) -> dict[str, str]:
    """Generate code for finished layouts. Return the text of all targets' files and of layout.lock, by path.

    Raises Rejected if a target reports an error, such as two messages with the same name in its language.
    """
    report = Report()
    texts = render_targets(TARGETS, config.targets, job_of(config, layouts, report), report)
    texts = {path: text for path, text in sorted(texts.items()) if not _is_linked(path, text, config)}
    return texts | {lockfile.LOCK: lockfile.write(layouts, texts, lock_settings(config))}


def _is_linked(path: str, text: str, config: Config) -> bool:
    """Return True if another run, whose output the user names with --link, has already generated the same file."""
    has_one_for_each_type = path.startswith(("c/", "cpp/", "cpp_ros1/", "cpp_ros2/", "st/"))
    return has_one_for_each_type and path in config.linked and config.linked[path] == lockfile.sha256(text)


def skippable(config: Config, requests: Iterable[str]) -> tuple[Set[TypeName], Set[TypeName]]:
    """Return the requested messages that --skip-unbounded keeps, and those that it leaves out.

    The types that the configuration uses count as requested. Raises Rejected if a request matches no message, or a
    definition is invalid.
    """
    opened = library(config)
    requested = read(config, dict.fromkeys([*requests, *config.types_used]), opened)
    usable = _drop_unbounded(config, requested, opened).requested
    return usable, requested.requested - usable


def _drop_unbounded(config: Config, schema: Schema, opened: definitions.Library) -> Schema:
    """Drop messages with unbounded fields, except those the configuration names.

    If no message would remain, return the schema unchanged.
    """
    used = read(config, config.types_used, opened).requested
    left = bounds.without_unbounded(schema, config.bounds, used)
    return left if left.requested else schema


def render_targets(targets: Sequence[Target], keys: Sequence[str], job: Job, report: Report) -> dict[str, str]:
    """Render the `targets` that `keys` name. Return the text of each file by path, in the order of `keys`.

    Raises Rejected if a target reports an error.
    """
    waiting = _with_dependencies(targets, keys)
    for target in waiting:
        _check_names(target, waiting, job, report)
    rendered: dict[str, tuple[RenderedFile, ...]] = {}
    while waiting:
        ready = [target for target in waiting if rendered.keys() >= set(target.after)]
        planned = {target.key: _plan(target, waiting, job._replace(rendered=rendered), report) for target in ready}
        report.stop_if_any()
        texts = render(output for outputs in planned.values() for output in outputs)
        for key, outputs in planned.items():
            rendered[key] = tuple(RenderedFile(output, texts[output.path]) for output in outputs)
        waiting = [target for target in waiting if target.key not in rendered]
    return {one.output.path: one.text for key in keys for one in rendered[key] if not one.output.piece}


def _plan(target: Target, waiting: Sequence[Target], job: Job, report: Report) -> list[Output]:
    """Return the planned files of a target. `waiting` lists the targets that are not rendered yet.

    A piece is a text that only other targets include in their files. If none of the waiting targets includes the files
    of this target, pieces are omitted.
    """
    is_included = any(target.key in other.after for other in waiting)
    return [output for output in target.load().plan(job, report) if is_included or not output.piece]


def _with_dependencies(targets: Sequence[Target], keys: Sequence[str]) -> list[Target]:
    """Return the targets that `keys` name and the targets they depend on, dependencies first."""
    needed = set(keys)
    for target in reversed(targets):
        if target.key in needed:
            needed.update(target.after)
    return [target for target in targets if target.key in needed]


def _check_names(target: Target, others: Sequence[Target], job: Job, report: Report) -> None:
    if names := target.load().NAMES:
        keys = [target.key, *(other.key for other in others if target.key in other.after)]
        naming.check(job.layouts, job.package, job.uses, names, keys, report)


def job_of(config: Config, layouts: Layouts, report: Report) -> Job:
    """Return the input of the targets, from the configuration and the layouts.

    Reports SHM502 if a topic, service or action has a type of another kind.
    """
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


class Item(NamedTuple):
    """One message in the list of available messages.

    * `size`: the size of the message in bytes, or None if a bound is missing or a definition is invalid.
    * `unbounded`: the keys that the user must add to [bounds].
    * `defaulted`: the keys whose bound is only the `default` of [bounds].
    * `diagnostics`: all other diagnostics that `generate` would report.
    """

    name: TypeName
    size: int | None
    unbounded: tuple[str, ...]
    diagnostics: tuple[Diagnostic, ...] = ()
    defaulted: tuple[str, ...] = ()


def inventory(config: Config, request: str | None = None) -> list[Item]:
    """List all available messages, or the messages of one request, including faulty ones.

    Raises Rejected if the request matches nothing or there is no folder to search.
    """
    opened = library(config)
    requests = [request] if request else dict.fromkeys(name.package for name in opened.known())
    schema, broken = definitions.load_usable(opened, requests, Report())
    names = sorted({*schema.requested, *broken})
    by_default = bounds.defaulted(schema, config.bounds)
    missing = bounds.unbounded(schema, config.bounds)
    mappable = tuple(message for message in schema.messages if not missing[message.name])
    bounded = bounds.apply(Schema(mappable), config.bounds, Report())
    all_sizes = layout.lay_out(bounded, _types(config, bounded), config.max_region, Report())
    layouts = {name: it._replace(requested=name in schema.requested) for name, it in all_sizes.items()}
    diagnostics = _diagnostics(config, layouts)
    return [
        Item(name, layouts[name].size, (), diagnostics[name], by_default.get(name, ()))
        if name in layouts
        else Item(name, None, missing.get(name, ()), broken.get(name, ()))
        for name in names
    ]


def _diagnostics(config: Config, layouts: Layouts) -> dict[TypeName, tuple[Diagnostic, ...]]:
    """Return the diagnostics of each message and its dependencies: too large regions, and names that targets reject."""
    report = Report()
    for target in _with_dependencies(TARGETS, config.targets):
        _check_names(target, TARGETS, Job(layouts, config.package), report)
    diagnostics: dict[TypeName, tuple[Diagnostic, ...]] = {}
    for name, laid_out in layouts.items():
        region_report = Report()
        layout.check_size(laid_out, config.max_region, region_report)
        own = [diagnostic for diagnostic in report.diagnostics if diagnostic.span.path == laid_out.message.span.path]
        inherited = [one for inner in laid_out.dependencies for one in diagnostics[inner] if one.code != "SHM303"]
        diagnostics[name] = tuple(dict.fromkeys([*region_report.diagnostics, *own, *inherited]))
    return diagnostics


def lock_settings(config: Config) -> dict[str, object]:
    """Return the settings that layout.lock records because they change the output.

    Some settings are omitted if they have their default value. [bounds] is always omitted: the layouts in layout.lock
    already contain the bounds.
    """
    mode, sync = config.regions.mode, config.regions.sync
    settings = {
        "source": config.source,
        "targets": list(config.targets),
        "package": config.package,
        "distribution": config.distribution or None,
        "runtime": config.runtime if config.runtime != "installed" else None,
        "ros_package": config.ros_package or None,
        "bool": config.types.bool,
        "time": config.types.time,
        "names": "ros" if config.types.names == "ros" else None,
        "encoding": config.types.encoding,
        "overflow": config.types.overflow,
        "topics": [f"{topic.direction} {topic.topic} {topic.type} depth {topic.depth}" for topic in config.topics],
        "services": [_lock_line(entry) for entry in config.services] or None,
        "actions": [_lock_line(entry) for entry in config.actions] or None,
        "task_interval": config.task_interval,
        "mode": f"{mode:04o}" if mode is not None else None,
        "group": config.regions.group or None,
        "sync": sync if sync != "lock" else None,
        "skip_unbounded": config.skip_unbounded or None,
    }
    return {key: value for key, value in settings.items() if value is not None}


def _lock_line(entry: CallEntry) -> str:
    """Return the line of a service or an action in layout.lock: server, name and type.

    The timeout is omitted, because it affects only the bridge.
    """
    return f"{entry.server} {entry.name} {entry.type}"
