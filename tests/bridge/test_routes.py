"""Test the path of a message through the bridge without ROS: real regions, and plain objects as ROS messages."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from copy import deepcopy
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from shmgen.bridge import plan
from shmgen.bridge.backend import RosPublisher, RosSubscription
from shmgen.bridge.codec.cut import cut
from shmgen.bridge.common.counters import Counters
from shmgen.bridge.diagnostics import ERROR, OK, STALE, WARN, Reporter
from shmgen.bridge.topics import FromPlc, ToPlc
from shmgen.config import Config, load
from shmgen.config.entries import Bound, Bounds
from shmgen.core.diagnostics import Rejected, Report, Span
from shmgen.live.classes import publisher, subscriber
from shmgen.live.session import Session
from shmgen.runtime import Publisher, Subscriber, Time, region_name
from shmgen.runtime.region.names import region_file
from tests.support.region_of import region_of

from ..runtime.messages import PosePublisher

PATH = """
std_msgs/Header header
string<=8 name
Mark[<=2] marks
uint8 level
"""
MARK = "wstring<=4 text\nstring<=3[<=2] words\nfloat64[2] at\n"


class Line:
    """A topic of the bridge whose ROS side is a plain object of the test."""

    def __init__(self, folder: Path, topic: str, keys: str = "", direction: str = "to_plc") -> None:
        for name, text in (("Path", PATH), ("Mark", MARK)):
            file = folder / "msgs" / "cell_msgs" / "msg" / f"{name}.msg"
            file.parent.mkdir(parents=True, exist_ok=True)
            file.write_text(text)
        (folder / "shmgen.toml").write_text(
            f'path = ["msgs"]\n[[topics]]\ntopic = "{topic}"\ntype = "cell_msgs/Path"\n'
            f'direction = "{direction}"\n{keys}\n'
        )
        self.log: list[str] = []
        self.config = load(folder / "shmgen.toml", "shmgen.toml", Report())
        (self.route,) = plan.routes(Session(self.config))
        self.counters = Counters(topic, self.log.append)
        self.sent: list[Any] = []
        self.side = (ToPlc if self.route.to_plc else FromPlc)(self.route, self.counters)
        assert self.side.end.attempted.wait(10)

    def start(self, send: Callable[[Any], None] | None = None) -> None:
        """Connect to a stand-in for ROS."""
        self.side.start(
            SimpleNamespace(  # type: ignore[arg-type]
                publisher=lambda wire: RosPublisher(message, send or (lambda sent: self.sent.append(deepcopy(sent)))),
                subscribe=lambda wire, take, errors: RosSubscription(message),
                now=lambda: Time(77, 5),
            )
        )

    def reader(self) -> Subscriber[Any]:
        return subscriber(self.route.kind, self.route.topic.topic, self.route.topic.depth)

    def writer(self) -> Publisher[Any]:
        return publisher(self.route.kind, self.route.topic.topic, self.route.topic.depth)

    def status(self) -> SimpleNamespace:
        return Reporter("bridge").status(self.side)

    def close(self) -> None:
        self.side.stopping.set()
        self.side.stop()
        self.side.end.close()


@pytest.fixture
def open_line(tmp_path: Path, topic: str) -> Iterator[Callable[..., Line]]:
    lines: list[Line] = []

    def open_line(keys: str = "", direction: str = "to_plc") -> Line:
        lines.append(Line(tmp_path, topic, keys, direction))
        return lines[-1]

    yield open_line
    for opened in lines:
        opened.close()


def message(**values: Any) -> SimpleNamespace:
    """Return an object with the attributes of a ROS message."""
    header = SimpleNamespace(stamp=SimpleNamespace(sec=0, nanosec=0), frame_id="")
    return SimpleNamespace(**{"header": header, "name": "", "marks": [], "level": 0, **values})


def mark(text: str = "", words: tuple[str, ...] = ()) -> SimpleNamespace:
    return SimpleNamespace(text=text, words=list(words), at=[0.0, 0.0])


def wait_until(condition: Callable[[], Any]) -> None:
    deadline = time.monotonic() + 10
    while not condition():
        assert time.monotonic() < deadline
        time.sleep(0.002)


def test_rejections_are_counted_and_logged_rate_limited(open_line: Callable[..., Line]) -> None:
    line = open_line()
    with line.reader() as reader:
        line.side.take(message(name="fits"))
        for _ in range(100):
            line.side.take(message(name="does not fit"))
        line.side.take(message(marks=[mark(), mark(words=("abcd",))]))
        line.side.take(message(level=300))
        assert reader.read().name == "fits"
        assert reader.read() is None
    assert (line.counters.passed, line.counters.rejected) == (1, 102)
    assert len(line.log) == 1
    assert "rejected: name: 12 bytes of UTF-8, capacity 8" in line.log[0]
    assert line.counters.complaint == "rejected: level: 300; uint8 goes from 0 to 255"


def test_overflow_truncate_shortens_long_values(open_line: Callable[..., Line]) -> None:
    line = open_line('overflow = "truncate"')
    long_marks = [mark("Grüße, Welt", ("abcd", "ä€", "x")), mark("\N{GRINNING FACE}" * 3), mark("third")]
    with line.reader() as reader:
        line.side.take(message(name="Straßenbahn", marks=long_marks, level=7))
        sample = reader.read()
    assert sample.name == "Straßen"  # 8 bytes of UTF-8
    assert [item.text for item in sample.marks] == ["Grüß", "\N{GRINNING FACE}" * 2]
    assert [list(item.words) for item in sample.marks] == [["abc", "ä"], []]
    assert sample.level == 7
    assert (line.counters.passed, line.counters.truncated, line.counters.rejected) == (1, 1, 0)
    assert "truncated: name: 12 bytes" in line.log[0]


def test_sequence_with_padding_after_its_count_is_truncated() -> None:
    config = Config(Path.cwd(), bounds=Bounds({}, {"sensor_msgs": Bound(2, Span("x"))}))
    kind = Session(config).message("sensor_msgs/JointState")
    assert any(step.offset > step.count_at + 4 > 4 for step in kind._steps_), "there is no gap"
    joints = SimpleNamespace(
        header=SimpleNamespace(stamp=None, frame_id=""), name=[], position=[1.0, 2.0, 3.0], velocity=[], effort=[]
    )
    cut(joints, kind)
    assert joints.position == [1.0, 2.0]


def test_wrong_array_length_is_rejected_despite_truncate(open_line: Callable[..., Line]) -> None:
    line = open_line('overflow = "truncate"')
    wrong_mark = mark()
    wrong_mark.at = [0.0, 0.0, 0.0]
    line.side.take(message(marks=[wrong_mark]))
    assert (line.counters.passed, line.counters.rejected) == (0, 1)
    assert "marks[0].at: 3 elements" in line.log[0]


def test_rate_to_the_plc_passes_the_newest_message(open_line: Callable[..., Line]) -> None:
    """Pass the last message of a burst too; a bridge that passes only every n-th message would drop it."""
    line = open_line("rate = 20\ndepth = 60")
    line.start()
    with line.reader() as reader:
        started_at = time.monotonic()
        for number in range(50):
            line.side.take(message(level=number))
            time.sleep(0.005)
        levels: list[int] = []
        wait_until(lambda: levels.extend(sample.level for sample in reader.read_all()) or 49 in levels)
        duration = time.monotonic() - started_at
    assert levels == sorted(levels)
    assert 2 <= len(levels) <= duration * 20 + 2
    assert line.counters.passed + line.counters.rate_limited == 50


def test_rate_to_ros_passes_the_newest_message(open_line: Callable[..., Line]) -> None:
    line = open_line("rate = 20", "from_plc")
    line.start()
    with line.writer() as writer:
        started_at = time.monotonic()
        for number in range(50):
            writer.publish(message(level=number))
            time.sleep(0.005)
        wait_until(lambda: line.sent and line.sent[-1].level == 49)
        duration = time.monotonic() - started_at
    assert 2 <= len(line.sent) <= duration * 20 + 2
    assert line.counters.passed + line.counters.rate_limited == 50
    assert line.counters.missed == 0


def test_every_message_of_a_burst_passes(open_line: Callable[..., Line]) -> None:
    line = open_line("depth = 200", "from_plc")
    line.start()
    with line.writer() as writer:
        for number in range(200):
            writer.publish(message(level=number))
        wait_until(lambda: len(line.sent) == 200)
    assert [sent.level for sent in line.sent] == list(range(200))
    assert str(line.counters) == "200 passed"


def test_zero_stamp_is_replaced_by_the_current_time(open_line: Callable[..., Line]) -> None:
    line = open_line("depth = 3", "from_plc")
    line.start()
    set_by_the_plc = message()
    set_by_the_plc.header.stamp = SimpleNamespace(sec=int(time.time()), nanosec=0)
    with line.writer() as writer:
        writer.publish(message())
        writer.publish(set_by_the_plc)
        wait_until(lambda: len(line.sent) == 2)
    assert vars(line.sent[0].header.stamp) == {"sec": 77, "nanosec": 5}
    assert vars(line.sent[1].header.stamp) == vars(set_by_the_plc.header.stamp)


def test_zero_stamp_stays_with_stamp_keep(open_line: Callable[..., Line]) -> None:
    line = open_line('stamp = "keep"', "from_plc")
    line.start()
    with line.writer() as writer:
        writer.publish(message())
        wait_until(lambda: line.sent)
    assert vars(line.sent[0].header.stamp) == {"sec": 0, "nanosec": 0}


@pytest.mark.parametrize(("keys", "levels"), [("", [2]), ("latch = true", [1, 2])])
def test_earlier_sample_is_sent_only_with_latch(
    open_line: Callable[..., Line], topic: str, keys: str, levels: list[int]
) -> None:
    open_line(keys, "from_plc").close()
    with open_line(keys, "from_plc").writer() as writer:
        writer.publish(message(level=1))
        line = open_line(keys, "from_plc")
        line.start()
        time.sleep(0.2)
        writer.publish(message(level=2))
        wait_until(lambda: len(line.sent) >= len(levels))
    assert [sent.level for sent in line.sent] == levels


def test_error_of_ros_loses_only_one_message(open_line: Callable[..., Line]) -> None:
    line = open_line("", "from_plc")

    def send(sent: Any) -> None:
        if sent.level == 1:
            raise KeyError("odd")
        line.sent.append(sent)

    line.start(send)
    with line.writer() as writer:
        for number in (1, 2):
            writer.publish(message(level=number))
            wait_until(lambda number=number: line.counters.passed + line.counters.rejected == number)
    assert [sent.level for sent in line.sent] == [2]
    assert line.log == [f"{line.counters.topic}: rejected by ROS: KeyError: 'odd'"]


def test_excessive_count_is_rejected_with_its_field(open_line: Callable[..., Line]) -> None:
    line = open_line("", "from_plc")
    line.start()
    with line.writer() as writer:
        broken = line.route.kind(marks=[])
        broken._marks_count = 9
        writer.publish(broken)
        wait_until(lambda: line.counters.rejected)
    assert "marks: the region has 9 elements" in line.log[0]


def test_removed_region_is_recreated(open_line: Callable[..., Line], topic: str) -> None:
    to_plc, from_plc = open_line("depth = 4"), None
    with to_plc.reader():
        Path(region_file(region_name(topic))).unlink()
        wait_until(lambda: to_plc.side.beat() or to_plc.side.end.current.reopen_count)
    with to_plc.reader() as reader:
        to_plc.side.take(message(level=3))
        assert reader.read().level == 3
    to_plc.close()
    from_plc = open_line("depth = 4", "from_plc")
    from_plc.start()
    Path(region_file(region_name(topic))).unlink()
    with from_plc.writer() as writer:
        writer.publish(message(level=4))
        wait_until(lambda: from_plc.sent)
    assert from_plc.sent[0].level == 4


def test_topic_recovers_from_a_region_of_another_layout(open_line: Callable[..., Line], topic: str) -> None:
    line = open_line("depth = 4")
    file = Path(region_file(region_name(topic)))
    with PosePublisher(f"{topic}_other", depth=4):
        Path(region_file(region_name(f"{topic}_other"))).rename(file)
    for _ in range(20):
        line.side.take(message())
        line.side.beat()
        time.sleep(0.02)
    file.unlink()
    wait_until(lambda: line.side.take(message()) or (line.side.end.current and file.exists()))
    with line.reader() as reader:
        wait_until(lambda: line.side.take(message(level=3)) or reader.read())


def test_second_writer_waits_until_the_first_closes(open_line: Callable[..., Line]) -> None:
    first, second = open_line(), open_line()
    assert (second.status().level, second.side.end.current) == (ERROR, None)
    assert "publishes already: stop it first" in second.status().message
    first.close()
    wait_until(lambda: second.side.end.current)
    assert len(second.log) == 2
    assert second.log[-1].endswith(": the region is open again")
    assert second.status().level == OK


def test_diagnostics_level_follows_the_topic(open_line: Callable[..., Line], topic: str) -> None:
    line = open_line("stale = 0.2")
    reporter = Reporter("bridge")

    def status() -> tuple[int, str]:
        status_ = reporter.status(line.side)
        return status_.level, status_.message

    assert status() == (STALE, "no message from ROS for 0.2 s or more")
    line.side.take(message())
    assert status()[0] == OK
    line.side.take(message(name="does not fit"))
    assert status() == (WARN, "rejected: name: 12 bytes of UTF-8, capacity 8")
    assert status()[0] == OK  # the level describes only messages since the last status
    time.sleep(0.25)
    assert status()[0] == STALE
    line.side.end.close()
    assert status()[0] == ERROR
    values = {value.key: value.value for value in line.status().values}
    assert values["region"] == f"/dev/shm/{region_name(topic)}"
    assert (values["passed"], values["rejected"], values["type"]) == ("1", "1", "cell_msgs/Path")
    assert 0.2 < float(values["age [s]"]) < 10


def test_heartbeat_stops_if_ros_is_silent(open_line: Callable[..., Line]) -> None:
    """Stop the heartbeat in the region if ROS is silent, even while the bridge runs."""
    line = open_line("stale = 0.1")
    with line.reader() as reader:
        assert reader.is_stale(0)
        line.side.take(message())
        line.side.beat()
        assert not reader.is_stale(5)
        time.sleep(0.15)
        before = region_of(reader).words[38]
        line.side.beat()
        assert region_of(reader).words[38] == before
        line.side.take(message())
        line.side.beat()
        assert region_of(reader).words[38] != before


def test_plc_without_a_changing_heartbeat_is_stale(open_line: Callable[..., Line]) -> None:
    line = open_line("stale = 0.1", "from_plc")
    line.start()
    with line.writer() as writer:
        for _ in range(20):
            writer.heartbeat()
            line.side.beat()
            time.sleep(0.01)
        assert line.status().level == OK
        time.sleep(0.15)
        line.side.beat()
        assert (line.status().level, line.status().message) == (
            STALE,
            "the PLC's heartbeat has not changed for 0.1 s or more",
        )


def test_service_type_is_refused_as_topic_type(tmp_path: Path, topic: str) -> None:
    service = tmp_path / "cell_msgs" / "srv" / "Start.srv"
    service.parent.mkdir(parents=True)
    service.write_text("bool now\n---\nbool done\n")
    (tmp_path / "shmgen.toml").write_text(f'path = ["."]\n[[topics]]\ntopic = "{topic}"\ntype = "cell_msgs/Start"\n')
    with pytest.raises(Rejected, match="is not a message"):
        plan.routes(Session(load(tmp_path / "shmgen.toml", "shmgen.toml", Report())))


def test_ros_message_of_another_definition_is_detected(open_line: Callable[..., Line]) -> None:
    route = open_line().route
    plan.check(route, message())
    other_message = message()
    del other_message.level
    with pytest.raises(ValueError, match=r"cell_msgs/Path of this ROS differs from shmgen's definition: .*'level'"):
        plan.check(route, other_message)
