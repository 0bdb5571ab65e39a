"""The order in which C endpoints access shared fields: other tests cannot detect a wrong order on x86-64."""

from __future__ import annotations

import os
import subprocess
from pathlib import Path

import pytest

from ..support import cpp_peer
from ..support.cpp_peer import HERE

ORDER = """
publish: lock_count lock_count= lock_holder= writer turn heartbeat= number= |RELEASE copy writer turn number= \
completed0= lock_holder= armed
read: completed0 completed1 number copy |ACQUIRE number
borrow: completed0 completed1 number copy |ACQUIRE number |ACQUIRE number
sleep: writer bell armed= |SEQ_CST completed0 completed1
take over: lock_holder lock_count lock_count= lock_holder= recoveries recoveries=
take over after the holder changed: lock_holder -> the lock was not free in time
"""
"""docs/protocol.md gives the reasons. A lock holder counts before it writes its id. A writer clears the slot's number,
copies, then sets the number and `completed`. A reader checks the number again, after a fence behind its copy."""


@pytest.mark.slow
@pytest.mark.skipif(os.uname().machine != "x86_64", reason="on other CPUs, a read takes the lock")
def test_c_endpoints_access_fields_in_the_documented_order(generated: Path, topic: str) -> None:
    program = cpp_peer.compiled(generated, "order", HERE / "order.c")
    process = subprocess.run([program, topic], capture_output=True, text=True, timeout=60, check=True)
    assert process.stdout == ORDER.lstrip()


@pytest.mark.slow
@pytest.mark.skipif(os.uname().machine != "x86_64", reason="on other CPUs, a read takes the lock")
def test_reader_slower_than_its_writer_still_gets_samples(generated: Path, topic: str) -> None:
    program = cpp_peer.compiled(generated, "slow_reader", HERE / "slow_reader.c")
    process = subprocess.run([program, topic], capture_output=True, text=True, timeout=60, check=False)
    assert (process.returncode, process.stdout) == (0, "done\n")
