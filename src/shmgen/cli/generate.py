"""The commands that read definitions and write bindings."""

from __future__ import annotations

import os
import re
import sys
import time
from collections.abc import Iterable, Sequence
from dataclasses import replace
from pathlib import Path

import click

from shmgen.cli import linked, options, requested
from shmgen.core.diagnostics import CODES, Diagnostic, Rejected, Span, closest
from shmgen.core.model import Layouts
from shmgen.core.plural import counted
from shmgen.drift import check_cache, lockfile
from shmgen.generator import changed, pipeline
from shmgen.targets import KEYS


@click.command()
@click.argument("messages", nargs=-1, metavar="[TYPE|PACKAGE|FILE]...")
@click.option(
    "-o",
    "--output",
    type=click.Path(path_type=Path, file_okay=False),
    default=Path("generated"),
    show_default=True,
    help="Output folder.",
)
@click.option(
    "-t",
    "--target",
    multiple=True,
    type=click.Choice(KEYS),
    help="Generate this target only and remove the files of others; may be repeated.",
)
@click.option("--skip-unbounded", is_flag=True, help="Leave out messages that still need a bound, instead of failing.")
@click.option("--only", is_flag=True, help="Generate these messages only and remove all others.")
@click.option(
    "--link",
    type=click.Path(path_type=Path, file_okay=False),
    multiple=True,
    help="Folder that another run has written: its messages keep their bounds, its headers and Structured Text are "
    "not written again; may be repeated.",
)
@click.option("-q", "--quiet", is_flag=True, help="Print diagnostics only.")
@click.option(
    "--depfile",
    type=click.Path(path_type=Path, dir_okay=False),
    help="Also write which files X depends on, for make or Ninja; named X.d.",
)
@options.where
def generate(
    messages: tuple[str, ...],
    output: Path,
    target: tuple[str, ...],
    skip_unbounded: bool,
    only: bool,
    link: tuple[Path, ...],
    quiet: bool,
    depfile: Path | None,
    config_file: Path | None,
    include: tuple[Path, ...],
) -> None:
    """Generate code for messages, services and actions.

    Takes a type (geometry_msgs/Pose), a package (geometry_msgs) or a file (path/to/Foo.msg), which are added to what
    the output folder already holds. Without arguments, generates what shmgen.toml lists and removes everything
    else. Only files that differ are written; after an error no file is touched.
    """
    from shmgen.core.write import current, write

    began = time.time_ns()
    config = options.load(config_file, include)
    if target:
        config = replace(config, targets=target)
    config = replace(config, skip_unbounded=skip_unbounded)
    opened = pipeline.library(config) if depfile or link else None
    if link and opened:
        config = linked.configured(config, link, opened)
    locks = [folder / lockfile.LOCK for folder in link]
    requests: list[str] = []
    texts: dict[str, str] = {}
    written = some = None
    while written is None:  # or another run has written since, and what it has done counts
        kept = current(output, lockfile.LOCK)
        edited = check_cache.changed(sys.argv[1:], {os.path.join(output, lockfile.LOCK): kept})
        some = changed.texts(config, output, edited) if edited is not None else None
        texts, leftovers = some or {}, list[str]()
        if some is None:
            lock, formerly = requested.former(output, kept)
            others = () if only else lock.requested
            requests = [*messages, *others] if messages else requested.configured(config)
            texts = requested.texts(config, requests, formerly if messages else {}, output, opened)
            linked.check(texts[lockfile.LOCK], locks)
            leftovers = sorted(set(lock.files) - set(texts))
        written = write(output, texts, leftovers, last=lockfile.LOCK, former=kept)
    total = len(texts) if some is None else (kept or b"").partition(b"\n[files]\n")[2].count(b"\n") + 1
    skipped = [] if quiet or not skip_unbounded else list(requested.left_out(config, requests))
    if not quiet:
        click.echo(_summary(output, total, skipped, written.changed, len(written.removed)), nl=False)
    own = {os.path.join(output, path): texts[path] for path in written.changed}
    if some is not None:
        check_cache.store_again(own)
        return
    files = [*(os.path.join(output, path) for path in texts), *map(str, locks)]
    if depfile and opened:
        files.append(str(depfile))
        own |= _write_depfile(depfile, filter(None, [options.file_in_force(config_file), *locks, *opened.files()]))
    said = "" if quiet else _summary(output, total, skipped)
    requested.remember(said, config, requests, config_file, files, began, own)


def _summary(output: Path, total: int, skipped: Sequence[str], changed: Sequence[str] = (), removed: int = 0) -> str:
    """What was done with so many files, and which messages were left out."""
    gone = f", {removed} removed" if removed else ""
    lines = [f"{output}: {counted(len(changed), 'file')} written, {total - len(changed)} unchanged{gone}"]
    lines += [f"  {output / path}" for path in changed]
    if skipped:
        lines.append(f"{counted(len(skipped), 'message')} left out for want of a bound, see `shmgen list`:")
        lines += [f"  {name}" for name in skipped]
    return "".join(f"{line}\n" for line in lines)


def _write_depfile(file: Path, read: Iterable[Path]) -> dict[str, str]:
    """As compilers write it for make; one that is so already is not touched. What was written."""
    made, *names = (
        re.sub("([ #])", r"\\\1", path.absolute().as_posix().replace("$", "$$"))
        for path in (file.with_suffix(""), *read)
    )
    text = f"{made}: {' '.join(names)}\n"
    if file.is_file() and file.read_text(encoding="utf-8") == text:
        return {}
    file.write_text(text, encoding="utf-8")
    return {str(file): text}


@click.command()
@click.argument("type_name", metavar="TYPE")
@click.option("--json", "as_json", is_flag=True, help="Print JSON.")
@click.option("--svg", "as_svg", is_flag=True, help="Print an SVG drawing of the memory map.")
@options.where
def show(type_name: str, as_json: bool, as_svg: bool, config_file: Path | None, include: tuple[Path, ...]) -> None:
    """Print the byte layout of a message: offset, size, ROS type, IEC type, comment.

    TYPE may also be a digest, as it stands in region headers and error messages: 16#BB4625C354F90C85.
    """
    from shmgen.show import table

    if as_json and as_svg:
        raise click.UsageError("--json or --svg, not both.")
    if digest := re.fullmatch(r"(?:16#|0x)?([0-9a-fA-F]{16})", type_name):
        layouts = _of_digest(int(digest[1], 16), config_file, include)
    else:
        layouts = pipeline.lay_out(options.load(config_file, include), [type_name])
    shown = [layout for layout in layouts.values() if layout.requested]
    if as_json:
        click.echo(table.as_json(shown, layouts), nl=False)
    elif as_svg:
        from shmgen.generator.render import render
        from shmgen.show import memory_map

        if len(shown) > 1:
            raise click.UsageError(f"--svg draws one message: {', '.join(str(layout.name) for layout in shown)}")
        for drawing in render([memory_map.plan(shown[0], layouts)]).values():
            click.echo(drawing.encode(), nl=False)
    else:
        click.echo("\n".join(table.table(layout, layouts) for layout in shown), nl=False)


def _of_digest(digest: int, config_file: Path | None, include: tuple[Path, ...]) -> Layouts:
    """What live regions, shmgen.toml, layout.lock and all definitions in reach know under it."""
    if not options.HAS_REGIONS:
        raise click.ClickException(
            "a digest is looked for in /dev/shm: run this on the Linux machine where the PLC runs"
        )
    from shmgen.cli import common
    from shmgen.live.digests import find

    registry = common.registry(config_file, include)
    if found := find(registry, digest):
        session, request = found
        return session.layouts([request])
    hint = "it was made with other bounds or types: call this where the shmgen.toml of that side is, or its layout.lock"
    raise Rejected(
        [Diagnostic("SHM004", f"no message here has the digest 16#{digest:016X}", Span("command line"), hint=hint)]
    )


@click.command()
@options.where
def types(config_file: Path | None, include: tuple[Path, ...]) -> None:
    """Print the type table between ROS, IEC 61131-3 and C, as configured."""
    from shmgen.show import lists

    click.echo(lists.type_table(options.load(config_file, include).types), nl=False)


@click.command("list")
@click.argument("asked", metavar="[PACKAGE|TYPE]", required=False)
@click.option("--json", "as_json", is_flag=True, help="Print JSON.")
@options.where
def list_(asked: str | None, as_json: bool, config_file: Path | None, include: tuple[Path, ...]) -> None:
    """List the messages that can be generated, with size, missing bounds and faults."""
    from shmgen.show import lists

    config = options.load(config_file, include)
    entries = pipeline.inventory(config, asked)
    click.echo(lists.inventory(entries, as_json, config.bounds.default_sequence), nl=False)


def _code(context: click.Context, parameter: click.Parameter, value: str) -> str:
    code = f"SHM{value:0>3}" if value.isdecimal() else value.upper()
    if code not in CODES:
        near = closest(code, CODES)
        raise click.BadParameter(f"{value} is not a diagnostic code{f'; did you mean {near}?' if near else ''}")
    return code


@click.command()
@click.argument("code", callback=_code, shell_complete=lambda *_: list(CODES))
def explain(code: str) -> None:
    """Explain a diagnostic, such as SHM101, and how to fix it."""
    installed = Path(__file__).parents[1] / "diagnostics.md"
    document = installed if installed.is_file() else Path(__file__).parents[3] / "docs" / "diagnostics.md"
    text = document.read_text(encoding="utf-8")
    section = text.partition(f"## {code}")[2].partition("\n## ")[0]
    click.echo(f"{code}{section.rstrip()}")


@click.command()
def schema() -> None:
    """Print a JSON schema of shmgen.toml, for editors that check and complete it."""
    import json

    from shmgen.config.schema import schema as made

    click.echo(json.dumps(made(), indent=2))


COMMANDS = (generate, show, types, list_, explain, schema)
