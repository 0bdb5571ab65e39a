"""Defines the harnesses and their planted faults, and runs Eva on them."""

from __future__ import annotations

import re
import shutil
import subprocess
import time
from pathlib import Path
from typing import NamedTuple

from shmgen import config
from shmgen.core.diagnostics import Report
from shmgen.generator import pipeline

from ..support.build import put

HERE = Path(__file__).parent
TOML = """\
messages = ["diagnostic_msgs/DiagnosticArray", "std_srvs/SetBool"]
targets = ["c"]
[bounds]
"diagnostic_msgs/DiagnosticArray.status" = 8
"diagnostic_msgs/DiagnosticStatus.values" = 2
[strings]
default = 40
"""


class Fault(NamedTuple):
    """A fault to plant: the text `old` in a header becomes `new`."""

    header: str
    old: str
    new: str


class Harness(NamedTuple):
    """A harness in C. Eva keeps `states` states apart at a point of the program before it merges them.

    More states are slower and more precise.
    """

    name: str
    states: int
    fault: Fault


HARNESSES = (
    Harness("read", 20, Fault("shmgen_link.h", "number & (link->slots - 1)", "number & link->slots")),
    Harness("write", 60, Fault("diagnostic_msgs/msg/diagnostic_array_shm.h", "status_count > 8", "status_count > 9")),
    Harness(
        "lock",
        60,
        Fault(
            "shmgen_wake.h",
            "self->count + (by_event ? 2 : 1) > SHMGEN_MOST",
            "self->count + (by_event ? 1 : 0) > SHMGEN_MOST",
        ),
    ),
    Harness("open", 350, Fault("shmgen_open.h", 'char own[280] = "/";', 'char own[248] = "/";')),
    Harness("name", 400, Fault("shmgen_calls.h", "SHMGEN_JOINED_SIZE - 1 - behind", "SHMGEN_JOINED_SIZE - behind + 1")),
    Harness("calls", 50, Fault("shmgen_calls.h", "payload, 0, self->end.type.size", "payload, 0, self->end.slot_size")),
)

# A status of 0 guarantees the result of a call, so Eva keeps these states apart from the others.
_PROMISE = (
    "publisher_begin publisher_check_claim publisher_place publisher_enter publisher_heartbeat check_header copy take"
    " subscriber_read server_beat readable send"
)
_OPTIONS = (
    "-c11 -machdep gcc_x86_64 -eva -eva-no-show-progress -eva-precision 1"
    " -eva-domains octagon,symbolic-locations,equality"
    " -eva-warn-undefined-pointer-comparison none"  # for comparisons with MAP_FAILED
)


class Proof(NamedTuple):
    """The result of an analysis. `alarms` is the number of operations that Eva could not prove to be valid.

    `statements` is the percentage of statements that Eva has analysed, of all functions that it reached.
    """

    alarms: int
    functions: int
    statements: int
    seconds: float

    @property
    def holds(self) -> bool:
        return self.alarms == 0

    def __str__(self) -> str:
        return (
            f"{self.alarms} alarms, {self.functions} functions, {self.statements} % of statements, {self.seconds:.0f} s"
        )


def generate(folder: Path) -> Path:
    """Generate the headers below `folder` and return their folder."""
    (folder / "shmgen.toml").write_text(TOML)
    loaded = config.load(folder / "shmgen.toml", "shmgen.toml", Report())
    put(pipeline.generate(loaded, loaded.messages), folder)
    return folder / "c"


def prove(harness: Harness, headers: Path, planted: bool = False) -> Proof:
    """Run Eva on a harness and return the result. Raise RuntimeError if Eva did not complete the analysis."""
    if planted:
        headers = Path(shutil.copytree(headers, headers.parent / f"planted_{harness.name}", dirs_exist_ok=True))
        file = headers / "shm_msgs" / harness.fault.header
        text = file.read_text()
        assert harness.fault.old in text, f"{harness.fault} is out of date"
        file.write_text(text.replace(harness.fault.old, harness.fault.new))
    split = ",".join(f"shmgen_{function}:0" for function in _PROMISE.split())
    command = ["frama-c", *_OPTIONS.split(), "-eva-split-return-function", split, "-eva-slevel", str(harness.states)]
    command += [f"-cpp-extra-args=-I{HERE} -I{HERE / 'include'} -I{headers}", str(HERE / f"{harness.name}.c")]
    started_at = time.monotonic()
    process = subprocess.run(command, capture_output=True, text=True, check=False)
    seconds = time.monotonic() - started_at
    coverage = re.search(r"(\d+) functions? analyzed.*\n.*: (\d+)% coverage", process.stdout)
    alarms = re.search(r"(\d+) alarms? generated", process.stdout)
    if process.returncode or not coverage or not alarms:
        raise RuntimeError(f"{harness.name}: {process.stdout[-2000:]}{process.stderr}")
    unproven = re.findall(r"(?:Assertions|Preconditions) .* (\d+) unknown +(\d+) invalid", process.stdout)
    total = int(alarms[1]) + sum(int(number) for row in unproven for number in row)
    return Proof(total, int(coverage[1]), int(coverage[2]), seconds)
