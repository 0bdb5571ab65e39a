"""Tests of `shmgen topics`, `info`, `bw`, `delay`, `show`, `echo` with fields, and of the shell completion."""

from __future__ import annotations

import csv
import json
import os
import pty
import re
import shutil
import subprocess
import sys
import threading

import pytest

from shmgen.config import Config
from shmgen.live.classes import publisher
from shmgen.live.session import Session
from shmgen.show.table import leaves
from shmgen.tools.messages import parse as typed
from shmgen.tools.messages import paths
from shmgen.tools.messages.echo import csv_row, csv_titles
from shmgen.tools.watch import overview

POSE = '{header: {frame_id: "a\\u001b[31mb, c"}, pose: {position: {x: 2.5}}}'


@pytest.fixture
def pose(topic, tmp_path):
    """A PoseStamped that a thread of this process publishes at 100 Hz."""
    kind = Session(Config(tmp_path)).message("geometry_msgs/PoseStamped")
    data = typed.parse(POSE.replace("header: {", "header: {stamp: now, "))
    stopping = threading.Event()
    with publisher(kind, topic, 1) as writer:

        def publish():
            while not stopping.wait(0.01):
                writer.publish(typed.build(kind, data))

        thread = threading.Thread(target=publish)
        thread.start()
        yield
        stopping.set()
        thread.join()


def test_topics_and_info_list_writers_and_readers(topic, pose, shmgen, peer):
    reader = peer(f"r = PoseSubscriber({topic + 'b'!r})")
    result = shmgen("topics")
    assert result.stdout.startswith("TOPIC ")
    (row,) = [line.split() for line in result.stdout.splitlines() if line.startswith(topic + " ")]
    assert row[1:3] == ["geometry_msgs/msg/PoseStamped", str(os.getpid())]
    regions = {region["topic"]: region for region in json.loads(shmgen("topics", "--json").stdout)}
    assert (regions[topic]["payload"], regions[topic]["readers"], regions[topic]["age"] < 30) == (144, [], True)
    assert (regions[topic + "b"]["readers"], regions[topic + "b"]["writer"]) == ([reader.pid], "-")
    text = shmgen("info", topic + "b").stdout
    assert "type: geometry_msgs/msg/Pose\ndigest: 16#0123456789ABCDEF\n" in text
    assert re.search(rf"^readers: 1(; others may be hidden: .*)?\n  {reader.pid} python", text, re.MULTILINE)
    missing = shmgen("info", topic[:-1])
    assert (missing.code, f"did you mean {topic}" in missing.stderr) == (1, True)


def test_table_fits_a_narrow_terminal():
    row = overview.Row("/a/long/topic", "package/msg/Long", "42 a longer name", 2, 0.5, readers=(1, 2))

    def table(width):
        return overview.table([row], width=width, columns=overview.LISTED)

    wide = max(map(len, table(None)))
    assert max(map(len, table(wide - 6))) == wide - 6
    assert table(wide - 12)[0].split() == ["TOPIC", "TYPE", "WRITER", "READERS", "SLOTS"]


def test_bw_and_delay_report_bytes_and_age(topic, pose, shmgen):
    def report(command, *options):
        result = shmgen(command, topic, "-n", "1", "--timeout", "20", *options)
        assert (result.code, result.stderr) == (0, ""), command
        return result.stdout

    values = json.loads(report("bw", "--json"))
    assert values["rate"] == pytest.approx(values["samples"] * 144)
    assert values["size"] == 144
    assert 20 < values["samples"] < 110
    assert report("delay").startswith("average delay: 0.")
    values = json.loads(report("delay", "--json"))
    assert values["by"] == "header.stamp"
    assert 0 <= values["shortest"] <= values["mean"] <= values["longest"]


def test_echo_prints_and_filters_fields(topic, shmgen):
    shmgen("pub", topic, "geometry_msgs/PoseStamped", POSE, "--once")
    echo = lambda *arguments: shmgen("echo", topic, "--once", *arguments)  # noqa: E731
    assert echo("--field", "pose.position").stdout == "x: 2.5\ny: 0.0\nz: 0.0\n---\n"
    assert echo("--field", "pose.position.x").stdout == "2.5\n---\n"
    assert echo("--field", "header.frame_id").stdout == '"a\\u001b[31mb, c"\n---\n'
    assert json.loads(echo("--field", "header", "--json").stdout)["frame_id"] == "a\x1b[31mb, c"
    titles, row = csv.reader(echo("--csv").stdout.splitlines())
    assert titles[:4] == ["header.stamp.sec", "header.stamp.nanosec", "header.frame_id", "pose.position.x"]
    assert row[:4] == ["0", "0", "a\\u001b[31mb, c", "2.5"]
    assert echo("--csv", "--field", "pose.position.x").stdout == "pose.position.x\n2.5\n"
    assert (
        echo("--filter", "pose.position.x > 2 and m.header.frame_id[0] == 'a'", "--field", "pose.position.y").code == 0
    )
    assert "no sample within" in echo("--filter", "pose.position.x > 3", "--timeout", "0.1").stderr
    for options, expected in (
        (("--field", "pose.positon.x"), "no field positon; did you mean position?"),
        (("--field", "pose[0]"), "is applied to a field that is not an array"),
        (("--filter", "pos.x > 1"), "no field pos; did you mean pose?"),
        (("--filter", "pose.__class__"), "__class__ is not a field"),
        (("--filter", "open('x')"), "functions are abs, "),
        (("--filter", "[x for x in pose]"), "ListComp is not allowed in a condition"),
        (("--filter", "pose >"), "is not a condition"),
    ):
        result = echo(*options)
        assert (result.code, result.stdout) == (1, ""), options
        assert expected in result.sentence
    assert echo("--json", "--csv").code == 2


def test_csv_puts_a_sequence_into_one_column(tmp_path):
    (tmp_path / "s_msgs" / "msg").mkdir(parents=True)
    (tmp_path / "s_msgs" / "msg" / "All.msg").write_text(
        "float64[<=3] many\nint8[2] two\nbool ok\ngeometry_msgs/Point[<=2] points\n"
    )
    session = Session(Config(tmp_path, path=(tmp_path,)))
    kind = session.message("s_msgs/All")
    message = typed.build(kind, {"many": [1.5, float("nan")], "two": [1, 2], "ok": True, "points": [{"x": 1.0}]})
    assert csv_titles(kind()) == ["many", "two[0]", "two[1]", "ok", "points"]
    assert csv_row(message) == ['[1.5, "NaN"]', "1", "2", "true", '[{"x": 1.0, "y": 0.0, "z": 0.0}]']
    get = paths.getter(kind, "points[0].x")
    assert (get(message), get(kind())) == (1.0, None)
    assert not paths.condition(kind, "points[1].x == 0")(message)
    assert paths.condition(kind, "len(points) == 1 and max(two) == 2")(message)
    layout = session.layout("s_msgs/All")
    rows = leaves(layout, session.layouts(["s_msgs/All"]))
    assert [row.path for row in rows if row.role == "data"] == ["many", "two", "ok", "points"]


def test_plot_command_points_to_view(shmgen):
    result = shmgen("plot", "/a", "x")
    assert (result.code, "did you mean `shmgen view --terminal`?" in result.stderr) == (2, True)


def test_show_finds_a_message_by_its_digest(topic, shmgen):
    output = shmgen("show", "geometry_msgs/Pose").stdout
    digest = output.partition("digest ")[2].split()[0]
    for spelling in (digest, f"16#{digest.upper()}"):
        assert shmgen("show", spelling).stdout == output
    missing = shmgen("show", "0123456789abcdef")
    assert (missing.code, "no message here has the digest 16#0123456789ABCDEF" in missing.stderr) == (1, True)


def complete(folder, *words):
    """Return the completions that bash would offer."""
    environment = {"COMP_WORDS": " ".join(["shmgen", *words]), "COMP_CWORD": str(len(words))}
    environment["_SHMGEN_COMPLETE"] = "bash_complete"
    process = subprocess.run(
        [sys.executable, "-c", "import sys; sys.argv[0] = 'shmgen'; from shmgen.__main__ import main; main()"],
        cwd=folder, env={**os.environ, **environment}, capture_output=True, text=True, check=True, timeout=60,
    )  # fmt: skip
    return [line.partition(",")[2] for line in process.stdout.splitlines()]


def test_completion_offers_topics_fields_and_types(topic, tmp_path, shmgen):
    shmgen("pub", topic, "geometry_msgs/PoseStamped", "--once")
    assert topic in complete(tmp_path, "echo", topic[:12])
    assert complete(tmp_path, "echo", topic, "--field", "pose.po") == [f"pose.position.{axis}" for axis in "xyz"]
    assert "header.frame_id" not in complete(tmp_path, "view", topic, "header.")
    assert "geometry_msgs/Pose" in complete(tmp_path, "pub", topic, "geometry_msgs/Po")


@pytest.mark.parametrize("shell", ["bash", "zsh", "fish"])
def test_completion_script_is_valid_in_each_shell(shell, shmgen):
    script = shmgen("completion", shell).stdout
    assert "_SHMGEN_COMPLETE" in script
    if shutil.which(shell):
        subprocess.run([shell, "-n"], input=script, check=True, text=True)
    assert shmgen("completion", "tcsh").code == 2


@pytest.mark.parametrize(
    ("variable", "value", "is_coloured"), [("NO_COLOR", "1", False), ("TERM", "dumb", False), ("A", "1", True)]
)
@pytest.mark.parametrize("command", [("info", "/no/such"), ("show", "no/such")], ids=["tool", "diagnostic"])
def test_terminal_colours_respect_no_color_and_term(variable, value, is_coloured, command, tmp_path):
    leader, follower = pty.openpty()
    environment = {**os.environ, "TERM": "xterm", variable: value}
    environment = {name: text for name, text in environment.items() if name != "NO_COLOR" or variable == "NO_COLOR"}
    arguments = [sys.executable, "-m", "shmgen", *command]
    process = subprocess.run(
        arguments, cwd=tmp_path, env=environment, stdin=follower, stdout=follower, stderr=follower, check=False
    )
    os.close(follower)
    assert process.returncode == 1
    assert ("\x1b[" in os.read(leader, 65536).decode()) == is_coloured
    os.close(leader)
