"""Tests of services between processes: each call ends in its own response, a failure or a timeout."""

from __future__ import annotations

import asyncio
import dis
import itertools
import logging
import signal
import threading
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from types import SimpleNamespace

import pytest
from shm_service.cell_msgs.action import Move_CommandPublisher, MoveActionServer
from shm_service.cell_msgs.srv import (
    Start_Reply,
    Start_ReplyPublisher,
    Start_Request,
    Start_RequestPublisher,
    Start_RequestSubscriber,
    Start_Response,
    StartClient,
    StartServer,
)

from shmgen import runtime
from shmgen.core import abi
from shmgen.runtime import calls
from shmgen.runtime.reference import lock, writer
from shmgen.runtime.region import header as h
from shmgen.runtime.region.names import region_file, region_name
from tests.support.engines import use_python
from tests.support.region_of import region_of

from ..support.tracing import traced

RUNTIME = str(Path(runtime.__file__).parent)

SERVE = """
with StartServer({topic!r}) as server:
    said("ready")
    server.serve(lambda request: Start_Response(success=request.on, batch=2 * request.batch, message="batch"))
"""
TAKE = """
with StartServer({topic!r}) as server:
    said("ready")
    said(server.wait(20).request.batch)
    time.sleep(20)
"""


def answer(request):
    return Start_Response(success=request.on, batch=2 * request.batch)


def request(batch=1):
    return Start_Request(on=True, batch=batch)


def test_call_between_two_processes(topic, peer):
    peer(SERVE.format(topic=topic))
    with StartClient(topic) as client:
        response = client.call(Start_Request(on=True, batch=21), timeout=10)
        assert response == Start_Response(success=True, batch=42, message="batch")
        assert type(response) is Start_Response
        assert [client.call(request(n), timeout=10).batch for n in range(50)] == list(range(0, 100, 2))


def test_call_between_spinning_client_and_server(topic, peer):
    peer(SERVE.format(topic=topic).replace(f"{topic!r})", f"{topic!r}, spin=0.0005)"))
    with StartClient(topic, spin=0.0005) as client:
        assert [client.call(request(n), timeout=10).batch for n in range(50)] == list(range(0, 100, 2))


def test_any_object_with_the_attributes_is_accepted(topic):
    with StartServer(topic) as server, StartClient(topic) as client:
        number = client.send(SimpleNamespace(on=True, batch=5))
        call = server.take()
        assert (call.number, call.request.batch) == (number, 5)
        assert server.reply(call, SimpleNamespace(success=True, batch=6, message="yes"))
        assert client.poll() == Start_Response(success=True, batch=6, message="yes")
        assert client.poll() is None


def test_invalid_value_is_refused_with_its_path(topic):
    with StartServer(topic) as server, StartClient(topic) as client:
        with pytest.raises(runtime.ValueRejected, match="batch"):
            client.send(SimpleNamespace(on=True, batch=-1))
        assert server.take() is None
        client.send(request())
        call = server.take()
        with pytest.raises(runtime.StringTooLong, match=r"response\.message"):
            server.reply(call, SimpleNamespace(success=True, batch=1, message="x" * 41))
        assert client.poll() is None
        assert server.reply(call, Start_Response(batch=3))
        assert client.poll().batch == 3


def test_call_is_answered_only_once(topic):
    with StartServer(topic) as server, StartClient(topic) as client:
        client.send(request())
        call = server.take()
        assert server.reply(call, Start_Response(batch=1))
        assert not server.reply(call, Start_Response(batch=2))
        assert not server.fail(call)
        assert client.poll().batch == 1


# --- failures ------------------------------------------------------------------------------------


def test_raising_handler_fails_its_call_and_server_continues(topic, caplog):
    def handler(request):
        if request.batch == 1:
            raise OSError("jammed")
        return SimpleNamespace(success=True, batch=2, message="x" * 41) if request.batch == 2 else answer(request)

    with StartServer(topic) as server, StartClient(topic) as client, caplog.at_level(logging.ERROR, "shmgen"):
        thread = threading.Thread(target=server.serve, args=(handler, 2.0))
        thread.start()
        for batch in (1, 2):
            with pytest.raises(runtime.CallFailed, match=rf"{topic}: the server reported that call \d+ failed"):
                client.call(request(batch), timeout=10)
        assert client.call(request(3), timeout=10).batch == 6
        thread.join()
    assert "jammed" in caplog.text
    assert "response.message: 41 bytes" in caplog.text


def test_keyboardinterrupt_in_handler_fails_call_and_ends_serve(topic):
    def handler(request):
        raise KeyboardInterrupt

    with StartServer(topic) as server, StartClient(topic) as client:
        client.send(request())
        with pytest.raises(KeyboardInterrupt):
            server.serve(handler, timeout=5)
        with pytest.raises(runtime.CallFailed):
            client.poll()


def interrupt_after(step, call):
    """Run `call`, and raise after its call or jump number `step` in the runtime. Return True if the exception came."""
    remaining = [step]
    due_frames = {}

    def trace(frame, event, _):
        if not frame.f_code.co_filename.startswith(RUNTIME):
            return None
        frame.f_trace_opcodes = True
        if event == "opcode":
            name = dis.opname[frame.f_code.co_code[frame.f_lasti]]
            is_due, due_frames[frame] = due_frames.get(frame, False), name.startswith(("CALL", "JUMP_B", "JUMP_A"))
            remaining[0] -= is_due
            if is_due and remaining[0] == 0:
                raise KeyboardInterrupt
        return trace

    try:
        with traced(trace):
            call()
    except KeyboardInterrupt:
        return True
    return False


def test_interrupt_at_any_step_of_a_call_does_no_harm(topic):
    """Let other threads get their turn after the interrupt, and give the next call its own answer."""

    def handler(request):
        if not request.batch:
            raise KeyboardInterrupt
        return answer(request)

    with StartServer(topic) as server, StartClient(topic) as client, ThreadPoolExecutor(2) as others:
        serving = others.submit(server.serve, handler, 20)
        client.call(request(), timeout=3)  # opens the event
        for step in range(1, 1000):
            was_interrupted = interrupt_after(step, lambda step=step: client.call(request(step), timeout=3))
            assert others.submit(client.call, request(2 * step), 3).result().batch == 4 * step
            if not was_interrupted:
                break
        assert step > 30
        client.send(request(0))
        assert isinstance(serving.exception(10), KeyboardInterrupt)


def test_interrupt_at_any_step_of_serve_does_no_harm(topic):
    """Answer an interrupted call at most once, and answer the next call as usual."""
    with StartServer(topic) as server, StartClient(topic) as client:
        server.wait(1e-3)  # opens the event
        for step in range(1, 1000):
            client.send(request(step))
            before = server._calls._responses.sequence
            was_interrupted = interrupt_after(step, lambda: server.serve(answer, timeout=1e-2))
            answers = server._calls._responses.sequence - before
            assert answers <= 1
            client.send(request(2 * step))
            call = server.take()
            assert server.reply(call, answer(call.request))
            assert client.poll().batch == 4 * step
            if answers and not was_interrupted:  # otherwise, serve() timed out before it reached the step
                break
        assert step > 30


def test_client_sends_nothing_without_a_server(topic, monkeypatch):
    with StartClient(topic) as client, Start_RequestSubscriber(f"{topic}-request") as bystander:
        started_at = time.monotonic()
        with pytest.raises(runtime.NoServer, match="the request was not sent"):
            client.call(request(), timeout=0.2)
        assert 0.2 <= time.monotonic() - started_at < 2
        assert not client.server_is_ready()
        timeouts, words = [], region_of(client._calls._responses).words
        monkeypatch.setattr(client._calls, "wait_for_server", timeouts.append)
        client.server_is_ready()
        words[h.WRITER] = h.PLC
        client.server_is_ready()
        words[h.WRITER] = 0
        monkeypatch.undo()
        assert timeouts == [0.0, 1.0], "a PLC server is detected within a second"
        assert bystander.read() is None
        with StartServer(topic):
            assert client.server_is_ready()
        assert not client.server_is_ready()


def test_wait_for_server_polls_every_two_milliseconds(topic, monkeypatch):
    naps, now = [], 100.0

    def sleep(seconds):
        nonlocal now
        naps.append(seconds)
        now += seconds

    with StartClient(topic) as client:
        monkeypatch.setattr(calls, "time", SimpleNamespace(monotonic=lambda: now, sleep=sleep))
        assert not client.wait_for_server(0.005)
        assert naps[:3] == pytest.approx([0.002, 0.002, 0.001])


def test_closed_client_raises_instead_of_waiting(topic):
    client = StartClient(topic)
    client.send(request())
    client.close()
    for use in (client.poll, lambda: client.wait(30), lambda: client.send(request())):
        with pytest.raises(runtime.Closed):
            use()


@pytest.mark.parametrize("by", ["thread", "signal"])
@pytest.mark.parametrize("server", [StartServer, MoveActionServer])
def test_close_ends_serve(server, by, topic):
    server = server(topic)
    former_handler = signal.signal(signal.SIGALRM, lambda *_: server.close())
    try:
        if by == "thread":
            threading.Timer(0.05, server.close).start()
        else:
            signal.setitimer(signal.ITIMER_REAL, 0.05)
        server.serve(lambda request: None, timeout=30)
        with pytest.raises(runtime.Closed):
            server.take()
    finally:
        signal.signal(signal.SIGALRM, former_handler)


def test_client_and_server_work_in_coroutines(topic):
    async def serve(server):
        call = await server.wait_async(30)
        server.reply(call, Start_Response(success=call.request.on, batch=7))

    async def scene(server, client):
        assert await server.wait_async(0.01) is None
        serving = asyncio.create_task(serve(server))
        client.send(request())
        response = await client.wait_async(30)
        await serving
        return response

    with StartServer(topic) as server, StartClient(topic) as client:
        assert asyncio.run(scene(server, client)).batch == 7


def test_close_ends_a_waiting_call(topic):
    with StartServer(topic), StartClient(topic) as client:
        threading.Timer(0.05, client.close).start()
        with pytest.raises(runtime.Closed):
            client.call(request(), timeout=30)


def test_call_waits_for_a_server_that_starts_later(topic, peer):
    with StartClient(topic) as client:
        responses = []
        thread = threading.Thread(target=lambda: responses.append(client.call(request(4), timeout=20)))
        thread.start()
        peer(SERVE.format(topic=topic))
        thread.join()
        assert responses[0].batch == 8


def test_call_times_out(topic):
    with StartServer(topic) as server, StartClient(topic) as client:
        started_at = time.monotonic()
        with pytest.raises(runtime.CallTimeout, match=r"call \d+ got no response within 0\.1 s"):
            client.call(request(), timeout=0.1)
        assert 0.1 <= time.monotonic() - started_at < 2
        assert server.reply(server.take(), Start_Response())
        assert client.poll() is None, "a late response is ignored"


# --- late and old calls --------------------------------------------------------------------------


def test_reply_to_a_cancelled_call_is_ignored(topic):
    with StartServer(topic) as server, StartClient(topic) as client:
        client.send(request(1))
        first_call = server.take()
        client.cancel()
        assert server.reply(first_call, answer(first_call.request))
        assert client.poll() is None
        client.send(request(2))
        assert client.poll() is None
        call = server.take()
        assert server.reply(call, answer(call.request))
        assert client.poll().batch == 4


def test_reply_to_the_former_call_is_ignored(topic):
    with StartServer(topic) as server, StartClient(topic) as client:
        client.send(request(1))
        first_call = server.take()
        client.send(request(2))
        assert server.reply(first_call, answer(first_call.request))
        assert client.poll() is None
        assert server.take().request.batch == 2


def test_reply_to_another_call_does_not_end_the_wait(topic, monkeypatch):
    with StartServer(topic) as server, StartClient(topic) as client:
        assert client.service == server.service == topic
        number = client.send(request(1))
        replies = [Start_Reply(call=call, status=Start_Reply.DONE) for call in (number + 1, number)]
        monkeypatch.setattr(client._calls._responses, "wait", lambda left: replies.pop(0))
        assert client.wait(30) is not None
        assert not replies
        assert client.wait(30) is None, "no call is open, so there is nothing to wait for"


def test_rejected_request_still_cancels_the_former_call(topic):
    with StartServer(topic) as server, StartClient(topic) as client:
        client.send(request(1))
        with pytest.raises(runtime.ValueRejected):
            client.send(SimpleNamespace(on=True, batch=-1))
        assert server.reply(server.take(), Start_Response())
        assert client.poll() is None


def test_request_overwritten_before_take_is_dropped(topic):
    with StartServer(topic) as server, StartClient(topic) as client:
        client.send(request(1))
        client.send(request(2))
        assert server.take().request.batch == 2
        assert server.take() is None


def test_older_call_cannot_be_answered_after_a_newer_take(topic):
    with StartServer(topic) as server, StartClient(topic) as client:
        client.send(request(1))
        old = server.take()
        client.send(request(2))
        new = server.take()
        assert server.reply(new, answer(new.request))
        assert not server.reply(old, answer(old.request))
        assert client.poll().batch == 4


def test_restarted_server_answers_no_old_call(topic, peer):
    first = peer(TAKE.format(topic=topic))
    with StartClient(topic) as client:
        client.send(request(7))
        assert first.hear() == "7"
        first.kill()
        with StartServer(topic) as server:
            assert server.take() is None
            assert client.poll() is None
            client.send(request(8))
            call = server.take()
            assert server.reply(call, answer(call.request))
            assert client.poll().batch == 16


def test_call_of_a_killed_server_times_out_and_the_next_succeeds(topic, peer):
    first = peer(TAKE.format(topic=topic))
    with StartClient(topic) as client:
        failures = []

        def call():
            try:
                client.call(request(7), timeout=1.0)
            except runtime.CallTimeout as error:
                failures.append(error)

        thread = threading.Thread(target=call)
        thread.start()
        assert first.hear() == "7"
        first.kill()
        peer(SERVE.format(topic=topic))
        thread.join()
        assert type(failures[0]) is runtime.CallTimeout
        assert client.call(request(9), timeout=10).batch == 18


def test_client_after_a_killed_client_continues_the_numbers(topic, peer):
    first = peer(f"""
client = StartClient({topic!r})
said("ready")
client.wait_for_server(20)
said(client.send(Start_Request(on=True, batch=7)))
time.sleep(20)
""")
    with StartServer(topic) as server:
        number = int(first.hear())
        old = server.wait(10)
        first.kill()
        with StartClient(topic) as client:
            assert client.send(request(8)) == number + 1
            assert server.reply(old, answer(old.request))
            assert client.poll() is None
            call = server.take()
            server.reply(call, answer(call.request))
            assert client.poll().batch == 16


def test_reply_older_than_its_request_is_ignored(topic):
    with Start_ReplyPublisher(f"{topic}-response") as former, StartClient(topic) as client:
        number = client.send(request())
        former.publish(SimpleNamespace(call=number + 1, status=1, response=Start_Response(batch=99)))
        assert client.send(request()) == number + 1
        assert client.poll() is None


def test_numbers_of_a_new_region_follow_the_former_numbers(topic):
    """Skip numbers in the new region, without counting them as missed."""
    numbers = []
    for _ in range(3):
        with StartServer(topic) as server, StartClient(topic) as client:
            for _ in range(2):
                numbers.append(client.send(request()))
                assert server.take().number == numbers[-1]
            assert server._calls._requests.missed == 0
        Path(region_file(region_name(f"{topic}-request"))).unlink()
    steps = [(later - earlier) % abi.RESTART_GAP for earlier, later in itertools.pairwise(numbers)]
    assert all(0 < step < 60e6 for step in steps), "the steps are microseconds"
    assert steps[::2] == [1, 1, 1]


# --- refused clients, servers and names -------------------------------------------------------------


def test_service_has_one_client_and_one_server(topic):
    with StartClient(topic), StartServer(topic):
        with pytest.raises(runtime.RegionInUse, match=f"{topic}-request"):
            StartClient(topic)
        with pytest.raises(runtime.RegionInUse, match=f"{topic}-response"):
            StartServer(topic)
    StartClient(topic).close()
    StartServer(topic).close()


def test_refused_server_leaves_the_call_to_the_running_server(topic):
    with StartServer(topic) as server, StartClient(topic) as client:
        client.send(request(3))
        with pytest.raises(runtime.RegionInUse):
            StartServer(topic)
        assert server.take().request.batch == 3


def test_service_of_another_type_is_refused(topic):
    with (
        Move_CommandPublisher(f"{topic}-response"),
        pytest.raises(runtime.LayoutMismatch, match="cell_msgs/action/Move_Command"),
    ):
        StartClient(topic)
    Start_RequestPublisher(f"{topic}-request").close()  # the refused client released the region


@pytest.mark.parametrize("name", ["/a b", "", "/cell//start", "~/start", "/a-request"])
def test_invalid_service_name_is_refused(name):
    for kind in (StartClient, StartServer):
        with pytest.raises(ValueError, match="topic"):
            kind(name)


@pytest.mark.parametrize("name", ["/a-", "/a-event", "/a-request-response", "/-request", "/a-request/b"])
def test_dash_in_a_topic_is_valid_only_before_a_suffix(name):
    with pytest.raises(ValueError, match="topic"):
        runtime.region_name(name)


# --- threads and PLCs --------------------------------------------------------------------------------


def test_threads_share_a_client(topic, peer):
    peer(SERVE.format(topic=topic))
    with StartClient(topic) as client:
        mismatches = []

        def work(first):
            for batch in range(first, first + 50):
                result = client.call(request(batch), timeout=20).batch
                if result != 2 * batch:
                    mismatches.append((batch, result))

        threads = [threading.Thread(target=work, args=(1000 * number,)) for number in range(4)]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
        assert not mismatches


def test_call_waits_for_another_thread_until_its_timeout(topic):
    with StartServer(topic), StartClient(topic) as client:

        def call_in_vain():
            with pytest.raises(runtime.CallTimeout):
                client.call(request(), timeout=1.0)

        thread = threading.Thread(target=call_in_vain)
        thread.start()
        time.sleep(0.1)
        with pytest.raises(runtime.CallTimeout, match="another thread"):
            client.call(request(), timeout=0.05)
        thread.join()


def test_plc_server_is_ready_while_its_heartbeat_changes(topic):
    with StartClient(topic) as client:
        words = region_of(client._calls._responses).words
        words[h.WRITER], words[h.HEARTBEAT] = h.PLC, 5
        assert not client.server_is_ready()
        stop = threading.Event()

        def cycle():
            while not stop.wait(0.01):
                words[h.HEARTBEAT] += 1

        thread = threading.Thread(target=cycle)
        thread.start()
        assert client.server_is_ready()
        assert client.wait_for_server(1.0)
        time.sleep(0.05)
        stop.set()
        thread.join()
        assert client.wait_for_server(0.0)  # the heartbeat changed since the last poll
        assert not client.server_is_ready()


def test_waiting_server_sends_heartbeats(topic):
    with StartServer(topic) as server, StartClient(topic) as client:
        before = region_of(client._calls._responses).words[h.HEARTBEAT]
        assert server.wait(0.3) is None
        assert region_of(client._calls._responses).words[h.HEARTBEAT] - before >= 3


def test_take_does_not_wait(topic, monkeypatch):
    waits = []
    with StartServer(topic) as server:
        monkeypatch.setattr(server, "wait", waits.append)
        assert server.take() is None
    assert waits == [0]


@pytest.mark.parametrize("is_uncertain", [False, True])
def test_uncertain_claim_skips_stale_requests_again(topic, monkeypatch, is_uncertain):
    class LatePublisher(StartServer.reply_publisher):
        def __init__(self, *arguments, **options):
            super().__init__(*arguments, **options)
            client.send(Start_Request())
            self._end.predecessor_may_be_alive = is_uncertain

    monkeypatch.setattr(StartServer, "reply_publisher", LatePublisher)
    with StartClient(topic) as client, StartServer(topic) as server:
        assert (server.take() is None) == is_uncertain


# --- machines that need the lock -----------------------------------------------------------------


@pytest.fixture
def on_arm(monkeypatch):
    use_python(monkeypatch)
    for module in (lock, writer):
        monkeypatch.setattr(module, "keeps_order", lambda: False)


def leave_lock_held(side, holder):
    """Leave the lock like a process that was killed while it held the lock."""
    assert region_of(side).semaphore.acquire()
    region_of(side).words[h.LOCK_COUNT] += 1
    region_of(side).words[h.LOCK_HOLDER] = holder


@pytest.mark.usefixtures("on_arm")
def test_server_survives_a_lock_held_by_a_dead_process(topic, caplog):
    """Finish each call after the lock is recovered. A short lock timeout ends neither the call nor serve()."""
    dead = 2**22 + 1  # greater than any pid of Linux

    def handler(request):
        if request.batch > 5:
            raise {6: OSError("jammed"), 7: KeyboardInterrupt("over")}[request.batch]
        return answer(request)

    with (
        ThreadPoolExecutor(1) as pool,
        StartServer(topic, lock_timeout=0.001) as server,
        StartClient(topic, lock_timeout=0.001) as client,
    ):
        serving = pool.submit(server.serve, handler, 60.0)
        assert client.wait_for_server(5)
        leave_lock_held(client._calls._requests, dead)
        leave_lock_held(server._calls._responses, dead)
        assert client.call(request(4), timeout=20).batch == 8
        assert client.call(request(5), timeout=20).batch == 10
        leave_lock_held(server._calls._responses, dead)
        for batch in (6, 7):
            with pytest.raises(runtime.CallFailed):
                client.call(request(batch), timeout=20)
        with pytest.raises(KeyboardInterrupt, match="over"):
            serving.result(20)
    assert caplog.text.count("waits for the lock") == 2


@pytest.mark.usefixtures("on_arm")
def test_server_started_while_the_lock_is_held_serves_no_old_call(topic):
    with StartClient(topic) as client:
        with StartServer(topic) as before:
            client.send(request())
            assert before.take() is not None
        semaphore = region_of(client._calls._requests).semaphore
        assert semaphore.acquire()
        with StartServer(topic) as server:
            semaphore.post()
            assert server.take() is None


@pytest.mark.usefixtures("on_arm")
def test_call_with_a_held_lock_ends_at_its_timeout(topic):
    with StartServer(topic) as server, StartClient(topic) as client:
        leave_lock_held(client._calls._requests, h.PLC)
        started_at = time.monotonic()
        with pytest.raises(runtime.LockTimeout):
            client.call(request(), timeout=0.1)
        assert 0.1 <= time.monotonic() - started_at < 10
        assert server.take() is None


@pytest.mark.usefixtures("on_arm")
def test_newer_call_replaces_a_response_that_waits_for_the_lock(topic):
    with StartServer(topic, lock_timeout=0) as server, StartClient(topic) as client:
        leave_lock_held(server._calls._responses, h.PLC)
        server._calls._responses._end.lock._since -= 3600
        batches = []

        def handler(request):
            batches.append(request.batch)
            if len(batches) == 1:
                client.send(Start_Request(on=True, batch=2))
            return answer(request)

        client.send(request())
        server.serve(handler, 0.2)
        assert batches == [1, 2]
        assert client.poll() is None
