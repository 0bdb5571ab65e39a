"""Test services of a real ROS 1 through the bridge, both ways. Python replaces the PLC at the regions."""

from __future__ import annotations

import re
import threading
import time
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from shmgen.bridge.plan import services
from shmgen.config import load
from shmgen.core.diagnostics import Report
from shmgen.live.classes import call_class
from shmgen.live.session import Session
from shmgen.runtime import CallFailed, ServiceClient, ServiceServer

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
    """The graph, the bridge, and the PLC's servers and clients."""

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
        """Serve in a thread until the returned event is set."""
        route = self.routes[name]
        server = call_class(ServiceServer, route.kinds)(route.entry.name)
        stop = threading.Event()

        def run() -> None:
            with server:
                while not stop.is_set():
                    server.serve(handler, timeout=0.05)

        threading.Thread(target=run, daemon=True).start()
        return stop

    def client(self, name: str) -> ServiceClient[Any, Any]:
        route = self.routes[name]
        return call_class(ServiceClient, route.kinds)(route.entry.name)

    def call(self, name: str, values: str) -> str:
        """Run `rosservice call`, and return its output and the log of errors."""
        process = self.graph.command("rosservice", "call", f"{self.space}/{name}", values)
        return str(process.communicate(timeout=LIMIT)[0]) + (self.graph.folder / "log").read_text()


@pytest.fixture
def cell(graph: Graph, space: str) -> Cell:
    return Cell(graph, space)


def test_services_pass_both_ways(cell: Cell) -> None:
    """Answer calls, fail them, and leave them unanswered, with an installed type and with one that is not installed."""
    stop = cell.serve(
        "flag", lambda request: SimpleNamespace(success=request.data, message="on" if request.data else "")
    )
    output = cell.call("flag", "data: true")
    assert "success: True" in output
    assert 'message: "on"' in output

    requests: list[Any] = []

    def start(request: Any) -> Any:
        requests.append([(part.name, part.size) for part in request.parts])
        if len(request.parts) == 1:
            raise RuntimeError("told to")
        return SimpleNamespace(count=len(request.parts), text="started")

    stopping = cell.serve("start", start)
    output = cell.call("start", "{parts: [{name: a, size: 1.5}, {name: b}], when: 0}")
    assert "count: 2" in output
    assert 'text: "started"' in output
    assert requests == [[("a", 1.5), ("b", 0.0)]]

    output = cell.call("start", "{parts: [{name: a}], when: 0}")
    assert re.search(r"the server reported that call \d+ failed", output)
    output = cell.call("start", "{parts: [{name: much too long a name}, {}], when: 0}")
    assert "service cannot process request: parts[0].name: 20 bytes of UTF-8, capacity 16" in output
    stopping.set()
    stop.set()
    cell.bridge.wait_for_line("/start: .* failed")

    peer = cell.graph.peer()
    answers = [{"count": 7, "text": "seven"}, None, {"count": 8, "text": "no room for so long a text"}, {"count": 9}]
    with cell.client("fetch") as plc:
        request = SimpleNamespace(parts=[], when=SimpleNamespace(secs=5, nsecs=0))
        with pytest.raises(CallFailed):
            plc.call(request, LIMIT)  # ROS has no server yet
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
    stop_again = cell.serve("flag", lambda request: SimpleNamespace(success=False, message="again"))
    assert 'message: "again"' in cell.call("flag", "data: true")
    stop_again.set()

    # Remove the regions; the PLC recreates them.
    time.sleep(0.2)  # until the last server has closed its regions
    for file in Path("/dev/shm").glob(f"*{cell.space[1:]}.*"):
        file.unlink()
    time.sleep(0.5)
    stop_anew = cell.serve("flag", lambda request: SimpleNamespace(success=True, message="anew"))
    assert 'message: "anew"' in cell.call("flag", "data: true")
    stop_anew.set()
    peer = cell.graph.peer()
    peer.ask(do="serve", service=f"{cell.space}/fetch", type="cell_msgs/Start", answers=[{"count": 10}])
    with cell.client("fetch") as plc:
        assert plc.call(request, LIMIT).count == 10

    cell.bridge.stop(15)
    cell.bridge.wait_for_line("/flag +3 passed$")
    cell.bridge.wait_for_line("/start +1 passed, 1 rejected, 1 failed")
    cell.bridge.wait_for_line("/fetch +3 passed, 1 rejected, 2 failed")


def test_call_to_a_stopped_plc_fails_after_its_timeout(cell: Cell) -> None:
    output = cell.call("start", "{parts: [], when: 0}")
    assert "no server within 0.5 s; the request was not sent" in output
