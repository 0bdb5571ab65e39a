"""Turns calls of a ROS service into calls of the PLC, and calls of the PLC into calls of a ROS service."""

from __future__ import annotations

import threading
from contextlib import suppress
from typing import Any

from shmgen.bridge.backend import Backend, Caller, NoAnswer
from shmgen.bridge.counters import Counters
from shmgen.bridge.plan import ServiceRoute
from shmgen.bridge.side import About
from shmgen.live.regions import View
from shmgen.runtime import Publisher, ServiceClient, ServiceServer, ShmError, Subscriber, ValueRejected, region_name
from shmgen.runtime.names import region_file

_LOOK = 0.1
"""Seconds after which a thread that waits for a call looks whether the bridge is to stop."""


class PlcServes:
    """A Side: ROS calls, the PLC answers. Calls that come at the same time follow one another."""

    def __init__(self, route: ServiceRoute, counters: Counters, stopping: threading.Event) -> None:
        self.about = _about(route, "PLC serves")
        self.counters = counters
        self._route = route
        kinds = {
            "request_publisher": type("RequestPublisher", (Publisher,), {"message_type": route.kinds["_Request"]}),
            "reply_subscriber": type("ReplySubscriber", (Subscriber,), {"message_type": route.kinds["_Reply"]}),
        }
        self._made: type[ServiceClient[Any, Any]] = type("BridgeClient", (ServiceClient,), kinds)
        self._client: ServiceClient[Any, Any] | None = None
        self._open()

    def join(self, backend: Backend) -> None:
        backend.serve(self._route.wire, self._answer)

    def tick(self) -> None:
        try:
            if self._client is None or self._view.removed:
                self.close()
                self._open()
        except (ShmError, OSError) as error:
            self.counters.complain(str(error))

    def silence(self) -> str:
        return ""

    @property
    def is_open(self) -> bool:
        return self._client is not None

    @property
    def lock_misses(self) -> int:
        return 0

    def close(self) -> None:
        if self._client:
            client, self._client = self._client, None
            client.close()
            self._view.close()

    def _open(self) -> None:
        self._client = self._made(self._route.service.name)
        self._view = _view(self._route)

    def _answer(self, request: Any, response: Any) -> None:
        counters = self.counters
        counters.came()
        try:
            if self._client is None:
                raise NoAnswer("there is no region")
            answer = self._client.call(request, self._route.service.timeout)
            self._route.kinds["_Response"]._decode(bytes(answer), 0, response)
            counters.passed += 1
        except ValueRejected as error:
            counters.rejected += 1
            counters.complain(f"rejected: {error}")
            raise NoAnswer(str(error)) from None
        except Exception as error:  # CallTimeout, CallFailed, or whatever a ROS may raise
            counters.failed += 1
            counters.complain(_words(error))
            raise NoAnswer(_words(error)) from None


class PlcCalls:
    """A Side: the PLC calls, ROS answers, in a thread of the service's own."""

    def __init__(self, route: ServiceRoute, counters: Counters, stopping: threading.Event) -> None:
        self.about = _about(route, "PLC calls")
        self.counters = counters
        self._route = route
        self._stopping = stopping
        kinds = {
            "request_subscriber": type("RequestSubscriber", (Subscriber,), {"message_type": route.kinds["_Request"]}),
            "reply_publisher": type("ReplyPublisher", (Publisher,), {"message_type": route.kinds["_Reply"]}),
        }
        self._made: type[ServiceServer[Any]] = type("BridgeServer", (ServiceServer,), kinds)
        self._server: ServiceServer[Any] | None = None
        self._open()

    def join(self, backend: Backend) -> None:
        self._thread = threading.Thread(target=self._run, args=(backend.client(self._route.wire),), daemon=True)
        self._thread.start()

    def tick(self) -> None:
        pass

    def silence(self) -> str:
        return ""

    @property
    def is_open(self) -> bool:
        return self._server is not None

    @property
    def lock_misses(self) -> int:
        return 0

    def close(self) -> None:
        with suppress(AttributeError):  # never joined
            self._thread.join(2 * _LOOK)
            if self._thread.is_alive():
                return
        self._close()

    def _open(self) -> ServiceServer[Any]:
        self._server = self._made(self._route.service.name)
        self._view = _view(self._route)
        return self._server

    def _close(self) -> None:
        if self._server:
            self._server.close()
            self._server = None
            self._view.close()

    def _run(self, caller: Caller) -> None:
        while not self._stopping.is_set():
            try:
                if self._server is None or self._view.removed:
                    self._close()
                server = self._server or self._open()
                if call := server.wait(_LOOK):
                    self.counters.came()
                    self._pass_on(server, call, caller)
            except (ShmError, OSError) as error:
                self.counters.complain(str(error))
                self._stopping.wait(_LOOK)

    def _pass_on(self, server: ServiceServer[Any], call: Any, caller: Caller) -> None:
        counters = self.counters
        try:
            request = caller.new()
            self._route.kinds["_Request"]._decode(bytes(call.request), 0, request)
            server.reply(call, caller.call(request, self._route.service.timeout))
            counters.passed += 1
            return
        except ValueRejected as error:
            counters.rejected += 1
            counters.complain(f"rejected: {error}")
        except Exception as error:  # NoAnswer, or whatever a ROS may raise
            counters.failed += 1
            counters.complain(_words(error))
        server.fail(call)


def _about(route: ServiceRoute, way: str) -> About:
    return About(route.service.name, way, route.service.type.short, region_file(_request(route)))


def _view(route: ServiceRoute) -> View:
    """Of the one region; who removes a service removes both."""
    return View(_request(route))


def _request(route: ServiceRoute) -> str:
    return f"{region_name(route.service.name)}-request"


def _words(error: Exception) -> str:
    return str(error) if isinstance(error, ShmError | NoAnswer) else f"{type(error).__name__}: {error}"
