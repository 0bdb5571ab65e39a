"""A service and an action for both sides: generated, compiled for the PLC, and with faulty copies of the blocks."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from shmgen.config import Config
from shmgen.generator import pipeline
from tests.softplc import Block, Plc, compile_st

from . import kept
from .build import put
from .plc_demo import CONFIRM

PACKAGE = "shm_plc_calls"
DEFINITIONS = {
    "calls_msgs/srv/Ask.srv": "uint64 question\nuint32 cycles\nbool fail\n---\nuint64 answer\nuint64[16] copies\n",
    "calls_msgs/action/Count.action": "uint32 target\nuint32 stride 1\n---\nuint32 reached\n---\nuint32 position\n",
}
FAULTS = {
    "any_reply": ("FB_ShmClient", " AND udiAnswered = udiCall;", ";"),
    "old_replies": ("FB_ShmClient", "        _fbReply.Skip();", "        ;"),
    "old_calls": ("FB_ShmServer", "    _fbRequest.Skip();", "    ;"),
    "early_end": (
        "FB_ShmServer",
        "xIdle := xReady AND NOT xExecute AND iJob = 0 AND _iJob = 0;",
        "xIdle := xReady AND NOT xExecute;",
    ),
}
"""Each fault: a block, a text in it, and the faulty text that replaces it."""
PROGRAMS = {
    # Answers a question after so many cycles. Wired as a block of a user's own would be, xExecute to xExecute.
    "FB_Answer": """
        FUNCTION_BLOCK FB_Answer
        VAR_INPUT
            xExecute : BOOL;
            Request  : ST_calls_msgs_Ask_Request;
        END_VAR
        VAR_OUTPUT
            xDone    : BOOL;
            xError   : BOOL;
            Response : ST_calls_msgs_Ask_Response;
        END_VAR
        VAR
            _udiCycles : UDINT;
            _uiIndex   : UINT;
        END_VAR
        xDone := FALSE;
        xError := FALSE;
        IF NOT xExecute THEN
            _udiCycles := 0;
        ELSIF _udiCycles < Request.cycles THEN
            _udiCycles := _udiCycles + 1;
        ELSE
            xDone := Request.fail = 0;
            xError := NOT xDone;
            Response.answer := 3 * Request.question + 1;
            FOR _uiIndex := 0 TO 15 DO
                Response.copies[_uiIndex] := Response.answer;
            END_FOR
        END_IF
        END_FUNCTION_BLOCK
        """,
    "PRG_Answer": """
        PROGRAM PRG_Answer
        VAR_INPUT
            sService : STRING(80);
        END_VAR
        VAR
            fbServer : FB_calls_msgs_Ask_Server;
            fbAnswer : FB_Answer;
        END_VAR
        fbServer(
            xEnable := TRUE,
            sService := sService,
            xDone := fbAnswer.xDone,
            xFailed := fbAnswer.xError,
            Response := fbAnswer.Response);
        fbAnswer(xExecute := fbServer.xExecute, Request := fbServer.Request);
        END_PROGRAM
        """,
    # Calls repeatedly and checks each response.
    "PRG_Ask": """
        PROGRAM PRG_Ask
        VAR_INPUT
            sService : STRING(80);
            udiCycles : UDINT;
            tTimeout : TIME := T#1s;
        END_VAR
        VAR_OUTPUT
            udiRight : UDINT;
            udiWrong : UDINT;
            udiTimeouts : UDINT;
            udiOther : UDINT;
        END_VAR
        VAR
            fbClient : FB_calls_msgs_Ask_Client;
            xExecute : BOOL;
            ulQuestion : ULINT;
        END_VAR
        fbClient(xEnable := TRUE, sService := sService, xExecute := xExecute, tTimeout := tTimeout);
        IF fbClient.xDone THEN
            IF fbClient.Response.answer = 3 * ulQuestion + 1 THEN
                udiRight := udiRight + 1;
            ELSE
                udiWrong := udiWrong + 1;
            END_IF
        ELSIF fbClient.xError THEN
            IF fbClient.eErrorID = E_ShmError.CALL_TIMEOUT THEN
                udiTimeouts := udiTimeouts + 1;
            ELSE
                udiOther := udiOther + 1;
            END_IF
        END_IF
        xExecute := NOT (fbClient.xDone OR fbClient.xError);
        IF NOT xExecute THEN
            ulQuestion := ulQuestion + 1;
            fbClient.Request.question := ulQuestion;
            fbClient.Request.cycles := udiCycles;
        END_IF
        END_PROGRAM
        """,
    # Counts up to the target, one step a cycle.
    "PRG_Count": """
        PROGRAM PRG_Count
        VAR_INPUT
            sAction : STRING(80);
        END_VAR
        VAR
            fbServer : FB_calls_msgs_Count_ActionServer;
            udiAt    : UDINT;
            xCounts  : BOOL;
        END_VAR
        fbServer(
            xEnable := TRUE,
            sAction := sAction,
            xDone := xCounts AND udiAt >= fbServer.Goal.target,
            xAborted := xCounts AND fbServer.xCancel,
            xReject := fbServer.xExecute AND fbServer.Goal.stride = 0);
        xCounts := fbServer.xExecute;
        IF xCounts THEN
            udiAt := udiAt + fbServer.Goal.stride;
        ELSE
            udiAt := 0;
        END_IF
        fbServer.Feedback.position := udiAt;
        fbServer.Result.reached := udiAt;
        END_PROGRAM
        """,
}


def nth(number: int) -> int:
    """Return the number of a client's call in a region that the client created 100 ms before its clock reached 0."""
    return 2**32 - 1000 * CONFIRM + number


@dataclass(frozen=True)
class Calls:
    """A service and an action, compiled for the PLC.

    `folder` has the generated Python in `python/`, and `plc/plc.so` for other processes.
    """

    plc: Plc
    folder: Path

    def client(self, service: str, fault: str = "", **inputs: Any) -> Block:
        return self._block("FB_calls_msgs_Ask_Client" + fault, sService=service, **inputs)

    def server(self, service: str, fault: str = "", **inputs: Any) -> Block:
        return self._block("FB_calls_msgs_Ask_Server" + fault, sService=service, **inputs)

    def action_client(self, action: str, **inputs: Any) -> Block:
        return self._block("FB_calls_msgs_Count_ActionClient", sAction=action, **inputs)

    def action_server(self, action: str, **inputs: Any) -> Block:
        return self._block("FB_calls_msgs_Count_ActionServer", sAction=action, **inputs)

    def _block(self, name: str, **inputs: Any) -> Block:
        block = self.plc.block(name)
        for name, value in {"xEnable": True, **inputs}.items():
            setattr(block, name, value)
        return block


def open_or_make(folder: Path, more: str = "") -> Calls:
    """Return the result of make() in `folder`. Call make() if it has not been called, in one process at a time."""
    with kept.locked(folder / "lock"):
        if not (folder / "made").exists():
            make(folder, more)
            (folder / "made").touch()
    return Calls(Plc.load(folder / "plc" / "plc.so"), folder)


def make(folder: Path, more: str = "") -> None:
    """Generate and compile the service and the action, with the fields `more` in requests and goals."""
    put({name: text.replace("---", f"{more}---", 1) for name, text in DEFINITIONS.items()}, folder / "definitions")
    config = Config(folder, path=(folder / "definitions",), package=PACKAGE, targets=("python", "st"))
    texts = pipeline.generate(config, ["calls_msgs/Ask", "calls_msgs/Count"])
    put(texts, folder)
    sources = {path: text for path, text in texts.items() if path.endswith(".st")}
    compile_st({**sources, **dict(_faulty(sources)), **PROGRAMS}, folder / "plc")


def _faulty(sources: Mapping[str, str]) -> Iterator[tuple[str, str]]:
    """Return a client or server for each fault: `FB_calls_msgs_Ask_Client_any_reply` uses `FB_ShmClient_any_reply`."""
    for fault, (block, right, wrong) in FAULTS.items():
        assert sources[f"st/shmgen/{block}.st"].count(right) == 1, f"{block} has no longer {right!r}"
        user = "FB_calls_msgs_Ask_Client" if block == "FB_ShmClient" else "FB_calls_msgs_Ask_Server"
        yield (
            f"{block}_{fault}",
            sources[f"st/shmgen/{block}.st"].replace(right, wrong).replace(block, f"{block}_{fault}"),
        )
        text = sources[f"st/calls_msgs/{user}.st"]
        yield f"{user}_{fault}", text.replace(user, f"{user}_{fault}").replace(block, f"{block}_{fault}")
