"""Check that hostile definitions result in the code of harmless definitions, in all targets."""

from __future__ import annotations

import ast
import functools
import importlib
import re
import subprocess
import sys
import tempfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import pytest
from hypothesis import HealthCheck, Phase, example, given, settings
from hypothesis import strategies as st

from shmgen.config import Config
from shmgen.config.entries import Bounds
from shmgen.core.diagnostics import Rejected
from shmgen.generator import pipeline
from tests.support.build import forget, put
from tests.support.languages import st_tokens, xml_tokens

from .contract import PIECES

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

pieces = st.sampled_from(PIECES)
letters = st.characters(exclude_categories=["Cc", "Cs"])
hostile_texts = st.lists(pieces | pieces | st.text(letters, max_size=4), min_size=1, max_size=6).flatmap(
    lambda parts: st.sampled_from(["".join(parts), " ".join(parts)])
)
units = st.lists(pieces, min_size=1, max_size=2).map(lambda parts: "m" + "".join(parts))
folders = hostile_texts.map(lambda text: text.replace("/", "|")[:60])

# Shrinking would run a compiler thousands of times.
fast_settings = settings(suppress_health_check=list(HealthCheck), phases=[Phase.explicit, Phase.reuse, Phase.generate])
TARGETS = ("python", "st", "plcopen", "c")


def definition(comment: str = "c", other: str = "o", unit: str = "u", text: str = "t") -> str:
    quoted = '"' + text.replace("\\", "\\\\").replace('"', '\\"').replace("\n", "\\n").replace("\r", "\\r") + '"'
    return (
        f"# x{comment}\n#{other}\n\n"
        f"string NAME={quoted}\nwstring WIDE={quoted}\nuint8 MODE=1  # {comment}\n# {other}\n\n"
        f"float32 speed 1.5  # x{comment}\n                   # {other}\n# {other}\nstring text {quoted}\n"
        f"int8[2] pair [1, 2]  # [{unit}] {other}\nstring[1] texts [{quoted}]  # {unit}[{unit}]\n"
        f"uint8 last  # {comment}\\\n"
    )


def generate(text: str, within: str = "plain") -> dict[str, str]:
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name, within)
        (folder / "demo_msgs" / "msg").mkdir(parents=True)
        (folder / "demo_msgs" / "msg" / "Foo.msg").write_text(text, encoding="utf-8")
        config = Config(Path(name), path=(folder,), bounds=Bounds({}, {}, 500), targets=TARGETS)
        return pipeline.generate(config, ["demo_msgs/Foo"])


@functools.cache
def harmless_code() -> dict[str, Any]:
    return code_by_path(generate(definition()))


@given(hostile_texts, hostile_texts, units, folders)
@example("c", "o", 'm"""+exit(1)+"""', "f")
@example("c\\", "*\\", "m*/", '"""*)')
@example("*??/", "??/", "m*??/", "??/")
@settings(fast_settings, max_examples=60)
@pytest.mark.slow
def test_comments_units_and_folders_do_not_change_code(comment: str, other: str, unit: str, within: str) -> None:
    codes = code_by_path(generate(definition(comment, other, unit), within))
    assert codes.keys() == harmless_code().keys()
    for path, expected in harmless_code().items():
        assert codes[path] == expected, path


@pytest.mark.slow
@given(st.lists(pieces | st.text(letters, max_size=4) | st.sampled_from("\n\r\t"), max_size=6).map("".join))
@settings(fast_settings, max_examples=40)
def test_strings_keep_their_values(text: str) -> None:
    """Keep constants and defaults as equal values in Python, and as literals of IEC 61131-3 in Structured Text."""
    texts = generate(definition(text=text))
    code_by_path(texts)
    message_class = python_class(texts)
    assert (text, text) == (message_class.NAME, message_class.WIDE)
    message = message_class()
    assert (message.text, list(message.texts)) == (text, [text])
    st_texts = [token for path in texts if path.startswith("st/demo_msgs/") for token in st_tokens(texts[path])]
    assert st_literal(text.encode(), "'", 2) in st_texts
    assert st_wide_literal(text) in st_texts


def st_literal(data: bytes, quote: str, digits: int) -> str:
    """Return a literal with hexadecimal escapes of all unprintable bytes (IEC 61131-3, tables 5 and 6)."""
    plain = [chr(byte) if 0x20 <= byte < 0x7F and chr(byte) not in f"${quote}" else None for byte in data]
    escaped = [f"${byte:0{digits}X}" if byte < 0x20 or byte > 0x7E else f"${chr(byte)}" for byte in data]
    return quote + "".join(char or escape for char, escape in zip(plain, escaped, strict=True)) + quote


def st_wide_literal(text: str) -> str:
    data = text.encode("utf-16-be")
    units = [int.from_bytes(data[at : at + 2], "big") for at in range(0, len(data), 2)]
    return (
        '"'
        + "".join(
            f"${chr(u16)}" if chr(u16) in '$"' else chr(u16) if 0x20 <= u16 < 0x7F else f"${u16:04X}" for u16 in units
        )
        + '"'
    )


def python_class(texts: Mapping[str, str]) -> Any:
    with tempfile.TemporaryDirectory() as folder:
        put({path: text for path, text in texts.items() if path.startswith("python/")}, Path(folder))
        sys.path.insert(0, f"{folder}/python")
        forget("shm_msgs")  # a package of a former test
        try:
            return importlib.import_module("shm_msgs.demo_msgs.msg").Foo
        finally:
            sys.path.remove(f"{folder}/python")
            forget("shm_msgs")


@pytest.mark.parametrize("name", ["../../etc", "/etc", "a/../../b", "x y", "ｐkg", ""])  # noqa: RUF001
def test_package_name_cannot_be_a_path(name: str, tmp_path: Path) -> None:
    """Ignore an invalid name in package.xml, and use the name of the folder instead."""
    files = {"good_msgs/package.xml": f"<package><name>{name}</name></package>", "good_msgs/msg/Foo.msg": "int8 a\n"}
    put(files, tmp_path)
    texts = pipeline.generate(Config(tmp_path, path=(tmp_path,)), ["good_msgs/Foo"])
    assert_paths_are_plain(texts)
    with pytest.raises(Rejected, match="SHM004"):
        pipeline.generate(Config(tmp_path, path=(tmp_path,)), [f"{name}/Foo"])


@pytest.mark.parametrize("name", ["__import__", "-rf", "x-y", "_"])
def test_package_with_an_invalid_name_is_not_found(name: str, tmp_path: Path) -> None:
    put({"x/package.xml": f"<package><name>{name}</name></package>", "x/msg/Foo.msg": "int8 a\n"}, tmp_path)
    for request in (f"{name}/Foo", "x/Foo"):
        with pytest.raises(Rejected, match="SHM004"):
            pipeline.generate(Config(tmp_path, path=(tmp_path,)), [request])


@pytest.mark.parametrize("source", ["jazzy", "noetic"])
@pytest.mark.parametrize("name", ["__import__", "Ｆoo", "Fоо", "Foo;", "Foo Bar", "$(id)", "-rf", "..", "Foo\n"])  # noqa: RUF001
def test_invalid_message_name_is_rejected(name: str, source: str, tmp_path: Path) -> None:
    put({f"demo_msgs/msg/{name}.msg": "int8 a\n"}, tmp_path)
    with pytest.raises(Rejected, match=r"SHM202|SHM004"):
        pipeline.generate(Config(tmp_path, source=source, path=(tmp_path,)), [f"{tmp_path}/demo_msgs/msg/{name}.msg"])


WORDS = "class None import end_type int str float list bytes len runtime values ctypes struct typing Message"


@pytest.mark.parametrize("name", WORDS.split())
def test_ros1_messages_may_have_reserved_names(name: str, tmp_path: Path) -> None:
    put({f"demo_msgs/msg/{name}.msg": "int8 a\n", "demo_msgs/msg/Foo.msg": f"demo_msgs/{name} b\n"}, tmp_path)
    texts = pipeline.generate(
        Config(tmp_path, source="noetic", path=(tmp_path,)), ["demo_msgs/Foo", f"demo_msgs/{name}"]
    )
    assert_paths_are_plain(texts)
    assert python_class(texts)().b.a == 0
    preprocessed(texts)


@pytest.mark.parametrize("name", [name for name in WORDS.split() if name.islower()])
def test_fields_may_have_reserved_names(name: str) -> None:
    fields = "string {0}\nstring other\nint8[2] numbers\nstring[2] texts\nduration d\nfloat32 last 1.5\n"
    texts = generate(fields.format(name))
    message = python_class(texts)(other="o", texts=["a", "b"])
    assert (message.other, list(message.numbers), list(message.texts), message.last) == ("o", [0, 0], ["a", "b"], 1.5)
    preprocessed(texts)


def assert_paths_are_plain(texts: Mapping[str, str]) -> None:
    for path in texts:
        assert re.fullmatch(r"(?:[A-Za-z0-9_]+/)*[A-Za-z0-9_]+(?:\.[a-z]+)+", path), path


# --- code without comments ----------------------------------------------------------------------


def code_by_path(texts: Mapping[str, str]) -> dict[str, Any]:
    """Return the code of each file, by path, without comments. Raise an error if a file is not valid."""
    headers = preprocessed(texts)
    codes: dict[str, Any] = {}
    for path, text in texts.items():
        if path.endswith(".py"):
            codes[path] = ast.dump(without_docstrings(ast.parse(text)))
            assert not re.search("[^\x20-\x7e\n]", re.sub(r'""".*?"""', "", text, flags=re.DOTALL)), path
        elif path.endswith(".st"):
            assert re.fullmatch(r"[\x20-\x7e\n]*", text), path
            codes[path] = st_tokens(text)
        elif path.endswith(".xml"):
            codes[path] = xml_tokens(text)
        elif path.endswith(".h"):
            codes[path] = headers[path]
        elif path.endswith((".c", ".map")):
            codes[path] = text
        elif path.endswith(".lock"):
            lock = tomllib.loads(text)["messages"]["demo_msgs/msg/Foo"]
            codes[path] = {**lock, "text": "", "origin": "", "units": ""}  # strings that contain comments
    assert codes.keys() == texts.keys() - {path for path in texts if path.endswith(("py.typed", ".json"))}
    return codes


def without_docstrings(tree: ast.AST) -> ast.AST:
    for node in ast.walk(tree):
        if isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef) and ast.get_docstring(node) is not None:
            node.body = node.body[1:]
    return tree


def preprocessed(texts: Mapping[str, str]) -> dict[str, str]:
    """Return the output of the C preprocessor, including trigraphs and continued lines; warnings are errors."""
    with tempfile.TemporaryDirectory() as folder:
        put({path: text for path, text in texts.items() if path.endswith(".h")}, Path(folder))
        (header,) = Path(folder).rglob("foo.h")
        command = ["gcc", "-xc", "-std=c11", "-Wall", "-Wextra", "-Werror", "-pedantic", f"-I{folder}/c"]
        for options in (["-fsyntax-only"], ["-E", "-P", "-dD"]):
            result = subprocess.run([*command, *options, str(header)], capture_output=True, text=True, check=False)
            assert result.returncode == 0, result.stderr[:2000]
        name = str(header.relative_to(folder))
        return {path: result.stdout if path == name else "" for path in texts if path.endswith(".h")}
