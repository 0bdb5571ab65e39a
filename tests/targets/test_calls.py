"""The blocks of services and actions as text: their interface, and that nothing leaves them with a lock held."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from shmgen.config import Config
from shmgen.generator import pipeline

from ..conftest import REPOSITORY
from ..support.build import put
from .test_st import interface, parse

ROLES = {"Client": "Start", "Server": "Start", "ActionClient": "Move", "ActionServer": "Move"}


@pytest.fixture(scope="module")
def texts(tmp_path_factory: pytest.TempPathFactory) -> dict[str, str]:
    """Each by its stem."""
    return generated(tmp_path_factory.mktemp("calls"), "bool")


@pytest.fixture(scope="module")
def counted(tmp_path_factory: pytest.TempPathFactory) -> dict[str, str]:
    """With sequences, for which the blocks have one output more."""
    return generated(tmp_path_factory.mktemp("counted"), "int8[<=2]")


def generated(folder: Path, type_: str) -> dict[str, str]:
    put({"cell_msgs/srv/Start.srv": f"{type_} a\n---\n{type_} b\n"}, folder)
    put({"cell_msgs/action/Move.action": f"{type_} a\n---\n{type_} b\n---\n{type_} c\n"}, folder)
    config = Config(folder, path=(folder,), targets=("st",))
    return {Path(path).stem: text for path, text in pipeline.generate(config, ["cell_msgs"]).items()}


@pytest.mark.slow
@pytest.mark.parametrize("role", ROLES)
def test_every_input_and_output_is_explained(counted: dict[str, str], role: str) -> None:
    page = (REPOSITORY / "docs" / "structured-text.md").read_text()
    table = page.partition(f"\n| {role} | name | meaning |\n")[2].partition("\n\n")[0]
    (block, *_) = parse(counted[f"FB_cell_msgs_{ROLES[role]}_{role}"])
    sides = interface(block)
    for section, word in (("InputDeclarations", "in"), ("OutputDeclarations", "out")):
        rows = re.findall(rf"^\| {word} \| (.+?) \|", table, re.MULTILINE)
        named = [name for row in rows for name in re.findall(r"`(\w+)", row)]
        assert sorted(named) == sorted(sides[section]), f"{role} {word}"
        assert not [type_ for type_ in sides[section].values() if "POINTER" in type_ or "REFERENCE" in type_]


@pytest.mark.parametrize("role", ROLES)
def test_what_begins_ends_in_the_same_call(texts: dict[str, str], role: str) -> None:
    code = re.sub(r"//.*", "", texts[f"FB_cell_msgs_{ROLES[role]}_{role}"])
    begun = re.findall(r"\.Begin(\w+)\(", code)
    assert begun
    assert begun == re.findall(r"\.End(\w+)\(", code)
    assert "RETURN" not in code


def test_typed_blocks_are_thin(texts: dict[str, str]) -> None:
    """What decides stands in the two common blocks: the typed ones copy, and hand inputs and outputs on."""
    for role, name in ROLES.items():
        code = texts[f"FB_cell_msgs_{name}_{role}"]
        assert "TIME()" not in code
        assert len(code.splitlines()) < 165, role
