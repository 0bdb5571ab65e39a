"""Clients and servers of a service or an action, in Python and in the soft PLC, that a test executes step by step.

Each response is the value of its request plus 1000.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from contextlib import nullcontext
from types import ModuleType, SimpleNamespace
from typing import Any

from tests.softplc import Plc

from .engines import in_python

DEFINITIONS = "plant_msgs/srv/Ask.srv", "plant_msgs/action/Count.action"
PATIENCE = 10.0
"""The time limit in seconds for opening regions and for the arrival of a request."""


def definitions(more: str = "") -> dict[str, str]:
    """Return the definitions of a service and an action. Their requests also have the fields `more`."""
    service, action = DEFINITIONS
    return {
        service: f"uint32 value\n{more}---\nuint32 value\n",
        action: f"uint32 value\n{more}---\nuint32 value\n---\nuint32 value\n",
    }


def until(condition: Callable[[], Any]) -> Any:
    """Call `condition` until its result is true, and return the result."""
    deadline = time.monotonic() + PATIENCE
    while not (result := condition()):
        assert time.monotonic() < deadline
        time.sleep(0.001)
    return result


class PythonClient:
    def __init__(self, package: ModuleType, name: str, acts: bool, pure: bool) -> None:
        with in_python() if pure else nullcontext():
            self._client = package.action.CountActionClient(name) if acts else package.srv.AskClient(name)
        self._acts = acts

    def send(self, value: int) -> None:
        """Send a request, whether a server is available or not."""
        request = SimpleNamespace(value=value, more=value)
        if self._acts:
            self._client._status = 0
            self._client._goal = self._client._calls.send_request(SimpleNamespace(cancel=0, goal=request))
        else:
            self._client.send(request)

    def response(self) -> int | None:
        """Return the value of a response or feedback that the client accepts, or None."""
        if self._acts and (feedback := self._client.feedback()):
            return int(feedback.value)
        response = self._client.poll()
        if response is None:
            return None
        return int(response.result.value if self._acts else response.value)

    def stop(self) -> None:
        self._client.close()


class PythonServer:
    def __init__(self, package: ModuleType, name: str, acts: bool, pure: bool) -> None:
        with in_python() if pure else nullcontext():
            self._server = package.action.CountActionServer(name) if acts else package.srv.AskServer(name)
        self._acts = acts
        self._call: Any = None

    def takes(self) -> bool:
        """Look for a request. Return True if the server has taken one."""
        self._call = self._server.take()
        return self._call is not None

    def respond(self) -> None:
        response = SimpleNamespace(value=self._call.request.value + 1000)
        if self._acts:
            self._call.publish_feedback(response)
            self._call.succeed(response)
        else:
            self._server.reply(self._call, response)

    def stop(self) -> None:
        self._server.close()


class PlcClient:
    """A client in the soft PLC. After stop(), the PLC runs no more cycles and releases nothing."""

    def __init__(self, plc: Plc, name: str, acts: bool) -> None:
        self._block = plc.block("FB_plant_msgs_Count_ActionClient" if acts else "FB_plant_msgs_Ask_Client")
        self._block.xEnable = True
        self._acts = acts
        setattr(self._block, "sAction" if acts else "sService", name)

    def send(self, value: int) -> None:
        block = self._block
        block(xExecute=False)
        (block.Goal if self._acts else block.Request).value = value
        until(lambda: block(xExecute=True, tTimeout=0) and (block.udiGoal if self._acts else block.udiCall))

    def response(self) -> int | None:
        block = self._block
        block()
        if self._acts and block.xNewFeedback:
            return int(block.Feedback.value)
        return int((block.Result if self._acts else block.Response).value) if block.xDone else None

    def stop(self) -> None:
        pass


class PlcServer:
    def __init__(self, plc: Plc, name: str, acts: bool) -> None:
        self._block = plc.block("FB_plant_msgs_Count_ActionServer" if acts else "FB_plant_msgs_Ask_Server")
        self._block.xEnable = True
        self._acts = acts
        setattr(self._block, "sAction" if acts else "sService", name)
        until(lambda: not self._block().xBusy)

    def takes(self) -> bool:
        return bool(self._block(xDone=False).xExecute)

    def respond(self) -> None:
        block = self._block
        value = (block.Goal if self._acts else block.Request).value + 1000
        (block.Result if self._acts else block.Response).value = value
        if self._acts:
            block.Feedback.value = value
            block()
        block(xDone=True)
        block(xDone=False)

    def stop(self) -> None:
        pass
