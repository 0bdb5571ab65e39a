"""SysShm and SysSemProcess return the results that CODESYS documents, if Structured Text calls them."""

from __future__ import annotations

import mmap
import os

import posix_ipc
import pytest

from shmgen.runtime.region.names import region_name
from tests.softplc import Block, Plc, compile_st
from tests.softplc.objects_for_tests import program

OK, TIMEOUT, BUFFERSIZE, NO_OBJECT, DUPLICATE = 0, 5, 15, 16, 18
INVALID = 2**64 - 1

VARIABLES = """
    sName : STRING(80); uxSize : __UXINT; udiResult : RTS_IEC_RESULT; hHandle : RTS_IEC_HANDLE; pData : POINTER TO BYTE;
    udiTimeout : UDINT;
"""
BODIES = {
    "P_Open": "hHandle := SysSharedMemoryOpen2(sName, 0, ADR(uxSize), ADR(udiResult));",
    "P_Create": "hHandle := SysSharedMemoryCreate(sName, 0, ADR(uxSize), ADR(udiResult));",
    "P_Write": "pData := SysSharedMemoryGetPointer(hHandle, ADR(udiResult)); pData[1] := 16#AB; "
    "udiResult := SysSharedMemoryClose(hHandle);",
    "P_Semaphore": "hHandle := SysSemProcessCreate(sName, ADR(udiResult));",
    "P_Try": "udiResult := SysSemProcessEnter(hHandle, 0);",
    "P_Leave": "udiResult := SysSemProcessLeave(hHandle);",
}


@pytest.fixture(scope="module")
def plc() -> Plc:
    return compile_st({f"{name}.st": program(name, VARIABLES.strip(), body) for name, body in BODIES.items()})


def run(plc: Plc, name: str, topic: str, size: int = 0, handle: int = INVALID) -> Block:
    block = plc.block(name)
    block.sName, block.uxSize, block.hHandle = region_name(topic), size, handle
    return block()


def test_open_does_not_create(plc: Plc, topic: str) -> None:
    block = run(plc, "P_Open", topic, 4096)
    assert (block.udiResult, block.hHandle) == (NO_OBJECT, INVALID)
    with pytest.raises(posix_ipc.ExistentialError):
        posix_ipc.SharedMemory(f"/{block.sName}")


def test_create_of_an_existing_object_returns_duplicate(plc: Plc, topic: str) -> None:
    assert run(plc, "P_Create", topic, 4096).udiResult == OK
    again = run(plc, "P_Create", topic, 4096)
    assert (again.udiResult, again.hHandle != INVALID) == (DUPLICATE, True)
    assert run(plc, "P_Write", topic, handle=again.hHandle).udiResult == OK
    memory = posix_ipc.SharedMemory(f"/{region_name(topic)}")
    with mmap.mmap(memory.fd, 0) as bytes_:
        assert (len(bytes_), bytes_[1]) == (4096, 0xAB)
    os.close(memory.fd)


@pytest.mark.parametrize("name", ["P_Open", "P_Create"])
def test_another_size_is_reported(plc: Plc, topic: str, name: str) -> None:
    run(plc, "P_Create", topic, 8192)
    block = run(plc, name, topic, 4096)
    assert (block.udiResult, block.hHandle, block.uxSize) == (BUFFERSIZE, INVALID, 8192)


@pytest.mark.parametrize(("rounded", "result"), [(False, BUFFERSIZE), (True, OK)])
def test_sizes_are_compared_exactly_or_in_pages(plc: Plc, topic: str, rounded: bool, result: int) -> None:
    run(plc, "P_Create", topic, 4096)
    plc.round_sizes(rounded)
    assert run(plc, "P_Open", topic, 4000).udiResult == result
    plc.round_sizes(False)


@pytest.mark.parametrize("initial_value", [0, 1])
def test_semaphore_has_its_initial_value_and_is_shared(plc: Plc, topic: str, initial_value: int) -> None:
    plc.born(initial_value)
    first = run(plc, "P_Semaphore", topic)
    assert first.udiResult == OK
    semaphore = posix_ipc.Semaphore(f"/{region_name(topic)}")
    assert semaphore.value == initial_value
    second = run(plc, "P_Semaphore", topic)
    assert (second.udiResult, second.hHandle != INVALID) == (DUPLICATE, True)
    if initial_value == 0:
        assert run(plc, "P_Leave", topic, handle=second.hHandle).udiResult == OK
    assert run(plc, "P_Try", topic, handle=first.hHandle).udiResult == OK
    assert run(plc, "P_Try", topic, handle=second.hHandle).udiResult == TIMEOUT
    assert (semaphore.value, plc.waits) == (0, 0)
