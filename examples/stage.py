"""Helpers for demos of a whole cell: generate code, start the PLC and other processes, and clean up.

The PLC here is a simulation for tests and demos (tests/softplc), not a real PLC. It compiles the generated and the
hand-written Structured Text through C++, and calls the programs like a cyclic task.
"""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from importlib.util import find_spec
from pathlib import Path

from shmgen import config
from shmgen.core.diagnostics import Report
from shmgen.runtime.region.names import region_file, region_name

REPOSITORY = Path(__file__).parents[1]
SHMGEN = (sys.executable, "-m", "shmgen")
LOOPBACK = (
    "<CycloneDDS><Domain><General><Interfaces>"
    '<NetworkInterface name="lo" multicast="true"/>'
    "</Interfaces></General></Domain></CycloneDDS>"
)
"""Cyclone's configuration that keeps DDS on this machine. A CYCLONEDDS_URI in the environment overrides it."""


class Cell:
    """The machine of an example, with generated code and running processes, which end with the cell.

    The code is generated from shmgen.toml in the folder `here` into `folder`.
    """

    def __init__(self, here: Path, folder: Path, processes: ExitStack) -> None:
        self.here, self.folder, self._processes = here, folder, processes
        path = os.pathsep.join(filter(None, [f"{folder}/python", os.environ.get("PYTHONPATH")]))
        self.environment = {"CYCLONEDDS_URI": LOOPBACK} | os.environ | {"PYTHONPATH": path, "PYTHONUNBUFFERED": "1"}

    def generate(self) -> None:
        """Generate the code that shmgen.toml requests."""
        self.shmgen("generate", "--quiet", "--output", self.folder)

    def shmgen(self, command: str, *arguments: str | Path) -> None:
        """Print and run a command of shmgen with the cell's configuration."""
        print("\n$ shmgen", command, *(word for word in arguments if word not in ("--output", self.folder)), flush=True)
        subprocess.run([*SHMGEN, command, *arguments, "-c", self.here / "shmgen.toml"], check=True)

    def start_plc(self, *programs: str) -> subprocess.Popen[str]:
        """Compile all Structured Text, and call PRG_Ros and `programs` (files in `here`) every millisecond."""
        sys.path.insert(0, str(REPOSITORY))
        own, generated = sorted(self.here.glob("*.st")), sorted((self.folder / "st").rglob("*.st"))
        names = " and ".join(path.name for path in own)
        print(
            f"\nThe PLC: {names} and {len(generated)} generated files, compiled and called every millisecond",
            flush=True,
        )
        with _progress("compiling Structured Text by way of C++", "it is kept for the next time in .venv"):
            from tests.softplc import compile_st

            compile_st({path.name: path.read_text() for path in (*generated, *own)}, self.folder / "plc")
        return self.run_plc(*programs)

    def run_plc(self, *programs: str) -> subprocess.Popen[str]:
        """Start the PLC again without compiling."""
        task = ["-m", "tests.softplc.task", self.folder / "plc" / "plc.so", "PRG_Ros", *programs]
        return self.start("PLC", *task, "--period", "0.001", ready="running", cwd=REPOSITORY)

    def start_bridge(self, backend: str) -> subprocess.Popen[str]:
        """Start `shmgen bridge` with a backend, such as dds."""
        return self.start(
            "bridge", "-m", "shmgen", "bridge", "--backend", backend, "-c", self.here / "shmgen.toml", ready="running"
        )

    def start(self, name: str, *arguments: str | Path, ready: str, cwd: Path | None = None) -> subprocess.Popen[str]:
        """Start a Python process that ends with the cell. Return once it prints a line that contains `ready`."""
        return self.start_program(name, sys.executable, *arguments, ready=ready, cwd=cwd)

    def start_program(
        self, name: str, *command: str | Path, ready: str, cwd: Path | None = None
    ) -> subprocess.Popen[str]:
        """Start any program that ends with the cell. Return once it prints a line that contains `ready`."""
        process = subprocess.Popen(command, cwd=cwd, env=self.environment, stdout=subprocess.PIPE, text=True)
        self._processes.callback(_end, process)
        assert process.stdout
        for line in process.stdout:
            print(f"   {name} (process {process.pid}): {line.strip()}", flush=True)
            if ready in line:
                return process
        raise SystemExit(f"{name} ended before it was ready")

    def run(self, script: str, *arguments: str, timeout: float = 120, python: str | Path = sys.executable) -> int:
        """Run a Python file in `here` to its end and return its exit status."""
        command = [python, self.here / script, *arguments]
        return subprocess.run(command, env=self.environment, timeout=timeout, check=False).returncode


@contextmanager
def cell(here: Path, *packages: str) -> Iterator[Cell]:
    """Yield a cell for the example in folder `here`. At the end, stop its processes and remove its regions.

    Raises SystemExit at once if a package that the example needs is not installed.
    """
    if missing := [package for package in packages if not find_spec(package.replace("-", "_"))]:
        raise SystemExit(f"this example needs: {sys.executable} -m pip install {' '.join(missing)}")
    with tempfile.TemporaryDirectory() as folder:
        try:
            with ExitStack() as processes:
                yield Cell(here, Path(folder), processes)
        finally:
            _clean(here / "shmgen.toml")


@contextmanager
def _progress(doing: str, done: str) -> Iterator[None]:
    """Print the progress of a long step every 10 s, and at the end its duration."""
    begun, over = time.monotonic(), threading.Event()

    def report() -> None:
        while not over.wait(10):
            print(f"   {doing}: {time.monotonic() - begun:.0f} s", flush=True)

    thread = threading.Thread(target=report, daemon=True)
    thread.start()
    try:
        yield
    finally:
        over.set()
        thread.join()
    if (took := time.monotonic() - begun) > 5:
        print(f"   {doing} took {took:.0f} s; {done}", flush=True)


def _clean(configuration: Path) -> None:
    """Remove all regions after the processes have ended. Publishers and subscribers do not remove their regions."""
    settings = config.load(configuration, configuration.name, Report())
    calls = [f"{service.name}-{half}" for service in settings.services for half in ("request", "response")]
    calls += [f"{action.name}-{third}" for action in settings.actions for third in ("goal", "feedback", "result")]
    existing = [
        name
        for name in [*(topic.topic for topic in settings.topics), *calls]
        if Path(region_file(region_name(name))).exists()
    ]
    if existing:
        subprocess.run([*SHMGEN, "clean", *existing], stdout=subprocess.DEVNULL, check=True)


def _end(process: subprocess.Popen[str]) -> None:
    process.terminate()
    try:
        process.wait(5)
    except subprocess.TimeoutExpired:
        process.kill()
        process.wait()
