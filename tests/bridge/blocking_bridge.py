"""Run `shmgen bridge` with a backend whose calls block: `blocking_bridge.py CALL HELD TRIGGER`.

CALL is the name of the call that blocks: `publish`, `create`, `discover` or `close`. HELD is `held` if the call keeps
the GIL while it blocks, as rclpy can in Fast DDS. A call blocks as soon as the file TRIGGER exists.
"""

from __future__ import annotations

import ctypes
import sys
from collections.abc import Callable
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Any

from shmgen.bridge.backend import Backend, RosClient, RosPublisher, RosSubscription
from shmgen.bridge.common import choice
from shmgen.cli.main import main

call, keeps_gil, trigger = sys.argv[1], sys.argv[2] == "held", Path(sys.argv[3])


def block(name: str, topic: str = "") -> None:
    """Block permanently if the call is for the topic `/…/blocked` or for no topic."""
    if name == call and topic.endswith("blocked" if topic else "") and trigger.exists():
        library = ctypes.PyDLL(None) if keeps_gil else ctypes.CDLL(None)
        mutex = ctypes.create_string_buffer(64)  # PTHREAD_MUTEX_INITIALIZER; no signal interrupts the second lock
        library.pthread_mutex_lock(mutex)
        library.pthread_mutex_lock(mutex)


class Blocking(Backend):
    """A backend with topics only."""

    def __init__(self, report: Callable[[str], None]) -> None:
        super().__init__()
        self._report = report

    def publisher(self, wire: Any) -> RosPublisher:
        block("create", wire.name)

        def send(message: Any) -> None:
            block("publish", wire.name)
            self._report(f"sent {wire.name}")

        return RosPublisher(lambda: SimpleNamespace(data=False), send)

    def subscribe(self, wire: Any, take: Any, errors: Any) -> RosSubscription:
        block("create", wire.name)
        return RosSubscription(lambda: SimpleNamespace(data=False))

    def serve(self, wire: Any, answer: Any, errors: Any) -> None:
        raise NotImplementedError

    def client(self, wire: Any) -> RosClient:
        raise NotImplementedError

    def alive(self) -> bool:
        block("discover")
        return True

    def close(self) -> None:
        block("close")


if __name__ == "__main__":
    module: Any = ModuleType("blocking")
    module.connect = lambda node: Blocking(node.log)
    choice.chosen = lambda key: ("blocking", "for a test")
    choice.module = lambda key: module
    sys.argv[1:] = ["bridge"]
    main()
