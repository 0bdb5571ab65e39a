"""A copy of the project with one more header field, and endpoints that use the field in all languages."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from collections.abc import Callable, Sequence
from pathlib import Path

from ..softplc import compile_st
from . import REPOSITORY
from .plc_demo import ready

WORD = '    HeaderField(180, "u32", "refused", "udiRefused", "readers", "samples they refused"),\n'
DOCS = "from tests.support.region_page import tables; print(*next(tables()), sep='\\n')"
COMPILE = "import hatch_build as it; print(it.build_extension(it.SOURCES / '_core.abi3.so'))"
PYTHON = """
import sys
sys.path.append("generated/python")
from shm_msgs.std_msgs.msg import UInt32, UInt32Publisher, UInt32Subscriber
from shmgen.runtime import engine, read_header, region_name
from shmgen.runtime.region import header
from tests.support.region_of import region_of
in_c, own, *topics = sys.argv[1:]
assert engine.IN_C == bool(in_c)
if own:
    with UInt32Publisher(own) as publisher:
        publisher.publish(UInt32(data=7))
for topic in topics:
    with UInt32Subscriber(topic) as subscriber:
        assert subscriber.read().data == 7, topic
        region_of(subscriber).words[header.REFUSED] += 1
    print(read_header(region_name(topic)).refused)
"""
C = r"""
#include "shm_msgs/std_msgs/msg/u_int32_shm.h"
#include <stdio.h>
int main(int many, char **topics)
{
    shm_std_msgs_UInt32 message = {.data = 7};
    shm_std_msgs_UInt32_publisher publisher;
    shm_std_msgs_UInt32_subscriber subscriber;
    shmgen_status status = SHMGEN_OK;
    if (topics[1][0] != 0) {
        if ((status = shm_std_msgs_UInt32_publisher_open(&publisher, topics[1], NULL)) == SHMGEN_OK)
            status = shm_std_msgs_UInt32_publisher_publish(&publisher, &message);
        shm_std_msgs_UInt32_publisher_close(&publisher);
    }
    for (int at = 2; at < many && status == SHMGEN_OK; at++) {
        message.data = 0;
        if ((status = shm_std_msgs_UInt32_subscriber_open(&subscriber, topics[at], NULL)) == SHMGEN_OK)
            status = shm_std_msgs_UInt32_subscriber_read(&subscriber, &message);
        if (status == SHMGEN_OK && message.data == 7)
            printf("%u\n", ++((shmgen_region *)(void *)subscriber.end.end.base)->refused);
        shm_std_msgs_UInt32_subscriber_close(&subscriber);
    }
    return status != SHMGEN_OK;
}
"""
ST = """FUNCTION_BLOCK FB_Refuse
VAR_INPUT
    pHeader : POINTER TO ST_ShmHeader;
END_VAR
VAR_OUTPUT
    udiRefused : UDINT;
END_VAR
pHeader^.udiRefused := pHeader^.udiRefused + 1;
udiRefused := pHeader^.udiRefused;
END_FUNCTION_BLOCK
"""

End = Callable[[str, Sequence[str]], list[int]]
"""Publishes 7 on the first topic if there is one, then reads each of the others, counts its sample as refused and
gives what the counter says then."""


def copy(folder: Path) -> None:
    """Copy the project, add the header field, and generate all files for one message."""
    for name in ("src", "templates"):
        shutil.copytree(REPOSITORY / name, folder / name, ignore=shutil.ignore_patterns("__pycache__", "*.so"))
    shutil.copy(REPOSITORY / "hatch_build.py", folder)
    table = folder / "src" / "shmgen" / "core" / "abi.py"
    head, last, rest = table.read_text().partition('    HeaderField(176, "u32", "bell"')
    line, end, rest = rest.partition("\n")
    table.write_text(head + last + line + end + WORD + rest)
    python(folder, "-m", "shmgen", "generate", "--quiet", "std_msgs/UInt32")


def python(folder: Path, *arguments: str, pure: bool = True) -> str:
    """Run Python with only this copy of shmgen and return the output."""
    environment = {**os.environ, "PYTHONPATH": f"{folder / 'src'}:{folder}:{REPOSITORY}"}
    environment["SHMGEN_PURE"] = "1" if pure else ""
    return ran([sys.executable, *arguments], cwd=folder, env=environment)


def ran(command: Sequence[str | Path], **options: object) -> str:
    done = subprocess.run(command, capture_output=True, text=True, check=False, **options)  # type: ignore[call-overload]
    assert done.returncode == 0, done.stderr[-4000:]
    return str(done.stdout)


def in_python(folder: Path, pure: bool) -> End:
    if not pure:
        assert python(folder, "-c", COMPILE, pure=False) == "\n"
    in_c = "" if pure else "C"
    return lambda own, topics: numbers(python(folder, "-c", PYTHON, in_c, own, *topics, pure=pure))


def in_c(folder: Path) -> End:
    (folder / "end.c").write_text(C)
    strict = ("-std=c11", "-Wall", "-Wextra", "-Werror", f"-I{folder / 'generated' / 'c'}")
    ran(["gcc", *strict, folder / "end.c", "-o", folder / "end", "-lrt", "-lpthread"])
    return lambda own, topics: numbers(ran([folder / "end", own, *topics]))


def in_st(folder: Path) -> End:
    texts = {str(path): path.read_text() for path in (folder / "generated" / "st").rglob("*.st")}
    plc = compile_st({**texts, "FB_Refuse.st": ST})
    plc.set_clock(0)

    def end(own: str, topics: Sequence[str]) -> list[int]:
        if own:
            publisher = plc.block("FB_std_msgs_UInt32_Publisher")
            publisher.xEnable, publisher.sTopic, publisher.Msg.data = True, own, 7
            assert ready(publisher).xSent
        counted = []
        for topic in topics:
            subscriber = plc.block("FB_std_msgs_UInt32_Subscriber")(xEnable=True, sTopic=topic)
            assert (subscriber().xValid, subscriber.Msg.data) == (True, 7), topic
            counted.append(plc.block("FB_Refuse")(pHeader=subscriber._fbRegion._pHeader).udiRefused)
        return counted

    return end


def numbers(text: str) -> list[int]:
    return [int(line) for line in text.split()]
