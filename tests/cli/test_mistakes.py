"""Test the diagnostics of typical mistakes: the problem, the position and the hint."""

from __future__ import annotations

import re
import shlex
from pathlib import Path

import pytest
from hypothesis import given, strategies

from shmgen.core.diagnostics import closest
from shmgen.core.model import OTHER_NAMES

from ..definitions.test_idl import needs_rosidl
from ..support.build import put
from ..support.command import run

FOO, TOML = "msgs/demo_msgs/msg/Foo.msg", "shmgen.toml"
FOO_ONLY = 'path = ["msgs"]\nmessages = ["demo_msgs/Foo"]\n'
TOPIC = '[[topics]]\ntopic = "/a"\ntype = "demo_msgs/Foo"\ndirection = "to_plc"\n'

DEFINITIONS = [
    # a line of a .msg; column; code; hint
    ("float64 x;", 9, "SHM202", "remove the `;`"),
    ("float64 x // speed", 11, "SHM006", "begin a comment with `#`"),
    ("// speed of the belt", 1, "SHM003", "begin a comment with `#`"),
    ("double x", 1, "SHM004", "did you mean `float64`?"),
    ("int32_t x", 1, "SHM004", "did you mean `int32`?"),
    ("LREAL x", 1, "SHM004", "did you mean `float64`?"),
    ("int x", 1, "SHM004", "did you mean `int32`?"),
    ("REAL x", 1, "SHM004", "did you mean `float32`?"),
    ("DINT x", 1, "SHM004", "did you mean `int32`?"),
    ("str x", 1, "SHM004", "did you mean `string`?"),
    ("long x", 1, "SHM004", "did you mean `int64`?"),
    ("TIME x", 1, "SHM004", "did you mean `builtin_interfaces/Duration`"),
    ("Fo x", 1, "SHM004", "looked in msgs/demo_msgs"),
    ("float64\u00a0x", 1, "SHM003", "U+00A0 looks like a blank"),
    ("float64 x\u00a01.0", 9, "SHM202", "U+00A0 looks like a blank"),
    ("uint16 A=1_000", 10, "SHM006", "write a number without `_`"),
    ("uint16 a 1_000", 10, "SHM006", "write a number without `_`"),
    ("flaot64 x", 1, "SHM004", "did you mean `float64`?"),
    ("Float64 x", 1, "SHM004", "did you mean `float64` or `std_msgs/Float64`?"),
    ("std::string name", 1, "SHM003", "write a type of another package as `package/Name`"),
    ("geometry_msgs::msg::Point p", 1, "SHM003", "write a type of another package as `package/Name`"),
    ("Point p", 1, "SHM004", "did you mean `geometry_msgs/Point`?"),
    ("geometry_msgs/Poes p", 1, "SHM004", "did you mean `geometry_msgs/Pose`?"),
    ("x : LREAL;", 3, "SHM202", "write the type first: `float64 x`"),
    ("x float64", 1, "SHM004", "write the type first: `float64 x`"),
    ("float64", 1, "SHM003", "write a field as a type and a name"),
    ("float64 max speed", 13, "SHM006", "replace the blank in the name"),
    ("float64 maxSpeed", 9, "SHM202", "small letters, digits and single underscores"),
    ("float64 x, y", 9, "SHM202", "write each field on its own line"),
    ("float64 x = 1.0", 9, "SHM202", "write a default without `=`"),
    ("uint8 MODE 1", 7, "SHM202", "write a constant with `=`"),
    ("const uint8 A=1", 13, "SHM006", "remove the word before the type"),
    ("enum Mode { A, B }", 6, "SHM202", "an enumeration as constants"),
    ("float64 data[3]", 9, "SHM202", "write the brackets directly after the type"),
    ("float64[] data", 1, "SHM101", "write `float64[<=N] data`"),
    ("float64[<5] data", 9, "SHM102", "write a bound as `string<=N`, or as `T[<=N]` for a sequence"),
    ("sequence<double> data", 1, "SHM003", "write a sequence as `T[]`"),
]
CONFIGURATIONS = [
    # shmgen.toml; line and column; code; hint
    ('path = ["gone"]\nmessages = ["demo_msgs"]\n', "1:10", "SHM001", "correct `path`"),
    ('mesages = ["demo_msgs"]\n', "1:1", "SHM501", "did you mean messages?"),
    ('path = ["msgs"]\nmessages = ["demo_msgs.msg.Foo"]\n', "2:14", "SHM004", "did you mean `demo_msgs/msg/Foo`?"),
    ("source = jazzy\n", "1:10", "SHM503", 'put the text in quotes: source = "jazzy"'),
    ("[[topics]]\ntopic = /arm/pose\n", "2:9", "SHM503", 'put the text in quotes: topic = "/arm/pose"'),
    ("messages = [geometry_msgs/Pose]\n", "1:13", "SHM503", "put each text in the list in quotes"),
    ("bounds {\n", "1:8", "SHM503", "write `[section]` or `key = value`"),
    ("messages:\n  - demo_msgs\n", "1:9", "SHM503", "write `=` after the key"),
    ('messages = ["demo_msgs" "std_msgs"]\n', "1:25", "SHM503", "put a comma between"),
    ('path = ["C:\\msgs"]\n', "1:14", "SHM503", "write `/` in paths"),
    (FOO_ONLY + 'path = ["msgs"]\n', "3:", "SHM503", "this key is set twice"),
    (FOO_ONLY + 'targets = ["pyhton"]\n', "3:1", "SHM502", "did you mean python?"),
    (FOO_ONLY + "[bounds]\ndemo_msgs/Foo.x = 4\n", "4:10", "SHM503", "put a key with a slash in quotes"),
    ('[bounds]\nmessages = ["demo_msgs"]\n', "2:1", "SHM502", "move this key above [bounds]"),
    (FOO_ONLY + TOPIC.replace("[[topics]]", "[[topic]]"), "3:3", "SHM501", "did you mean topics?"),
]
COMMANDS = [
    # a command line; the error; hint
    ("genrate demo_msgs", "no command is called 'genrate'", "did you mean `shmgen generate`?"),
    ("topic list", "no command is called 'topic'", "did you mean `shmgen topics`?"),
    ("help", "no command is called 'help'", "did you mean `shmgen --help`?"),
    ("show geometry_msgs::msg::Pose", "SHM004", "did you mean `geometry_msgs/msg/Pose`?"),
    ("show geometry_msgs/msg/Pose.msg", "SHM001", "give a message as package and name"),
    ("generate demo_msgs -I msgs -t ST", "'ST' is not one of", "Did you mean st?"),
    ("generate demo_msgs -I msgs -t pyhton", "'pyhton' is not one of", "Did you mean python?"),
    ("check --fail-on braking", "'braking' is not one of", "Did you mean breaking?"),
    ("generate msgs/", "SHM004", "give a folder of packages with -I"),
    (
        "generate demo_msgs -I msgs/demo_msgs/msg",
        "SHM004",
        "give the package's folder demo_msgs/ instead of its folder msg/",
    ),
    ("generate sensor_msgs/JointState", "SHM101", "one bound for all sequences: default = N under [bounds]"),
    ("echo /a --field", "echo [OPTIONS] TOPIC", "Option '--field' requires an argument."),
    ("pub /a geometry_msgs/Pose x=1", "error[SHM704]", "hint: write `{position: ...}`, with a blank after the colon"),
    ("generate", "SHM504", "name one, `shmgen generate geometry_msgs/Pose`"),
    ("pub /a std_msgs/Float64 '{dta: 1}' --once", "dta: error[SHM704]: no such field", "did you mean data?"),
]


IN_IDL = [
    # a member of a struct in an .idl; code; hint
    ("int x;", "SHM004", "did you mean `int32`?"),
    ("float64 x;", "SHM004", "did you mean `double`?"),
    ("LREAL x;", "SHM004", "did you mean `double`?"),
    ("bool x;", "SHM004", "did you mean `boolean`?"),
    ("str x;", "SHM004", "did you mean `string`?"),
    ("duoble x;", "SHM004", "did you mean `double`?"),
    ("Foo x;", "SHM301", "a message cannot contain itself"),
    ("sequence<Foo, 2> x;", "SHM301", "a message cannot contain itself"),
    ("demo_msgs::msg::Foo x;", "SHM301", "a message cannot contain itself"),
    ("Mode x;", "SHM004", "use `uint32`, and constants"),
    ("geometry_msgs::msg::Poes x;", "SHM004", "did you mean `geometry_msgs/Pose`?"),
    ("double x", "SHM003", "put a `;` before this"),
    ("double[3] x;", "SHM003", "write the brackets after the name: `double x[3]`"),
    ("string<=3 x;", "SHM003", "write a bound as `string<N>`"),
    ("map<string, long> x;", "SHM003", "one sequence for the keys"),
    ("double x; # speed", "SHM003", "begin a comment with `//`"),
    ("geometry_msgs/Pose x;", "SHM003", "a type as `package::msg::Name`"),
    ("x : double;", "SHM003", "write the type first: `double x;`"),
    ("};", "SHM003", "add a field"),
]


@needs_rosidl
@pytest.mark.parametrize(("member", "error", "hint"), IN_IDL, ids=[member for member, *_ in IN_IDL])
def test_hint_for_an_idl_uses_idl_syntax(tmp_path: Path, member: str, error: str, hint: str) -> None:
    enum = "enum Mode { ONE, TWO };"
    text = f"module demo_msgs {{ module msg {{ {enum} struct Foo {{\n{member}\n}}; }}; }};\n"
    put({"msgs/demo_msgs/msg/Foo.idl": text}, tmp_path)
    result = run(["show", "demo_msgs/Foo", "-I", "msgs"], tmp_path)
    assert f"error[{error}]: " in result.stderr.splitlines()[0], result.stderr
    assert hint in result.stderr.partition("  hint: ")[2], result.stderr
    assert "remove the `;`" not in result.stderr
    assert "package/Name" not in result.stderr


@needs_rosidl
def test_msg_syntax_in_an_idl_is_reported(tmp_path: Path) -> None:
    put({"msgs/demo_msgs/msg/Foo.idl": "float64 x\n"}, tmp_path)
    result = run(["show", "demo_msgs/Foo", "-I", "msgs"], tmp_path).stderr
    assert "write `module package { module msg {" in result


WORDS = [
    *OTHER_NAMES,
    "A",
    "B",
    "Fo",
    "foo",
    "FOO",
    "Foos",
    "Bar",
    "bar",
    "Pose",
    "Header",
    "float",
    "Float",
    "float46",
]


@pytest.mark.parametrize("word", WORDS)
@pytest.mark.family("[wchar]", "[Pose]", "[float46]", "[uint8_t]")
def test_hint_suggests_neither_the_message_nor_the_input(tmp_path: Path, word: str) -> None:
    put({FOO: f"{word} x\n", "msgs/demo_msgs/msg/Bar.msg": "int8 x\n"}, tmp_path)
    for name in ("Foo", "F", "A"):
        put({f"msgs/demo_msgs/msg/{name}.msg": f"{word} x\n"}, tmp_path)
        for command in (["show", f"demo_msgs/{name}"], ["show", word], ["show", f"demo_msgs/{word}"]):
            result = run([*command, "-I", "msgs"], tmp_path).stderr
            suggestions = re.findall(r"`([\w/]+)`", "".join(re.findall("did you mean (.*)", result)))
            inputs = {command[1]} if result.startswith(command[1]) else {word, f"demo_msgs/{word}"}
            assert not inputs & {*suggestions}, result
            assert f"field: demo_msgs/{name}.x" not in result or f"demo_msgs/{name}" not in suggestions, result


@given(strategies.sampled_from(WORDS), strategies.lists(strategies.sampled_from(WORDS)))
def test_closest_name_differs_from_the_word(word: str, known: list[str]) -> None:
    assert closest(word, known, 0) != word


@pytest.mark.parametrize(("line", "column", "error", "hint"), DEFINITIONS, ids=[line for line, *_ in DEFINITIONS])
def test_mistake_in_a_definition(tmp_path: Path, line: str, column: int, error: str, hint: str) -> None:
    put({FOO: f"# A message.\n{line}\n"}, tmp_path)
    result = run(["generate", "demo_msgs", "-I", "msgs", "-q"], tmp_path)
    assert result.code == 1
    assert result.stderr.startswith(f"{FOO}:2:{column}: error[{error}]: "), result.stderr
    assert hint in result.stderr.partition("  hint: ")[2], result.stderr


@pytest.mark.parametrize(("text", "place", "error", "hint"), CONFIGURATIONS, ids=[hint for *_, hint in CONFIGURATIONS])
def test_mistake_in_the_configuration(tmp_path: Path, text: str, place: str, error: str, hint: str) -> None:
    put({FOO: "float64 x\n", TOML: text}, tmp_path)
    result = run(["generate", "-q"], tmp_path)
    assert result.code == 1
    assert result.stderr.startswith(f"{TOML}:{place}"), result.stderr
    assert f"error[{error}]: " in result.stderr.splitlines()[0]
    assert hint in result.stderr.partition("  hint: ")[2], result.stderr


@pytest.mark.parametrize(("line", "error", "hint"), COMMANDS, ids=[line for line, *_ in COMMANDS])
def test_mistake_on_the_command_line(tmp_path: Path, line: str, error: str, hint: str) -> None:
    put({FOO: "float64 x\n"}, tmp_path)
    result = run(shlex.split(line), tmp_path)
    assert (result.code in (1, 2), result.stdout) == (True, "")
    assert error in result.stderr
    assert hint in result.stderr
