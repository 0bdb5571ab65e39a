"""The mistakes that users typically make: what it is that is wrong, where, and what to do, in each."""

from __future__ import annotations

import shlex
from pathlib import Path

import pytest

from ..support.build import put
from ..support.command import run

FOO, TOML = "msgs/demo_msgs/msg/Foo.msg", "shmgen.toml"
HERE = 'path = ["msgs"]\nmessages = ["demo_msgs/Foo"]\n'
TOPIC = '[[topics]]\ntopic = "/a"\ntype = "demo_msgs/Foo"\ndirection = "to_plc"\n'

DEFINITIONS = [
    # a line of a .msg; column; what is wrong; what to do
    ("float64 x;", 9, "SHM202", "take the `;` away"),
    ("float64 x // speed", 11, "SHM006", "a comment begins with `#`"),
    ("// speed of the belt", 1, "SHM003", "a comment begins with `#`"),
    ("double x", 1, "SHM004", "did you mean `float64`?"),
    ("int32_t x", 1, "SHM004", "did you mean `int32`?"),
    ("LREAL x", 1, "SHM004", "did you mean `float64`?"),
    ("flaot64 x", 1, "SHM004", "did you mean `float64`?"),
    ("Float64 x", 1, "SHM004", "did you mean `float64` or `std_msgs/Float64`?"),
    ("std::string name", 1, "SHM003", "a type of another package is `package/Name`"),
    ("geometry_msgs::msg::Point p", 1, "SHM003", "a type of another package is `package/Name`"),
    ("Point p", 1, "SHM004", "did you mean `geometry_msgs/Point`?"),
    ("geometry_msgs/Poes p", 1, "SHM004", "did you mean `geometry_msgs/Pose`?"),
    ("x : LREAL;", 3, "SHM202", "the type comes first: `float64 x`"),
    ("x float64", 1, "SHM004", "the type comes first: `float64 x`"),
    ("float64", 1, "SHM003", "a field is a type and a name"),
    ("float64 max speed", 13, "SHM006", "a name is one word"),
    ("float64 maxSpeed", 9, "SHM202", "small letters, digits and single underscores"),
    ("float64 x, y", 9, "SHM202", "one field a line"),
    ("float64 x = 1.0", 9, "SHM202", "a default is written without `=`"),
    ("uint8 MODE 1", 7, "SHM202", "a constant is written with `=`"),
    ("const uint8 A=1", 13, "SHM006", "a declaration is a type and a name, nothing before"),
    ("enum Mode { A, B }", 6, "SHM202", "an enumeration is constants"),
    ("float64 data[3]", 9, "SHM202", "the brackets belong to the type"),
    ("float64[] data", 1, "SHM101", "write `float64[<=N] data`"),
    ("float64[<5] data", 9, "SHM102", "a bound is `string<=N`, of a sequence `T[<=N]`"),
    ("sequence<double> data", 1, "SHM003", "a sequence is `T[]`"),
]
CONFIGURATIONS = [
    # shmgen.toml; line and column; what is wrong; what to do
    ('path = ["gone"]\nmessages = ["demo_msgs"]\n', "1:10", "SHM001", "correct `path`"),
    ('mesages = ["demo_msgs"]\n', "1:1", "SHM501", "did you mean messages?"),
    ('path = ["msgs"]\nmessages = ["demo_msgs.msg.Foo"]\n', "2:14", "SHM004", "did you mean `demo_msgs/msg/Foo`?"),
    ("source = jazzy\n", "1:10", "SHM503", 'a word stands in quotes: source = "jazzy"'),
    ("messages:\n  - demo_msgs\n", "1:9", "SHM503", "a key is followed by `=`"),
    ('messages = ["demo_msgs" "std_msgs"]\n', "1:25", "SHM503", "a comma stands between"),
    ('path = ["C:\\msgs"]\n', "1:14", "SHM503", "write `/` in paths"),
    (HERE + 'path = ["msgs"]\n', "3:", "SHM503", "this key is there twice"),
    (HERE + 'targets = ["pyhton"]\n', "3:1", "SHM502", "did you mean python?"),
    (HERE + "[bounds]\ndemo_msgs/Foo.x = 4\n", "4:10", "SHM503", "a key with a slash stands in quotes"),
    ('[bounds]\nmessages = ["demo_msgs"]\n', "2:1", "SHM502", "put it above [bounds]"),
    (HERE + TOPIC.replace("[[topics]]", "[[topic]]"), "3:3", "SHM501", "did you mean topics?"),
]
COMMANDS = [
    # a command line; what it is told; what to do
    ("genrate demo_msgs", "no command is called 'genrate'", "did you mean `shmgen generate`?"),
    ("topic list", "no command is called 'topic'", "did you mean `shmgen topics`?"),
    ("help", "no command is called 'help'", "did you mean `shmgen --help`?"),
    ("show geometry_msgs::msg::Pose", "SHM004", "did you mean `geometry_msgs/msg/Pose`?"),
    ("show geometry_msgs/msg/Pose.msg", "SHM001", "a message is named by package and name"),
    ("generate msgs/", "SHM004", "a folder of packages is given with -I"),
    ("generate demo_msgs -I msgs/demo_msgs/msg", "SHM004", "give demo_msgs/, the package, not its msg/"),
    ("generate", "SHM504", "name one, `shmgen generate geometry_msgs/Pose`"),
    ("pub /a std_msgs/Float64 '{dta: 1}' --once", "dta: no such field", "did you mean data?"),
]


def test_they_are_47() -> None:
    assert len(DEFINITIONS) + len(CONFIGURATIONS) + len(COMMANDS) == 47


@pytest.mark.parametrize(("line", "column", "what", "do"), DEFINITIONS, ids=[line for line, *_ in DEFINITIONS])
def test_in_a_definition(tmp_path: Path, line: str, column: int, what: str, do: str) -> None:
    put({FOO: f"# A message.\n{line}\n"}, tmp_path)
    said = run(["generate", "demo_msgs", "-I", "msgs", "-q"], tmp_path)
    assert said.code == 1
    assert said.stderr.startswith(f"{FOO}:2:{column}: error[{what}]: "), said.stderr
    assert do in said.stderr.partition("  hint: ")[2], said.stderr


@pytest.mark.parametrize(("text", "place", "what", "do"), CONFIGURATIONS, ids=[do for *_, do in CONFIGURATIONS])
def test_in_the_configuration(tmp_path: Path, text: str, place: str, what: str, do: str) -> None:
    put({FOO: "float64 x\n", TOML: text}, tmp_path)
    said = run(["generate", "-q"], tmp_path)
    assert said.code == 1
    assert said.stderr.startswith(f"{TOML}:{place}"), said.stderr
    assert f"error[{what}]: " in said.stderr.splitlines()[0]
    assert do in said.stderr.partition("  hint: ")[2], said.stderr


@pytest.mark.parametrize(("line", "what", "do"), COMMANDS, ids=[line for line, *_ in COMMANDS])
def test_on_the_command_line(tmp_path: Path, line: str, what: str, do: str) -> None:
    put({FOO: "float64 x\n"}, tmp_path)
    said = run(shlex.split(line), tmp_path)
    assert (said.code in (1, 2), said.stdout) == (True, "")
    assert what in said.stderr
    assert do in said.stderr
