"""Writes the PLC's side of `shmgen selftest`, for CODESYS or OpenPLC."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

from shmgen.config import Config
from shmgen.core.diagnostics import Report
from shmgen.core.model import Output
from shmgen.generator import pipeline
from shmgen.targets import TARGETS, Job

PROGRAM = "PRG_ShmSelfTest"


def texts(config: Config, openplc: bool) -> dict[str, str]:
    """{path: text} of what templates/selftest/shmgen.toml asks for."""
    report = Report()
    layouts = pipeline.lay_out(config, [*config.messages, *config.types_used])
    targets = [replace(target, room=_WithProgram) if target.key == "st" else target for target in TARGETS]
    keys = ("openplc", "matiec") if openplc else ("st", "plcopen")
    return pipeline.printed_by(targets, keys, pipeline.job_of(config, layouts, report), report)


class _WithProgram:
    """The target st, with a program more that PRG_Ros calls: in CODESYS one's own are in the IDE, this one is not."""

    NAMES = None

    def plan(self, job: Job, report: Report) -> Iterator[Output]:
        from shmgen.targets.st import program, target

        for output in target.plan(job, report):
            view = output.view
            if isinstance(view, program.Program):
                output = replace(output, view=view._replace(behind=(PROGRAM,)))
            yield output
        yield Output(f"st/{PROGRAM}.st", f"selftest/{PROGRAM}.st", None)
