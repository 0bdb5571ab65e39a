"""The client of a service."""

from __future__ import annotations

import threading
import time
from typing import Any, Generic, TypeVar

from shmgen.runtime.calls import CallClient
from shmgen.runtime.errors import CallFailed, CallTimeout, NoServer
from shmgen.runtime.messages.message import Message
from shmgen.runtime.publisher import Publisher
from shmgen.runtime.region.resource import CallEnd, OpenRegion
from shmgen.runtime.subscriber import Subscriber

Request = TypeVar("Request", bound=Message)
Response = TypeVar("Response", bound=Message)


class ServiceClient(CallEnd, Generic[Request, Response]):
    """Call one service, one call at a time.

    Threads may share a client. A forked child must open its own client.

    ```python
    with SetBoolClient("/lamp") as client:
        response = client.call(SetBool_Request(data=True), timeout=1.0)
        print(response.success)
    ```
    """

    request_publisher: type[Publisher[Request]]
    reply_subscriber: type[Subscriber[Any]]
    _calls: CallClient[Request, Any]

    def _open(self, write: OpenRegion, read: OpenRegion) -> None:
        requests = write(self.request_publisher, "request")
        responses = read(self.reply_subscriber, "response")
        self._calls = CallClient(requests, responses, "call")
        self._one_at_a_time = threading.RLock()

    def call(self, request: Any, timeout: float) -> Response:
        """Wait for a server, send `request`, wait for the response and return it, all within `timeout` seconds.

        `request` is a request message, or any object with the same attributes.
        Raises NoServer if no server is available; nothing was sent. Raises CallTimeout if no response arrives in time;
        the server may still handle the request. Raises CallFailed if the server reports a failure.
        Raises ValueRejected if a value does not fit.
        Raises LockTimeout if this machine needs the lock (not x86) and the lock is not free in time.
        """
        deadline = time.monotonic() + timeout
        try:
            if not self._one_at_a_time.acquire(timeout=max(0.0, timeout)):
                raise CallTimeout(f"{self._name}: a call of another thread used the whole timeout of {timeout:g} s")
            if not self._calls.wait_for_server(deadline - time.monotonic()):
                raise NoServer(f"{self._name}: no server within {timeout:g} s; the request was not sent")
            number = self._calls.send_request(request, deadline)
            reply = self._calls.wait(deadline - time.monotonic())
            if reply is None:
                self._calls.number = 0
                raise CallTimeout(f"{self._name}: call {number} got no response within {timeout:g} s")
            response = self._response(reply)
            return response  # noqa: RET504 the last step before the release must not be a call
        finally:
            # A signal handler may raise after acquire() but before its result is assigned. Therefore release() alone
            # decides whether this thread holds the lock.
            try:  # noqa: SIM105
                self._one_at_a_time.release()
            except RuntimeError:
                pass

    def send(self, request: Any) -> int:
        """Send `request`, even if no server is available, and return its number. Then use poll() or wait().

        Sending abandons a call that is still pending. Raises ValueRejected and LockTimeout as call() does.
        """
        with self._one_at_a_time:
            return self._calls.send_request(request)

    def poll(self) -> Response | None:
        """Return the response to the last send(), or None if the response has not arrived. Do not wait.

        The response is returned once: the next call returns None. Raises CallFailed if the server reports a failure.
        """
        with self._one_at_a_time:
            reply = self._calls.poll()
            return None if reply is None else self._response(reply)

    def wait(self, timeout: float) -> Response | None:
        """Return the response to the last send() as soon as the response arrives, or None after `timeout` seconds.

        Raises CallFailed if the server reports a failure.
        """
        with self._one_at_a_time:
            reply = self._calls.wait(timeout)
            return None if reply is None else self._response(reply)

    async def wait_async(self, timeout: float) -> Response | None:
        """Return the response to the last send() as soon as the response arrives, or None after `timeout` seconds.

        For coroutines: `client.send(request)`, then `await client.wait_async(timeout)`.
        Raises CallFailed if the server reports a failure.
        """
        return await self._calls.incoming._poll_until_found(self.poll, timeout)

    def cancel(self) -> None:
        """Abandon the request of the last send(). If the server still sends a response, the client discards it."""
        with self._one_at_a_time:
            self._calls.number = 0

    def server_is_ready(self) -> bool:
        """Return True if a server is available now. The call takes up to 1 s if the last known server was a PLC."""
        with self._one_at_a_time:
            return self._calls.server_is_ready()

    def wait_for_server(self, timeout: float) -> bool:
        """Return True as soon as a server is available, or False after `timeout` seconds."""
        with self._one_at_a_time:
            return self._calls.wait_for_server(timeout)

    @property
    def service(self) -> str:
        """The name of the service."""
        return self._name

    def _response(self, reply: Any) -> Response:
        if reply.status != reply.DONE:
            raise CallFailed(f"{self._name}: the server reported that call {reply.call} failed")
        response: Response = reply.response
        return response
