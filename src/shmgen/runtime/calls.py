"""Requests and their responses in two regions: what clients and servers of services and of actions share.

A request has the number of its sample, and a response carries the number of its request. So a late response, to a call
given up or to a former client, is known from its number, and a restarted server knows by the position of the samples
what was asked before its time (docs/protocol.md, "Services").
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from math import inf
from typing import Any, Generic, TypeVar

from shmgen.core import abi
from shmgen.runtime.errors import CountExceeded, LockTimeout
from shmgen.runtime.messages.message import Message
from shmgen.runtime.publisher import Publisher
from shmgen.runtime.region import header as h
from shmgen.runtime.region.settings import UNTIL_RECOVERED
from shmgen.runtime.subscriber import Subscriber

Q = TypeVar("Q", bound=Message)
A = TypeVar("A", bound=Message)
T = TypeVar("T")

_LOOK = 2e-3
"""Seconds between two looks for a server."""
_FRESH = abi.CLAIM_MS / 1000
"""Seconds for which a heartbeat seen to move counts, and within which a PLC that still runs moves it."""
_LONGEST_WAIT = 1.0
_HEARTBEAT = abi.HEARTBEAT_MS / 1000
"""Seconds between two signs of life of a server that waits."""


class CallClient(Generic[Q, A]):
    """The end of the client. `number` is that of the request without a response yet, 0 = none.

    `key` is the name of the field that holds the number in a response.
    """

    def __init__(self, requests: Publisher[Q], responses: Subscriber[A], key: str) -> None:
        self.number = 0
        self._requests = requests
        self._responses = responses
        self._key = key
        self._beat = -1
        self._looked = 0.0

    def send_request(self, request: Any, deadline: float | None = None) -> int:
        """Sends a request and gives the one before up; returns its number. Raises as Publisher.publish.

        `deadline`, by time.monotonic(): how long it may wait for the lock, where that is needed.
        """
        self.number = 0
        self._responses._end.skip()  # what is there responds to nothing that is still to come
        left = None if deadline is None else round(1e9 * (deadline - time.monotonic()))
        self._requests._end.publish(request, left)
        self.number = self._requests.sequence
        return self.number

    def tell(self, message: Any) -> None:
        """Sends what asks for no response. Raises as Publisher.publish."""
        self._requests.publish(message)

    def poll(self) -> A | None:
        """The response, once. Responses come in the order of their requests, so the newest is enough."""
        return self._own(self._responses.read())

    def wait(self, timeout: float) -> A | None:
        """The response as soon as it comes, or None after `timeout` seconds."""
        deadline = time.monotonic() + timeout
        while self.number:
            left = max(0.0, deadline - time.monotonic())
            if response := self._own(self._responses.wait(left)):
                return response
            if not left:
                break
        return None

    def server_is_ready(self) -> bool:
        """Whether somebody serves now. Takes up to a second where a PLC served and may have stopped."""
        return self.wait_for_server(_FRESH if self._responses._end.load(h.WRITER) == h.PLC else 0.0)

    def wait_for_server(self, timeout: float) -> bool:
        """Whether somebody serves, as soon as somebody does or after `timeout` seconds."""
        deadline = time.monotonic() + timeout
        while not self._server_lives():
            left = deadline - time.monotonic()
            if left <= 0:
                return False
            time.sleep(min(_LOOK, left))
        return True

    def close(self) -> None:
        self._requests.close()
        self._responses.close()

    def _own(self, response: A | None) -> A | None:
        if response is None or not self.number or getattr(response, self._key) != self.number:
            return None
        self.number = 0
        return response

    def _server_lives(self) -> bool:
        """A process holds its record lock, and has put its name there; a PLC can only be seen to count."""
        end, now = self._responses._end, time.monotonic()
        is_plc = end.load(h.WRITER) == h.PLC
        if not is_plc and end.is_claimed():
            return True
        before, self._beat = self._beat, end.load(h.HEARTBEAT)
        known, self._looked = now - self._looked < _FRESH, now
        return is_plc and known and self._beat != before


class CallServer(Generic[Q, A]):
    """The end of the server. `number` is that of the request begun last, 0 = none: no other can get a response."""

    def __init__(self, requests: Subscriber[Q], responses: Publisher[A]) -> None:
        """`requests` holds nothing unread: see `skip_stale`."""
        self.number = 0
        self._requests = requests
        self._responses = responses
        self._begun_at = 0

    def take(self, timeout: float) -> tuple[int, Q] | None:
        """The newest request with its number, once, as soon as there is one, or None after `timeout` seconds.

        Tells the other side that it lives.
        """
        deadline = time.monotonic() + timeout
        while True:
            self._responses.heartbeat()
            left = max(0.0, deadline - time.monotonic())
            request = self._requests.wait(min(left, _HEARTBEAT)) if left else self._requests.read()
            if request is not None:
                self._responses._end.assure()  # or another server has taken over, and serves it
                return self._requests.sequence, request
            if not left:
                return None

    def begin(self, number: int) -> None:
        """From now on this request waits for its response, and no other."""
        self.number, self._begun_at = number, self._responses.sequence

    def is_usable(self, request: Message, refuse: Callable[[], object]) -> bool:
        """False: the request begun last has a count above its bound, and `refuse` has sent the response."""
        try:
            request._check_counts()
        except CountExceeded:
            log_exception(f"{self._requests.topic}: request {self.number} cannot be used")
            self.retry_until_sent(refuse, deadline_of(UNTIL_RECOVERED))
            return False
        return True

    def awaits(self, number: int) -> bool:
        """Whether that request still waits for its response.

        By what was published, so that an exception out of a signal handler behind that makes no second response.
        """
        return number == self.number and self._responses.sequence == self._begun_at

    def send_response(self, number: int, response: Any) -> bool:
        """False, and nothing sent, if that request waits no more. Raises as Publisher.publish."""
        if not self.awaits(number):
            return False
        self._responses.publish(response)
        return True

    def retry_until_sent(self, send: Callable[[], object], deadline: float = inf) -> None:
        """Calls `send`, which sends a response, until the lock lets it through: of a lock no server ends.

        Gives up at the deadline, by time.monotonic(), and for a newer request, since nobody waits for this any more.
        """
        told = False
        while True:
            try:
                send()
                return
            except LockTimeout:
                if not told:
                    log_exception(f"{self._responses.topic}: the reply to {self.number} waits for the lock")
                told = True
            if time.monotonic() >= deadline or self._requests.ready(0.0):
                return
            self._responses.heartbeat()
            time.sleep(_LOOK)

    def client_lives(self) -> bool:
        """A process holds its record lock; a PLC's heartbeat has moved within the last second."""
        requests = self._requests
        if requests._end.load(h.WRITER) == h.PLC:
            return not requests.is_stale(_FRESH)
        return bool(requests._end.is_claimed())

    def close(self) -> None:
        self._requests.close()
        self._responses.close()


def deadline_of(timeout: float | None) -> float:
    """By time.monotonic(); None: never."""
    return inf if timeout is None else time.monotonic() + timeout


def until(deadline: float, wait: Callable[[float], T | None]) -> Iterator[T]:
    """What `wait` gives, until that instant by time.monotonic()."""
    while (left := deadline - time.monotonic()) > 0:
        found = wait(min(left, _LONGEST_WAIT))
        if found is not None:
            yield found


def log_exception(text: str) -> None:
    """Into the log `shmgen`, with the traceback of the exception that is being handled."""
    import logging  # takes longer to load than the rest of the runtime

    logging.getLogger("shmgen").exception(text)


def skip_stale(requests: Subscriber[Q]) -> None:
    """Takes what lies there for read: whether a server before this one has done it nobody knows.

    Comes before the claim that shows clients a server, so that no call is lost between the two.
    """
    requests._end.skip()
