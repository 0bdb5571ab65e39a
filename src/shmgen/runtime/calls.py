"""The shared parts of clients and servers of services and actions: requests and responses in two regions.

The number of a request is its sample number, and a response contains the number of its request. The client therefore
recognizes a late response to an abandoned call, or to a previous client, by its number. A restarted server recognizes
requests from before its start by the position of their samples (docs/protocol.md, "Services").
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from math import inf
from typing import Any, Generic, TypeVar

from shmgen.core import abi
from shmgen.runtime.errors import Closed, CountExceeded, InForkedChild, LockTimeout
from shmgen.runtime.messages.message import Message
from shmgen.runtime.publisher import Publisher
from shmgen.runtime.region import header as h
from shmgen.runtime.region.settings import UNTIL_RECOVERED
from shmgen.runtime.subscriber import Subscriber

Q = TypeVar("Q", bound=Message)
A = TypeVar("A", bound=Message)
T = TypeVar("T")

_LOOK = 2e-3
"""Seconds between two checks for a server, or between two attempts to send a response."""
_FRESH = abi.CLAIM_MS / 1000
"""Seconds for which a heartbeat counts as recent. A running PLC increments its heartbeat within this time."""
_LONGEST_WAIT = 1.0
HEARTBEAT_INTERVAL = abi.HEARTBEAT_MS / 1000
"""Seconds between two heartbeats of a waiting server."""


class CallClient(Generic[Q, A]):
    """Sends the requests of one service or action and receives the responses. One request is pending at a time.

    `number` is the number of the pending request, or 0 if no request is pending. `key` is the name of the response
    field that contains the number of the request.
    """

    def __init__(self, requests: Publisher[Q], responses: Subscriber[A], key: str) -> None:
        self.number = 0
        self._requests, self._writer = requests, requests.engine_end
        self._responses, self._reader = responses, responses.engine_end
        self.incoming = responses
        self._key = key
        self._beat = -1
        self._looked = 0.0

    def send_request(self, request: Any, deadline: float | None = None) -> int:
        """Send a request and return its number. Abandon the previous request.

        `deadline`, a value of time.monotonic(), limits the wait for the lock on machines that need the lock (not x86).
        Raises the errors of Publisher.publish().
        """
        self.number = 0
        self._reader.skip()  # existing responses do not belong to the new request
        left = None if deadline is None else round(1e9 * (deadline - time.monotonic()))
        self._writer.publish(request, left)
        self.number = self._requests.sequence
        return self.number

    def poll(self) -> A | None:
        """Return the response to the pending request, or None if the response has not arrived. Do not wait.

        The response is returned once. Only one request is pending, and responses arrive in the order of their requests,
        so this method reads only the newest response.
        """
        return self._own(self._responses.read())

    def wait(self, timeout: float) -> A | None:
        """Return the response to the pending request as soon as it arrives, or None after `timeout` seconds.

        Return None at once if no request is pending.
        """
        deadline = time.monotonic() + timeout
        while self.number:
            left = max(0.0, deadline - time.monotonic())
            if response := self._own(self._responses.wait(left)):
                return response
            if not left:
                break
        return None

    def server_is_ready(self) -> bool:
        """Return True if a server is available now. The call takes up to 1 s if the last known server was a PLC."""
        return self.wait_for_server(_FRESH if self._reader.load(h.WRITER) == h.PLC else 0.0)

    def wait_for_server(self, timeout: float) -> bool:
        """Return True as soon as a server is available, or False after `timeout` seconds."""
        deadline = time.monotonic() + timeout
        while not self._server_lives():
            left = deadline - time.monotonic()
            if left <= 0:
                return False
            time.sleep(min(_LOOK, left))
        return True

    def _own(self, response: A | None) -> A | None:
        if response is None or not self.number or getattr(response, self._key) != self.number:
            return None
        self.number = 0
        return response

    def _server_lives(self) -> bool:
        """Return True if a server is running.

        A server process holds a record lock and has stored its process id. A PLC holds no record lock. A PLC is
        running if its heartbeat has changed since the previous call of this method, provided that the previous call was
        at most 1 s ago.
        """
        end, now = self._reader, time.monotonic()
        end.check()
        is_plc = end.load(h.WRITER) == h.PLC
        if not is_plc and end.is_claimed():
            return True
        before, self._beat = self._beat, end.load(h.HEARTBEAT)
        known, self._looked = now - self._looked < _FRESH, now
        return is_plc and known and self._beat != before


class CallServer(Generic[Q, A]):
    """Receives the requests of one service or action and sends the responses. One request is pending at a time.

    `number` is the number of the request last passed to begin(), or 0. Only this request can get a response.
    """

    def __init__(self, requests: Subscriber[Q], responses: Publisher[A], *others: Publisher[Any]) -> None:
        """Serve the requests in the region of `requests`, and publish the responses by `responses`.

        A previous server may already have handled the requests that exist. Therefore the caller must mark all requests
        as read before it opens `responses` and `others`, its other publishers, and so becomes visible to clients.
        """
        self.number = 0
        self._requests, self._reader = requests, requests.engine_end
        self._responses, self._writer = responses, responses.engine_end
        self.incoming = requests
        self._begun_at = 0, 0
        self._answered = 0
        if any(publisher.engine_end.predecessor_may_be_alive for publisher in (responses, *others)):
            self._reader.skip()

    def take(self, timeout: float) -> tuple[int, Q] | None:
        """Wait at most `timeout` seconds for a request. Return its sample number and its message, or None.

        If several requests are unread, return the newest. Each request is returned once. While waiting, send heartbeats
        to the client.
        """
        deadline = time.monotonic() + timeout
        while True:
            self._responses.heartbeat()
            left = max(0.0, deadline - time.monotonic())
            request = self._requests.wait(min(left, HEARTBEAT_INTERVAL)) if left else self._requests.read()
            if request is not None:
                self._writer.check_claim()  # raises ClaimLost if another server has taken over
                return self._requests.sequence, request
            if not left:
                return None

    def begin(self, number: int) -> None:
        """Make `number` the only request that can get a response."""
        self.number, self._answered, self._begun_at = number, 0, self._position()

    def is_usable(self, request: Message, refuse: Callable[[], object]) -> bool:
        """Return True if all counts of the request are within their bounds.

        If a count exceeds its bound, log the reason by the logger `shmgen`, call `refuse`, which sends a failure to
        the client, and return False.
        """
        try:
            request._check_counts()
        except CountExceeded:
            log_exception(f"{self._requests.topic}: request {self.number} cannot be used")
            self.retry_until_sent(refuse, deadline_of(UNTIL_RECOVERED))
            return False
        return True

    def awaits(self, number: int) -> bool:
        """Return True if request `number` is pending: the last begin() was for this request, and no response was sent.

        A signal handler may interrupt this server between the publication of the response and the assignment that
        records the response as published. Therefore also check whether the response region has a new sample.
        """
        if number != self.number or number == self._answered:
            return False
        count, sequence = self._position()
        return sequence == self._begun_at[1] or count != self._begun_at[0]  # a reopened region has other numbers

    def _position(self) -> tuple[int, int]:
        return self._responses.reopen_count, self._responses.sequence

    def send_response(self, number: int, response: Any) -> bool:
        """Send the response to request `number`. If the request is no longer pending, send nothing and return False.

        Raises the errors of Publisher.publish().
        """
        if not self.awaits(number):
            return False
        self._responses.publish(response)
        self._answered = number
        return True

    def retry_until_sent(self, send: Callable[[], object], deadline: float = inf) -> None:
        """Call `send`, a function that sends a response, and repeat the call while it raises LockTimeout.

        Give up at `deadline`, a value of time.monotonic(), or when a newer request arrives, because the client then no
        longer waits for this response.
        """
        is_logged = False
        while True:
            try:
                send()
                return
            except LockTimeout:
                if not is_logged:
                    log_exception(f"{self._responses.topic}: the reply to request {self.number} waits for the lock")
                is_logged = True
            if time.monotonic() >= deadline or self._requests.ready(0.0):
                return
            self._responses.heartbeat()
            time.sleep(_LOOK)

    def client_lives(self) -> bool:
        """Return True if a client is running.

        A client process holds a record lock. A PLC is running if its heartbeat has changed within the last second.
        """
        if self._reader.load(h.WRITER) == h.PLC:
            return not self._requests.is_stale(_FRESH)
        return bool(self._reader.is_claimed())


def deadline_of(timeout: float | None) -> float:
    """Return the time.monotonic() value `timeout` seconds from now, or infinity for None."""
    return inf if timeout is None else time.monotonic() + timeout


def until(deadline: float, wait: Callable[[float], T | None]) -> Iterator[T]:
    """Yield each result of `wait` that is not None, until `deadline` or until `wait` raises Closed.

    `wait` receives the longest time to wait in seconds. `deadline` is a value of time.monotonic().
    """
    while (left := deadline - time.monotonic()) > 0:
        try:
            result = wait(min(left, _LONGEST_WAIT))
        except InForkedChild:
            raise
        except Closed:
            return
        if result is not None:
            yield result


def log_exception(text: str) -> None:
    """Log `text` by the logger `shmgen`, with the traceback of the current exception."""
    import logging  # takes longer to load than the rest of the runtime

    logging.getLogger("shmgen").exception(text)
