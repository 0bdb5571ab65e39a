"""The rosidl_parser of the wheels, in environments of their own, reads .idl as Debian's does; nothing else loads it."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from ..conftest import REPOSITORY
from ..support.build import put
from .test_idl import needs_rosidl

FOLDERS = {
    "msgs/a_msgs/msg/Foo.idl": """
#include "a_msgs/msg/Point.idl"
module a_msgs { module msg {
  typedef a_msgs::msg::Point a_msgs__msg__Point__3[3];
  module Foo_Constants { const uint8 A = 1; const string NAME = "x\\"y"; const double PI = 3.14; };
  @verbatim (language="comment", text="What it is." "\\n" "And more.")
  struct Foo {
    @unit (value="m") @default (value=2.5) double d;
    boolean b; octet o; char c; wchar w; int8 i; short s; unsigned long long u; float f;
    string<5> text; wstring<5> wide; sequence<wstring<5>> wides; sequence<string<5>, 2> texts;
    sequence<double, 12> many;
    @default (value="(1, 2)") sequence<long, 3> numbers;
    a_msgs__msg__Point__3 points; sequence<a_msgs::msg::Point, 2> more; builtin_interfaces::msg::Time at;
  };
}; };
""",
    "msgs/a_msgs/msg/Point.idl": "module a_msgs { module msg { struct Point { double x, y[2]; }; }; };\n",
    "msgs/a_msgs/msg/Plain.msg": "float64 x\n",
    "shmgen.toml": 'path = ["msgs"]\n[bounds]\na_msgs = 2\n[strings]\na_msgs = 9\n',
}


def python_of(environment: str) -> Path:
    python = REPOSITORY / ".venv" / environment / "bin" / "python"
    if not python.exists():
        pytest.skip(f"no .venv/{environment}: `make test-all` makes it where there are wheels of ROS 2")
    return python


def shown(python: Path | str, folder: Path, message: str, before: str = "", behind: str = "") -> str:
    """What `shmgen show --json` says there, and what code around it prints."""
    program = f"import sys\n{before}\nfrom shmgen.__main__ import main\ntry: main()\nexcept SystemExit: pass\n{behind}"
    command = [python, "-c", program, "show", "--json", message]
    environment = {name: value for name, value in os.environ.items() if not name.startswith(("PYTHON", "AMENT"))}
    environment["PYTHONPATH"] = str(REPOSITORY / "src")
    done = subprocess.run(command, cwd=folder, env=environment, capture_output=True, text=True, check=False)
    assert not done.stderr
    return done.stdout


@needs_rosidl
@pytest.mark.parametrize(("environment", "lark"), [("idl", "1"), ("ros2-jazzy", "0"), ("ros2-kilted", "0")])
def test_every_parser_reads_the_same(environment: str, lark: str, tmp_path: Path) -> None:
    """With blark beside it, whose lark has the last word when all are installed at once."""
    python = python_of(environment)
    put(FOLDERS, tmp_path)
    code = "import lark, rosidl_parser as it; print(it.__file__, lark.__version__)"
    *text, said = shown(python, tmp_path, "a_msgs/Foo", behind=code).splitlines()
    assert text == shown(sys.executable, tmp_path, "a_msgs/Foo").splitlines()
    assert len(text) > 100
    file, version = said.split()
    assert Path(file).is_relative_to(python.parent.parent)
    assert version.partition(".")[0] == lark
    if environment == "idl":
        program = "import blark; print(blark.parse_source_code('PROGRAM p\\nEND_PROGRAM').exception)"
        assert subprocess.run([python, "-c", program], capture_output=True, text=True, check=False).stdout == "None\n"


def test_a_msg_loads_no_parser_of_idl(tmp_path: Path) -> None:
    put(FOLDERS, tmp_path)
    code = "print({name.partition('.')[0] for name in sys.modules} & {'lark', 'rosidl_parser', 'rosidl_adapter'})"
    assert shown(sys.executable, tmp_path, "a_msgs/Plain", behind=code).splitlines()[-1] == "set()"


@needs_rosidl
def test_half_a_wheel_is_not_taken_for_a_parser(tmp_path: Path) -> None:
    """Where `pip install` of Debian's Python puts one part of it where that looks, and the other where it does not."""
    put({**FOLDERS, "half/rosidl_parser/_dummy.so": ""}, tmp_path)
    assert '"a_msgs/msg/Foo"' in shown(sys.executable, tmp_path, "a_msgs/Foo", before="sys.path.insert(0, 'half')")
