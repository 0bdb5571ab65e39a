"""Test the generated check in C for counts above their bounds."""

from __future__ import annotations

import ctypes
import subprocess
from pathlib import Path
from typing import Any

import pytest

from shmgen.config import Config
from shmgen.core.model import TypeName
from shmgen.generator import pipeline

from ..support.build import module, put
from ..support.counts import DEFINITIONS, MOST, PACKAGE, PLACES, spoil, tree

SOURCE = """
#include "{package}/counts_msgs/msg/tree.h"
#include "{package}/counts_msgs/msg/plain.h"
#ifdef __cplusplus
extern "C"
#endif
int valid(const shm_counts_msgs_Tree *tree)
{{
    static const shm_counts_msgs_Plain plain = {{0}};
    return shmgen_valid_shm_counts_msgs_Tree(tree) && shmgen_valid_shm_counts_msgs_Plain(&plain);
}}
"""


@pytest.fixture(scope="module", params=["gcc -xc -std=c11", "g++ -xc++ -std=c++17"])
def message_and_check(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> tuple[Any, Any]:
    """The Python module of the messages, and the check compiled from C."""
    folder: Path = tmp_path_factory.mktemp("counts")
    for name, text in {**DEFINITIONS, "msg/Plain": "uint32 a\n"}.items():
        put({f"counts_msgs/{name}.{name.partition('/')[0]}": text}, folder)
    config = Config(folder, path=(folder,), package=PACKAGE, targets=("python", "c"))
    put(pipeline.generate(config, ["counts_msgs"]), folder)
    library = folder / "valid.so"
    options = ["-Wall", "-Wextra", "-Wshadow", "-Wconversion", "-Werror", "-pedantic", "-shared", "-fPIC"]
    if "c++" in request.param:
        options.append("-Wno-missing-field-initializers")
    command = [*request.param.split(), *options, f"-I{folder / 'c'}", "-", "-o", str(library)]
    subprocess.run(command, input=SOURCE.format(package=PACKAGE), text=True, check=True)
    return module(folder, PACKAGE, TypeName("counts_msgs", "msg", "Tree")), ctypes.CDLL(str(library)).valid


def test_check_accepts_counts_up_to_the_bounds(message_and_check: tuple[Any, Any]) -> None:
    msg, valid = message_and_check
    message = tree(msg, 1)
    assert valid(ctypes.byref(message)) == 1
    spoil(message, "crown[1].leaves[0].weights", MOST)
    spoil(message, "trunk.leaves[2].weights", MOST)
    message._crown_count, message.trunk._leaves_count = 1, 2
    assert valid(ctypes.byref(message)) == 1
    assert valid(ctypes.byref(msg.Tree())) == 1


@pytest.mark.parametrize(("path", "count"), PLACES)
def test_check_rejects_a_count_above_its_bound(message_and_check: tuple[Any, Any], path: str, count: int) -> None:
    msg, valid = message_and_check
    message = tree(msg, 1)
    spoil(message, path, count)
    assert valid(ctypes.byref(message)) == 0
