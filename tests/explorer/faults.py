"""The faults of faults.toml, which can be planted in generated files."""

from __future__ import annotations

import sys
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib


@dataclass(frozen=True)
class Fault:
    """A fault to plant in `file`: each of `edits` is a text and its replacement.

    `scene` is the scene that finds the fault, or `test` the test that finds it. `reason` explains why no scene does.
    """

    name: str
    file: str
    edits: tuple[tuple[str, str], ...]
    scene: str = ""
    reason: str = ""
    test: str = ""

    def planted(self, texts: Mapping[str, str]) -> dict[str, str]:
        """Return `texts` with the fault in its file."""
        path = next(path for path in texts if path.endswith(f"/{self.file}"))
        text = texts[path]
        for old, new in self.edits:
            assert text.count(old) == 1, f"{self.name}: {self.file} has {text.count(old)} times {old!r}"
            text = text.replace(old, new)
        return {**texts, path: text}


_ALL = [Fault(**fault) for fault in tomllib.loads(Path(__file__).with_name("faults.toml").read_text())["fault"]]
FAULTS = [fault for fault in _ALL if fault.scene]
TESTED = [fault for fault in _ALL if fault.test]
"""For `make mutants` (tests/rigs/header_faults.py)."""
