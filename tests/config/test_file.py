"""Each key of shmgen.toml and [tool.shmgen] accepts its values, and each error names its place."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Any

import pytest

from shmgen import config
from shmgen.config import Config
from shmgen.config.entries import Bound
from shmgen.config.file import CallEntry, TopicEntry
from shmgen.core.diagnostics import Diagnostic, Rejected, Report, Span
from shmgen.core.model import Regions, TypeOptions


def load(folder: Path, text: str | bytes, name: str = "shmgen.toml") -> Config:
    (folder / name).write_bytes(text if isinstance(text, bytes) else text.encode())
    return config.load(folder / name, name, Report())


def load_errors(folder: Path, text: str | bytes, name: str = "shmgen.toml") -> tuple[Diagnostic, ...]:
    with pytest.raises(Rejected) as caught:
        load(folder, text, name)
    return caught.value.diagnostics


def test_empty_file_is_the_default_configuration(tmp_path: Path) -> None:
    assert load(tmp_path, "") == Config(tmp_path)


@pytest.mark.parametrize(
    ("text", "changes"),
    [
        ('messages = ["std_msgs/Bool", "std_msgs"]', {"messages": ("std_msgs/Bool", "std_msgs")}),
        ('source = "noetic"', {"source": "noetic"}),
        ('targets = ["st", "c"]', {"targets": ("st", "c")}),
        ('package = "robot_shm"', {"package": "robot_shm"}),
        ("max_region = 4096", {"max_region": 4096}),
        ('distribution = "robot-shm 1.2.0rc1"', {"distribution": "robot-shm 1.2.0rc1"}),
        ('runtime = "beside"', {"runtime": "beside"}),
        ("max_region = 0x7FFF_FFFF", {"max_region": 2**31 - 1}),
        ('[types]\nbool = "BOOL"', {"types": TypeOptions(bool="BOOL")}),
        ('types.time = "LTIME"', {"types": TypeOptions(time="LTIME")}),
        ('types = { time = "struct" }', {"types": TypeOptions(time="struct")}),
        ('[strings]\nencoding = "latin-1"', {"types": TypeOptions(encoding="latin-1")}),
        ('[strings]\noverflow = "truncate"', {"types": TypeOptions(overflow="truncate")}),
    ],
)
def test_keys_are_loaded(tmp_path: Path, text: str, changes: dict[str, Any]) -> None:
    loaded = load(tmp_path, text)
    assert dataclasses.replace(loaded, places={}) == dataclasses.replace(Config(tmp_path), **changes)


def test_bounds_keep_their_lines(tmp_path: Path) -> None:
    lines = [
        "[strings]",
        "default = 40",
        '"std_msgs/Header.frame_id" = 32',
        "[bounds]",
        "sensor_msgs = 4",
        '"sensor_msgs/JointState" = 8  # all of them',
        "'sensor_msgs/JointState.name' = 9",
    ]
    bounds = load(tmp_path, "\r\n".join(lines)).bounds

    def bound(value: int, line: int, width: int) -> Bound:
        return Bound(value, Span("shmgen.toml", line, 1, width, lines[line - 1]))

    assert bounds.default_string == 40
    assert bounds.strings == {"std_msgs/Header.frame_id": bound(32, 3, 26)}
    assert bounds.sequences == {
        "sensor_msgs": bound(4, 5, 11),
        "sensor_msgs/JointState": bound(8, 6, 24),
        "sensor_msgs/JointState.name": bound(9, 7, 29),
    }


def test_topics_are_loaded(tmp_path: Path) -> None:
    text = '[[topics]]\ntopic = "/a"\ntype = "std_msgs/Bool"\n[[topics]]\n'
    text += 'topic = "/b"\ntype = "std_msgs/Int8"\ndirection = "from_plc"\ndepth = 4\n'
    assert load(tmp_path, text).topics == (
        TopicEntry("/a", "std_msgs/Bool", "to_plc", 1, Span("shmgen.toml", 2, 1, 5, 'topic = "/a"')),
        TopicEntry("/b", "std_msgs/Int8", "from_plc", 4, Span("shmgen.toml", 5, 1, 5, 'topic = "/b"')),
    )


def test_services_and_actions_are_loaded(tmp_path: Path) -> None:
    text = '[[services]]\nservice = "/a"\ntype = "std_srvs/SetBool"\n[[actions]]\naction = "/b"\ntype = "arm/Move"\n'
    text += '[[services]]\nservice = "/c"\ntype = "std_srvs/Trigger"\nserver = "ros"\ntimeout = 3\n'
    loaded = load(tmp_path, text)
    assert loaded.services == (
        CallEntry("/a", "std_srvs/SetBool", "plc", 1.0, Span("shmgen.toml", 2, 1, 7, 'service = "/a"')),
        CallEntry("/c", "std_srvs/Trigger", "ros", 3.0, Span("shmgen.toml", 8, 1, 7, 'service = "/c"')),
    )
    assert loaded.actions == (CallEntry("/b", "arm/Move", "plc", 1.0, Span("shmgen.toml", 5, 1, 6, 'action = "/b"')),)
    assert loaded.types_used == ("std_srvs/SetBool", "std_srvs/Trigger", "arm/Move")


def test_paths_are_relative_to_the_folder_of_the_file(tmp_path: Path) -> None:
    loaded = load(tmp_path, 'path = ["msgs", "/opt/msgs"]\nmessages = ["msgs/Robot.msg", "a/B"]')
    assert loaded.path == (tmp_path / "msgs", Path("/opt/msgs"))
    assert loaded.messages == (str(tmp_path / "msgs" / "Robot.msg"), "a/B")


def test_options_of_regions_are_loaded(tmp_path: Path) -> None:
    assert load(tmp_path, "").regions == Regions(None, "", "lock")
    text = '[regions]\nmode = "0666"\ngroup = "plc"\nsync = "sequence"\n'
    assert load(tmp_path, text).regions == Regions(0o666, "plc", "sequence")


def test_requests_keep_their_places(tmp_path: Path) -> None:
    text = 'messages = [\n    "a/B",\n]\n[[topics]]\ntopic = "/t"\ntype = "a/C"\n'
    assert load(tmp_path, text).places == {
        "a/B": Span("shmgen.toml", 2, 6, 3, '    "a/B",'),
        "a/C": Span("shmgen.toml", 6, 9, 3, 'type = "a/C"'),
    }


@pytest.mark.parametrize(
    ("text", "code", "line", "column", "width", "phrase"),
    [
        ('sauce = "jazzy"', "SHM501", 1, 1, 5, "unknown key sauce"),
        ('\n  source = "jazy"', "SHM502", 2, 3, 6, "did you mean jazzy?"),
        ("source = 1", "SHM502", 1, 1, 6, "not 1"),
        ("source = []", "SHM502", 1, 1, 6, "not []"),
        ('messages = "a/B"', "SHM502", 1, 1, 8, "a list of strings"),
        ("messages = [1]", "SHM502", 1, 1, 8, "a list of strings"),
        ("path = 'msgs'", "SHM502", 1, 1, 4, "a list of strings"),
        ('targets = ["sst"]', "SHM502", 1, 1, 7, '"sst" is not one of'),
        ("targets = []", "SHM502", 1, 1, 7, "empty"),
        ('package = "a-b"', "SHM502", 1, 1, 7, "'a-b'"),
        ('package = "class"', "SHM502", 1, 1, 7, "'class'"),
        ('package = "shmgen"', "SHM502", 1, 1, 7, "'shmgen'"),
        ("package = 3", "SHM502", 1, 1, 7, "3"),
        ("max_region = 0", "SHM502", 1, 1, 10, "from 1 to"),
        ('distribution = "robot-shm"', "SHM502", 1, 1, 12, "a name and a version"),
        ("max_region = true", "SHM502", 1, 1, 10, "not True"),
        ("max_region = 1e3", "SHM502", 1, 1, 10, "not 1000.0"),
        ("max_region = 2147483648", "SHM502", 1, 1, 10, "from 1 to 2147483647"),
        ("types = 3", "SHM502", 1, 1, 5, "write [types]"),
        ('time = "TIME"', "SHM501", 1, 1, 4, "move it under [types]"),
        ('[types]\ntim = "TIME"', "SHM501", 2, 1, 3, "did you mean time?"),
        ('[types]\ntime = "Time"', "SHM502", 2, 1, 4, "TIME, LTIME, struct"),
        ("[types]\nbool = true", "SHM502", 2, 1, 4, "not True"),
        ("types.tim = 'TIME'", "SHM501", 1, 1, 5, "did you mean time?"),
        ("[strings]\ndefault = '80'", "SHM502", 2, 1, 7, "not '80'"),
        ("[strings]\ndefalt = 80", "SHM501", 2, 1, 6, "did you mean default?"),
        ("[strings]\nencoding = 'ascii'", "SHM502", 2, 1, 8, "utf-8, latin-1"),
        ('[regions]\nmode = "0640"', "SHM502", 2, 1, 4, "not '0640'"),
        ("[regions]\nmode = 0o660", "SHM502", 2, 1, 4, "in quotes"),
        ('[regions]\nmode = "0560"', "SHM502", 2, 1, 4, "each process must read and write"),
        ("[regions]\ngroup = ''", "SHM502", 2, 1, 5, "the name of a group"),
        ("[regions]\ngroup = 5", "SHM502", 2, 1, 5, "not 5"),
        ("[regions]\nsync = 'seqence'", "SHM502", 2, 1, 4, "did you mean sequence?"),
        ("[regions]\nmod = '0660'", "SHM501", 2, 1, 3, "did you mean mode?"),
        ("[bounds]\n'a b' = 1", "SHM501", 2, 1, 5, '"package/Message.field"'),
        ("[bounds]\n'a/B.c.d' = 1", "SHM501", 2, 1, 9, "unknown key"),
        ("[bounds]\n'a/B' = 0", "SHM502", 2, 1, 5, "not 0"),
        ("[bounds]\na.B = 1", "SHM502", 2, 1, 1, "in quotes"),
        ("[bounds]\na/B = 1", "SHM503", 2, 2, 1, '"a/B" = 8'),
        ("topics = 3", "SHM502", 1, 1, 6, "[[topics]]"),
        ("[topics]\ntopic = '/a'", "SHM502", 1, 2, 6, "[[topics]]"),
        ("[[topics]]\ntopic = '/a'", "SHM502", 1, 3, 6, 'type = "..."'),
        ("[[topics]]\ntype = 3\ntopic = '/a'", "SHM502", 2, 1, 4, "not 3"),
        ("[[topics]]\ntype = 'a/B'\ntopic = '/a'\ndeep = 3", "SHM501", 4, 1, 4, "did you mean depth?"),
        ("[[topics]]\ntype = 'a/B'\ntopic = '/a'\ndirection = ''", "SHM502", 4, 1, 9, "to_plc, from_plc"),
        ("[[topics]]\ntype = 'a/B'\ntopic = '/a'\ndepth = 0", "SHM502", 4, 1, 5, "not 0"),
        ("[services]\nservice = '/a'", "SHM502", 1, 2, 8, "[[services]]"),
        ("[[services]]\ntype = 'a/B'", "SHM502", 1, 3, 8, 'service = "..."'),
        ("[[services]]\nservice = '/a'\ntype = 'a/B'\nserver = 'me'", "SHM502", 4, 1, 6, "plc, ros"),
        ("[[services]]\nservice = '/a'\ntype = 'a/B'\ntimeout = 0", "SHM502", 4, 1, 7, "from 0.001 to 86400"),
        ("[[services]]\nservice = '/a'\ntype = 'a/B'\ntimout = 1", "SHM501", 4, 1, 6, "did you mean timeout?"),
        ("[[services]]\nservice = '/a-b'\ntype = 'a/B'", "SHM502", 2, 1, 7, "letters, digits and _"),
        (f"[[services]]\nservice = '/{66 * 'a'}'\ntype = 'a/B'", "SHM502", 2, 1, 7, "only 65 and a suffix"),
        ("[[actions]]\naction = '/a'\ntype = 'B'", "SHM502", 3, 1, 4, "is not an action"),
        ("[[actions]]\naction = '/a'\ntype = 'a/B'\ndepth = 1", "SHM501", 4, 1, 5, "unknown key depth"),
        ("messages = [", "SHM503", 1, 13, 1, ""),
        ("a = 1\na = 2", "SHM503", 2, 6, 1, "overwrite"),
        ("[types]\ntime = LTIME", "SHM503", 2, 8, 1, 'time = "LTIME"'),
        (b"# \xc3\xa4\nmessages = ['\xff']", "SHM002", 2, 14, 0, "0xFF"),
    ],
)
def test_errors_name_code_place_and_hint(
    tmp_path: Path, text: str | bytes, code: str, line: int, column: int, width: int, phrase: str
) -> None:
    (error,) = load_errors(tmp_path, text)
    span = error.span
    assert (error.code, span.path, span.line, span.column, span.width) == (
        code,
        "shmgen.toml",
        line,
        column,
        width,
    ), str(error)
    assert phrase in error.message + error.hint


def test_topic_listed_twice_is_an_error(tmp_path: Path) -> None:
    entry = "[[topics]]\ntopic = 'a'\ntype = 'a/B'\n"
    (error,) = load_errors(tmp_path, entry + entry.replace("'a'", "'/a'"))
    assert (error.code, error.span.line, error.message) == ("SHM502", 5, "topic /a is listed twice")


def test_errors_are_reported_from_top_to_bottom(tmp_path: Path) -> None:
    errors = load_errors(tmp_path, "[strings]\n'a/B' = 0\ndefault = 0\n[types]\nbool = 1\n[nonsense]\nx = 1\n")
    assert [(e.code, e.span.line) for e in errors] == [("SHM502", 2), ("SHM502", 3), ("SHM502", 5), ("SHM501", 6)]


def test_byte_order_mark_is_ignored(tmp_path: Path) -> None:
    assert load(tmp_path, b"\xef\xbb\xbfmax_region = 9").max_region == 9


def test_lines_are_counted_as_in_toml(tmp_path: Path) -> None:
    (error,) = load_errors(tmp_path, "# a\u2028b\x85c\nmax_region = 0\r\n")
    assert (error.span.line, error.span.text) == (2, "max_region = 0")


def test_table_of_pyproject_is_loaded(tmp_path: Path) -> None:
    text = '[project]\nname = "robot"\n[tool.shmgen]\nsource = "humble"\n[tool.shmgen.bounds]\n"a/B" = 3\n'
    loaded = load(tmp_path, text + '[[tool.shmgen.topics]]\ntopic = "/a"\ntype = "a/B"\n', "pyproject.toml")
    assert (loaded.source, loaded.bounds.sequences["a/B"].span.line, loaded.topics[0].span.line) == ("humble", 6, 8)


@pytest.mark.parametrize(
    ("text", "line"),
    [
        ("[bounds]\nx = 1\n[tool.shmgen]\nbounds = 3", 4),
        ("[tool.shmgen.types]\nbool = 1", 2),
        ("[tool.shmgen.types.bool]\na = 1", 1),
        ("tool = 3", 1),
    ],
)
def test_errors_in_pyproject_name_their_line(tmp_path: Path, text: str, line: int) -> None:
    (error,) = load_errors(tmp_path, text, "pyproject.toml")
    assert (error.code, error.span.path, error.span.line) == ("SHM502", "pyproject.toml", line), str(error)


def test_shmgen_toml_takes_precedence_over_pyproject(tmp_path: Path) -> None:
    assert config.find(tmp_path) is None
    (tmp_path / "pyproject.toml").write_text("[tool.other]")
    assert config.find(tmp_path) is None
    (tmp_path / "pyproject.toml").write_text("[tool.shmgen]")
    assert config.find(tmp_path) == tmp_path / "pyproject.toml"
    (tmp_path / "shmgen.toml").write_text("")
    assert config.find(tmp_path) == tmp_path / "shmgen.toml"
