"""The shmgen.toml of docs/tutorial-plc.md, what that generates, and the Structured Text of the whole PLC."""

from __future__ import annotations

import re
from pathlib import Path

from shmgen import config
from shmgen.core.diagnostics import Report
from shmgen.generator import pipeline

from ..conftest import REPOSITORY

PAGE = (REPOSITORY / "docs" / "tutorial-plc.md").read_text()


def project(folder: Path, topic: str) -> tuple[str, dict[str, str], dict[str, str]]:
    """shmgen.toml is written into `folder`; in the Structured Text, PRG_Conveyor with it, `topic` is before each."""
    (settings,), (program,) = (re.findall(rf"```{kind}\n(.*?)```", PAGE, re.DOTALL) for kind in ("toml", "iecst"))
    (folder / "shmgen.toml").write_text(settings)
    texts = pipeline.generate(config.load(folder / "shmgen.toml", "shmgen.toml", Report()), ())
    st = {
        path: text.replace("sTopic := '", f"sTopic := '{topic}") for path, text in texts.items() if path.endswith(".st")
    }
    return settings, texts, st | {"yours.st": f"PROGRAM PRG_Conveyor\n{program}END_PROGRAM\n"}
