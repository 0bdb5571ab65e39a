"""Which machine keeps loads and stores in their memory_order, and what stands between them on one that does not."""

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
"""sys.maxsize of a process of 64 and of 32 bits."""


def chosen():
    """The fence of a Python that starts there."""
    fresh = runpy.run_path(memory_order.__file__)
    return memory_order._locked if fresh["fence"] is fresh["_locked"] else fresh["fence"]


@pytest.fixture
def machine(monkeypatch):
    """Turns a machine's name, the bits of a process there, and what membarrier(2) answers, into the calls of it."""

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
def test_x86_keeps_its_order(machine, name):
    calls = machine(name, answer=-1)
    assert memory_order.keeps_order()
    assert memory_order.has_barrier()
    assert chosen() is memory_order._locked
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
def test_linux_has_a_barrier_for_others(machine, name, maxsize, number):
    """Numbers of asm/unistd.h; 2 is MEMBARRIER_CMD_GLOBAL_EXPEDITED. Each call of the fence is one of Linux."""
    calls = machine(name, maxsize)
    assert not memory_order.keeps_order()
    assert memory_order.has_barrier()
    fence = chosen()
    del calls[:]
    fence()
    assert calls == [[(ctypes.c_long, value) for value in (number, 2, 0, 0)]]


@pytest.mark.parametrize(("name", "maxsize", "answer"), [("aarch64", WORDS[0], -1), ("riscv64", WORDS[1], 0)])
def test_machines_without_any(machine, name, maxsize, answer):
    machine(name, maxsize, answer)
    assert not memory_order.has_barrier()
    assert chosen() is memory_order._locked
    memory_order._locked()


def test_each_word_stands_between_two_barriers(machine, monkeypatch):
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
    ("pure", "flags", "abi_of_it", "taken"),
    [("", "", 0, True), ("1", "", 0, False), ("", "", 1, False), ("", "t", 0, False)],
)
def test_an_extension_that_is_older_or_of_another_python_is_not_taken(monkeypatch, pure, flags, abi_of_it, taken):
    """A free-threaded Python (flag t) finds one made by its neighbour by name, and would fail in the middle of it."""
    extension = Mock(ABI=abi.ABI + abi_of_it)
    monkeypatch.setenv("SHMGEN_PURE", pure)
    monkeypatch.setattr(sys, "abiflags", flags)
    monkeypatch.setattr(shmgen, "_core", extension, raising=False)
    assert runpy.run_path(engine.__file__)["engine"] is (extension if taken else reference)
