"""Two hooks of hatchling: what is compiled for each wheel, and README.md as PyPI shows it.

The first turns src/shmgen/runtime/extension into the engine, and for shmgen itself bridge/common/alarm.c into an
extension of the bridge, and the templates into Python. It is called for each wheel, of shmgen and of
packaging/shmgen-runtime, and each editable installation, which reads its templates as they are. Nothing depends on the
extensions: without a compiler, without Python's headers, and with SHMGEN_PURE set, there are none.

The second makes links and pictures of README.md lead to the repository, at the tag of this version. The address is
that in SHMGEN_REPOSITORY, which the release workflow sets to where it runs (https://github.com/OWNER/shmgen); without
it links stay as they are, and there are no [project.urls].
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
"""The engine; `shmgen.h`, which all of it includes, is printed from shmgen/core/abi.py."""
RUNTIME = {"_core.abi3.so": tuple(f"runtime/extension/{name}.c" for name in ("core", "table", "objects", "wire"))}
ALL = RUNTIME | {"_alarm.abi3.so": ("bridge/common/alarm.c",)}
LIMITED = (3, 10)
"""The oldest Python that the binary runs on; so it does on all later ones."""
FLAGS = ("-O2", "-std=gnu11", "-fPIC", "-pthread", f"-DPy_LIMITED_API=0x{LIMITED[0]:02X}{LIMITED[1]:02X}0000")
"""The compiler options for each file in C."""
_LINK = re.compile(r"(!?)\[([^\]]*)\]\(([^)#:\s]+)((?:#[^)]*)?)\)")
PAGES = {
    "Documentation": "tree/{tag}/docs",
    "Changelog": "blob/{tag}/CHANGELOG.md",
    "Issues": "issues",
}


class StraightHook(BuildHookInterface[Any]):
    """Adds the extensions to a wheel, or writes them beside the sources of an editable installation."""

    PLUGIN_NAME = "custom"

    def initialize(self, version: str, build_data: dict[str, Any]) -> None:
        """Compile the extensions. hatchling calls this method before a build; `version` is `standard` or `editable`."""
        names = ALL if Path(self.root).resolve() == HERE else RUNTIME
        if version == "editable":
            notes = [build_extension(SOURCES / name) for name in names]
        else:
            self._folder = tempfile.TemporaryDirectory()  # until the wheel is made
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
            self.app.display_info(f"publish and read stay in Python: {max(notes)}")


def build_extension(target: Path) -> str:
    """Compile an extension of ALL. Return `""`, or the reason why it was not compiled."""
    if os.environ.get("SHMGEN_PURE"):
        return "SHMGEN_PURE is set"
    if sys.platform != "linux" or sys.implementation.name != "cpython" or sysconfig.get_config_var("Py_GIL_DISABLED"):
        return "the extension is for CPython with its lock, on Linux"
    compiler = shlex.split(os.environ.get("CC", "")) or [shutil.which("cc") or shutil.which("gcc") or "clang"]
    printed = tempfile.TemporaryDirectory()
    temporary = target.with_name(f"{target.name}.{os.getpid()}")  # whoever has the old one mapped keeps it
    folders = (sysconfig.get_path("include"), HEADERS, printed.name)
    sources = (str(SOURCES / source) for source in ALL[target.name])
    where = [*(f"-I{folder}" for folder in folders), *sources, "-o", str(temporary)]
    try:
        print_header(Path(printed.name))
        done = subprocess.run([*compiler, *FLAGS, "-shared", *where], capture_output=True, text=True, check=False)
        if done.returncode == 0:
            temporary.replace(target)
            return ""
        return next((line for line in done.stderr.splitlines() if "error" in line), f"{compiler[0]} failed")
    except OSError as error:
        return str(error)
    finally:
        temporary.unlink(missing_ok=True)
        printed.cleanup()


def print_header(folder: Path) -> None:
    """Write `shmgen.h` as it is generated for C programs."""
    render, region = _of_shmgen("generator.render"), _of_shmgen("targets.c.region")
    for text in render.render([region.plan("engine")]).values():
        (folder / "shmgen.h").write_text(text, encoding="utf-8")


def compiled_templates(folder: Path) -> dict[str, str]:
    """Return the compiled templates and their path in a wheel."""
    module = folder / "printers.py"
    module.write_text(_of_shmgen("generator.templates").compile_templates(HERE / "templates"), encoding="utf-8")
    return {str(module): f"{_of_shmgen('generator.render').RENDERERS_MODULE.replace('.', '/')}.py"}


def _of_shmgen(module: str) -> Any:
    """Import a module of this checkout, which is not installed yet."""
    if str(SOURCES.parent) not in sys.path:
        sys.path.insert(0, str(SOURCES.parent))
    return importlib.import_module(f"shmgen.{module}")


class Metadata(MetadataHookInterface):
    """The fields `readme` and `urls`."""

    PLUGIN_NAME = "custom"

    def update(self, metadata: dict[str, Any]) -> None:
        """Set the fields. hatchling calls this method with the table [project] of pyproject.toml."""
        repository, tag = os.environ.get("SHMGEN_REPOSITORY", "").rstrip("/"), f"v{metadata['version']}"
        text = (Path(self.root) / "README.md").read_text(encoding="utf-8")
        text = absolute(text, repository, tag) if repository else text
        metadata["readme"] = {"content-type": "text/markdown", "text": text}
        metadata["urls"] = urls(repository, tag) if repository else {}


def urls(repository: str, tag: str) -> dict[str, str]:
    """Return the table [project.urls]."""
    return {"Repository": repository} | {name: f"{repository}/{page.format(tag=tag)}" for name, page in PAGES.items()}


def absolute(text: str, repository: str, tag: str) -> str:
    """Return Markdown whose relative links lead to files of the repository, and pictures to their bytes."""

    def moved(link: re.Match[str]) -> str:
        picture, words, target, anchor = link.groups()
        kind = "raw" if picture else "blob" if re.search(r"\.\w+$|LICENSE", target) else "tree"
        return f"{picture}[{words}]({repository}/{kind}/{tag}/{target}{anchor})"

    return _LINK.sub(moved, text)
