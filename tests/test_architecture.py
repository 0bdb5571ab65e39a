"""Imports follow the architecture, templates contain no logic, and each error code has a description and a test."""

from __future__ import annotations

import ast
import re
import subprocess
import sys
from graphlib import TopologicalSorter
from pathlib import Path

import pytest
from jinja2 import Environment, nodes

from shmgen.core.diagnostics import CODES

from .conftest import REPOSITORY

SOURCE = REPOSITORY / "src" / "shmgen"
TEMPLATES = sorted((REPOSITORY / "templates").rglob("*.j2"))

# Package (a folder of src/shmgen) -> the packages that it may import. The graph has no cycle.
ARROWS: dict[str, set[str]] = {
    "core": set(),
    "definitions": {"core"},
    "targets": {"core"},
    "drift": {"core"},
    "plc": {"core"},
    "runtime": {"core", "_core"},
    "config": {"core", "targets"},
    "generator": {"config", "core", "definitions", "drift", "targets"},
    "show": {"core", "generator", "targets"},
    "live": {"config", "core", "definitions", "drift", "generator", "runtime"},
    "tools": {"config", "core", "live", "runtime", "targets"},
    "bridge": {"_alarm", "config", "core", "generator", "live", "runtime", "targets"},
    "view": {"core", "live", "runtime", "show", "targets", "tools"},
    "bag": {"", "bridge", "core", "drift", "generator", "live", "runtime"},
    "cli": {"", "bag", "bridge", "config", "core", "definitions", "drift", "generator", "live", "plc", "runtime"}
    | {"show", "targets", "tools", "view"},
    "__init__": set(),
    "__main__": {"cli", "drift"},
}
# Folder in a package -> its other folders that it may import. Modules beside these folders may import all of them.
INNER_ARROWS: dict[str, set[str]] = {
    "bridge/codec": set(),
    "bridge/common": {"backend", "codec"},
    "bridge/ros1": {"backend", "codec", "common"},
    "bridge/ros2": {"backend", "codec", "common"},
    "bridge/dds": {"backend", "codec", "common", "ros2"},
    "bridge/zenoh": {"backend", "codec", "common", "ros2"},
    "runtime/region": {"errors"},
    "runtime/messages": {"errors", "region"},
    "tools/messages": set(),
    "tools/watch": {"messages"},
    "tools/doctor": set(),
}
PACKAGES, IMPORTS, MODULES, ENTRIES = 20, 70, 6, 18
"""The limits: packages, imports between them, modules beside them, and entries of bridge, runtime and tools each."""
ONLY_IN = {
    "click": {"cli"},
    "jinja2": {"generator"},
    "mcap": {"bag"},
    "rosbags": {"bag", "bridge", "definitions"},
    "aiohttp": {"view"},
    "rich": {"view"},
    "textual": {"cli", "view"},
    "textual_plotext": {"cli", "view"},
    "textual_serve": {"view"},
    "rosidl_parser": {"definitions"},
    "posix_ipc": {"runtime"},
    "ruamel": {"bridge", "tools"},
    "rospy": {"bridge"},
    "rcl_interfaces": {"bridge"},
    "rclpy": {"bridge"},
    "genpy": {"bridge"},
    "cyclonedds": {"bridge"},
    "xxhash": {"bridge"},
    "zenoh": {"bridge"},
}


def package_of(path: Path) -> str:
    return path.relative_to(SOURCE).parts[0].removesuffix(".py")


def imports(path: Path) -> set[str]:
    """Return the dotted names of all modules that a file imports, also inside functions."""
    names: set[str] = set()
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{path}: relative import"
            assert node.module
            names |= {f"{node.module}.{alias.name}" for alias in node.names}
    return names


@pytest.mark.parametrize("path", sorted(SOURCE.rglob("*.py")), ids=lambda path: str(path.relative_to(SOURCE)))
def test_imports_follow_the_architecture(path: Path) -> None:
    here = package_of(path)
    inner = "/".join(path.relative_to(SOURCE).parts[:2])
    for name in imports(path):
        first, *others = name.split(".")
        if first == "shmgen":
            other = "" if others[0].startswith("__") else others[0]
            assert other in ARROWS[here] | {here}, f"{here} imports {name}"
            if other == here and inner in INNER_ARROWS:
                assert others[1] in INNER_ARROWS[inner] | {inner.partition("/")[2]}, f"{inner} imports {name}"
        elif first in ONLY_IN:
            assert here in ONLY_IN[first], f"{here} imports {name}"


def test_allowed_imports_have_no_cycle() -> None:
    for inner in INNER_ARROWS:
        assert (SOURCE / inner).is_dir(), inner
    for arrows in (ARROWS, {key.partition("/")[2]: to for key, to in INNER_ARROWS.items()}):
        TopologicalSorter(arrows).prepare()  # raises CycleError


def test_modules_have_no_import_cycle() -> None:
    modules = {".".join(path.relative_to(SOURCE.parent).with_suffix("").parts): path for path in SOURCE.rglob("*.py")}
    arrows = {}
    for module, path in modules.items():
        names = {name if name in modules else name.rpartition(".")[0] for name in imports(path)}
        arrows[module] = names & set(modules) - {module}
    TopologicalSorter(arrows).prepare()


def test_architecture_stays_small() -> None:
    imports_between = sum(len(to - {"", "_alarm", "_core"}) for to in ARROWS.values())
    assert len(ARROWS) <= PACKAGES
    assert imports_between <= IMPORTS
    assert len(list(SOURCE.glob("*.py"))) <= MODULES
    for name in ("bridge", "runtime", "tools"):
        entries = [entry for entry in (SOURCE / name).iterdir() if entry.name != "__pycache__"]
        assert len(entries) <= ENTRIES, name


def test_config_loads_no_target() -> None:
    """Load only shmgen.targets, whose tuple contains the names of all targets."""
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
    third_party = set(loaded) - set(bare) - set(sys.stdlib_module_names)
    assert third_party <= {"shmgen", "posix_ipc"}


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
def test_templates_contain_no_logic(path: Path) -> None:
    tree = Environment().parse(path.read_text())
    for node in tree.find_all(nodes.Node):
        assert isinstance(node, ALLOWED), f"{path.name}:{node.lineno}: {type(node).__name__}"
        if isinstance(node, nodes.If):
            assert isinstance(node.test, nodes.Name | nodes.Getattr), (
                f"{path.name}:{node.lineno}: a condition is a name"
            )
        if isinstance(node, nodes.Const):
            assert isinstance(node.value, str), f"{path.name}:{node.lineno}: only a template's name is a constant"


def test_each_error_code_has_a_description_and_a_test() -> None:
    documented = re.findall(r"^## (SHM\d{3}) (.+)$", (SOURCE / "diagnostics.md").read_text(), re.MULTILINE)
    assert dict(documented) == CODES
    tests = {folder.name.partition("_")[0] for folder in (REPOSITORY / "tests" / "errors").iterdir() if folder.is_dir()}
    assert tests == set(CODES)


def test_modules_stay_below_400_lines() -> None:
    for path in SOURCE.rglob("*.py"):
        assert len(path.read_text().splitlines()) <= 400, path
