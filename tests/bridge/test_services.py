"""Services of a real ROS 1 through the bridge, both ways; Python plays the PLC here, over the regions."""

from __future__ import annotations

import re
import threading
import time
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from shmgen.bridge.plan import CallRoute, services
from shmgen.config import load
from shmgen.core.diagnostics import Report
from shmgen.live.session import Session
from shmgen.runtime import CallFailed, Publisher, ServiceClient, ServiceServer, Subscriber

from ..support.ros1 import LIMIT, Bridge, Graph

START = "Part[] parts\ntime when\n---\nint32 count\nstring text\n"
SETBOOL = "bool data # e.g. for hardware enabling / disabling\n---\nbool success\nstring message\n"
CONFIG = """
source = "noetic"
path = ["msgs"]
[bounds]
cell_msgs = 4
[strings]
default = 16
[[services]]
service = "{space}/flag"
type = "std_srvs/SetBool"
timeout = 2.0
[[services]]
service = "{space}/start"
type = "cell_msgs/Start"
timeout = 0.5
[[services]]
service = "{space}/fetch"
type = "cell_msgs/Start"
server = "ros"
timeout = 2.0
"""


class Cell:
    """The graph, the bridge, and the PLC's ends of its services."""

    def __init__(self, graph: Graph, space: str) -> None:
        part = "string name\nfloat32 size\n"
        graph.generate("cell_msgs", {"srv/Start.srv": START, "msg/Part.msg": part})
        definition = graph.folder / "msgs" / "std_srvs" / "srv" / "SetBool.srv"
        definition.parent.mkdir(parents=True)
        definition.write_text(SETBOOL)
        self.graph, self.space = graph, space
        self.bridge: Bridge = graph.bridge(CONFIG.format(space=space))
        config = load(graph.folder / "shmgen.toml", "shmgen.toml", Report())
        self.routes = {route.entry.name.rpartition("/")[2]: route for route in services(Session(config))}

    def serve(self, name: str, handler: Callable[[Any], Any]) -> threading.Event:
        """In a thread, until the event is set."""
        route = self.routes[name]
        kinds = {
            "request_subscriber": end(Subscriber, route, "_Request"),
            "reply_publisher": end(Publisher, route, "_Reply"),
        }
        server = type("Server", (ServiceServer,), kinds)(route.entry.name)
        stop = threading.Event()

        def run() -> None:
            with server:
                while not stop.is_set():
                    server.serve(handler, timeout=0.05)

        threading.Thread(target=run, daemon=True).start()
        return stop

    def client(self, name: str) -> ServiceClient[Any, Any]:
        route = self.routes[name]
        kinds = {
            "request_publisher": end(Publisher, route, "_Request"),
            "reply_subscriber": end(Subscriber, route, "_Reply"),
        }
        made: ServiceClient[Any, Any] = type("Client", (ServiceClient,), kinds)(route.entry.name)
        return made

    def call(self, name: str, values: str) -> str:
        """`rosservice call`."""
        done = self.graph.command("rosservice", "call", f"{self.space}/{name}", values)
        return str(done.communicate(timeout=LIMIT)[0]) + (self.graph.folder / "log").read_text()


def end(base: Any, route: CallRoute, part: str) -> Any:
    return type("End", (base,), {"message_type": route.kinds[part]})


@pytest.fixture
def cell(graph: Graph, space: str) -> Cell:
    return Cell(graph, space)


def test_both_ways(cell: Cell) -> None:
    """Answered, failed and not answered at all, with a type that is installed and one that is not."""
    stop = cell.serve(
        "flag", lambda request: SimpleNamespace(success=request.data, message="on" if request.data else "")
    )
    shown = cell.call("flag", "data: true")
    assert "success: True" in shown
    assert 'message: "on"' in shown

    seen: list[Any] = []

    def start(request: Any) -> Any:
        seen.append([(part.name, part.size) for part in request.parts])
        if len(request.parts) == 1:
            raise RuntimeError("told to")
        return SimpleNamespace(count=len(request.parts), text="started")

    stopping = cell.serve("start", start)
    shown = cell.call("start", "{parts: [{name: a, size: 1.5}, {name: b}], when: 0}")
    assert "count: 2" in shown
    assert 'text: "started"' in shown
    assert seen == [[("a", 1.5), ("b", 0.0)]]

    shown = cell.call("start", "{parts: [{name: a}], when: 0}")
    assert re.search(r"the server reported that call \d+ failed", shown)
    shown = cell.call("start", "{parts: [{name: much too long a name}, {}], when: 0}")
    assert "service cannot process request: parts[0].name: 20 bytes of UTF-8, capacity 16" in shown
    stopping.set()
    stop.set()
    cell.bridge.wait_for_line("/start: .* failed")

    peer = cell.graph.peer()
    answers = [{"count": 7, "text": "seven"}, None, {"count": 8, "text": "no room for so long a text"}, {"count": 9}]
    with cell.client("fetch") as plc:
        request = SimpleNamespace(parts=[], when=SimpleNamespace(secs=5, nsecs=0))
        with pytest.raises(CallFailed):
            plc.call(request, LIMIT)  # nobody serves it in ROS
        peer.ask(do="serve", service=f"{cell.space}/fetch", type="cell_msgs/Start", answers=answers)
        response = plc.call(request, LIMIT)
        assert (response.count, response.text) == (7, "seven")
        for _ in range(2):
            with pytest.raises(CallFailed):
                plc.call(request, LIMIT)
        assert plc.call(request, LIMIT).count == 9

    cell.graph.stop_master()
    cell.bridge.wait_for_line("the ROS master is unreachable")
    cell.graph.start_master()
    cell.bridge.wait_for_line("registering again")
    again = cell.serve("flag", lambda request: SimpleNamespace(success=False, message="again"))
    assert 'message: "again"' in cell.call("flag", "data: true")
    again.set()

    # Somebody removes the regions, and the PLC makes new ones.
    time.sleep(0.2)  # the server that was `again` lets go
    for file in Path("/dev/shm").glob(f"*{cell.space[1:]}.*"):
        file.unlink()
    time.sleep(0.5)
    anew = cell.serve("flag", lambda request: SimpleNamespace(success=True, message="anew"))
    assert 'message: "anew"' in cell.call("flag", "data: true")
    anew.set()
    peer = cell.graph.peer()
    peer.ask(do="serve", service=f"{cell.space}/fetch", type="cell_msgs/Start", answers=[{"count": 10}])
    with cell.client("fetch") as plc:
        assert plc.call(request, LIMIT).count == 10

    cell.bridge.stop(15)
    cell.bridge.wait_for_line("/flag +3 passed$")
    cell.bridge.wait_for_line("/start +1 passed, 1 rejected, 1 failed")
    cell.bridge.wait_for_line("/fetch +3 passed, 1 rejected, 2 failed")


def test_a_plc_that_is_off_costs_its_timeout_and_no_more(cell: Cell) -> None:
    shown = cell.call("start", "{parts: [], when: 0}")
    assert "no server within 0.5 s; the request was not sent" in shown
