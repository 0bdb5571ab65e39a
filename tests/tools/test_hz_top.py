"""Tests of `shmgen hz` and `shmgen top`: their counts, and the screen of `top` on a pseudo-terminal."""

from __future__ import annotations

import json
import os
import pty
import re
import select
import subprocess
import sys
import termios
import time

import pytest

from shmgen.runtime.region import header as h
from shmgen.tools.messages import stream
from shmgen.tools.watch import overview, reports
from tests.support.region_of import region_of

from ..runtime.messages import PosePublisher, PoseSubscriber, pose


def test_hz_reports_the_rate_of_a_steady_writer(topic, shmgen, started):
    pub = started("pub", topic, "std_msgs/Int32", "-r", "100")
    assert pub.stdout.readline()
    result = shmgen("hz", topic, "-n", "2", "--json")
    assert (result.code, result.stderr) == (0, "")
    for report in map(json.loads, result.stdout.splitlines()):
        assert 50 < report["rate"] < 110
        assert report["shortest"] <= 0.0101
        assert report["longest"] >= 0.0099
        assert 0 <= report["deviation"] < 0.1
    assert shmgen("hz", topic, "-n", "1").stdout.startswith("average rate: ")


def test_hz_counts_overwritten_samples(topic):
    """Publish bursts of five into two slots: hz reads two of them, and counts three as missed."""
    notes = []
    with PosePublisher(topic) as publisher:
        publisher.publish(pose(0.0))
        regions = stream.regions(topic, None, 1, notes.append)
        view, reader = next(regions)
        batches = stream.batches(topic, view, reader, 1)
        assert [sample.number for sample in next(batches)] == [1]
        for number in range(2, 32, 5):
            for _ in range(5):
                publisher.publish(pose(1.0))
            assert [sample.number for sample in next(batches)] == [number + 3, number + 4]
        assert reader.missed == 18
        assert view.header().missed == 0, "the header counts only samples that readers missed"
        regions.close()
    assert notes == []


def test_delay_uses_the_stamps_of_the_samples():
    header = h.header_for("test_msgs/msg/Any", 0, 8, 1)
    samples = [reports.Seen(number, 1.0, age) for number, age in enumerate((None, 0.25, 0.75))]
    report = reports.delay(reports.Window("/any", samples, 0, header, "stamp"))
    assert (report.mean, report.shortest, report.longest, report.deviation, report.window) == (0.5, 0.25, 0.75, 0.25, 2)
    assert reports.delay(reports.Window("/any", samples[:1], 0, header, "stamp")) is None
    with pytest.raises(ValueError, match="/any: its messages have no time stamp, and its writer stores no time"):
        reports.delay(reports.Window("/any", samples[:1], 0, header, "the writer's stamp"))


def test_rate_is_computed_from_numbers_and_times():
    rate = compute_rate((1, 10.0), (2, 10.1), (4, 10.3), (5, 10.5), missed=1)
    assert rate.rate == 4 / 0.5
    assert (round(rate.shortest, 9), round(rate.longest, 9)) == (0.1, 0.2)
    assert (rate.window, rate.missed) == (4, 1)
    assert round(rate.deviation, 9) == 0.05
    assert compute_rate((1, 10.0)) is None
    assert compute_rate((2**32 - 1, 10.0), (2, 11.0)).rate == 1.0  # the greatest number, then the number of slots


def compute_rate(*samples, missed=0):
    header = h.header_for("test_msgs/msg/Any", 0, 8, 1)
    return reports.rate(reports.Window("/any", [reports.Seen(*sample, None) for sample in samples], missed, header, ""))


def parse_rows(text, topic):
    return [line.split() for line in text.splitlines() if line.startswith(topic + " ")]


@pytest.mark.slow
def test_top_prints_tables_into_a_pipe(topic, shmgen, started):
    pub = started("pub", topic, "std_msgs/Int32", "-r", "100")
    assert pub.stdout.readline()
    result = shmgen("top", "-n", "2", "-d", "0.5")
    assert (result.code, result.stderr) == (0, "")
    assert "\x1b" not in result.stdout
    assert result.stdout.startswith("TOPIC ")
    rows = parse_rows(result.stdout, topic)
    assert len(rows) == 2
    for row in rows:
        assert row[1].endswith("/s")
        assert row[4:6] == ["std_msgs/msg/Int32", str(pub.pid)]
    (row,) = [row for row in json.loads(shmgen("top", "--once", "--json").stdout) if row["topic"] == topic]
    assert 50 < row["rate"] < 120
    assert 0 <= row["age"] < 0.5
    assert (row["slots"], row["recoveries"]) == (2, 0)
    pub.kill()
    pub.wait()
    (row,) = parse_rows(shmgen("top", "--once", "-d", "0.2").stdout, topic)
    assert row[5] == "gone"


def row(topic, rate):
    return overview.Row(topic, "demo_msgs/msg/Long", "42 a longer name", 2, 1.0, rate=rate, lock=0.0)


def test_top_counts_samples_that_readers_missed(topic, shmgen):
    with PosePublisher(topic, depth=3) as publisher:
        readers = [PoseSubscriber(topic, depth=3) for _ in range(2)]
        for x in range(10):
            publisher.publish(pose(x))
        assert readers[0].read().position.x == 9.0
        assert len(readers[1].read_all()) == 4
        assert [reader.missed for reader in readers] == [9, 6]
        assert read_row(shmgen, topic)["missed"] == 9 + 6
        region_of(publisher).words[h.MISSED] = 2**32 - 1
        publisher.publish(pose(10))
        publisher.publish(pose(11))
        for reader in readers:
            assert reader.read().position.x == 11.0
            reader.close()
    assert read_row(shmgen, topic)["missed"] == 1


def read_row(shmgen, topic):
    rows = json.loads(shmgen("top", "--once", "-d", "0.1", "--json").stdout)
    return next(row for row in rows if row["topic"] == topic)


def test_table_is_ordered_and_fits_the_width():
    rows = [row("/b", 1.0), row("/a", 5.0), row("/c", None)]
    assert [item.topic for item in overview.ordered(rows, "topic", False)] == ["/a", "/b", "/c"]
    assert [item.topic for item in overview.ordered(rows, "rate", False)] == ["/a", "/b", "/c"]
    assert [item.topic for item in overview.ordered(rows, "rate", True)] == ["/b", "/a", "/c"]
    wide = max(map(len, overview.table(rows, "")))
    assert max(map(len, overview.table(rows, "", width=wide - 6))) == wide - 6
    assert "5.0/s" in overview.table(rows, "", width=20)[2]


def test_narrow_table_keeps_the_topic_and_drops_right_columns():
    for topic, titles in (
        ("/cell/oven/temperature", ["TOPIC", "RATE", "AGE", "TYPE", "WRITER", "SLOTS"]),
        ("/cell/arm/left/joint_trajectory_controller/state", ["TOPIC", "RATE", "AGE"]),
    ):
        table = overview.table([row(topic, 1000.0)], "", width=80)
        assert table[0].split() == titles
        assert table[1].split()[:5] == [topic, "1000.0/s", "1.0", "s", *table[1].split()[4:5]]
        assert max(map(len, table)) <= 80
    assert "...msgs/msg/Long" in overview.table([row("/cell/oven/temperatures", 1.0)], "", width=86)[1]
    assert "42 a long..." in overview.table([row("/cell/oven/temperatures", 1.0)], "", width=80)[1]
    assert overview.table([row("/a/topic/wider/than/this", 1.0)], "", width=12)[1] == "...than/this"


def test_slots_are_reported_instead_of_the_depth(topic, shmgen):
    """Report slots, because depth 4 and depth 7 both need eight slots."""
    with PosePublisher(topic, depth=4):
        assert read_row(shmgen, topic)["slots"] == 8
        (region,) = [region for region in json.loads(shmgen("topics", "--json").stdout) if region["topic"] == topic]
        assert (region["slots"], "depth" in region) == (8, False)
        assert "payload: 56 bytes, 8 slots" in shmgen("info", topic).stdout
        assert f"{topic}  geometry_msgs/msg/Pose, 8 slots, " in shmgen("doctor", topic).stdout


def test_columns_keep_their_position_between_tables():
    """Keep the columns while rates, the sort order and the regions change."""
    before = {}
    first = overview.table([row("/a", None)], "topic", None, before)
    for rate, column in ((9.9, "rate"), (10.0, "age"), (999.9, "lock"), (1000.0, "type"), (0.0, "topic")):
        lines = overview.table([row("/a", rate)], column, None, before)
        assert len(lines[1]) == len(first[1])
        assert [title.start() for title in re.finditer(r"[A-Z]\b", lines[0].replace("*", " "))] == [
            title.start() for title in re.finditer(r"[A-Z]\b", first[0].replace("*", " "))
        ]
    wide = overview.table([row("/a", 12345.6), row("/a/long/name", 1.0)], "", None, before)
    assert len(overview.table([row("/a", 1.0)], "", None, before)[1]) == len(wide[1])
    narrow = overview.table([row("/a", 1.0)], "", 70, before)
    assert [len(line) for line in overview.table([row("/a", 12345.6)], "", 70, before)] == [
        len(line) for line in narrow
    ]


class Terminal:
    """`shmgen top` on a terminal of 80 by 24 characters."""

    def __init__(self, folder):
        self.leader, follower = pty.openpty()
        termios.tcsetwinsize(follower, (24, 80)) if hasattr(termios, "tcsetwinsize") else None
        self.before = termios.tcgetattr(follower)
        self.follower = follower
        environment = {**os.environ, "TERM": "xterm", "COLUMNS": "80", "LINES": "24"}
        command = [sys.executable, "-m", "shmgen", "top", "-d", "0.2"]
        self.process = subprocess.Popen(
            command, stdin=follower, stdout=follower, stderr=follower, cwd=folder, env=environment
        )
        self.output = ""

    def until(self, pattern):
        self.output = ""
        deadline = time.monotonic() + 20
        while not re.search(pattern, self.output, re.DOTALL):
            assert time.monotonic() < deadline, self.output
            if select.select([self.leader], [], [], 0.2)[0]:
                self.output += os.read(self.leader, 65536).decode()

    def press(self, keys):
        os.write(self.leader, keys.encode())

    def close(self):
        self.process.kill()
        self.process.wait()
        os.close(self.leader)
        os.close(self.follower)


def test_top_reacts_to_keys_on_a_terminal(topic, tmp_path):
    with PosePublisher(topic) as publisher:
        publisher.publish(pose(1.0))
        terminal = Terminal(tmp_path)
        try:
            terminal.until(r"\x1b\[\?1049h.*TOPIC\*.*/shmgen_test/t")
            terminal.press("s\x1b[A")
            terminal.until(r"RATE\*")
            terminal.press("ss")
            terminal.until(r"a wider terminal shows [A-Z, ]*LOCK, MISSED, RECOVERIES")
            terminal.press("rq")
            terminal.until(r"\x1b\[\?25h\x1b\[\?1049l$")
            assert terminal.process.wait(10) == 0
            assert termios.tcgetattr(terminal.follower) == terminal.before
        finally:
            terminal.close()


def test_top_restores_the_terminal_on_sigterm(tmp_path):
    terminal = Terminal(tmp_path)
    try:
        terminal.until(r"TOPIC\*")
        assert termios.tcgetattr(terminal.follower) != terminal.before
        terminal.process.terminate()
        terminal.until(r"\x1b\[\?1049l$")
        assert terminal.process.wait(10) == 143
        assert termios.tcgetattr(terminal.follower) == terminal.before
    finally:
        terminal.close()
