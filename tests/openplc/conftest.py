"""Programs of the open PLC dialects, compiled once in a session with the stubs of tests/support/open_plc.py."""

from __future__ import annotations

import shutil
from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from shmgen.config import Config
from shmgen.core.model import Layouts
from shmgen.generator import pipeline

from ..support import build, kept, open_plc
from ..support.open_plc import COMPILERS, Program

MESSAGES = {
    "Part": "string<=12 name\nint64 big\nuint64 bigger\nbool[3] flags\n",
    "All": "bool a\nint8 b\nuint8 c\nint16 d\nuint16 e\nint32 f\nuint32 g\nint64 h\nuint64 i\nfloat32 j\nfloat64 k\n"
    "string<=20 text\nstring<=40[<=3] texts\nstring<=8[2] pair\nfloat64[4] four\nPart part\nPart[2] two\n"
    "Part[<=3] some\nbuiltin_interfaces/Time stamp\nbuiltin_interfaces/Duration[<=2] took\n"
    "uint8 type\nuint8 step\nuint8 time\nuint8 array\nuint8 nan\nuint8 eof\nuint8 en\nuint8 int\n",
    "Given": "float64 x 1.5\n"
    "int32[3] y [0, 2147483647, -2147483648]\nuint64 z 18446744073709551615\nbool on true\nPart part\n",
    "Number": "uint32 value\n",
    "Empty": "",
}
CALLS = {
    "srv/Start.srv": "bool on\nuint32 batch\nstring<=8 name\nint8[<=3] codes\n---\n"
    "bool success\nuint32 batch\nstring<=20 message\nfloat64[<=2] values\n",
    "srv/Stop.srv": "---\n",
    "action/Move.action": "uint32 target\nint8[<=3] over\n---\nuint32 way\nint8[<=3] took\n---\n"
    "uint32 way\nint8[<=3] past\n",
}
PACKAGE = "shm_msgs"


def texts_of(
    folder: Path, messages: dict[str, str], calls: Mapping[str, str] | None = None, **settings: Any
) -> tuple[dict[str, str], Layouts]:
    """Generate the messages, services and actions of demo_msgs. Return the files and the layouts."""
    build.put({f"demo_msgs/msg/{name}.msg": text for name, text in messages.items()}, folder)
    build.put({f"demo_msgs/{path}": text for path, text in (calls or {}).items()}, folder)
    targets = ("matiec", "openplc", "python")
    config = replace(Config(folder, source="jazzy", path=(folder,), package=PACKAGE, targets=targets), **settings)
    return pipeline.generate(config, ["demo_msgs"]), pipeline.lay_out(config, ["demo_msgs"])


@pytest.fixture(scope="session")
def generated(tmp_path_factory: pytest.TempPathFactory, worker_id: str) -> tuple[Path, dict[str, str], Layouts]:
    """The folder with the generated Python, all generated files, and the layouts."""
    base = tmp_path_factory.getbasetemp()
    folder = (base if worker_id == "master" else base.parent) / "openplc"
    with kept.locked(folder / "lock"):
        texts, layouts = texts_of(folder, MESSAGES, CALLS)
        if not (folder / "python").exists():
            build.put(texts, folder)
    return folder, texts, layouts


_DIALECTS = [pytest.param(name, marks=() if name == "openplc-v4" else pytest.mark.slow, id=name) for name in COMPILERS]


@pytest.fixture(scope="session", params=_DIALECTS)
def shared(request: pytest.FixtureRequest, generated: tuple[Path, dict[str, str], Layouts]) -> Path:
    """The compiled shared object of one dialect."""
    compiler = str(request.param)
    if shutil.which(COMPILERS[compiler][0]) is None:
        pytest.skip(f"{COMPILERS[compiler][0]} is not installed")
    folder = generated[0] / compiler
    with kept.locked(folder / "lock"):
        if not (folder / "plc.so").exists():
            open_plc.compiled(generated[1], compiler, folder)
    return folder / "plc.so"


@pytest.fixture
def plc(shared: Path) -> Iterator[Program]:
    """The loaded program. It is unloaded at the end, which closes the endpoints of its blocks."""
    program = Program(shared)
    yield program
    program.unload()


@pytest.fixture
def python(generated: tuple[Path, dict[str, str], Layouts]) -> Callable[[str], tuple[Any, Any, Any]]:
    """The message class, the publisher and the subscriber of a message of demo_msgs."""
    folder, _, layouts = generated
    return lambda name: build.classes(folder, PACKAGE, next(it for it in layouts if it.short == f"demo_msgs/{name}"))
