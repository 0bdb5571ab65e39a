"""Test that rosidl_parser from wheels reads .idl like Debian's rosidl_parser, and that only .idl files load it."""

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


def python_in(environment: str) -> Path:
    python = REPOSITORY / ".venv" / environment / "bin" / "python"
    if not python.exists():
        pytest.skip(f"no .venv/{environment}: `make test-all` creates it if wheels of ROS 2 are available")
    return python


def show(python: Path | str, folder: Path, message: str, before: str = "", after: str = "") -> str:
    """Return the output of `shmgen show --json` in `folder`, and of the code that runs before and after."""
    program = f"import sys\n{before}\nfrom shmgen.__main__ import main\ntry: main()\nexcept SystemExit: pass\n{after}"
    command = [python, "-c", program, "show", "--json", message]
    environment = {name: value for name, value in os.environ.items() if not name.startswith(("PYTHON", "AMENT"))}
    environment["PYTHONPATH"] = str(REPOSITORY / "src")
    result = subprocess.run(command, cwd=folder, env=environment, capture_output=True, text=True, check=False)
    assert not result.stderr
    return result.stdout


@needs_rosidl
@pytest.mark.parametrize(("environment", "lark"), [("idl", "1"), ("ros2-jazzy", "0"), ("ros2-kilted", "0")])
def test_parsers_of_all_wheels_read_the_same(environment: str, lark: str, tmp_path: Path) -> None:
    """Compare each environment with Debian's parser. In environment `idl`, blark determines the version of lark."""
    python = python_in(environment)
    put(FOLDERS, tmp_path)
    code = "import lark, rosidl_parser as it; print(it.__file__, lark.__version__)"
    *text, details = show(python, tmp_path, "a_msgs/Foo", after=code).splitlines()
    assert text == show(sys.executable, tmp_path, "a_msgs/Foo").splitlines()
    assert len(text) > 100
    file, version = details.split()
    assert Path(file).is_relative_to(python.parent.parent)
    assert version.partition(".")[0] == lark
    if environment == "idl":
        program = "import blark; print(blark.parse_source_code('PROGRAM p\\nEND_PROGRAM').exception)"
        assert subprocess.run([python, "-c", program], capture_output=True, text=True, check=False).stdout == "None\n"


def test_msg_does_not_load_the_idl_parser(tmp_path: Path) -> None:
    put(FOLDERS, tmp_path)
    code = "print({name.partition('.')[0] for name in sys.modules} & {'lark', 'rosidl_parser', 'rosidl_adapter'})"
    assert show(sys.executable, tmp_path, "a_msgs/Plain", after=code).splitlines()[-1] == "set()"


@needs_rosidl
def test_incomplete_wheel_is_ignored(tmp_path: Path) -> None:
    """Ignore a wheel of which `pip install` of Debian's Python put only one part into the search path."""
    put({**FOLDERS, "half/rosidl_parser/_dummy.so": ""}, tmp_path)
    assert '"a_msgs/msg/Foo"' in show(sys.executable, tmp_path, "a_msgs/Foo", before="sys.path.insert(0, 'half')")
