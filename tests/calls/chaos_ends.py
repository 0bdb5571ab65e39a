"""The clients and servers of the calls chaos, for a service and for an action, in Python and in the soft PLC.

Each end runs in a separate process until it is killed. A response is a function of its request, so a client detects a
response to another request at once. Ends report events as entries of a kind and a number; see `Stage.report`.
"""

from __future__ import annotations

import os
import random
import struct
import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from types import ModuleType, SimpleNamespace
from typing import Any, TypeAlias

from shmgen import runtime
from tests.support.plc_calls import Calls

SLACK = 0.5
"""Seconds that a call may last beyond its timeout on a busy machine."""
CYCLE = 0.0002
"""Duration of a cycle in seconds."""
FIRST = 300, 0.3
"""Cycles of a client's first request, during which a new region can start, and the request's timeout in seconds."""
ENTRY = struct.Struct("<cI")


@dataclass
class Stage:
    """Data that the ends of one version share. `client_fault` and `server_fault` are suffixes of faulty block names."""

    calls: Calls
    srv: ModuleType
    action: ModuleType
    name: str
    reports: int
    client_fault: str = ""
    server_fault: str = ""

    def report(self, kind: bytes, value: int) -> None:
        """Report a served request (s), an old request (o), or how a call ended (r, w, f, t, n, c, e, l)."""
        os.write(self.reports, ENTRY.pack(kind, value & 0xFFFFFFFF))

    def newest(self, half: str) -> int:
        """Return the number of the newest request, or 0. The request is old for a server that starts now."""
        with suppress(runtime.RegionMissing):
            return runtime.read_header(f"{runtime.region_name(self.name)}-{half}").newest
        return 0

    def report_request(self, number: int, old: int) -> None:
        self.report(b"s" if is_later(number, old) else b"o", number)


Work: TypeAlias = Callable[[Stage, random.Random], None]


def is_later(number: int, than: int) -> bool:
    """Return True if a request was sent after another, although numbers wrap around."""
    return than == 0 or 0 < (number - than) % 2**32 < 2**31


def answer_to(question: int) -> int:
    return 3 * question + 1


def compute_reached(target: int) -> int:
    return target * 2654435761 & 0xFFFFFFFF


def compute_position(target: int) -> int:
    return target ^ 0x5A5A5A5A


# --- a service ---------------------------------------------------------------------------------------------


def serve(stage: Stage, dice: random.Random) -> None:
    old = stage.newest("request")
    with stage.srv.AskServer(stage.name) as server:
        while True:
            call = server.wait(0.2)
            if call is None:
                continue
            stage.report_request(call.number, old)
            time.sleep(call.request.cycles * CYCLE)
            if call.request.fail:
                server.fail(call)
            else:
                answer = answer_to(call.request.question)
                server.reply(call, SimpleNamespace(answer=answer, copies=[answer] * 16))


def plc_serve(stage: Stage, dice: random.Random) -> None:
    server = stage.calls.server(stage.name, stage.server_fault)
    job = stage.calls.plc.block("FB_Answer")
    old = stage.newest("request")
    while True:
        if server.xBusy or server.xError:  # not open yet, so a request that arrives now is old as well
            old = stage.newest("request")
        before = server.xExecute
        server(xDone=job.xDone, xFailed=job.xError)
        if server.xExecute and not before:
            stage.report_request(server.udiCall, old)
            job.Request.question, job.Request.cycles = server.Request.question, server.Request.cycles
            job.Request.fail = server.Request.fail
        job(xExecute=server.xExecute)
        if job.xDone:
            server.Response.answer = job.Response.answer
            for index in range(16):
                server.Response.copies[index] = job.Response.copies[index]
        time.sleep(CYCLE)


def ask(stage: Stage, dice: random.Random) -> None:
    """Send requests, and wait for a server before some of them."""
    cycles, timeout = FIRST
    with stage.srv.AskClient(stage.name) as client:
        while True:
            question, started_at = dice.getrandbits(60), time.monotonic()
            request = SimpleNamespace(question=question, cycles=cycles, fail=dice.random() < 0.05, more=0)
            kind = b"t"
            with suppress(runtime.CallTimeout):
                try:
                    response = client.call(request, timeout) if dice.random() < 0.6 else _poll(client, request, timeout)
                    kind = b"r" if _is_own(response, question) else b"w"
                except runtime.CallFailed:
                    kind = b"f"
                except runtime.NoServer:
                    kind = b"n"
            _report_end(stage, kind, question, started_at, timeout)
            cycles, timeout = _cycles(dice), _timeout(dice)
            time.sleep(dice.uniform(0.0, 0.002))


def plc_ask(stage: Stage, dice: random.Random) -> None:
    client = stage.calls.client(stage.name, stage.client_fault)()
    cycles, timeout = FIRST
    while True:
        question, started_at = dice.getrandbits(60), time.monotonic()
        request, cancel = client.Request, dice.random() < 0.1
        request.question, request.cycles, request.fail = question, cycles, dice.random() < 0.05
        client(xExecute=True, tTimeout=int(timeout * 1000), xCancel=False)
        while client.xBusy:
            time.sleep(CYCLE)
            client(xCancel=cancel and client.udiCall != 0 and dice.random() < 0.1)
        kind = b"r" if client.xDone and _is_own(client.Response, question) else b"w"
        _report_end(stage, kind if client.xDone else _failure_kind(client), question, started_at, timeout)
        client(xExecute=False)
        cycles, timeout = _cycles(dice), _timeout(dice)


# --- an action ---------------------------------------------------------------------------------------------


def act(stage: Stage, dice: random.Random) -> None:
    """Reject goals with a stride of 0, and end cancelled goals as canceled."""
    old = stage.newest("goal")
    with stage.action.CountActionServer(stage.name) as server:
        while True:
            goal = server.wait(0.2)
            if goal is None:
                continue
            stage.report_request(goal.number, old)
            target = goal.request.target
            if goal.request.stride == 0:
                goal.reject()
                continue
            goal.accept()
            for _ in range(goal.request.stride - 1):
                goal.publish_feedback(SimpleNamespace(position=compute_position(target)))
                time.sleep(CYCLE)
                if goal.is_cancel_requested:
                    break
            if goal.is_cancel_requested:
                goal.canceled(SimpleNamespace(reached=compute_reached(target)))
            else:
                goal.succeed(SimpleNamespace(reached=compute_reached(target)))


def plc_act(stage: Stage, dice: random.Random) -> None:
    server = stage.calls.action_server(stage.name)
    old, cycles_left = stage.newest("goal"), 0
    while True:
        if server.xBusy or server.xError:
            old = stage.newest("goal")
        before, busy = server.xExecute, server.xExecute and cycles_left > 0
        rejects = server.xExecute and server.Goal.stride == 0
        server(
            xDone=server.xExecute and not busy and not rejects,
            xReject=rejects,
            xAborted=busy and server.xCancel,
        )
        cycles_left -= 1
        if server.xExecute and not before:
            stage.report_request(server.udiGoal, old)
            cycles_left = server.Goal.stride - 1
            server.Feedback.position = compute_position(server.Goal.target)
            server.Result.reached = compute_reached(server.Goal.target)
        time.sleep(CYCLE)


def send_goals(stage: Stage, dice: random.Random) -> None:
    stride, timeout = FIRST
    with stage.action.CountActionClient(stage.name) as client:
        while True:
            target, started_at = dice.getrandbits(32), time.monotonic()
            kind = b"t"
            with suppress(runtime.CallTimeout):
                try:
                    client.send_goal(SimpleNamespace(target=target, stride=stride, more=0), timeout)
                    kind = _follow(client, target, started_at + timeout, dice)
                except runtime.NoServer:
                    kind = b"n"
            _report_end(stage, kind, target, started_at, timeout)
            stride, timeout = _stride(dice), _timeout(dice)
            time.sleep(dice.uniform(0.0, 0.002))


def _follow(client: Any, target: int, deadline: float, dice: random.Random) -> bytes:
    """Return how the goal ended: r, f, c or t, or w if feedback or result belong to another goal."""
    cancels = dice.random() < 0.1
    while time.monotonic() < deadline:
        feedback, outcome = client.feedback(), client.poll()
        if feedback is not None and feedback.position != compute_position(target):
            return b"w"
        if outcome is not None:
            return _outcome_kind(outcome, target)
        if cancels and dice.random() < 0.1:
            client.cancel()
            cancels = False
        time.sleep(CYCLE)
    return b"t"


def _outcome_kind(outcome: Any, target: int) -> bytes:
    if outcome.status == outcome.SUCCEEDED:
        return b"r" if outcome.result.reached == compute_reached(target) else b"w"
    return b"c" if outcome.status == outcome.CANCELED else b"f"


def plc_send_goals(stage: Stage, dice: random.Random) -> None:
    client = stage.calls.action_client(stage.name)()
    stride, timeout = FIRST
    while True:
        target, started_at = dice.getrandbits(32), time.monotonic()
        cancels, kind = dice.random() < 0.1, b""
        client.Goal.target, client.Goal.stride = target, stride
        client(xExecute=True, tTimeout=int(timeout * 1000), xCancel=False)
        while client.xBusy:
            time.sleep(CYCLE)
            client(xCancel=cancels and client.udiGoal != 0 and dice.random() < 0.1)
            if client.xNewFeedback and client.Feedback.position != compute_position(target):
                kind = b"w"
        if client.xDone:
            kind = kind or (b"r" if client.Result.reached == compute_reached(target) else b"w")
        _report_end(stage, kind or _failure_kind(client), target, started_at, 60.0)  # feedback restarts the timeout
        client(xExecute=False)
        stride, timeout = _stride(dice), _timeout(dice)


# --- helpers of clients ------------------------------------------------------------------------------------


def _timeout(dice: random.Random) -> float:
    """Return a random timeout in seconds."""
    return dice.choice((0.003, 0.03, 0.3))


def _cycles(dice: random.Random) -> int:
    return dice.choice((0, 0, 0, 1, 3, 10, 30))


def _stride(dice: random.Random) -> int:
    """Return the cycles of a goal, or 0 for a goal that the server rejects."""
    return 0 if dice.random() < 0.05 else max(1, _cycles(dice))


def _poll(client: Any, request: Any, timeout: float) -> Any:
    client.send(request)
    end = time.monotonic() + timeout
    while time.monotonic() < end:
        if response := client.poll():
            return response
        time.sleep(CYCLE)
    client.cancel()
    raise runtime.CallTimeout


def _is_own(response: Any, question: int) -> bool:
    return bool(response.answer == answer_to(question)) and all(copy == response.answer for copy in response.copies)


def _failure_kind(client: Any) -> bytes:
    """Return how a PLC's call without a response ended: c, f, t or e."""
    return b"c" if client.xAborted else {"CALL_FAILED": b"f", "CALL_TIMEOUT": b"t"}.get(client.eErrorID, b"e")


def _report_end(stage: Stage, kind: bytes, value: int, started_at: float, timeout: float) -> None:
    delay = time.monotonic() - started_at - timeout
    if delay > SLACK:
        stage.report(b"l", int(delay * 1000))
    stage.report(kind, value)
