"""Generate C++17 headers: a class with asserted offsets for each message, and its publisher and subscriber."""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

from shmgen.core.diagnostics import Report
from shmgen.core.model import Layout, Output, Regions
from shmgen.targets import Job
from shmgen.targets.c import ends, region
from shmgen.targets.c.target import Member
from shmgen.targets.c.text import Head, in_comment, message_head, quoted
from shmgen.targets.cpp import calls
from shmgen.targets.cpp.members import constant_line, members, visits
from shmgen.targets.cpp.names import NAMES as NAMES
from shmgen.targets.cpp.names import class_name, header, namespace, qualified

RUNTIME = ("shmgen_values.hpp", "shmgen_fields.hpp", "shmgen_loans.hpp", "shmgen.hpp", "shmgen_calls.hpp",
           "shmgen_actions.hpp", "shmgen_notifier.hpp")  # fmt: skip
"""Handwritten headers in templates/cpp."""


class Header(NamedTuple):
    """The template data for one message, as finished C++ code.

    `visits` is an expression that visits the fields in order.
    """

    head: Head
    doc: tuple[str, ...]
    open: tuple[str, ...]
    name: str
    qualified: str
    base: str
    align: str
    size: str
    digest: str
    literal: str
    settings: ends.RegionSettings
    constants: tuple[str, ...]
    members: tuple[Member, ...]
    visits: str
    requested: bool


def plan(job: Job, report: Report) -> Iterator[Output]:
    """Yield `cpp/<package>/<ros package>/msg/pose.hpp` for each message, and the shared files.

    The headers include no file from `c/`, because `cpp/` has its own copies of the protocol's headers.
    """
    root = f"cpp/{job.package}"
    yield region.plan(job.package, key="cpp")
    yield from ends.runtime(root)
    for file in RUNTIME:
        yield Output(f"{root}/{file}", f"cpp/{file}", None)
    for name, layout in job.layouts.items():
        view = _header(layout, job.package, job.options.regions)
        yield Output(f"cpp/{header(name, job.package)}", "cpp/message.hpp.j2", view)
    yield from calls.plan(job.layouts, job.package)


def _header(layout: Layout, package: str, regions: Regions) -> Header:
    name, message = layout.name, layout.message
    includes = [f"{package}/shmgen.hpp", *sorted(header(inner, package) for inner in layout.dependencies)]
    return Header(
        head=message_head(layout, header(name, package), includes),
        doc=tuple(in_comment(message.doc).splitlines()),
        open=tuple(namespace(name, package).split("::")),
        name=class_name(name),
        qualified=qualified(name, package),
        base=f"{class_name(name)}_Constants" if message.constants else "",
        align=str(layout.align),
        size=str(layout.size),
        digest=f"{layout.digest:016x}",
        literal=quoted(str(name).encode()),
        settings=ends.region_settings(regions),
        constants=tuple(constant_line(constant, layout.options) for constant in message.constants),
        members=tuple(members(layout, package)),
        visits=visits(layout),
        requested=layout.requested,
    )
