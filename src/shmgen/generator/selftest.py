"""Generates the PLC program of `shmgen selftest`, for CODESYS or OpenPLC."""

from __future__ import annotations

from collections.abc import Iterator

from shmgen.config import Config
from shmgen.core.diagnostics import Report
from shmgen.core.model import Output
from shmgen.generator import pipeline
from shmgen.targets import TARGETS, Job

PROGRAM = "PRG_ShmSelfTest"


def texts(config: Config, openplc: bool) -> dict[str, str]:
    """Generate the files that the PLC needs for the self-test. Return the text of each file by path.

    `config` is the configuration templates/selftest/shmgen.toml.
    """
    report = Report()
    layouts = pipeline.lay_out(config, [*config.messages, *config.types_used])
    targets = [target._replace(load=_WithProgram) if target.key == "st" else target for target in TARGETS]
    keys = ("openplc", "matiec") if openplc else ("st", "plcopen")
    return pipeline.render_targets(targets, keys, pipeline.job_of(config, layouts, report), report)


class _WithProgram:
    """The target st, extended by the program of the self-test. PRG_Ros calls this program after the blocks."""

    NAMES = None

    def plan(self, job: Job, report: Report) -> Iterator[Output]:
        from shmgen.targets.st import program, target

        for output in target.plan(job, report):
            view = output.view
            if isinstance(view, program.Program):
                output = output._replace(view=view._replace(behind=(PROGRAM,)))
            yield output
        yield Output(f"st/{PROGRAM}.st", f"selftest/{PROGRAM}.st", None)
