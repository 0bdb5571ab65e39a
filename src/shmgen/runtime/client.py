"""The client of a service."""

from __future__ import annotations

import threading
import time
from contextlib import ExitStack
from typing import Any, Generic, TypeVar

from shmgen.runtime.calls import CallClient
from shmgen.runtime.errors import CallFailed, CallTimeout, NoServer
from shmgen.runtime.messages.message import Message
from shmgen.runtime.publisher import Publisher
from shmgen.runtime.region.resource import Closable
from shmgen.runtime.subscriber import Subscriber

Request = TypeVar("Request", bound=Message)
Response = TypeVar("Response", bound=Message)


class ServiceClient(Closable, Generic[Request, Response]):
    """Calls one service, one call at a time; threads may share it, forked children open their own."""

    request_publisher: type[Publisher[Request]]
    reply_subscriber: type[Subscriber[Any]]

    def __init__(
        self,
        service: str,
        *,
        lock_timeout: float | None = None,
        mode: int | None = None,
        group: str | int | None = None,
        spin: float = 0.0,
    ) -> None:
        """Opens the service's regions or creates them; one client for each service. No server is needed yet.

        `lock_timeout` (seconds), `mode`, `group` and `spin` as for a Subscriber, and its errors: ValueError,
        LayoutMismatch, RegionInUse, PermissionDenied, RegionUnusable.
        """
        options: dict[str, Any] = {"lock_timeout": lock_timeout, "mode": mode, "group": group}
        with ExitStack() as opened:
            requests = opened.enter_context(self.request_publisher(f"{service}-request", **options))
            responses = opened.enter_context(self.reply_subscriber(f"{service}-response", spin=spin, **options))
            opened.pop_all()
        self._calls = CallClient(requests, responses, "call")
        self._one_at_a_time = threading.RLock()
        self._service = service

    def call(self, request: Any, timeout: float) -> Response:
        """Waits for a server, sends `request` (any object with its attributes) and waits for the response.

        All within `timeout` seconds. Raises NoServer, and nothing was sent; CallTimeout, and the server may still do
        it; CallFailed; ValueRejected for a value that does not fit; LockTimeout.
        """
        deadline = time.monotonic() + timeout
        try:
            if not self._one_at_a_time.acquire(timeout=max(0.0, timeout)):
                raise CallTimeout(f"{self._service}: another thread's call took all of the {timeout:g} s")
            if not self._calls.wait_for_server(deadline - time.monotonic()):
                raise NoServer(f"{self._service}: no server within {timeout:g} s; the request was not sent")
            number = self._calls.send_request(request, deadline)
            reply = self._calls.wait(deadline - time.monotonic())
            if reply is None:
                self._calls.number = 0
                raise CallTimeout(f"{self._service}: call {number} got no response within {timeout:g} s")
            response = self._response(reply)
            return response  # noqa: RET504 no call is the last thing before the release
        finally:
            # One call, which knows itself whether there is something to release: a signal handler may raise behind
            # each call, so also before the result of acquire() is there.
            try:  # noqa: SIM105
                self._one_at_a_time.release()
            except RuntimeError:
                pass

    def send(self, request: Any) -> int:
        """Sends `request`, whether a server is available or not, and returns the call's number; then use poll().

        A call that is still pending is abandoned. Raises ValueRejected and LockTimeout.
        """
        with self._one_at_a_time:
            return self._calls.send_request(request)

    def poll(self) -> Response | None:
        """The response to what send() sent, once, or None if it is not there yet. Raises CallFailed."""
        with self._one_at_a_time:
            reply = self._calls.poll()
            return None if reply is None else self._response(reply)

    def wait(self, timeout: float) -> Response | None:
        """The same as soon as it is there, or None after `timeout` seconds. Raises CallFailed."""
        with self._one_at_a_time:
            reply = self._calls.wait(timeout)
            return None if reply is None else self._response(reply)

    def cancel(self) -> None:
        """Abandons what send() sent, on the client side only: the server may handle it, its response is discarded."""
        with self._one_at_a_time:
            self._calls.number = 0

    def server_is_ready(self) -> bool:
        """Whether a server is available now. Takes up to a second where a PLC was the server and may have stopped."""
        with self._one_at_a_time:
            return self._calls.server_is_ready()

    def wait_for_server(self, timeout: float) -> bool:
        """Whether a server is available, as soon as one is or after `timeout` seconds."""
        with self._one_at_a_time:
            return self._calls.wait_for_server(timeout)

    def close(self) -> None:
        """Releases the service for another client; the regions stay."""
        self._calls.close()

    @property
    def service(self) -> str:
        """As given."""
        return self._service

    def _response(self, reply: Any) -> Response:
        if reply.status != reply.DONE:
            raise CallFailed(f"{self._service}: the server reported that call {reply.call} failed")
        response: Response = reply.response
        return response
