"""Who may import whom, what a template may hold, and that codes, docs and error folders are one set."""

from __future__ import annotations

import ast
import re
import subprocess
import sys
from pathlib import Path

import pytest
from jinja2 import Environment, nodes

from shmgen.diagnostics import CODES

from .conftest import REPOSITORY

SOURCE = REPOSITORY / "src" / "shmgen"
TEMPLATES = sorted((REPOSITORY / "templates").rglob("*.j2"))

# Room -> what of shmgen it may import. `model` and `diagnostics` are the words all rooms share, made with `records`.
WORDS = {"diagnostics", "model", "records", "wording"}
ARROWS = {
    "abi": set(),
    "records": set(),
    "diagnostics": {"records"},
    "model": {"diagnostics", "records"},
    "cache": set(),
    "wording": set(),
    "toml": set(),
    "definitions": WORDS | {"definitions", "cache"},
    "bounds": WORDS,
    "layout": WORDS | {"abi"},
    "config": WORDS | {"abi", "bounds", "config", "targets", "toml"},
    "targets": WORDS | {"abi", "targets", "toml"},
    "render": {"model", "cache"},
    "write": {"diagnostics", "records"},
    "type_hash": {"model"},
    "drift": WORDS | {"cache", "drift", "toml", "type_hash", "write"},
    "resolve": WORDS | {"config", "targets"},
    "pipeline": WORDS | {"bounds", "config", "definitions", "drift", "layout", "render", "resolve", "targets"},
    "plc": WORDS | {"plc"},
    "show": WORDS | {"layout", "pipeline", "show", "targets", "type_hash"},
    "runtime": {"_straight", "abi", "runtime", "wording"},
    "live": WORDS | {"abi", "bounds", "config", "definitions", "live", "pipeline", "runtime", "toml"},
    "bag": WORDS | {"", "bag", "bridge", "drift", "live", "pipeline", "runtime", "type_hash"},
    "tools": WORDS | {"config", "live", "runtime", "targets", "tools"},
    "bridge": WORDS
    | {"_transcode", "bridge", "config", "live", "pipeline", "resolve", "runtime", "targets", "type_hash"},
    "view": WORDS | {"live", "runtime", "show", "targets", "tools", "view"},
    "cli": WORDS
    | {"", "bag", "bridge", "cache", "cli", "config", "definitions", "drift", "live", "pipeline", "render", "runtime"}
    | {"plc", "show", "targets", "tools", "view", "write"},
    "__init__": set(),
    "__main__": {"cli", "drift"},
}
ONLY_IN = {
    "click": {"cli"},
    "jinja2": {"render"},
    "rosbags": {"bag", "bridge", "definitions"},
    "aiohttp": {"view"},
    "rich": {"view"},
    "textual": {"cli", "view"},
    "textual_plotext": {"cli", "view"},
    "textual_serve": {"view"},
    "rosidl_parser": {"definitions"},
    "posix_ipc": {"runtime"},
    "ruamel": {"tools"},
    "rospy": {"bridge"},
    "rclpy": {"bridge"},
    "genpy": {"bridge"},
    "cyclonedds": {"bridge"},
}


def stage(path: Path) -> str:
    return path.relative_to(SOURCE).parts[0].removesuffix(".py")


def imports(path: Path) -> set[str]:
    """Dotted names of all modules a file imports, wherever in it."""
    found: set[str] = set()
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{path}: relative import"
            assert node.module
            found |= {f"{node.module}.{alias.name}" for alias in node.names}
    return found


@pytest.mark.parametrize("path", sorted(SOURCE.rglob("*.py")), ids=lambda path: str(path.relative_to(SOURCE)))
def test_imports_follow_the_arrows(path: Path) -> None:
    for name in imports(path):
        first, _, rest = name.partition(".")
        if first == "shmgen":
            other = rest.partition(".")[0]
            other = "" if other.startswith("__") else other
            assert other in ARROWS[stage(path)], f"{stage(path)} imports {name}"
        elif first in ONLY_IN:
            assert stage(path) in ONLY_IN[first], f"{stage(path)} imports {name}"


def test_the_configuration_loads_no_target() -> None:
    """It takes the keys of targets from the one tuple, and knows no more of them."""
    code = "import sys, shmgen.config; print(*[name for name in sys.modules if name.startswith('shmgen.targets')])"
    done = subprocess.run([sys.executable, "-c", code], check=True, capture_output=True, text=True)
    assert done.stdout.split() == ["shmgen.targets"]


def test_runtime_loads_only_the_standard_library_and_posix_ipc() -> None:
    code = "import sys, shmgen.runtime; print(*sorted({name.partition('.')[0] for name in sys.modules}))"
    loaded = subprocess.run(
        [sys.executable, "-I", "-c", code], check=True, capture_output=True, text=True
    ).stdout.split()
    bare = subprocess.run(
        [sys.executable, "-I", "-c", code.replace(", shmgen.runtime", "")], check=True, capture_output=True, text=True
    ).stdout.split()
    foreign = set(loaded) - set(bare) - set(sys.stdlib_module_names)
    assert foreign == {"shmgen", "posix_ipc"}


ALLOWED = (
    nodes.Template,
    nodes.Output,
    nodes.TemplateData,
    nodes.Name,
    nodes.Getattr,
    nodes.For,
    nodes.If,
    nodes.Include,
    nodes.Const,
)


@pytest.mark.parametrize("path", TEMPLATES, ids=lambda path: str(path.relative_to(REPOSITORY / "templates")))
def test_templates_hold_text_and_holes_only(path: Path) -> None:
    tree = Environment().parse(path.read_text())
    for node in tree.find_all(nodes.Node):
        assert isinstance(node, ALLOWED), f"{path.name}:{node.lineno}: {type(node).__name__}"
        if isinstance(node, nodes.If):
            assert isinstance(node.test, nodes.Name | nodes.Getattr), (
                f"{path.name}:{node.lineno}: a condition is a name"
            )
        if isinstance(node, nodes.Const):
            assert isinstance(node.value, str), f"{path.name}:{node.lineno}: only a template's name is a constant"


def test_codes_docs_and_error_folders_are_the_same_set() -> None:
    documented = re.findall(r"^## (SHM\d{3}) (.+)$", (REPOSITORY / "docs" / "diagnostics.md").read_text(), re.MULTILINE)
    assert dict(documented) == CODES
    shown = {folder.name.partition("_")[0] for folder in (REPOSITORY / "tests" / "errors").iterdir() if folder.is_dir()}
    assert shown == set(CODES)


def test_no_file_outgrows_a_head() -> None:
    for path in SOURCE.rglob("*.py"):
        assert len(path.read_text().splitlines()) <= 400, path
