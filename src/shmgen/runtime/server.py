"""The server of a service: hands requests to Python, and its responses back."""

from __future__ import annotations

import time
from collections.abc import Callable
from contextlib import ExitStack, suppress
from functools import partial
from types import SimpleNamespace
from typing import Any, Generic, NamedTuple, TypeVar

from shmgen.runtime.calls import CallServer, deadline_of, log_exception, skip_stale, until
from shmgen.runtime.errors import LockTimeout
from shmgen.runtime.messages.message import Message
from shmgen.runtime.publisher import Publisher
from shmgen.runtime.region.resource import Closable
from shmgen.runtime.subscriber import Subscriber

Request = TypeVar("Request", bound=Message)


class Call(NamedTuple):
    """A pending request; `number` counts the requests of the service."""

    number: int
    request: Any


class ServiceServer(Closable, Generic[Request]):
    """Serves one service, one call at a time. Not for two threads at a time; forked children open their own."""

    request_subscriber: type[Subscriber[Request]]
    reply_publisher: type[Publisher[Any]]

    def __init__(
        self,
        service: str,
        *,
        lock_timeout: float | None = None,
        mode: int | None = None,
        group: str | int | None = None,
        spin: float = 0.0,
    ) -> None:
        """Opens the service's regions or creates them; one server for each service. Requests pending before are stale.

        `lock_timeout` (seconds), `mode`, `group` and `spin` as for a Subscriber, and its errors: ValueError,
        LayoutMismatch, RegionInUse, PermissionDenied, RegionUnusable.
        """
        options: dict[str, Any] = {"lock_timeout": lock_timeout, "mode": mode, "group": group}
        with ExitStack() as opened:
            requests = opened.enter_context(self.request_subscriber(f"{service}-request", spin=spin, **options))
            skip_stale(requests)
            responses = opened.enter_context(self.reply_publisher(f"{service}-response", **options))
            if responses._end.doubtful:
                skip_stale(requests)
            opened.pop_all()
        self._calls = CallServer(requests, responses)
        self._reply: Any = self.reply_publisher.message_type
        self._service = service

    def serve(self, handler: Callable[[Request], Any], timeout: float | None = None) -> None:
        """Replies to each request with what `handler(request)` returns: a response, or any object with its attributes.

        Ends after `timeout` seconds, or never. An exception in the handler, or a response that does not fit, makes
        that call FAILED and is logged as `shmgen`; a KeyboardInterrupt or another BaseException ends serve(). A lock
        timeout does not: the response then waits until the lock is free or the client has abandoned the call.
        """
        deadline = deadline_of(timeout)
        for call in until(deadline, self.wait):
            try:
                response = handler(call.request)
                self._calls.retry_until_sent(partial(self.reply, call, response), deadline)
            except Exception:
                self._calls.retry_until_sent(partial(self.fail, call), deadline)
                log_exception(f"{self._service}: call {call.number} failed")
            except BaseException:
                with suppress(LockTimeout):
                    self.fail(call)
                raise

    def take(self) -> Call | None:
        """The newest request not taken yet, or None. Take or wait often: that is the heartbeat for a PLC."""
        return self.wait(0.0)

    def wait(self, timeout: float) -> Call | None:
        """The newest request as soon as there is a new one, or None after `timeout` seconds.

        A request before it that was not taken is dropped: its client has abandoned it. One with a count above its
        bound fails at once, and is logged as `shmgen`.
        """
        deadline = time.monotonic() + timeout
        while taken := self._calls.take(max(0.0, deadline - time.monotonic())):
            call = Call(*taken)
            self._calls.begin(call.number)
            if self._calls.is_usable(call.request, partial(self.fail, call)):
                return call
        return None

    def reply(self, call: Call, response: Any) -> bool:
        """Sends the response; False if the call has one already, or a newer call has been taken.

        Raises ValueRejected, with the path of the field, and LockTimeout; the call is then still pending.
        """
        return self._calls.send_response(
            call.number, SimpleNamespace(call=call.number, status=self._reply.DONE, response=response)
        )

    def fail(self, call: Call) -> bool:
        """Reports to the client that the call failed; False as in reply(). Raises LockTimeout."""
        return self._calls.send_response(call.number, self._reply(call=call.number, status=self._reply.FAILED))

    def close(self) -> None:
        """Releases the service for another server; the regions stay."""
        self._calls.close()

    @property
    def service(self) -> str:
        """As given."""
        return self._service
