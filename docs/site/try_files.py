"""Put beside the page `try/` of a built site what runs the generator in the browser: Pyodide, and shmgen as a wheel.

Usage: python docs/site/try_files.py SITE

Everything comes from npm's and PyPI's registries now, and nothing later: the page loads files of its own site only.
"""

from __future__ import annotations

import hashlib
import json
import os
import shutil
import subprocess
import sys
import tarfile
import tempfile
import zipfile
from pathlib import Path

from shmgen.definitions import store

ROOT = Path(__file__).parents[2]
PYODIDE = "pyodide@314.0.7"
PYODIDE_FILES = ("pyodide.mjs", "pyodide.asm.mjs", "pyodide.asm.wasm", "python_stdlib.zip", "pyodide-lock.json")
UNUSED = ("shmgen/bag/", "shmgen/bridge/", "shmgen/runtime/extension/", "shmgen/tools/", "shmgen/view/")
"""Folders of the wheel that generating does not load. The runtime stays: `runtime = "beside"` copies it."""


def main(site: Path) -> None:
    """Write `files/<hash>/` and `manifest.json`, which names that folder and the size of each file in bytes."""
    if shutil.which("npm") is None:
        print("site: the page try/ is built without its generator: it needs npm (apt-get install npm)", file=sys.stderr)
        return
    page = site / "try"
    with tempfile.TemporaryDirectory() as folder:
        files = Path(folder, "files")
        files.mkdir()
        unpack_pyodide(Path(folder), files)
        pack_python(Path(folder), files / "packages.zip")
        digest = hashlib.sha256()
        for file in sorted(files.iterdir()):
            digest.update(file.name.encode() + file.read_bytes())
        name = digest.hexdigest()[:12]
        shutil.rmtree(page / "files", ignore_errors=True)
        shutil.copytree(files, page / "files" / name)
    sizes = {file.name: file.stat().st_size for file in sorted((page / "files" / name).iterdir())}
    manifest = {"folder": f"files/{name}/", "sizes": sizes, "sources": list(store.names())}
    (page / "manifest.json").write_text(json.dumps(manifest, indent=1))


def unpack_pyodide(folder: Path, target: Path) -> None:
    """Copy the files of npm's package `pyodide` that run Python in a browser."""
    command = ["npm", "pack", "--silent", "--pack-destination", str(folder), PYODIDE]
    subprocess.run(command, check=True, stdout=subprocess.DEVNULL)
    with tarfile.open(next(folder.glob("pyodide-*.tgz"))) as archive:
        for name in PYODIDE_FILES:
            member = archive.extractfile(f"package/{name}")
            assert member is not None, name
            (target / name).write_bytes(member.read())


def pack_python(folder: Path, target: Path) -> None:
    """Write one zip of shmgen's wheel, the built-in stores as JSON, and the page's own module."""
    environment = {**os.environ, "SHMGEN_PURE": "1"}
    pip = [sys.executable, "-m", "pip", "wheel", "--quiet", "--disable-pip-version-check", "--no-deps"]
    subprocess.run([*pip, "--wheel-dir", str(folder), str(ROOT)], check=True, env=environment)
    with zipfile.ZipFile(target, "w") as archive:
        with zipfile.ZipFile(next(folder.glob("*.whl"))) as wheel:
            for name in wheel.namelist():
                if name.startswith("shmgen/") and not name.startswith(UNUSED):
                    add(archive, name, wheel.read(name))
        add(archive, "generator.py", (ROOT / "docs" / "try" / "generator.py").read_bytes())
        for source in store.names():
            add(archive, f"stores/{source}.json", json.dumps(store.texts(source)).encode())


def add(archive: zipfile.ZipFile, name: str, content: bytes) -> None:
    """Add a file with the fixed date of ZipInfo: equal content gives an equal zip, which browsers keep."""
    archive.writestr(zipfile.ZipInfo(name), content, zipfile.ZIP_DEFLATED, 9)


if __name__ == "__main__":
    main(Path(sys.argv[1]))
