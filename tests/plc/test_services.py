"""The blocks of a service, running against each other: every call ends in its own answer, or says why not.

Both stand in one PLC here, whose clock stands still but for what a test adds to it.
"""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.softplc import Block

from ..support.plc_calls import FAULTS, Calls, nth
from ..support.plc_demo import CLAIM, Memory, ready, take_over

ENDS = ("xDone", "xBusy", "xAborted", "xError")


def state(client: Block) -> str:
    """Which one of the four it is; more than one is none of them."""
    return "+".join(name for name in ENDS if getattr(client, name))


def begin(client: Block, question: int) -> None:
    client(xExecute=False)
    client.Request.question = question
    client(xExecute=True)


def answer(server: Block, value: int) -> None:
    server.Response.answer = value
    server(xDone=True)
    server(xDone=False)


def test_a_call_and_its_answer(calls: Calls, topic: str) -> None:
    server, client = ready(calls.server(topic)), ready(calls.client(topic))
    assert (state(client), client.udiCall, server.xExecute, server.xBusy) == ("", 0, False, False)
    begin(client, 5)
    assert (state(client), client.udiCall) == ("xBusy", nth(1))
    assert (server().xExecute, server.Request.question, server.udiCall) == (True, 5, nth(1))
    for _ in range(3):
        assert (state(client()), server().xExecute) == ("xBusy", True)
    server.Response.answer = 16
    assert server(xDone=True).xExecute is False
    assert (state(client()), client.Response.answer, client.eErrorID) == ("xDone", 16, "NO_ERROR")
    assert state(client()) == "xDone"
    assert state(client(xExecute=False)) == ""


def test_no_request_is_shown_that_may_be_half_of_one(calls: Calls, topic: str) -> None:
    """Overwritten while it is copied, as by a client that goes on without the lock."""
    server, client = ready(calls.server(topic)), ready(calls.client(topic))
    begin(client, 5)
    number = 192 + 64 + 8  # of the slot of the first sample
    request = Memory(topic, "-request")
    assert request.bytes()[number : number + 4] == nth(1).to_bytes(4, "little")
    request.poke(number, bytes(4))
    server()
    assert (server.xExecute, server.Request.question) == (False, 0)
    request.poke(number, nth(1).to_bytes(4, "little"))
    assert (server().xExecute, server.Request.question) == (True, 5)


def test_who_lets_go_early_sees_the_end_for_one_cycle(calls: Calls, topic: str) -> None:
    server, client = ready(calls.server(topic)), ready(calls.client(topic))
    begin(client, 5)
    assert state(client(xExecute=False)) == "xBusy"
    server()
    answer(server, 16)
    assert (state(client()), state(client())) == ("xDone", "")
    begin(client, 6)
    assert (state(client), server().xExecute, server.Request.question) == ("xBusy", True, 6)


def test_the_job_of_one_call_is_not_that_of_the_next(calls: Calls, topic: str) -> None:
    """xExecute falls between two calls, and what says that a job is done has fallen before the next is given."""
    server, client = ready(calls.server(topic)), ready(calls.client(topic))
    begin(client, 1)
    server()
    server.Response.answer = 4
    server(xDone=True)
    assert state(client()) == "xDone"
    begin(client, 2)
    for _ in range(3):
        assert (server().xExecute, state(client())) == (False, "xBusy")
    assert (server(xDone=False).xExecute, server.Request.question) == (True, 2)


def test_a_job_that_is_done_for_one_cycle_while_the_lock_is_held(calls: Calls, topic: str) -> None:
    server, client = ready(calls.server(topic)), ready(calls.client(topic))
    begin(client, 1)
    server()
    server.Response.answer = 4
    calls.plc.fail("SysSemProcessEnter", 5)
    assert server(xDone=True).xExecute
    assert server(xDone=False).xExecute
    calls.plc.fail("", 0)
    assert server().xExecute is False
    assert (state(client()), client.Response.answer) == ("xDone", 4)


def test_what_the_server_cannot_do(calls: Calls, topic: str) -> None:
    server, client = ready(calls.server(topic)), ready(calls.client(topic))
    begin(client, 1)
    server()
    server(xFailed=True, xDone=True)
    assert (state(client()), client.eErrorID, client.Response.answer) == ("xError", "CALL_FAILED", 0)
    assert (state(client(xExecute=False)), client.eErrorID) == ("", "NO_ERROR")


def test_no_answer_in_time(calls: Calls, topic: str) -> None:
    client = ready(calls.client(topic))
    begin(client, 1)
    calls.plc.set_clock(999)
    assert state(client()) == "xBusy"
    calls.plc.set_clock(1000)
    assert (state(client()), client.eErrorID) == ("xError", "CALL_TIMEOUT")


def test_no_time_limit(calls: Calls, topic: str) -> None:
    client = ready(calls.client(topic, tTimeout=0))
    begin(client, 1)
    calls.plc.set_clock(2**31)
    assert state(client()) == "xBusy"


def test_an_answer_that_is_there_when_the_time_is_up(calls: Calls, topic: str) -> None:
    server, client = ready(calls.server(topic)), ready(calls.client(topic))
    begin(client, 1)
    server()
    answer(server, 4)
    calls.plc.set_clock(60_000)
    assert state(client()) == "xDone"


def late(calls: Calls, topic: str, fault: str = "") -> tuple[Block, Block]:
    """The first call is given up; its answer comes while the second waits for its own."""
    server, client = ready(calls.server(topic)), ready(calls.client(topic, fault))
    begin(client, 1)
    server()
    calls.plc.set_clock(1000)
    assert client().eErrorID == "CALL_TIMEOUT"
    begin(client, 2)
    answer(server, 4)
    return server, client


def test_a_late_answer_is_passed_over(calls: Calls, topic: str) -> None:
    server, client = late(calls, topic)
    assert state(client()) == "xBusy"
    assert (server.Request.question, server.udiCall) == (2, nth(2))
    answer(server, 7)
    assert (state(client()), client.Response.answer) == ("xDone", 7)


def test_cancel(calls: Calls, topic: str) -> None:
    server, client = ready(calls.server(topic)), ready(calls.client(topic))
    begin(client, 1)
    assert (state(client(xCancel=True)), client.eErrorID) == ("xAborted", "NO_ERROR")
    client(xCancel=False)
    assert server().xExecute  # it may do it all the same; nobody hears of it
    answer(server, 4)
    begin(client, 2)
    assert state(client()) == "xBusy"
    server()
    answer(server, 7)
    assert (state(client()), client.Response.answer) == ("xDone", 7)


def test_a_call_given_up_before_it_was_taken_is_not_served(calls: Calls, topic: str) -> None:
    server, client = ready(calls.server(topic)), ready(calls.client(topic))
    begin(client, 1)
    client(xCancel=True)
    client(xCancel=False)
    begin(client, 2)
    assert (server().Request.question, server.udiCall) == (2, nth(2))


def interrupted(calls: Calls, topic: str, fault: str = "") -> tuple[Block, Block]:
    """A server ends while a call waits for it, and another takes its place."""
    first, client = ready(calls.server(topic)), ready(calls.client(topic, tTimeout=0))
    begin(client, 1)
    first()
    second = ready(calls.server(topic, fault))
    take_over(second)
    return second(), client


def test_a_new_server_answers_no_old_call(calls: Calls, topic: str) -> None:
    server, client = interrupted(calls, topic)
    assert (server.xBusy, server.xExecute, state(client())) == (False, False, "xBusy")
    client(xCancel=True)
    client(xCancel=False)
    begin(client, 2)
    assert (server().xExecute, server.Request.question) == (True, 2)


def test_a_call_made_before_the_server_holds_the_service_is_old(calls: Calls, topic: str) -> None:
    ready(calls.server(topic))
    server = ready(calls.server(topic))
    client = ready(calls.client(topic, tTimeout=0))
    begin(client, 1)
    assert (server().xBusy, server.xExecute) == (True, False)
    take_over(server)
    assert (server().xBusy, server.xExecute, server().xExecute) == (False, False, False)


def test_a_new_client_goes_on_with_the_numbers(calls: Calls, topic: str) -> None:
    server, first = ready(calls.server(topic)), ready(calls.client(topic))
    begin(first, 1)
    server()
    first(xEnable=False)
    assert (state(first), first.udiCall) == ("", 0)
    second = ready(calls.client(topic))
    begin(second, 2)
    answer(server, 4)
    assert (state(second()), second.udiCall, server.Request.question) == ("xBusy", nth(2), 2)


def made_anew(calls: Calls, topic: str, fault: str = "") -> Block:
    """The request's region was removed, and, since the clock stands still here, the next has the same numbers."""
    server, client = ready(calls.server(topic)), ready(calls.client(topic))
    begin(client, 1)
    server()
    answer(server, 4)
    client(xEnable=False)
    for file in Path("/dev/shm").glob(f"*{topic[1:].replace('/', '.')}-request*"):
        file.unlink()
    client = ready(calls.client(topic, fault))
    begin(client, 2)
    assert client.udiCall == nth(1)
    return client


def test_the_answer_of_a_former_region_is_old(calls: Calls, topic: str) -> None:
    assert state(made_anew(calls, topic)()) == "xBusy"


def test_one_client_and_one_server(calls: Calls, topic: str) -> None:
    server, client = ready(calls.server(topic)), ready(calls.client(topic))
    others = ready(calls.server(topic)), ready(calls.client(topic))
    server(), client()
    for other in others:
        assert other().eErrorID == "WRITER_IN_USE"
    begin(others[1], 1)
    assert (state(others[1]), others[0].xError) == ("xBusy", True)
    calls.plc.set_clock(1000)
    server(), client()
    assert (state(others[1]()), others[1].eErrorID) == ("xError", "WRITER_IN_USE")


def test_a_call_waits_until_the_service_is_open(calls: Calls, topic: str) -> None:
    ready(calls.client(topic))
    client = ready(calls.client(topic))  # watches whether the other is still alive
    begin(client, 1)
    calls.plc.set_clock(CLAIM - 1)
    assert (state(client()), client.udiCall) == ("xBusy", 0)
    client = ready(calls.client(topic, tTimeout=2 * CLAIM))
    begin(client, 1)
    take_over(client)
    assert (state(client()), client.udiCall) == ("xBusy", nth(1) + 2)  # the other may still use 1 and 2


def test_what_cannot_be_opened(calls: Calls, topic: str) -> None:
    ready(calls.server(topic))
    Memory(topic, "-response").poke(8, b"\x99")
    client = ready(calls.client(topic))
    assert (state(client), client.eErrorID) == ("", "DIGEST_MISMATCH")
    begin(client, 1)
    assert state(client) == "xBusy"
    calls.plc.set_clock(999)
    assert state(client()) == "xBusy"
    calls.plc.set_clock(1000)
    assert (state(client()), client.eErrorID) == ("xError", "DIGEST_MISMATCH")


def test_what_can_be_opened_after_all(calls: Calls, topic: str) -> None:
    server = ready(calls.server(topic))
    memory = Memory(topic, "-response")
    memory["magic"] = 5
    client = ready(calls.client(topic))
    begin(client, 1)
    memory["magic"] = 0x474D4853
    calls.plc.set_clock(500)
    assert (state(client()), client.udiCall) == ("xBusy", nth(1))
    server()
    answer(server, 4)
    assert state(client()) == "xDone"


def test_without_a_time_limit_a_call_waits_for_its_regions(calls: Calls, topic: str) -> None:
    server = ready(calls.server(topic))
    memory = Memory(topic, "-response")
    memory["magic"] = 5
    client = ready(calls.client(topic, tTimeout=0))
    begin(client, 1)
    assert (state(client), state(client())) == ("xBusy", "xBusy")
    memory["magic"] = 0x474D4853
    calls.plc.set_clock(500)
    assert (state(client()), client.udiCall) == ("xBusy", nth(1))
    server()
    answer(server, 4)
    assert state(client()) == "xDone"


def test_without_a_time_limit_what_cannot_be_opened_is_told_at_once(calls: Calls, topic: str) -> None:
    client = calls.client("no name", tTimeout=0)()
    begin(client, 1)
    assert (state(client), client.eErrorID) == ("xError", "TOPIC_INVALID")


@pytest.mark.parametrize(("length", "error"), [(65, "NO_ERROR"), (66, "TOPIC_TOO_LONG")])
def test_the_longest_name(calls: Calls, topic: str, length: int, error: str) -> None:
    name = f"{topic}/{'x' * (length - len(topic))}"
    assert (calls.client(name)().eErrorID, calls.server(name)().eErrorID) == (error, error)


def test_disabled_it_is_as_new(calls: Calls, topic: str) -> None:
    server, client = ready(calls.server(topic)), ready(calls.client(topic))
    begin(client, 1)
    server()
    client(xEnable=False)
    server(xEnable=False)
    assert (state(client), server.xExecute, server.xBusy, server.xError) == ("", False, False, False)
    assert Memory(topic, "-request")["writer"] == Memory(topic, "-response")["writer"] == 0
    server.xEnable = client.xEnable = True
    ready(server), ready(client)  # xExecute is still TRUE, which is an edge now
    assert (server().xExecute, server.udiCall, state(client)) == (True, nth(2), "xBusy")


# --- planted faults: each of them is one that a test above finds --------------------------------------


def test_every_fault_is_planted() -> None:
    here = Path(__file__).read_text()
    assert all(f'"_{fault}"' in here for fault in FAULTS)


def test_a_client_that_does_not_look_at_the_number(calls: Calls, topic: str) -> None:
    assert state(late(calls, topic, "_any_reply")[1]()) == "xDone", "the fault does nothing"


def test_a_client_that_takes_what_is_there(calls: Calls, topic: str) -> None:
    assert state(made_anew(calls, topic, "_old_replies")()) == "xDone", "the fault does nothing"


def test_a_server_that_answers_old_calls(calls: Calls, topic: str) -> None:
    assert interrupted(calls, topic, "_old_calls")[0]().xExecute, "the fault does nothing"


def test_a_server_that_takes_the_end_of_one_job_for_that_of_the_next(calls: Calls, topic: str) -> None:
    server, client = ready(calls.server(topic, "_early_end")), ready(calls.client(topic))
    begin(client, 1)
    server()
    server(xDone=True)
    client()
    begin(client, 2)
    server()
    server()
    assert state(client()) == "xDone", "the fault does nothing"
