"""A request whose count exceeds its bound is answered at once, as in C and C++, and no handler receives it."""

from __future__ import annotations

import logging
import threading

import pytest

from shmgen import runtime
from shmgen.config import Config
from shmgen.core.model import TypeName
from shmgen.generator import pipeline
from shmgen.runtime import engine
from tests.support import build, counts
from tests.support.engines import use_python


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("counts")
    for name, text in counts.DEFINITIONS.items():
        build.put({f"msgs/counts_msgs/{name}.{name.partition('/')[0]}": text}, folder)
    config = Config(folder, path=(folder / "msgs",), package=counts.PACKAGE, targets=("python",))
    build.put(pipeline.generate(config, ["counts_msgs"]), folder)
    return folder


@pytest.fixture(params=["Python", pytest.param("C", marks=pytest.mark.skipif(not engine.IN_C, reason="no extension"))])
def kinds(request, monkeypatch, folder):
    """A function that returns the module of a service or an action, in either engine."""
    if request.param == "Python":
        use_python(monkeypatch)
    return lambda kind, name: build.module(folder, counts.PACKAGE, TypeName("counts_msgs", kind, name))


def spoil(message, path, count=5):
    """Set a wrong count in a message, as a faulty client could."""
    counts.spoil(message, path, count)
    return message


def test_request_with_an_excessive_count_fails(topic, kinds, caplog):
    sort, handled = kinds("srv", "Sort"), []

    def handler(request):
        handled.append(request.id)
        return sort.Sort_Response()

    with sort.SortServer(topic) as server, sort.SortClient(topic) as client, caplog.at_level(logging.ERROR):
        for number in (1, 3):
            client.send(spoil(sort.Sort_Request(), "items"))
            server.serve(handler, timeout=0.05)
            with pytest.raises(runtime.CallFailed):
                client.wait(timeout=1)
            client.send(sort.Sort_Request(id=number))
            server.serve(handler, timeout=0.05)
            assert client.wait(timeout=1)
            assert handled.pop() == number
            assert not handled
        assert caplog.text.count("items: the region has 5 elements; the bound is 4") == 2
        client.send(spoil(sort.Sort_Request(), "items"))
        timer = threading.Timer(0.05, client.send, [sort.Sort_Request(id=7)])
        timer.start()
        assert server.wait(timeout=5).request.id == 7, "a wait skips the refused request"
        timer.join()


def test_goal_with_an_excessive_count_is_rejected(topic, kinds):
    walk = kinds("action", "Walk")
    with walk.WalkActionServer(topic) as server, walk.WalkActionClient(topic) as client:
        command = walk.Walk_CommandPublisher.message_type
        number = client._calls.send_request(spoil(command(), "goal.steps"))
        assert server.take() is None
        assert client.result(timeout=1).status == walk.Walk_Outcome.REJECTED
        client.send_goal(walk.Walk_Goal(), timeout=1)
        assert server.take().number == number + 1


@pytest.mark.parametrize(("path", "count"), counts.PLACES)
def test_excessive_count_is_found_at_any_depth(folder, path, count):
    msg = build.module(folder, counts.PACKAGE, TypeName("counts_msgs", "msg", "Tree"))
    message = counts.tree(msg, 1)
    message._check_counts()
    counts.spoil(message, path, count)
    with pytest.raises(runtime.CountExceeded) as raised:
        message._check_counts()
    assert raised.value.path == path
