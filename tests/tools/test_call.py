"""Tests of `shmgen call`, and of other tools with the regions of a service."""

from __future__ import annotations

import json
import re
import threading
import time
from pathlib import Path

import pytest

from shmgen import config
from shmgen.core.diagnostics import Report
from shmgen.live.classes import ClassRegistry, call_class
from shmgen.live.session import Session
from shmgen.runtime import ServiceServer
from shmgen.tools.messages import call as tool

DEFINITION = "bool on\nuint32 batch 7\n---\nbool success\nuint32[<=40] batches\nstring message\n"
CONFIGURATION = '[strings]\n"cell_msgs/Start_Response.message" = 12\n'


@pytest.fixture
def folder(shmgen, tmp_path):
    (tmp_path / "cell_msgs" / "srv").mkdir(parents=True)
    (tmp_path / "cell_msgs" / "srv" / "Start.srv").write_text(DEFINITION)
    (tmp_path / "shmgen.toml").write_text(f'path = ["."]\n{CONFIGURATION}')
    return tmp_path


@pytest.fixture
def running_server(folder, topic):
    """A server in a thread of this process, which answers the command like a PLC or a bridge."""
    registry = ClassRegistry(Session(config.load(folder / "shmgen.toml", "shmgen.toml", Report())), None)
    _, client = tool.build(topic, "cell_msgs/Start", {}, registry)
    kinds = {"_Request": client.request_publisher.message_type, "_Reply": client.reply_subscriber.message_type}
    stop = threading.Event()

    def handler(request):
        if not request.on:
            raise OSError("jammed")
        return Answer(request.batch)

    def serve():
        while not stop.is_set():
            server.serve(handler, 0.1)

    with call_class(ServiceServer, kinds)(topic) as server:
        thread = threading.Thread(target=serve)
        thread.start()
        yield
        stop.set()
        thread.join()


class Answer:
    success = True
    message = "on its way"

    def __init__(self, batch):
        self.batches = range(batch, batch + 40)


def test_call_prints_the_response(running_server, shmgen, topic):
    result = shmgen("call", topic, "cell_msgs/Start", "{on: true}")
    assert (result.code, result.stderr) == (0, "")
    lines = result.stdout.splitlines()
    assert lines[:2] == ["requesting: Start_Request(on=True, batch=7)", "success: true"]
    assert lines[2].endswith(" 45, 46]")
    assert lines[3:] == ["message: on its way"]
    result = shmgen("call", topic, "cell_msgs/srv/Start", '{"on": true, "batch": 1}', "--json")
    assert json.loads(result.stdout) == {"success": True, "batches": [*range(1, 41)], "message": "on its way"}
    result = shmgen("call", topic, "cell_msgs/Start")
    assert (result.code, result.stdout) == (1, "requesting: Start_Request(on=False, batch=7)\n")
    assert re.match(rf"{topic}: error\[SHM703\]: the server reported that call \d+ failed\n  hint: ", result.stderr)
    for half, line in (("request", "batch: 7"), ("response", "status: 2")):
        assert line in shmgen("echo", f"{topic}-{half}", "--once").stdout
    doctor_result = shmgen("doctor", topic)
    assert f"{topic}-request  cell_msgs/srv/Start_Request, 2 slots, 3 samples" in doctor_result.stdout
    assert f"{topic}-response  cell_msgs/srv/Start_Reply, 2 slots, 3 samples" in doctor_result.stdout
    assert "2 regions, no faults" in doctor_result.stdout
    assert "publishes to it" in shmgen("clean", topic).stderr


def test_invalid_arguments_are_refused_before_a_region_exists(folder, shmgen, topic):
    for arguments, message in (
        (("cell_msgs/Start", "{batch: many}"), "batch: 'many' is str"),
        (("cell_msgs/Start", "{off: true}"), "off: no such field in cell_msgs/srv/Start_Request"),
        (("cell_msgs/Start", "{off"), "; write YAML or JSON, in quotes"),
        (("Start",), "Start is not a service type: write package/Name"),
        (("std_msgs/Bool",), "std_msgs/Bool is a message, not a service; `shmgen pub` publishes it"),
        (("std_msgs/Boot",), "unknown message type `std_msgs/srv/Boot`"),
    ):
        result = shmgen("call", topic, *arguments)
        assert result.code == 1
        assert message in result.sentence
    assert not list(Path("/dev/shm").glob(f"*{topic[1:].replace('/', '.')}*"))


def test_call_without_a_server_times_out(folder, shmgen, topic):
    started_at = time.monotonic()
    result = shmgen("call", topic, "cell_msgs/Start", "--timeout", "0.1")
    assert result.code == 1
    assert f"{topic}: no server within 0.1 s; the request was not sent" in result.sentence
    assert time.monotonic() - started_at < 5
    region = topic[1:].replace("/", ".")
    removed = shmgen("clean", topic)
    assert removed.code == 0
    ends = ("-request", "-response")
    files = [f"/dev/shm/sem.{region}{end}" for end in ends]
    assert set(removed.stdout.split()) - {"removed"} == {*files, *(f"/dev/shm/{region}{end}" for end in ends)}
    assert not list(Path("/dev/shm").glob(f"*{region}*"))


def test_call_refuses_a_server_with_another_layout(running_server, shmgen, topic, folder):
    (folder / "shmgen.toml").write_text('path = ["."]\n')
    result = shmgen("call", topic, "cell_msgs/Start", "{on: true}")
    assert result.code == 1
    assert "the region has another layout of cell_msgs/srv/Start_Reply than this" in result.stderr


def test_doctor_compares_service_regions_with_shmgen_toml(folder, shmgen, topic):
    shmgen("call", topic, "cell_msgs/Start", "--timeout", "0.01")
    (folder / "other_msgs" / "srv").mkdir(parents=True)
    (folder / "other_msgs" / "srv" / "Go.srv").write_text("---\n")
    with (folder / "shmgen.toml").open("a") as file:
        file.write(f'[[services]]\nservice = "{topic}"\ntype = "other_msgs/Go"\n')
    result = shmgen("doctor", topic)
    assert "the region has type cell_msgs/srv/Start_Request, but shmgen.toml has other_msgs/Go_Request" in result.stdout
    assert "the region has type cell_msgs/srv/Start_Reply, but shmgen.toml has other_msgs/Go_Reply" in result.stdout
