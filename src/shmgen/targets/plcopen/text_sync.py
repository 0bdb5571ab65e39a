"""Write the generated Structured Text in the layout of cds-text-sync's text-first mode: one file for each object.

The file of a block or program contains the declaration, a line that marks the beginning of the code, and the code.
Each method is a separate file beside the block. Data types and lists are rendered as in the target st.
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
"""None, because the target st creates and checks all names."""


def plan(job: Job, report: Report) -> Iterator[Output]:
    """Yield a file for each object in `cds_text_sync/`, which has the same subfolders as `st/`."""
    for file in job.rendered["st"]:
        path = "cds_text_sync" + file.output.path.removeprefix("st")
        match stored_object(file):
            case Unit() as unit:
                yield Output(path, "plcopen/unit.st.j2", unit)
                for method in unit.methods:
                    declared = method._replace(declaration=f"{MADE}\n{method.declaration}")
                    yield Output(f"{path.removesuffix('st')}{method.name}.st", "plcopen/unit.st.j2", declared)
            case _:
                yield Output(path, file.output.template, file.output.view)
