"""`shmgen schema`, the table in docs/configuration.md and the parser have the same keys and refuse the same values."""

from __future__ import annotations

import json
import re
import subprocess
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from shmgen.config import keys, load
from shmgen.config.keys import KEYS, MAX_NUMBER, Key
from shmgen.config.schema import schema
from shmgen.core import toml
from shmgen.core.diagnostics import Rejected, Report

from ..conftest import REPOSITORY
from ..support import import_or_skip
from ..support.command import run

PAGE = REPOSITORY / "docs/configuration.md"
PLACE = re.compile(r"(?<=<!-- keys -->\n)(.*)(?=<!-- /keys -->)", re.DOTALL)


def table_rows() -> Iterator[str]:
    """Yield the rows of the table of all keys in Markdown."""
    yield from ("| key | type | default | meaning |", "|---|---|---|---|")
    for key in KEYS:
        name = f"`{keys.header(key.section)}` `{key.name}`" if key.section else f"`{key.name}`"
        default = "required" if key.required else "" if key.default is None else f"`{json.dumps(key.default)}`"
        yield f"| {name} | {type_of(key)} | {default} | {key.meaning} |"
        if key.section in keys.FREE_SECTIONS and key == keys.keys_of(key.section)[-1]:
            name = f'`{keys.header(key.section)}` `"package/Message.field"`'
            yield f"| {name} | 1 to {MAX_NUMBER} | | Replaces the key `default` for one field, message or package. |"


def type_of(key: Key) -> str:
    if key.choices:
        words = ", ".join(f"`{choice}`" for choice in key.choices)
        return f"list of {words}" if key.kind == "strings" else words
    if key.kind in ("integer", "number"):
        return f"{key.least:.10g} to {key.most:.10g}{f' {key.unit}' if key.unit else ''}"
    return {"strings": "list of strings", "boolean": "`true`, `false`"}.get(key.kind, key.kind)


def test_configuration_page_contains_the_table(request: pytest.FixtureRequest) -> None:
    page = PAGE.read_text(encoding="utf-8")
    expected = PLACE.sub(lambda _: "\n".join(["", *table_rows(), "", ""]), page)
    if request.config.getoption("--update-golden"):
        PAGE.write_text(expected, encoding="utf-8")
    assert PAGE.read_text(encoding="utf-8") == expected, "pytest --update-golden tests/config/test_schema.py"


def is_valid(document: Any) -> bool:
    jsonschema = import_or_skip("jsonschema")
    return bool(jsonschema.Draft7Validator(schema()).is_valid(document))


def is_accepted(folder: Path, text: str) -> bool:
    (folder / "shmgen.toml").write_text(text, encoding="utf-8")
    try:
        load(folder / "shmgen.toml", "shmgen.toml", Report())
    except Rejected:
        return False
    return True


def test_command_prints_a_valid_schema() -> None:
    jsonschema = import_or_skip("jsonschema")
    printed = json.loads(run(["schema"], REPOSITORY).stdout)
    jsonschema.Draft7Validator.check_schema(printed)
    assert printed == json.loads(json.dumps(schema()))


def make_example(key: Key) -> str:
    """Return a value that the key accepts, in TOML."""
    by_pattern = {"mode": "0660", "group": "plc", "topic": "/a", "service": "/a", "action": "/a", "type": "p_msgs/A"}
    if key.kind == "string":
        return json.dumps(key.default or by_pattern.get(key.name, ""))
    value = {"choice": key.choices[-1:], "strings": [list(key.choices)], "boolean": [True]}.get(key.kind, [key.most])
    return json.dumps(next(iter(value)))


def make_document(key: Key, value: str) -> str:
    rest = [other for other in keys.keys_of(key.section) if other.required and other is not key]
    if key.section == "topics" and key.name == "stamp":
        rest += [other for other in KEYS if other[:2] == ("topics", "direction")]
    lines = [f"{other.name} = {make_example(other)}" for other in rest]
    return "\n".join([keys.header(key.section) if key.section else "", *lines, f"{key.name} = {value}", ""])


@pytest.mark.parametrize("key", KEYS, ids=lambda key: f"{key.section}.{key.name}")
def test_schema_and_parser_accept_the_same_keys(key: Key, tmp_path: Path) -> None:
    text = make_document(key, make_example(key))
    assert is_accepted(tmp_path, text)
    assert is_valid(toml.loads(text))
    for wrong in ('"no such thing"', "-1", "[1]", "{}"):
        if key.kind == "string" and wrong.startswith('"') and key.name != "mode":
            continue
        text = make_document(key, wrong)
        assert not is_accepted(tmp_path, text), text
        assert not is_valid(toml.loads(text)), text


@pytest.mark.parametrize(
    "text",
    [
        'mesages = ["a"]',
        "[bounds]\n'a/B.c' = 0",
        "[bounds]\n'a/B.c.d' = 3",
        "[[topics]]\ntopic = '/a'",
        "[[topics]]\ntopic = '/a'\ntype = 'a/B'\nqueue = 3",
        "[topics]\ntopic = '/a'\ntype = 'a/B'",
        "package = 'class'",
        "package = 'shmgen'",
        "ros_package = 'A'",
        "distribution = 'robot'",
        "targets = []",
        "[bridge]\ndomain = 233",
        "[regions]\nmode = '0640'\n",
        "max_region = true",
    ],
)
def test_schema_and_parser_refuse_invalid_files(text: str, tmp_path: Path) -> None:
    assert not is_accepted(tmp_path, text)
    assert not is_valid(toml.loads(text))


def test_files_of_the_repository_are_valid() -> None:
    result = subprocess.run(["git", "ls-files", "*shmgen.toml"], cwd=REPOSITORY, capture_output=True, text=True)
    if result.returncode:
        pytest.skip("not a checkout of git")
    files = [name for name in result.stdout.split() if not name.startswith("tests/errors/")]
    assert len(files) > 10
    assert [name for name in files if not is_valid(toml.loads((REPOSITORY / name).read_text("utf-8")))] == []


def test_empty_file_is_the_default_configuration(tmp_path: Path) -> None:
    from shmgen.config import Config

    (tmp_path / "shmgen.toml").write_text("")
    assert load(tmp_path / "shmgen.toml", "shmgen.toml", Report()) == Config(tmp_path)
