"""Read a tutorial's shmgen.toml and PLC program, and generate the Structured Text of the whole PLC."""

from __future__ import annotations

import re
from pathlib import Path

from shmgen import config
from shmgen.core.diagnostics import Report
from shmgen.generator import pipeline

from . import REPOSITORY


def project(page: str, folder: Path, topic: str) -> tuple[str, dict[str, str], dict[str, str]]:
    """Write shmgen.toml of a page of docs/ into `folder`.

    Return shmgen.toml, all generated files, and the Structured Text with the page's program. In the Structured Text,
    each topic begins with `topic`.
    """
    text = (REPOSITORY / "docs" / page).read_text()
    (settings,), (program,) = (re.findall(rf"```{kind}\n(.*?)```", text, re.DOTALL) for kind in ("toml", "iecst"))
    (folder / "shmgen.toml").write_text(settings)
    texts = pipeline.generate(config.load(folder / "shmgen.toml", "shmgen.toml", Report()), ())
    st = {
        path: text.replace("sTopic := '", f"sTopic := '{topic}") for path, text in texts.items() if path.endswith(".st")
    }
    return settings, texts, st | {"example.st": program}
