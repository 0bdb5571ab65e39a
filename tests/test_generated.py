"""generated/ and the pictures of the docs are up to date, byte for byte."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from fnmatch import fnmatch
from pathlib import Path

from shmgen import config
from shmgen.core.diagnostics import Report
from shmgen.generator import pipeline

from .conftest import REPOSITORY
from .rigs.fbd import blocks
from .rigs.world import world
from .support.build import committed_texts, put


def test_generated_is_up_to_date() -> None:
    folder = REPOSITORY / "generated"
    patterns = re.findall(r"^!(.*[^/])$", (folder / ".gitignore").read_text(), re.MULTILINE)
    files = {str(path.relative_to(folder)): path.read_bytes() for path in folder.rglob("*") if path.is_file()}
    files = {path: data for path, data in files.items() if any(fnmatch(path, pattern) for pattern in patterns)}
    texts = {path: text for path, text in committed_texts().items() if any(fnmatch(path, name) for name in patterns)}
    assert sorted(files) == sorted([".gitignore", *texts]), "run `make generated`"
    for path, text in texts.items():
        assert files[path] == text.encode(), f"{path}: run `make generated`"


def test_memory_map_is_up_to_date() -> None:
    from shmgen.core.model import TypeName
    from shmgen.generator.render import render
    from shmgen.show import memory_map

    settings = config.load(REPOSITORY / "shmgen.toml", "shmgen.toml", Report())
    name = TypeName("sensor_msgs", "msg", "BatteryState")
    layouts = pipeline.lay_out(settings, [str(name)])
    (drawing,) = render([memory_map.plan(layouts[name], layouts)]).values()
    assert (REPOSITORY / "docs" / "memory_map.svg").read_text() == drawing, "run `make generated`"


def test_architecture_picture_is_up_to_date() -> None:
    assert (REPOSITORY / "docs" / "architecture.svg").read_text() == world(), "run `make generated`"


def test_picture_of_the_blocks_is_up_to_date(tmp_path: Path) -> None:
    assert (REPOSITORY / "docs" / "blocks.svg").read_text() == blocks(tmp_path), "run `make pictures`"


def test_generated_python_raises_no_warning(tmp_path: Path) -> None:
    """Define `_layout_` with each `_pack_`: ctypes warns of a missing one since Python 3.14, and rejects it in 3.19."""
    put({path: text for path, text in committed_texts().items() if path.startswith("python/")}, tmp_path)
    folder = tmp_path / "python"
    modules = [path.relative_to(folder).with_suffix("") for path in folder.rglob("_*.py")]
    code = f"import {', '.join('.'.join(module.parts).removesuffix('.__init__') for module in modules)}\n" + (
        "from shmgen.runtime import Message\n"
        "assert all((kind._pack_, kind._layout_) == (1, 'ms') for kind in Message.__subclasses__())\n"
        "print(len(Message.__subclasses__()))\n"
    )
    command = [sys.executable, "-W", "error", "-c", code]
    done = subprocess.run(command, env=os.environ | {"PYTHONPATH": str(folder)}, capture_output=True, text=True)
    assert (done.stderr, int(done.stdout or 0) > 10) == ("", True)
