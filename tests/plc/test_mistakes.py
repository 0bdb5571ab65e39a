"""The checks of test_bytes detect each mistake that is planted into generated Structured Text."""

from __future__ import annotations

import random
from collections.abc import Mapping
from pathlib import Path

import pytest

from shmgen.core.model import Layouts, TypeName

from ..softplc import CompileError, compile_st
from ..support.build import classes
from ..support.plc_bytes import assert_compiled_as_laid_out, assert_same_defaults, echo, echoes
from ..support.plc_demo import PACKAGE, generated
from ..support.schemas import plain, random_message

DEMO = TypeName("demo_msgs", "msg", "Demo")

MISTAKES = {
    "nothing": ("", "", ""),
    "a wrong type": ("ST_demo_msgs_Demo", "b          : UDINT", "b          : UINT"),
    "a wrong sign": ("ST_demo_msgs_Demo", "tail       : ARRAY[0..2] OF DINT", "tail       : ARRAY[0..2] OF UDINT"),
    "a missing padding": ("ST_demo_msgs_Demo", "    _pad0      : ARRAY[0..1] OF USINT;\n", ""),
    "another default": ("ST_demo_msgs_Inner", "k     : INT := 7;", "k     : INT := 8;"),
    "a wrong constant": ("GVL_Shm", "SLOT_HEADER   : UDINT := 16;", "SLOT_HEADER   : UDINT := 12;"),
    "a wrong magic": ("GVL_Shm", ":= 16#474D4853", ":= 16#474D4854"),
    "a missing member": ("ST_ShmHeader", "    udiWriter      : UDINT;", "    //"),
    "a narrow variable": ("FB_ShmRegion", "_udiNumber      : UDINT;", "_udiNumber      : UINT;"),
    "an assignment forgotten": ("FB_demo_msgs_Demo_Publisher", "    pSlot^ := pFrom^;\n", ""),
    "another slot": ("FB_ShmRegion", "uxOffset := udiNumber MOD _udiSlots + _udiLane * _udiSlots;", "uxOffset := 0;"),
}


@pytest.fixture(scope="module")
def demo(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Mapping[str, str], Layouts]:
    folder = tmp_path_factory.mktemp("mistakes")
    return folder, *generated(folder, "demo_msgs/Demo")


@pytest.mark.parametrize("mistake", MISTAKES)
@pytest.mark.family("[a wrong type]")
def test_planted_mistake_is_detected(demo: tuple[Path, Mapping[str, str], Layouts], topic: str, mistake: str) -> None:
    folder, texts, layouts = demo
    stem, right, wrong = MISTAKES[mistake]
    st = {path: text for path, text in texts.items() if path.endswith(".st")}
    for path in st:
        if Path(path).stem == stem:
            assert right in st[path]
            st[path] = st[path].replace(right, wrong)
    if mistake == "nothing":
        prove(folder, st, layouts, topic)
    else:
        with pytest.raises((AssertionError, CompileError)):
            prove(folder, st, layouts, topic)


def prove(folder: Path, st: Mapping[str, str], layouts: Layouts, topic: str) -> None:
    """Check a message as test_bytes checks every message."""
    plc = compile_st({**st, **echoes(layouts)})
    for name, layout in layouts.items():
        assert_compiled_as_laid_out(plc, name, layout)
    kinds = classes(folder, PACKAGE, DEMO)
    assert_same_defaults(plc, layouts[DEMO], kinds[0])
    for seed in range(3):
        message = random_message(layouts[DEMO], layouts, random.Random(seed))
        answer, _ = echo(plc, DEMO, kinds, f"{topic}/s{seed}", message)
        assert plain(answer) == plain(message)
