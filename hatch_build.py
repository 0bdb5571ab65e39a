"""Compile the extensions and templates for a wheel, and prepare README.md for PyPI, with two hooks of hatchling.

ExtensionHook runs for the wheels of shmgen and packaging/shmgen-runtime, and for editable installations. It compiles
src/shmgen/runtime/extension into the engine. For shmgen, it also compiles bridge/common/alarm.c, an extension of the
bridge. For a wheel of shmgen, it compiles the templates into a Python module. Without a compiler or Python's headers,
or if SHMGEN_PURE is set, the hook leaves out the extensions, because shmgen also works without them.

ReadmeHook changes the relative links of README.md to links into the repository, at the tag of this version. The release
workflow sets SHMGEN_REPOSITORY to the repository's address (https://github.com/OWNER/shmgen). Without this variable,
links stay relative, and the package has no [project.urls].
"""

from __future__ import annotations

import importlib
import os
import re
import shlex
import shutil
import subprocess
import sys
import sysconfig
import tempfile
from pathlib import Path
from typing import Any

from hatchling.builders.hooks.plugin.interface import BuildHookInterface
from hatchling.metadata.plugin.interface import MetadataHookInterface

HERE = Path(__file__).resolve().parent
SOURCES = HERE / "src" / "shmgen"
HEADERS = HERE / "templates" / "c"
"""The folder of the C headers that contain the engine. write_header() adds `shmgen.h`."""
RUNTIME = {"_core.abi3.so": tuple(f"runtime/extension/{name}.c" for name in ("core", "table", "objects", "wire"))}
"""The C files of each extension in the package shmgen-runtime."""
ALL = RUNTIME | {"_alarm.abi3.so": ("bridge/common/alarm.c",)}
"""The C files of each extension in the package shmgen."""
LIMITED = (3, 10)
"""The oldest supported Python. An extension that is compiled for its limited API also runs on later versions."""
FLAGS = ("-O2", "-std=gnu11", "-fPIC", "-pthread", f"-DPy_LIMITED_API=0x{LIMITED[0]:02X}{LIMITED[1]:02X}0000")
"""The compiler options for each file in C."""
_LINK = re.compile(r"(!?)\[([^\]]*)\]\(([^)#:\s]+)((?:#[^)]*)?)\)")
PAGES = {
    "Documentation": "tree/{tag}/docs",
    "Changelog": "blob/{tag}/CHANGELOG.md",
    "Issues": "issues",
}
"""The pages of the repository that PyPI links."""


class ExtensionHook(BuildHookInterface[Any]):
    """Adds the extensions to a wheel, or writes them beside the sources of an editable installation."""

    PLUGIN_NAME = "custom"

    def initialize(self, version: str, build_data: dict[str, Any]) -> None:
        """Compile the extensions. Hatchling calls this before the build. `version` is `standard` or `editable`."""
        names = ALL if Path(self.root).resolve() == HERE else RUNTIME
        if version == "editable":
            notes = [build_extension(SOURCES / name) for name in names]
        else:
            self._folder = tempfile.TemporaryDirectory()  # kept until the wheel is built
            folder = Path(self._folder.name)
            if names == ALL:
                build_data["force_include"] |= compiled_templates(folder)
            notes = [build_extension(folder / name) for name in names]
            if not any(notes):
                platform = sysconfig.get_platform().replace("-", "_").replace(".", "_")
                build_data["force_include"] |= {str(folder / name): f"shmgen/{name}" for name in names}
                build_data["tag"] = f"cp{LIMITED[0]}{LIMITED[1]}-abi3-{platform}"
                build_data["pure_python"] = False
        if any(notes):
            self.app.display_info(f"installed without the C extensions: {max(notes)}")


def build_extension(target: Path) -> str:
    """Compile the extension `target.name` of ALL. Return the reason if that is not possible, otherwise `""`."""
    if os.environ.get("SHMGEN_PURE"):
        return "SHMGEN_PURE is set"
    if sys.platform != "linux" or sys.implementation.name != "cpython" or sysconfig.get_config_var("Py_GIL_DISABLED"):
        return "the extensions require Linux and CPython with the GIL"
    compiler = shlex.split(os.environ.get("CC", "")) or [shutil.which("cc") or shutil.which("gcc") or "clang"]
    generated = tempfile.TemporaryDirectory()
    temporary = target.with_name(f"{target.name}.{os.getpid()}")  # processes that mapped the old extension keep it
    folders = (sysconfig.get_path("include"), HEADERS, generated.name)
    sources = (str(SOURCES / source) for source in ALL[target.name])
    arguments = [*(f"-I{folder}" for folder in folders), *sources, "-o", str(temporary)]
    try:
        write_header(Path(generated.name))
        done = subprocess.run([*compiler, *FLAGS, "-shared", *arguments], capture_output=True, text=True, check=False)
        if done.returncode == 0:
            temporary.replace(target)
            return ""
        return next((line for line in done.stderr.splitlines() if "error" in line), f"{compiler[0]} failed")
    except OSError as error:
        return str(error)
    finally:
        temporary.unlink(missing_ok=True)
        generated.cleanup()


def write_header(folder: Path) -> None:
    """Write `shmgen.h`, as generated for C programs, into `folder`."""
    render, region = _import("generator.render"), _import("targets.c.region")
    for text in render.render([region.plan("engine")]).values():
        (folder / "shmgen.h").write_text(text, encoding="utf-8")


def compiled_templates(folder: Path) -> dict[str, str]:
    """Compile the templates into a Python module in `folder`. Return its path and its path in a wheel."""
    module = folder / "renderers.py"
    module.write_text(_import("generator.templates").compile_templates(HERE / "templates"), encoding="utf-8")
    return {str(module): f"{_import('generator.render').RENDERERS_MODULE.replace('.', '/')}.py"}


def _import(module: str) -> Any:
    """Import a module of shmgen from this checkout, because shmgen is not installed yet."""
    if str(SOURCES.parent) not in sys.path:
        sys.path.insert(0, str(SOURCES.parent))
    return importlib.import_module(f"shmgen.{module}")


class ReadmeHook(MetadataHookInterface):
    """Sets the fields `readme` and `urls` of the package's metadata."""

    PLUGIN_NAME = "custom"

    def update(self, metadata: dict[str, Any]) -> None:
        """Set the fields. Hatchling calls this with the table [project] of pyproject.toml."""
        repository, tag = os.environ.get("SHMGEN_REPOSITORY", "").rstrip("/"), f"v{metadata['version']}"
        text = (Path(self.root) / "README.md").read_text(encoding="utf-8")
        text = with_absolute_links(text, repository, tag) if repository else text
        metadata["readme"] = {"content-type": "text/markdown", "text": text}
        metadata["urls"] = urls(repository, tag) if repository else {}


def urls(repository: str, tag: str) -> dict[str, str]:
    """Return the table [project.urls] for the repository's address and a tag."""
    return {"Repository": repository} | {name: f"{repository}/{page.format(tag=tag)}" for name, page in PAGES.items()}


def with_absolute_links(text: str, repository: str, tag: str) -> str:
    """Return Markdown whose relative links lead to pages of the repository, and pictures to files."""

    def absolute(link: re.Match[str]) -> str:
        picture, words, target, anchor = link.groups()
        kind = "raw" if picture else "blob" if re.search(r"\.\w+$|LICENSE", target) else "tree"
        return f"{picture}[{words}]({repository}/{kind}/{tag}/{target}{anchor})"

    return _LINK.sub(absolute, text)
