"""The server of a service: passes requests to a Python handler and sends the responses."""

from __future__ import annotations

import time
from collections.abc import Callable
from contextlib import suppress
from functools import partial
from types import SimpleNamespace
from typing import Any, Generic, NamedTuple, TypeVar

from shmgen.runtime.calls import HEARTBEAT_INTERVAL, CallServer, deadline_of, log_exception, until
from shmgen.runtime.errors import LockTimeout
from shmgen.runtime.messages.message import Message
from shmgen.runtime.publisher import Publisher
from shmgen.runtime.region.resource import CallEnd, OpenRegion
from shmgen.runtime.subscriber import Subscriber

Request = TypeVar("Request", bound=Message)


class Call(NamedTuple):
    """A pending request. `number` is the sample number of the request and identifies the call.

    ```python
    with SetBoolServer("/lamp") as server:
        if call := server.wait(timeout=1.0):
            server.reply(call, SetBool_Response(success=call.request.data))
    ```
    """

    number: int
    request: Any


class ServiceServer(CallEnd, Generic[Request]):
    """Serve one service, one call at a time.

    Only one thread at a time may use a server. A forked child must open its own server.

    ```python
    def switch(request):
        return SetBool_Response(success=request.data)

    with SetBoolServer("/lamp") as server:
        server.serve(switch, timeout=1.0)
    ```
    """

    request_subscriber: type[Subscriber[Request]]
    reply_publisher: type[Publisher[Any]]
    _calls: CallServer[Request, Any]

    def _open(self, write: OpenRegion, read: OpenRegion) -> None:
        requests = read(self.request_subscriber, "request")
        requests.engine_end.skip()
        responses = write(self.reply_publisher, "response")
        self._calls = CallServer(requests, responses)
        self._reply: Any = self.reply_publisher.message_type

    def serve(self, handler: Callable[[Request], Any], timeout: float | None = None) -> None:
        """Call `handler(request)` for each request and send its return value as the response.

        The handler returns a response message, or any object with the same attributes.
        Return after `timeout` seconds, or when another thread or a signal handler closes the server.
        If the handler raises an exception or the response does not fit, the call becomes FAILED and the exception is
        logged by the logger `shmgen`. KeyboardInterrupt and any other BaseException end serve().
        A lock timeout does not end serve(): the server retries until the lock is free, `timeout` ends, or the client
        sends a newer request.
        """
        deadline = deadline_of(timeout)
        for call in until(deadline, self.wait):
            try:
                response = handler(call.request)
                self._calls.retry_until_sent(partial(self.reply, call, response), deadline)
            except Exception:
                self._calls.retry_until_sent(partial(self.fail, call), deadline)
                log_exception(f"{self._name}: call {call.number} failed")
            except BaseException:
                with suppress(LockTimeout):
                    self.fail(call)
                raise

    def take(self) -> Call | None:
        """Return the newest request that no call has returned yet, or None. Do not wait.

        Call take() or wait() often: each call sends the heartbeat by which a PLC client recognizes a running server.
        """
        return self.wait(0.0)

    def wait(self, timeout: float) -> Call | None:
        """Return the newest request as soon as a new request arrives, or None after `timeout` seconds.

        Drop older requests that no call has returned: the client has abandoned them. If a count in the request exceeds
        its bound, the call fails at once and the failure is logged by the logger `shmgen`.
        """
        deadline = time.monotonic() + timeout
        while request := self._calls.take(max(0.0, deadline - time.monotonic())):
            call = Call(*request)
            self._calls.begin(call.number)
            if self._calls.is_usable(call.request, partial(self.fail, call)):
                return call
        return None

    async def wait_async(self, timeout: float) -> Call | None:
        """Return the newest request as soon as it arrives, or None after `timeout` seconds. For coroutines."""
        return await self._calls.incoming._poll_until_found(self.take, timeout, HEARTBEAT_INTERVAL)

    def reply(self, call: Call, response: Any) -> bool:
        """Send the response. Return False if the call already has a response, or if a newer call was taken.

        Raises ValueRejected, with the path of the field, if a value does not fit.
        Raises LockTimeout if this machine needs the lock (not x86) and the lock is not free in time.
        After both errors the call is still pending.
        """
        return self._calls.send_response(
            call.number, SimpleNamespace(call=call.number, status=self._reply.DONE, response=response)
        )

    def fail(self, call: Call) -> bool:
        """Report to the client that the call failed.

        Return False if the call already has a response, or if a newer call was taken.
        Raises LockTimeout as reply() does.
        """
        return self._calls.send_response(call.number, self._reply(call=call.number, status=self._reply.FAILED))

    @property
    def service(self) -> str:
        """The name of the service."""
        return self._name
