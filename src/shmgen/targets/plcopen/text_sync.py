"""Lays the generated Structured Text out as cds-text-sync takes it in its text-first mode: one object a file.

A block or program has its declaration, a line that tells where the code begins, and the code; a method is a file beside
it. Data types and lists are printed as the target st prints them.
"""

from __future__ import annotations

from collections.abc import Iterator

from shmgen.core.diagnostics import Report
from shmgen.core.model import Output
from shmgen.targets import Job
from shmgen.targets.plcopen.target import stored_object
from shmgen.targets.st.objects import Unit
from shmgen.targets.st.text import MADE

NAMES = None
"""All are those that the target st made."""


def plan(job: Job, report: Report) -> Iterator[Output]:
    """`cds_text_sync/` with the folders of `st/`."""
    for printed in job.printed["st"]:
        path = "cds_text_sync" + printed.output.path.removeprefix("st")
        match stored_object(printed):
            case Unit() as unit:
                yield Output(path, "plcopen/unit.st.j2", unit)
                for method in unit.methods:
                    declared = method._replace(declaration=f"{MADE}\n{method.declaration}")
                    yield Output(f"{path.removesuffix('st')}{method.name}.st", "plcopen/unit.st.j2", declared)
            case _:
                yield Output(path, printed.output.template, printed.output.view)
