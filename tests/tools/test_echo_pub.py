"""Tests of `shmgen pub` and `shmgen echo`: text becomes samples, and samples become the same text."""

from __future__ import annotations

import ctypes
import json
import math
import random
import signal
import time
from pathlib import Path

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from ruamel.yaml import YAML

from shmgen.config import Config, load
from shmgen.core.diagnostics import Report
from shmgen.core.model import TypeName
from shmgen.generator import pipeline
from shmgen.runtime import CountExceeded
from shmgen.runtime.region import header
from shmgen.tools.messages import format
from shmgen.tools.messages import parse as typed

from ..support import build, counts, schemas

POSE = """position:
  x: 1.0
  y: 0.0
  z: 0.0
orientation:
  x: 0.0
  y: 0.0
  z: 0.0
  w: 1.0
---
"""


def publish(shmgen, topic, *arguments):
    result = shmgen("pub", topic, *arguments, "--once")
    assert (result.code, result.stderr) == (0, "")
    assert result.stdout.startswith("publishing #1: ")


def expect_rejection(shmgen, topic, *arguments):
    result = shmgen("pub", topic, *arguments, "--once")
    assert (result.code, result.stdout) == (1, "")
    assert not list(Path("/dev/shm").glob(f"*{topic.replace('/', '.')[1:]}*"))
    return result.sentence


@pytest.mark.parametrize("text", ["{position: {x: 1}}", '{"position": {"x": 1.0}}', "position:\n  x: 1e0"])
def test_pub_accepts_yaml_and_json(text, topic, shmgen):
    publish(shmgen, topic, "geometry_msgs/Pose", text)
    result = shmgen("echo", topic, "--once")
    assert (result.code, result.stdout, result.stderr) == (0, POSE, "")


def test_echo_prints_a_float32_with_its_shortest_digits(topic, shmgen):
    """Print 0.01 of a float32 instead of 0.009999999776482582, the equal float64."""
    publish(shmgen, topic, "geometry_msgs/Point32", "{x: 0.01, y: -3.4028235e38, z: 1e-45}")
    outputs = {
        options: shmgen("echo", topic, *options.split(), "--once").stdout
        for options in ("", "--json", "--csv", "--field x")
    }
    assert outputs == {
        "": "x: 0.01\ny: -3.4028235e+38\nz: 1e-45\n---\n",
        "--json": '{"x": 0.01, "y": -3.4028235e+38, "z": 1e-45}\n',
        "--csv": outputs["--csv"],
        "--field x": "0.01\n---\n",
    }
    assert "0.01,-3.4028235e+38,1e-45" in outputs["--csv"]


@given(st.floats(width=32))
def test_shortest_digits_of_a_float32_are_exact(value):
    shortest = format.shortest(value)
    assert ctypes.c_float(shortest).value == value or math.isnan(value)
    assert len(repr(shortest)) <= len(repr(value))


def test_pub_fills_in_defaults_and_the_present_time(topic, shmgen):
    before = time.time()
    publish(shmgen, topic, "geometry_msgs/msg/PoseStamped", "header: {stamp: now, frame_id: 'yes'}")
    result = shmgen("echo", topic, "--once")
    message = YAML(typ="safe", pure=True).load(result.stdout.removesuffix("---\n"))
    assert before - 1 < message["header"]["stamp"]["sec"] < time.time() + 1
    assert message["header"]["frame_id"] == "yes"
    assert "frame_id: 'yes'\n" in result.stdout
    publish(shmgen, topic, "geometry_msgs/PoseStamped")


@pytest.mark.parametrize(
    ("type_name", "text", "error"),
    [
        (
            "geometry_msgs/Pose",
            "{positon: {}}",
            "positon: no such field in geometry_msgs/msg/Pose; did you mean position?",
        ),
        ("geometry_msgs/Pose", "{position: {w: 1}}", "position.w: no such field"),
        ("geometry_msgs/Pose", "{position: 3}", "position: 3 is int, not the fields of"),
        ("geometry_msgs/Pose", "{position: {x: far}}", "position.x: 'far' is str, not float64"),
        ("std_msgs/Int32", "{data: 3000000000}", "data: 3000000000; int32 goes from"),
        ("std_msgs/Float64", "{data: 1e999}", "1e999 is too large for float64; write infinity as .inf"),
        ("std_msgs/Float64", '{"data": -1e999}', "-1e999 is too large for float64"),
        ("std_msgs/Float64", f"{{data: 1{400 * '0'}}}", "is too large for float64"),
        ("std_msgs/ColorRGBA", "{r: 1e300}", "r: 1e+300 is too large for float32"),
        ("std_msgs/String", 5000 * "[", "brackets are nested too deeply"),
        ("std_msgs/Bool", "{data: 'false'}", "data: 'false' is not a bool"),
        ("std_msgs/String", "{data: " + 81 * "x" + "}", "data: 81 bytes of UTF-8, capacity 80"),
        ("std_msgs/Header", "{stamp: {secs: 1}}", "stamp.secs: no such field in a time; did you mean sec?"),
        ("std_msgs/Header", "{stamp: later}", "stamp: 'later' is str, not the fields of a time"),
        ("sensor_msgs/Imu", "{orientation_covariance: [1, 2]}", "orientation_covariance: 2 elements"),
        ("std_msgs/String", "{data: [", "line 1, column "),
        ("std_msgs/Strin", "{}", "unknown message type `std_msgs/Strin`"),
    ],
)
def test_pub_error_names_the_field_and_creates_no_region(type_name, text, error, topic, shmgen):
    assert error in expect_rejection(shmgen, topic, type_name, text)


def test_explicit_infinity_and_nan_are_accepted(topic, shmgen):
    for text in ("{r: .inf, g: -.inf, b: .nan}", '{"r": Infinity, "g": "-Infinity", "b": "NaN"}'):
        publish(shmgen, topic, "std_msgs/ColorRGBA", text)
        assert shmgen("echo", topic, "--once").stdout == "r: .inf\ng: -.inf\nb: .nan\na: 0.0\n---\n"


def test_error_in_an_array_has_an_index(topic, tmp_path, shmgen):
    (tmp_path / "shmgen.toml").write_text('[bounds]\n"geometry_msgs/Polygon" = 4\n')
    error = expect_rejection(shmgen, topic, "geometry_msgs/Polygon", "points: [{x: 1}, {x: 2, y: a}]")
    assert "points[1].y: 'a' is str, not float32" in error
    publish(shmgen, topic, "geometry_msgs/Polygon", "points: [{x: 1}, {x: 2, y: 3}]")
    assert shmgen("echo", topic, "--once").stdout == (
        "points:\n- x: 1.0\n  y: 0.0\n  z: 0.0\n- x: 2.0\n  y: 3.0\n  z: 0.0\n---\n"
    )


def test_echo_marks_shortened_arrays(topic, shmgen):
    publish(shmgen, topic, "sensor_msgs/Imu", json.dumps({"orientation_covariance": list(range(9))}))
    assert (
        "orientation_covariance: [0.0, 1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0, 8.0]\n"
        in shmgen("echo", topic, "--once").stdout
    )
    publish(shmgen, topic + "b", "geometry_msgs/PoseWithCovariance")
    short, full = (shmgen("echo", topic + "b", "--once", *more).stdout for more in ((), ("--full",)))
    assert ", 0.0, '... 36 in all']\n" in short
    assert full.count("0.0, ") == 35
    assert len(json.loads(shmgen("echo", topic + "b", "--once", "--json").stdout)["covariance"]) == 36


def test_echo_reports_a_damaged_count_and_prints_the_next(topic, file, tmp_path, shmgen, started):
    (tmp_path / "shmgen.toml").write_text('[bounds]\n"sensor_msgs/JointState" = 3\n')
    publish(shmgen, topic, "sensor_msgs/JointState", "{position: [1.0]}")
    with file.open("r+b") as region:
        fields = header.unpack(region.read(), 0)
        (count,) = (slot for slot in slots_of("sensor_msgs/JointState", tmp_path) if slot.name == "position_count")
        region.seek(fields.header_size + fields.slot_size + header.SLOT_HEADER + count.offset)
        region.write((2**32 - 1).to_bytes(4, "little"))
    line = f"{topic}: error[SHM702]: damaged sample: position: the region has 4,294,967,295 elements; the bound is 3\n"
    once = shmgen("echo", topic, "--once")
    assert (once.code, once.stdout, once.stderr.partition("  hint")[0]) == (1, "", line)
    process = started("echo", topic, "-n", "2", "--json")
    assert process.stderr.readline() == line
    publish(shmgen, topic, "sensor_msgs/JointState", "{position: [2.0]}")
    assert json.loads(process.stdout.readline())["position"] == [2.0]
    assert process.wait() == 1


def slots_of(name, folder):
    config = load(folder / "shmgen.toml", "shmgen.toml", Report())
    return next(layout for layout in pipeline.lay_out(config, [name]).values() if layout.requested).slots


@pytest.mark.parametrize(("path", "count"), counts.PLACES)
def test_error_names_the_path_of_a_damaged_count(path, count, tmp_path_factory):
    folder = tmp_path_factory.mktemp("counts")
    for name, text in counts.DEFINITIONS.items():
        build.put({f"counts_msgs/{name}.{name.partition('/')[0]}": text}, folder)
    config = Config(folder, path=(folder,), package="shm_counts_shown", targets=("python",))
    build.put(pipeline.generate(config, ["counts_msgs/Tree"]), folder)
    msg = build.module(folder, "shm_counts_shown", TypeName("counts_msgs", "msg", "Tree"))
    message = counts.tree(msg, 1)
    assert format.yaml(message)
    counts.spoil(message, path, count)
    for show in (format.yaml, format.as_json):
        with pytest.raises(CountExceeded) as raised:
            show(message)
        assert raised.value.path == path


def test_echo_finds_the_layout_by_its_digest(topic, tmp_path, shmgen):
    """Search shmgen.toml, then layout.lock. If neither matches, print both digests and a hint."""
    toml = tmp_path / "shmgen.toml"
    toml.write_text('[bounds]\n"sensor_msgs/JointState" = 3\n[strings]\n"sensor_msgs/JointState.name" = 7\n')
    publish(shmgen, topic, "sensor_msgs/JointState", "{name: [a, b], position: [1, 2]}")
    text = shmgen("echo", topic, "--once").stdout
    assert "name: [a, b]\nposition: [1.0, 2.0]\nvelocity: []\n" in text

    shmgen("generate", "sensor_msgs/JointState", "-q")
    toml.rename(tmp_path / "other.toml")
    assert shmgen("echo", topic, "--once").stdout == text
    publish(shmgen, topic, "sensor_msgs/JointState", "{name: [c]}")

    (tmp_path / "generated" / "layout.lock").unlink()
    toml.write_text('[bounds]\n"sensor_msgs/JointState" = 5\n')
    result = shmgen("echo", topic, "--once")
    assert (result.code, result.stdout) == (1, "")
    fields = header.unpack(Path(f"/dev/shm/{topic[1:].replace('/', '.')}").read_bytes(), 0)
    assert f"region: digest 16#{fields.digest:016X}\n" in result.stderr
    assert "here:   digest 16#" in result.stderr
    assert "by shmgen.toml" in result.stderr
    assert "-c" in result.stderr
    assert shmgen("echo", topic, "--once", "-c", "other.toml").code == 0


def test_pub_and_echo_accept_messages_of_a_folder(topic, tmp_path, shmgen):
    folder = tmp_path / "msgs" / "demo_msgs" / "msg"
    folder.mkdir(parents=True)
    (folder / "Robot.msg").write_text("int32 from\nduration pause\ntime[2] stamps\nstring<=5[<=2] names\n")
    data = {
        "from": 3,
        "pause": {"sec": 1, "nanosec": 5_000_000},
        "stamps": [{"sec": 5, "nanosec": 0}] * 2,
        "names": ["a"],
    }
    publish(shmgen, topic, "demo_msgs/Robot", json.dumps(data), "-I", "msgs")
    echoed = json.loads(shmgen("echo", topic, "--once", "--json", "-I", "msgs").stdout)
    assert (echoed["from"], echoed["pause"], echoed["names"]) == (3, data["pause"], ["a"])
    (folder.parent / "srv").mkdir()
    (folder.parent / "srv" / "Go.srv").write_text("int32 there\n---\n")
    assert (
        "demo_msgs/Go has 3 messages, but a topic carries one"
        in shmgen("pub", topic, "demo_msgs/Go", "-I", "msgs").stderr
    )
    unknown = shmgen("echo", topic, "--once")
    assert unknown.code == 1
    assert "unknown message type `demo_msgs/msg/Robot`" in unknown.stderr


def test_echo_waits_for_a_region_and_its_replacement(topic, shmgen, started):
    echo = started("echo", topic, "-n", "2", "--json")
    assert echo.stderr.readline().startswith(f"{topic}: no such region; ")
    shmgen("pub", topic, "std_msgs/Int32", "{data: 1}", "--once")
    assert json.loads(echo.stdout.readline()) == {"data": 1}
    shmgen("clean", topic, "--force")
    assert any("waiting for a new one" in line for line in echo.stderr)
    shmgen("pub", topic, "std_msgs/Bool", "{data: true}", "--once")
    assert json.loads(echo.stdout.readline()) == {"data": True}
    assert echo.wait(10) == 0


def test_pub_keeps_its_rate_and_echo_prints_every_sample(topic, tmp_path, shmgen, started):
    (tmp_path / "shmgen.toml").write_text(f'[[topics]]\ntopic = "{topic}"\ntype = "std_msgs/Int32"\ndepth = 16\n')
    shmgen("pub", topic, "std_msgs/Int32", "--once")
    echo = started("echo", topic, "-n", "21", "--json")
    assert echo.stdout.readline() == '{"data": 0}\n'
    started_at = time.monotonic()
    assert len(shmgen("pub", topic, "std_msgs/Int32", "{data: 7}", "-r", "100", "-n", "20").stdout.splitlines()) == 20
    assert time.monotonic() - started_at > 0.19
    stdout, stderr = echo.communicate(timeout=10)
    assert stdout == '{"data": 7}\n' * 20
    assert "overwritten" not in stderr


def test_ctrl_c_exits_with_code_0(topic, shmgen, started):
    pub = started("pub", topic, "std_msgs/Int32", "-r", "50")
    assert pub.stdout.readline()
    echo, hz, top = started("echo", topic), started("hz", topic), started("top", "-d", "0.2")
    for process in (echo, hz, top, pub):
        assert process.stdout.readline()
        process.send_signal(signal.SIGINT)
        _, stderr = process.communicate(timeout=10)
        assert (process.returncode, stderr) == (0, "")


def test_second_writer_is_refused_and_echo_times_out(topic, shmgen, started):
    pub = started("pub", topic, "std_msgs/Int32", "-r", "50")
    assert pub.stdout.readline()
    result = shmgen("pub", topic, "std_msgs/Int32", "--once")
    assert result.code == 1
    assert f"process {pub.pid} publishes already" in result.stderr
    silent = shmgen("echo", topic + "x", "--timeout", "0.1")
    assert silent.code == 1
    assert f"{topic}x: error[SHM701]: no region within 0.1 s\n  hint: see `shmgen doctor {topic}x`\n" in silent.stderr
    pub.send_signal(signal.SIGINT)
    pub.wait(10)
    assert "no sample within 0.1 s" in shmgen("echo", topic, "--timeout", "0.1").stderr


@pytest.mark.slow
@given(text=st.text(max_size=20))
@settings(max_examples=200, deadline=None)
def test_any_text_is_printed_as_yaml(text):
    line = f"data: {format._text(text)}\n"
    assert YAML(typ="safe", pure=True).load(line) == {"data": text}


class TestAnyMessage:
    @given(schema=schemas.schemas(), seed=st.integers(0, 2**32))
    @settings(max_examples=15, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
    def test_printed_message_parses_to_an_equal_message(self, schema, seed, tmp_path_factory):
        """Print a random message as YAML and JSON, and parse both texts again."""
        folder = tmp_path_factory.mktemp("any")
        layouts = build.layouts_of(schema)
        package = f"any_{folder.name}"
        build.put(build.texts_of(layouts, "python", package), folder)
        for layout in layouts.values():
            kind, _, _ = build.classes(folder, package, layout.name)
            original = schemas.random_message(layout, layouts, random.Random(seed))
            message = typed.build(kind, schemas.plain(original))
            for text in (format.yaml(message, None), format.as_json(message)):
                assert typed.build(kind, typed.parse(text)) == message, text


@pytest.mark.slow
def test_sigterm_leaves_the_lock_of_pub_free(topic, started, shmgen):
    """Release the lock, whatever `pub` was doing at the signal."""
    for _ in range(3):
        pub = started("pub", topic, "std_msgs/Int32", "-r", "10000")
        assert pub.stdout.readline()
        pub.terminate()
        assert pub.wait(10) == 143
    assert shmgen("doctor", topic).code == 0
