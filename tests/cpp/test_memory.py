"""After opening, C and C++ endpoints allocate no memory and print nothing, and they have no global variables."""

from __future__ import annotations

import re
import shutil
import subprocess
from pathlib import Path

import pytest

from ..support import cpp_peer

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(shutil.which("g++") is None or shutil.which("nm") is None, reason="no g++ and binutils"),
]

ALLOWED_CALLS = {
    "copying": "memcpy memset memcmp memchr strlen strcmp strchr strncmp strcasecmp strcpy strncpy strcat",
    "compiling": "__stack_chk_fail _GLOBAL_OFFSET_TABLE_",
    "regions": "shm_open shm_unlink mmap munmap ftruncate posix_fallocate fstat fcntl pread pwrite close",
    "access": "fchmod fchown getegid geteuid getgrgid_r getgrnam_r getgroups getpwuid_r madvise",
    "locks": "sem_open sem_close sem_unlink sem_trywait sem_clockwait sem_getvalue sem_post sem_init",
    "times": "clock_gettime nanosleep sched_yield",
    "processes": "getpid kill __errno_location syscall",
}
"""All external functions that the C headers call: none of them prints, or allocates memory that stays allocated."""

CYCLE = """
#include "shm_plc_demo/demo_msgs/msg/demo.hpp"
#include <cstdio>
#include <cstdlib>
#include <new>

static unsigned long taken;
void *operator new(std::size_t size)
{
    ++taken;
    if (void *room = std::malloc(size))
        return room;
    throw std::bad_alloc();
}
void operator delete(void *room) noexcept { std::free(room); }
void operator delete(void *room, std::size_t) noexcept { std::free(room); }

using namespace std::chrono_literals;
using namespace shm_plc_demo::demo_msgs::msg;

int main(int, char **words)
{
    DemoPublisher publisher(words[1]);
    DemoSubscriber subscriber(words[1]), idle(words[1]);
    const unsigned long opening = taken;
    (void)subscriber.ready(1ms);
    Demo message, read;
    unsigned wrong = 0;
    const unsigned long before = taken;
    for (std::uint32_t a = 1; a <= 300; ++a) {
        message.a = a;
        message.label = "label";
        message.tail = {1, 2};
        wrong += (a % 2 ? publisher.publish(message) : publisher.try_publish(message)) != SHMGEN_OK;
        message.label = std::string_view("much too long for it");
        wrong += publisher.publish(message) == SHMGEN_OK || publisher.rejected() != "label";
        switch (a % 5) {
        case 0: wrong += subscriber.read_into(read) != SHMGEN_OK || read.a != a; break;
        case 1: wrong += !subscriber.read() || subscriber.sequence() != a; break;
        case 2: wrong += !subscriber.try_read(); break;
        case 3: wrong += !subscriber.wait(1ms) || subscriber.read().has_value(); break;
        default: wrong += subscriber.read_all([](const Demo &) {}) != 1;
        }
        wrong += subscriber.is_stale(10s) || subscriber.missed() != 0;
    }
    std::printf("%d %lu %lu %u\\n", opening != 0, before - opening, taken - before, wrong);
}
"""


def test_c_headers_call_no_function_that_allocates_or_prints(generated: Path, tmp_path: Path) -> None:
    # shmgen_block.h allocates a function block's endpoints at the first call. shmgen_notifier.h starts a thread.
    excluded = ("shmgen_block", "shmgen_notifier")
    headers = sorted(path for path in (generated / "c").rglob("*.h") if not path.name.startswith(excluded))
    source = "".join(f'#include "{path}"\n' for path in headers)
    object_file = tmp_path / "all.o"
    command = [
        "gcc",
        "-xc",
        "-std=gnu11",
        "-O1",
        "-fkeep-inline-functions",
        f"-I{generated / 'c'}",
        "-c",
        "-o",
        object_file,
        "-",
    ]
    subprocess.run(command, input=source, text=True, check=True)
    lines = subprocess.run(["nm", object_file], capture_output=True, text=True, check=True).stdout.splitlines()
    symbols = [(words[-2], words[-1]) for words in map(str.split, lines)]
    assert ("t", "shmgen_publisher_complete") in symbols
    called = {re.sub(r"^__(\w+)_chk$", r"\1", name) for kind, name in symbols if kind == "U"}  # undo gcc's hardening
    assert called <= {name for names in ALLOWED_CALLS.values() for name in names.split()}
    assert not [name for kind, name in symbols if kind in "BbDdCGgSs"]


def test_cpp_calls_allocate_no_memory_after_opening(generated: Path, tmp_path: Path, topic: str) -> None:
    source = tmp_path / "cycle.cpp"
    source.write_text(CYCLE)
    program = cpp_peer.compiled(generated, "cycle", source)
    process = subprocess.run([program, topic], capture_output=True, text=True, check=True)
    assert process.stdout.split()[1:] == ["0", "0", "0"]
