"""Service blocks work with each other. Every call ends with its own response or an error.

Both run in one PLC here, whose clock changes only when a test sets it.
"""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.softplc import Block

from ..support.plc_calls import FAULTS, Calls, nth
from ..support.plc_demo import CLAIM, Memory, ready, take_over

STATES = ("xDone", "xBusy", "xAborted", "xError")


def state(client: Block) -> str:
    """Return the names of the state outputs that are TRUE, joined by plus signs."""
    return "+".join(name for name in STATES if getattr(client, name))


def start_call(client: Block, question: int) -> None:
    client(xExecute=False)
    client.Request.question = question
    client(xExecute=True)


def respond(server: Block, value: int) -> None:
    server.Response.answer = value
    server(xDone=True)
    server(xDone=False)


def test_call_gets_its_response(calls: Calls, topic: str) -> None:
    server, client = ready(calls.server(topic)), ready(calls.client(topic))
    assert (state(client), client.udiCall, server.xExecute, server.xBusy) == ("", 0, False, False)
    start_call(client, 5)
    assert (state(client), client.udiCall) == ("xBusy", nth(1))
    assert (server().xExecute, server.Request.question, server.udiCall) == (True, 5, nth(1))
    for _ in range(3):
        assert (state(client()), server().xExecute) == ("xBusy", True)
    server.Response.answer = 16
    assert server(xDone=True).xExecute is False
    assert (state(client()), client.Response.answer, client.eErrorID) == ("xDone", 16, "NO_ERROR")
    assert state(client()) == "xDone"
    assert state(client(xExecute=False)) == ""


def test_request_overwritten_during_the_copy_is_dropped(calls: Calls, topic: str) -> None:
    """Drop a request that a client without the lock overwrites while the server copies it."""
    server, client = ready(calls.server(topic)), ready(calls.client(topic))
    start_call(client, 5)
    number = 192 + 64 + 8  # the offset of the call number in the first sample's slot
    request = Memory(topic, "-request")
    assert request.bytes()[number : number + 4] == nth(1).to_bytes(4, "little")
    request.poke(number, bytes(4))
    server()
    assert (server.xExecute, server.Request.question) == (False, 0)
    request.poke(number, nth(1).to_bytes(4, "little"))
    assert (server().xExecute, server.Request.question) == (True, 5)


def test_end_shows_for_one_cycle_if_xexecute_fell_early(calls: Calls, topic: str) -> None:
    server, client = ready(calls.server(topic)), ready(calls.client(topic))
    start_call(client, 5)
    assert state(client(xExecute=False)) == "xBusy"
    server()
    respond(server, 16)
    assert (state(client()), state(client())) == ("xDone", "")
    start_call(client, 6)
    assert (state(client), server().xExecute, server.Request.question) == ("xBusy", True, 6)


def test_xdone_of_one_call_does_not_end_the_next(calls: Calls, topic: str) -> None:
    """Keep xExecute FALSE after a call until xDone has fallen, and then show the next call."""
    server, client = ready(calls.server(topic)), ready(calls.client(topic))
    start_call(client, 1)
    server()
    server.Response.answer = 4
    server(xDone=True)
    assert state(client()) == "xDone"
    start_call(client, 2)
    for _ in range(3):
        assert (server().xExecute, state(client())) == (False, "xBusy")
    assert (server(xDone=False).xExecute, server.Request.question) == (True, 2)


def test_xdone_for_one_cycle_counts_despite_a_held_lock(calls: Calls, topic: str) -> None:
    server, client = ready(calls.server(topic)), ready(calls.client(topic))
    start_call(client, 1)
    server()
    server.Response.answer = 4
    calls.plc.fail("SysSemProcessEnter", 5)
    assert server(xDone=True).xExecute
    assert server(xDone=False).xExecute
    calls.plc.fail("", 0)
    assert server().xExecute is False
    assert (state(client()), client.Response.answer) == ("xDone", 4)


def test_xfailed_fails_the_call(calls: Calls, topic: str) -> None:
    server, client = ready(calls.server(topic)), ready(calls.client(topic))
    start_call(client, 1)
    server()
    server(xFailed=True, xDone=True)
    assert (state(client()), client.eErrorID, client.Response.answer) == ("xError", "CALL_FAILED", 0)
    assert (state(client(xExecute=False)), client.eErrorID) == ("", "NO_ERROR")


def test_call_without_a_response_times_out(calls: Calls, topic: str) -> None:
    client = ready(calls.client(topic))
    start_call(client, 1)
    calls.plc.set_clock(999)
    assert state(client()) == "xBusy"
    calls.plc.set_clock(1000)
    assert (state(client()), client.eErrorID) == ("xError", "CALL_TIMEOUT")


def test_timeout_0_disables_the_timeout(calls: Calls, topic: str) -> None:
    client = ready(calls.client(topic, tTimeout=0))
    start_call(client, 1)
    calls.plc.set_clock(2**31)
    assert state(client()) == "xBusy"


def test_existing_response_is_read_despite_the_timeout(calls: Calls, topic: str) -> None:
    server, client = ready(calls.server(topic)), ready(calls.client(topic))
    start_call(client, 1)
    server()
    respond(server, 4)
    calls.plc.set_clock(60_000)
    assert state(client()) == "xDone"


def send_late_response(calls: Calls, topic: str, fault: str = "") -> tuple[Block, Block]:
    """Let the first call time out and send its response while a second call waits for its own response."""
    server, client = ready(calls.server(topic)), ready(calls.client(topic, fault))
    start_call(client, 1)
    server()
    calls.plc.set_clock(1000)
    assert client().eErrorID == "CALL_TIMEOUT"
    start_call(client, 2)
    respond(server, 4)
    return server, client


def test_late_response_is_ignored(calls: Calls, topic: str) -> None:
    server, client = send_late_response(calls, topic)
    assert state(client()) == "xBusy"
    assert (server.Request.question, server.udiCall) == (2, nth(2))
    respond(server, 7)
    assert (state(client()), client.Response.answer) == ("xDone", 7)


def test_response_to_a_canceled_call_is_ignored(calls: Calls, topic: str) -> None:
    server, client = ready(calls.server(topic)), ready(calls.client(topic))
    start_call(client, 1)
    assert (state(client(xCancel=True)), client.eErrorID) == ("xAborted", "NO_ERROR")
    client(xCancel=False)
    assert server().xExecute  # the server may still execute the call, but the client drops the response
    respond(server, 4)
    start_call(client, 2)
    assert state(client()) == "xBusy"
    server()
    respond(server, 7)
    assert (state(client()), client.Response.answer) == ("xDone", 7)


def test_call_canceled_early_is_not_executed(calls: Calls, topic: str) -> None:
    server, client = ready(calls.server(topic)), ready(calls.client(topic))
    start_call(client, 1)
    client(xCancel=True)
    client(xCancel=False)
    start_call(client, 2)
    assert (server().Request.question, server.udiCall) == (2, nth(2))


def replace_server(calls: Calls, topic: str, fault: str = "") -> tuple[Block, Block]:
    """Replace the server while a call waits for its response. Return the new server and the client."""
    first, client = ready(calls.server(topic)), ready(calls.client(topic, tTimeout=0))
    start_call(client, 1)
    first()
    second = ready(calls.server(topic, fault))
    take_over(second)
    return second(), client


def test_new_server_does_not_execute_an_old_call(calls: Calls, topic: str) -> None:
    server, client = replace_server(calls, topic)
    assert (server.xBusy, server.xExecute, state(client())) == (False, False, "xBusy")
    client(xCancel=True)
    client(xCancel=False)
    start_call(client, 2)
    assert (server().xExecute, server.Request.question) == (True, 2)


def test_call_from_before_the_claim_is_dropped(calls: Calls, topic: str) -> None:
    ready(calls.server(topic))
    server = ready(calls.server(topic))
    client = ready(calls.client(topic, tTimeout=0))
    start_call(client, 1)
    assert (server().xBusy, server.xExecute) == (True, False)
    take_over(server)
    assert (server().xBusy, server.xExecute, server().xExecute) == (False, False, False)


def test_new_client_continues_the_call_numbers(calls: Calls, topic: str) -> None:
    server, first = ready(calls.server(topic)), ready(calls.client(topic))
    start_call(first, 1)
    server()
    first(xEnable=False)
    assert (state(first), first.udiCall) == ("", 0)
    second = ready(calls.client(topic))
    start_call(second, 2)
    respond(server, 4)
    assert (state(second()), second.udiCall, server.Request.question) == ("xBusy", nth(2), 2)


def recreate_request_region(calls: Calls, topic: str, fault: str = "") -> Block:
    """Send a call through a new request region. Its number repeats, because the clock does not advance here."""
    server, client = ready(calls.server(topic)), ready(calls.client(topic))
    start_call(client, 1)
    server()
    respond(server, 4)
    client(xEnable=False)
    for file in Path("/dev/shm").glob(f"*{topic[1:].replace('/', '.')}-request*"):
        file.unlink()
    client = ready(calls.client(topic, fault))
    start_call(client, 2)
    assert client.udiCall == nth(1)
    return client


def test_response_of_a_former_region_is_ignored(calls: Calls, topic: str) -> None:
    assert state(recreate_request_region(calls, topic)()) == "xBusy"


def test_second_client_and_server_are_refused(calls: Calls, topic: str) -> None:
    server, client = ready(calls.server(topic)), ready(calls.client(topic))
    others = ready(calls.server(topic)), ready(calls.client(topic))
    server(), client()
    for other in others:
        assert other().eErrorID == "WRITER_IN_USE"
    start_call(others[1], 1)
    assert (state(others[1]), others[0].xError) == ("xBusy", True)
    calls.plc.set_clock(1000)
    server(), client()
    assert (state(others[1]()), others[1].eErrorID) == ("xError", "WRITER_IN_USE")


def test_call_waits_until_its_client_is_open(calls: Calls, topic: str) -> None:
    ready(calls.client(topic))
    client = ready(calls.client(topic))  # watches whether the first client is alive
    start_call(client, 1)
    calls.plc.set_clock(CLAIM - 1)
    assert (state(client()), client.udiCall) == ("xBusy", 0)
    client = ready(calls.client(topic, tTimeout=2 * CLAIM))
    start_call(client, 1)
    take_over(client)
    assert (state(client()), client.udiCall) == ("xBusy", nth(1) + 2)  # the first client may still use 1 and 2


def test_region_with_another_digest_fails_the_call(calls: Calls, topic: str) -> None:
    ready(calls.server(topic))
    Memory(topic, "-response").poke(8, b"\x99")
    client = ready(calls.client(topic))
    assert (state(client), client.eErrorID) == ("", "DIGEST_MISMATCH")
    start_call(client, 1)
    assert state(client) == "xBusy"
    calls.plc.set_clock(999)
    assert state(client()) == "xBusy"
    calls.plc.set_clock(1000)
    assert (state(client()), client.eErrorID) == ("xError", "DIGEST_MISMATCH")


def test_call_is_sent_once_the_region_is_valid(calls: Calls, topic: str) -> None:
    server = ready(calls.server(topic))
    memory = Memory(topic, "-response")
    memory["magic"] = 5
    client = ready(calls.client(topic))
    start_call(client, 1)
    memory["magic"] = 0x474D4853
    calls.plc.set_clock(500)
    assert (state(client()), client.udiCall) == ("xBusy", nth(1))
    server()
    respond(server, 4)
    assert state(client()) == "xDone"


def test_call_without_a_timeout_waits_for_its_regions(calls: Calls, topic: str) -> None:
    server = ready(calls.server(topic))
    memory = Memory(topic, "-response")
    memory["magic"] = 5
    client = ready(calls.client(topic, tTimeout=0))
    start_call(client, 1)
    assert (state(client), state(client())) == ("xBusy", "xBusy")
    memory["magic"] = 0x474D4853
    calls.plc.set_clock(500)
    assert (state(client()), client.udiCall) == ("xBusy", nth(1))
    server()
    respond(server, 4)
    assert state(client()) == "xDone"


def test_call_without_a_timeout_reports_an_invalid_name(calls: Calls, topic: str) -> None:
    client = calls.client("no name", tTimeout=0)()
    start_call(client, 1)
    assert (state(client), client.eErrorID) == ("xError", "TOPIC_INVALID")


@pytest.mark.parametrize(("length", "error"), [(65, "NO_ERROR"), (66, "TOPIC_TOO_LONG")])
def test_service_name_has_a_maximum_length(calls: Calls, topic: str, length: int, error: str) -> None:
    name = f"{topic}/{'x' * (length - len(topic))}"
    assert (calls.client(name)().eErrorID, calls.server(name)().eErrorID) == (error, error)


def test_disabled_blocks_reset_outputs_and_release_claims(calls: Calls, topic: str) -> None:
    server, client = ready(calls.server(topic)), ready(calls.client(topic))
    start_call(client, 1)
    server()
    client(xEnable=False)
    server(xEnable=False)
    assert (state(client), server.xExecute, server.xBusy, server.xError) == ("", False, False, False)
    assert Memory(topic, "-request")["writer"] == Memory(topic, "-response")["writer"] == 0
    server.xEnable = client.xEnable = True
    ready(server), ready(client)  # xExecute is still TRUE, which counts as a new rising edge
    assert (server().xExecute, server.udiCall, state(client)) == (True, nth(2), "xBusy")


# --- planted faults, which the tests above detect -----------------------------------------------------


def test_every_fault_is_planted() -> None:
    here = Path(__file__).read_text()
    assert all(f'"_{fault}"' in here for fault in FAULTS)


def test_fault_makes_the_client_ignore_call_numbers(calls: Calls, topic: str) -> None:
    assert state(send_late_response(calls, topic, "_any_reply")[1]()) == "xDone", "the planted fault has no effect"


def test_fault_makes_the_client_accept_old_responses(calls: Calls, topic: str) -> None:
    assert state(recreate_request_region(calls, topic, "_old_replies")()) == "xDone", "the planted fault has no effect"


def test_planted_fault_executes_old_calls(calls: Calls, topic: str) -> None:
    assert replace_server(calls, topic, "_old_calls")[0]().xExecute, "the planted fault has no effect"


def test_planted_fault_ends_the_next_call(calls: Calls, topic: str) -> None:
    server, client = ready(calls.server(topic, "_early_end")), ready(calls.client(topic))
    start_call(client, 1)
    server()
    server(xDone=True)
    client()
    start_call(client, 2)
    server()
    server()
    assert state(client()) == "xDone", "the planted fault has no effect"
