"""On machines that reorder loads and stores, memory barriers keep their order."""

from __future__ import annotations

import ctypes
import os
import runpy
import sys
from types import SimpleNamespace
from unittest.mock import Mock

import pytest

import shmgen
from shmgen.core import abi
from shmgen.runtime import engine, reference
from shmgen.runtime.reference import memory_order

WORDS = 2**63 - 1, 2**31 - 1
"""The values of sys.maxsize in a 64-bit and in a 32-bit process."""


def load_fence():
    """Return the fence that a newly started Python uses."""
    fresh = runpy.run_path(memory_order.__file__)
    return memory_order._locked if fresh["fence"] is fresh["_locked"] else fresh["fence"]


@pytest.fixture
def machine(monkeypatch):
    """A function that simulates a machine and its answer to membarrier(2), and returns the list of system calls."""

    def pretend(name, maxsize=WORDS[0], answer=0):
        calls = []

        def syscall(*arguments):
            calls.append([(type(argument), argument.value) for argument in arguments])
            return answer

        monkeypatch.setattr(os, "uname", lambda: SimpleNamespace(machine=name))
        monkeypatch.setattr(sys, "maxsize", maxsize)
        monkeypatch.setattr(ctypes, "CDLL", lambda name: SimpleNamespace(syscall=syscall))
        return calls

    yield pretend
    monkeypatch.undo()


@pytest.mark.parametrize("name", ["x86_64", "AMD64", "i386", "i486", "i586", "i686"])
def test_x86_needs_no_barrier(machine, name):
    calls = machine(name, answer=-1)
    assert memory_order.keeps_order()
    assert memory_order.has_barrier()
    assert load_fence() is memory_order._locked
    words = memoryview(bytearray(8))
    assert memory_order.ordered(words) is words
    assert not calls


@pytest.mark.parametrize(
    ("name", "maxsize", "number"),
    [
        ("aarch64", WORDS[0], 283),
        ("riscv64", WORDS[0], 283),
        ("aarch64", WORDS[1], 389),
        ("armv8l", WORDS[1], 389),
        ("armv7l", WORDS[1], 389),
    ],
)
def test_other_machines_use_membarrier(machine, name, maxsize, number):
    """Call membarrier(2), by its number in asm/unistd.h, with 2 for MEMBARRIER_CMD_GLOBAL_EXPEDITED."""
    calls = machine(name, maxsize)
    assert not memory_order.keeps_order()
    assert memory_order.has_barrier()
    fence = load_fence()
    del calls[:]
    fence()
    assert calls == [[(ctypes.c_long, value) for value in (number, 2, 0, 0)]]


@pytest.mark.parametrize(("name", "maxsize", "answer"), [("aarch64", WORDS[0], -1), ("riscv64", WORDS[1], 0)])
def test_machines_without_membarrier_use_a_lock(machine, name, maxsize, answer):
    machine(name, maxsize, answer)
    assert not memory_order.has_barrier()
    assert load_fence() is memory_order._locked
    memory_order._locked()


def test_header_access_is_between_two_barriers(machine, monkeypatch):
    machine("aarch64")
    log = Mock()
    log.words.__getitem__ = lambda _, at: log.load(at) and 5
    log.words.__setitem__ = lambda _, at, value: log.store(at, value)
    monkeypatch.setattr(memory_order, "fence", log.fence)
    words = memory_order.ordered(log.words)
    assert words[3] == 5
    words[4] = 6
    words.release()
    steps = [(name, *arguments) for name, arguments, _ in log.mock_calls]
    fence = ("fence",)
    assert steps == [fence, ("load", 3), fence, fence, ("store", 4, 6), fence, ("words.release",)]


@pytest.mark.parametrize(
    ("pure", "flags", "abi_offset", "is_loaded"),
    [("", "", 0, True), ("1", "", 0, False), ("", "", 1, False), ("", "t", 0, False)],
)
def test_older_or_foreign_extension_is_not_loaded(monkeypatch, pure, flags, abi_offset, is_loaded):
    """Ignore the extension of another Python, which a free-threaded Python (flag t) finds by name but cannot use."""
    extension = Mock(ABI=abi.ABI + abi_offset)
    monkeypatch.setenv("SHMGEN_PURE", pure)
    monkeypatch.setattr(sys, "abiflags", flags)
    monkeypatch.setattr(shmgen, "_core", extension, raising=False)
    assert runpy.run_path(engine.__file__)["engine"] is (extension if is_loaded else reference)
