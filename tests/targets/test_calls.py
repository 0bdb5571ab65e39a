"""Check the text of the blocks of services and actions: their interface, and that no call keeps a lock."""

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
    """The generated text of each file, by the file's stem."""
    return generate_texts(tmp_path_factory.mktemp("calls"), "bool")


@pytest.fixture(scope="module")
def texts_with_sequences(tmp_path_factory: pytest.TempPathFactory) -> dict[str, str]:
    """The generated texts for messages with sequences, whose blocks have one more output."""
    return generate_texts(tmp_path_factory.mktemp("counted"), "int8[<=2]")


def generate_texts(folder: Path, type_: str) -> dict[str, str]:
    put({"cell_msgs/srv/Start.srv": f"{type_} a\n---\n{type_} b\n"}, folder)
    put({"cell_msgs/action/Move.action": f"{type_} a\n---\n{type_} b\n---\n{type_} c\n"}, folder)
    config = Config(folder, path=(folder,), targets=("st",))
    return {Path(path).stem: text for path, text in pipeline.generate(config, ["cell_msgs"]).items()}


@pytest.mark.slow
@pytest.mark.parametrize("role", ROLES)
def test_page_explains_all_inputs_and_outputs(texts_with_sequences: dict[str, str], role: str) -> None:
    page = (REPOSITORY / "docs" / "structured-text.md").read_text()
    table = page.partition(f"\n| {role} | name | meaning |\n")[2].partition("\n\n")[0]
    (block, *_) = parse(texts_with_sequences[f"FB_cell_msgs_{ROLES[role]}_{role}"])
    sections = interface(block)
    for section, word in (("InputDeclarations", "in"), ("OutputDeclarations", "out")):
        rows = re.findall(rf"^\| {word} \| (.+?) \|", table, re.MULTILINE)
        documented = [name for row in rows for name in re.findall(r"`(\w+)", row)]
        assert sorted(documented) == sorted(sections[section]), f"{role} {word}"
        assert not [type_ for type_ in sections[section].values() if "POINTER" in type_ or "REFERENCE" in type_]


@pytest.mark.parametrize("role", ROLES)
def test_block_releases_locks_in_the_same_call(texts: dict[str, str], role: str) -> None:
    code = re.sub(r"//.*", "", texts[f"FB_cell_msgs_{ROLES[role]}_{role}"])
    begin_calls = re.findall(r"\.Begin(\w+)\(", code)
    assert begin_calls
    assert begin_calls == re.findall(r"\.End(\w+)\(", code)
    assert "RETURN" not in code


def test_typed_blocks_contain_no_logic(texts: dict[str, str]) -> None:
    """Keep all logic in the two common blocks: typed blocks only copy data and forward inputs and outputs."""
    for role, name in ROLES.items():
        code = texts[f"FB_cell_msgs_{name}_{role}"]
        assert "TIME()" not in code
        assert len(code.splitlines()) < 165, role
