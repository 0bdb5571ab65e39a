"""What happens to a message on its way, without any ROS: real regions, plain objects with ROS's attributes."""

from __future__ import annotations

import threading
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
    """One topic with both its ends in hand."""

    def __init__(self, folder: Path, topic: str, keys: str = "", direction: str = "to_plc") -> None:
        for name, text in (("Path", PATH), ("Mark", MARK)):
            file = folder / "msgs" / "cell_msgs" / "msg" / f"{name}.msg"
            file.parent.mkdir(parents=True, exist_ok=True)
            file.write_text(text)
        (folder / "shmgen.toml").write_text(
            f'path = ["msgs"]\n[[topics]]\ntopic = "{topic}"\ntype = "cell_msgs/Path"\n'
            f'direction = "{direction}"\n{keys}\n'
        )
        self.told: list[str] = []
        self.stopping = threading.Event()
        self.config = load(folder / "shmgen.toml", "shmgen.toml", Report())
        (self.route,) = plan.routes(Session(self.config))
        self.counters = Counters(topic, self.told.append)
        self.sent: list[Any] = []
        self.side = (ToPlc if self.route.to_plc else FromPlc)(self.route, self.counters, self.stopping)
        assert self.side.end.attempted.wait(10)

    def start(self, send: Callable[[Any], None] | None = None) -> None:
        """Joins what looks like a ROS."""
        self.side.start(
            SimpleNamespace(  # type: ignore[arg-type]
                publisher=lambda wire: RosPublisher(message, send or (lambda sent: self.sent.append(deepcopy(sent)))),
                subscribe=lambda wire, callback: RosSubscription(message),
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
        self.stopping.set()
        self.side.stop()
        self.side.end.close()


@pytest.fixture
def line(tmp_path: Path, topic: str) -> Iterator[Callable[..., Line]]:
    made: list[Line] = []

    def make(keys: str = "", direction: str = "to_plc") -> Line:
        made.append(Line(tmp_path, topic, keys, direction))
        return made[-1]

    yield make
    for one in made:
        one.close()


def message(**values: Any) -> SimpleNamespace:
    """As a ROS has it."""
    header = SimpleNamespace(stamp=SimpleNamespace(sec=0, nanosec=0), frame_id="")
    return SimpleNamespace(**{"header": header, "name": "", "marks": [], "level": 0, **values})


def mark(text: str = "", words: tuple[str, ...] = ()) -> SimpleNamespace:
    return SimpleNamespace(text=text, words=list(words), at=[0.0, 0.0])


def soon(condition: Callable[[], Any]) -> None:
    deadline = time.monotonic() + 10
    while not condition():
        assert time.monotonic() < deadline
        time.sleep(0.002)


def test_what_does_not_fit_is_counted_and_told_once_in_a_while(line: Callable[..., Line]) -> None:
    one = line()
    with one.reader() as reader:
        one.side.take(message(name="fits"))
        for _ in range(100):
            one.side.take(message(name="does not fit"))
        one.side.take(message(marks=[mark(), mark(words=("abcd",))]))
        one.side.take(message(level=300))
        assert reader.read().name == "fits"
        assert reader.read() is None
    assert (one.counters.passed, one.counters.rejected) == (1, 102)
    assert len(one.told) == 1
    assert "rejected: name: 12 bytes of UTF-8, capacity 8" in one.told[0]
    assert one.counters.complaint == "rejected: level: 300; uint8 goes from 0 to 255"


def test_too_long_is_cut_where_that_is_wanted(line: Callable[..., Line]) -> None:
    one = line('overflow = "truncate"')
    too_much = [mark("Grüße, Welt", ("abcd", "ä€", "x")), mark("\N{GRINNING FACE}" * 3), mark("third")]
    with one.reader() as reader:
        one.side.take(message(name="Straßenbahn", marks=too_much, level=7))
        got = reader.read()
    assert got.name == "Straßen"  # 8 bytes of UTF-8
    assert [item.text for item in got.marks] == ["Grüß", "\N{GRINNING FACE}" * 2]
    assert [list(item.words) for item in got.marks] == [["abc", "ä"], []]
    assert got.level == 7
    assert (one.counters.passed, one.counters.truncated, one.counters.rejected) == (1, 1, 0)
    assert "truncated: name: 12 bytes" in one.told[0]


def test_what_has_a_gap_behind_its_count_is_cut_too() -> None:
    config = Config(Path.cwd(), bounds=Bounds({}, {"sensor_msgs": Bound(2, Span("x"))}))
    kind = Session(config).message("sensor_msgs/JointState")
    assert any(step.offset > step.count_at + 4 > 4 for step in kind._steps_), "there is no gap"
    joints = SimpleNamespace(
        header=SimpleNamespace(stamp=None, frame_id=""), name=[], position=[1.0, 2.0, 3.0], velocity=[], effort=[]
    )
    cut(joints, kind)
    assert joints.position == [1.0, 2.0]


def test_what_cutting_does_not_mend_is_rejected(line: Callable[..., Line]) -> None:
    one = line('overflow = "truncate"')
    wrong = mark()
    wrong.at = [0.0, 0.0, 0.0]
    one.side.take(message(marks=[wrong]))
    assert (one.counters.passed, one.counters.rejected) == (0, 1)
    assert "marks[0].at: 3 elements" in one.told[0]


def test_a_rate_towards_the_plc_lets_the_newest_through(line: Callable[..., Line]) -> None:
    """Not only every n-th: the last of a burst must not be lost for ever."""
    one = line("rate = 20\ndepth = 60")
    one.start()
    with one.reader() as reader:
        begun = time.monotonic()
        for number in range(50):
            one.side.take(message(level=number))
            time.sleep(0.005)
        got: list[int] = []
        soon(lambda: got.extend(one.level for one in reader.read_all()) or 49 in got)
        took = time.monotonic() - begun
    assert got == sorted(got)
    assert 2 <= len(got) <= took * 20 + 2
    assert one.counters.passed + one.counters.rate_limited == 50


def test_a_rate_towards_ros_lets_the_newest_through(line: Callable[..., Line]) -> None:
    one = line("rate = 20", "from_plc")
    one.start()
    with one.writer() as writer:
        begun = time.monotonic()
        for number in range(50):
            writer.publish(message(level=number))
            time.sleep(0.005)
        soon(lambda: one.sent and one.sent[-1].level == 49)
        took = time.monotonic() - begun
    assert 2 <= len(one.sent) <= took * 20 + 2
    assert one.counters.passed + one.counters.rate_limited == 50
    assert one.counters.missed == 0


def test_each_message_of_a_burst_crosses(line: Callable[..., Line]) -> None:
    one = line("depth = 200", "from_plc")
    one.start()
    with one.writer() as writer:
        for number in range(200):
            writer.publish(message(level=number))
        soon(lambda: len(one.sent) == 200)
    assert [got.level for got in one.sent] == list(range(200))
    assert str(one.counters) == "200 passed"


def test_a_stamp_of_zero_becomes_now(line: Callable[..., Line]) -> None:
    one = line("depth = 3", "from_plc")
    one.start()
    set_by_the_plc = message()
    set_by_the_plc.header.stamp = SimpleNamespace(sec=int(time.time()), nanosec=0)
    with one.writer() as writer:
        writer.publish(message())
        writer.publish(set_by_the_plc)
        soon(lambda: len(one.sent) == 2)
    assert vars(one.sent[0].header.stamp) == {"sec": 77, "nanosec": 5}
    assert vars(one.sent[1].header.stamp) == vars(set_by_the_plc.header.stamp)


def test_a_stamp_of_zero_may_stay(line: Callable[..., Line]) -> None:
    one = line('stamp = "keep"', "from_plc")
    one.start()
    with one.writer() as writer:
        writer.publish(message())
        soon(lambda: one.sent)
    assert vars(one.sent[0].header.stamp) == {"sec": 0, "nanosec": 0}


@pytest.mark.parametrize(("keys", "levels"), [("", [2]), ("latch = true", [1, 2])])
def test_what_was_said_before_is_heard_only_where_it_is_latched(
    line: Callable[..., Line], topic: str, keys: str, levels: list[int]
) -> None:
    line(keys, "from_plc").close()
    with line(keys, "from_plc").writer() as writer:
        writer.publish(message(level=1))
        one = line(keys, "from_plc")
        one.start()
        time.sleep(0.2)
        writer.publish(message(level=2))
        soon(lambda: len(one.sent) >= len(levels))
    assert [got.level for got in one.sent] == levels


def test_whatever_ros_raises_costs_one_message_only(line: Callable[..., Line]) -> None:
    one = line("", "from_plc")

    def send(what: Any) -> None:
        if what.level == 1:
            raise KeyError("odd")
        one.sent.append(what)

    one.start(send)
    with one.writer() as writer:
        for number in (1, 2):
            writer.publish(message(level=number))
            soon(lambda number=number: one.counters.passed + one.counters.rejected == number)
    assert [got.level for got in one.sent] == [2]
    assert one.told == [f"{one.counters.topic}: rejected by ROS: KeyError: 'odd'"]


def test_a_count_that_no_plc_should_write_is_rejected_with_its_field(line: Callable[..., Line]) -> None:
    one = line("", "from_plc")
    one.start()
    with one.writer() as writer:
        broken = one.route.kind(marks=[])
        broken._marks_count = 9
        writer.publish(broken)
        soon(lambda: one.counters.rejected)
    assert "marks: the writer says 9 elements" in one.told[0]


def test_a_region_that_was_removed_is_made_again(line: Callable[..., Line], topic: str) -> None:
    there, back = line("depth = 4"), None
    with there.reader():
        Path(region_file(region_name(topic))).unlink()
        soon(lambda: there.side.beat() or there.side.end.current.reopen_count)
    with there.reader() as reader:
        there.side.take(message(level=3))
        assert reader.read().level == 3
    there.close()
    back = line("depth = 4", "from_plc")
    back.start()
    Path(region_file(region_name(topic))).unlink()
    with back.writer() as writer:
        writer.publish(message(level=4))
        soon(lambda: back.sent)
    assert back.sent[0].level == 4


def test_a_region_that_was_replaced_by_another_layout_comes_back(line: Callable[..., Line], topic: str) -> None:
    one = line("depth = 4")
    file = Path(region_file(region_name(topic)))
    with PosePublisher(f"{topic}_other", depth=4):
        Path(region_file(region_name(f"{topic}_other"))).rename(file)
    for _ in range(20):
        one.side.take(message())
        one.side.beat()
        time.sleep(0.02)
    file.unlink()
    soon(lambda: one.side.take(message()) or (one.side.end.current and file.exists()))
    with one.reader() as reader:
        soon(lambda: one.side.take(message(level=3)) or reader.read())


def test_a_second_writer_waits_until_the_first_has_gone(line: Callable[..., Line]) -> None:
    first, second = line(), line()
    assert (second.status().level, second.side.end.current) == (ERROR, None)
    assert "publishes already; one writer a topic" in second.status().message
    first.close()
    soon(lambda: second.side.end.current)
    assert len(second.told) == 2
    assert second.told[-1].endswith(": the region is open again")
    assert second.status().level == OK


def test_levels_of_diagnostics(line: Callable[..., Line], topic: str) -> None:
    one = line("stale = 0.2")
    reporter = Reporter("bridge")

    def status() -> tuple[int, str]:
        found = reporter.status(one.side)
        return found.level, found.message

    assert status() == (STALE, "no message from ROS for 0.2 s or more")
    one.side.take(message())
    assert status()[0] == OK
    one.side.take(message(name="does not fit"))
    assert status() == (WARN, "rejected: name: 12 bytes of UTF-8, capacity 8")
    assert status()[0] == OK  # of what came since
    time.sleep(0.25)
    assert status()[0] == STALE
    one.side.end.close()
    assert status()[0] == ERROR
    shown = {value.key: value.value for value in one.status().values}
    assert shown["region"] == f"/dev/shm/{region_name(topic)}"
    assert (shown["passed"], shown["rejected"], shown["type"]) == ("1", "1", "cell_msgs/Path")
    assert 0.2 < float(shown["age [s]"]) < 10


def test_the_plc_sees_a_ros_that_fell_silent(line: Callable[..., Line]) -> None:
    """The heartbeat stands for ROS, not only for the bridge."""
    one = line("stale = 0.1")
    with one.reader() as reader:
        assert reader.is_stale(0)
        one.side.take(message())
        one.side.beat()
        assert not reader.is_stale(5)
        time.sleep(0.15)
        before = region_of(reader).words[38]
        one.side.beat()
        assert region_of(reader).words[38] == before
        one.side.take(message())
        one.side.beat()
        assert region_of(reader).words[38] != before


def test_a_plc_whose_heartbeat_stands_still_is_stale(line: Callable[..., Line]) -> None:
    one = line("stale = 0.1", "from_plc")
    one.start()
    with one.writer() as writer:
        for _ in range(20):
            writer.heartbeat()
            one.side.beat()
            time.sleep(0.01)
        assert one.status().level == OK
        time.sleep(0.15)
        one.side.beat()
        assert (one.status().level, one.status().message) == (
            STALE,
            "the PLC's heartbeat has not changed for 0.1 s or more",
        )


def test_a_type_of_several_messages_is_refused(tmp_path: Path, topic: str) -> None:
    service = tmp_path / "cell_msgs" / "srv" / "Start.srv"
    service.parent.mkdir(parents=True)
    service.write_text("bool now\n---\nbool done\n")
    (tmp_path / "shmgen.toml").write_text(f'path = ["."]\n[[topics]]\ntopic = "{topic}"\ntype = "cell_msgs/Start"\n')
    with pytest.raises(Rejected, match="is not a message"):
        plan.routes(Session(load(tmp_path / "shmgen.toml", "shmgen.toml", Report())))


def test_messages_of_another_definition_are_known_at_once(line: Callable[..., Line]) -> None:
    route = line().route
    plan.check(route, message())
    other = message()
    del other.level
    with pytest.raises(ValueError, match=r"cell_msgs/Path of this ROS differs from shmgen's definition: .*'level'"):
        plan.check(route, other)
