"""Carries calls between a ROS service and the PLC, in either direction."""

from __future__ import annotations

import threading
import time
from typing import Any

from shmgen.bridge.backend import Backend, NoAnswer, RosClient
from shmgen.bridge.counters import Counters
from shmgen.bridge.endpoint import LOOK, ReopeningEndpoint, WorkerThread
from shmgen.bridge.plan import ServiceRoute
from shmgen.live.classes import client, server
from shmgen.runtime import CallTimeout, NoServer, RegionInUse, ServiceClient, ServiceServer, ShmError, ValueRejected


class PlcServiceServer:
    """A Side: ROS calls, the PLC answers. Calls that come at the same time follow one another."""

    def __init__(self, route: ServiceRoute, counters: Counters, stopping: threading.Event) -> None:
        self.about = route.about
        self.counters = counters
        self._route = route
        self._stopping = stopping
        made = client(route.kinds["_Request"], route.kinds["_Reply"])
        self.end: ReopeningEndpoint[ServiceClient[Any, Any]] = ReopeningEndpoint(
            lambda: made(route.service.name), counters, stopping
        )
        self.beat, self.leave, self.close = self.end.beat, lambda: None, self.end.close

    def join(self, backend: Backend) -> None:
        backend.serve(self._route.wire, self._answer, self.counters.refuse)

    def _answer(self, request: Any, response: Any) -> None:
        self.counters.came()
        try:
            answer = self._called(request)
            self._route.kinds["_Response"]._decode(bytes(answer), 0, response)
            self.counters.passed += 1
        except Exception as error:  # CallTimeout, CallFailed, or whatever a ROS may raise
            raise NoAnswer(unanswered(self.counters, error)) from None

    def _called(self, request: Any) -> Any:
        """As ServiceClient.call, which would go on when the bridge ends, and hold up the end of the process."""
        timeout = self._route.service.timeout
        deadline = time.monotonic() + timeout

        def left() -> float:
            if self._stopping.is_set():
                raise NoAnswer("the bridge ends")
            if self.end.look() is not caller:
                raise NoAnswer(self.end.why)
            return min(LOOK, deadline - time.monotonic())

        if not self.end.lock.acquire(timeout=timeout):
            raise CallTimeout(f"the calls before it took all of the {timeout:g} s")
        try:
            caller = self.end.look()
            if caller is None:
                raise NoAnswer(f"there is no region: {self.end.why}")
            try:
                while not caller.wait_for_server(max(0.0, left())):
                    if left() <= 0:
                        raise NoServer(f"no server within {timeout:g} s; the request was not sent")
                number = caller.send(request)
                while (answer := caller.wait(max(0.0, left()))) is None:
                    if left() <= 0:
                        raise CallTimeout(f"call {number} got no response within {timeout:g} s")
                return answer
            except RegionInUse as error:
                self.end.lose(str(error))
                raise
            finally:
                caller.cancel()
        finally:
            self.end.lock.release()


class PlcServiceClient:
    """A Side: the PLC calls, ROS answers, in a thread of the service's own."""

    def __init__(self, route: ServiceRoute, counters: Counters, stopping: threading.Event) -> None:
        self.about = route.about
        self.counters = counters
        self._route = route
        made = server(route.kinds["_Request"], route.kinds["_Reply"])
        self.end: ReopeningEndpoint[ServiceServer[Any]] = ReopeningEndpoint(
            lambda: made(route.service.name), counters, stopping
        )
        self._loop = WorkerThread(self._step, self.end, stopping)
        self.beat, self.leave, self.close = self.end.beat, self._loop.leave, self.end.close

    def join(self, backend: Backend) -> None:
        self._caller: RosClient = backend.client(self._route.wire)
        self._loop.start()

    def _step(self, served: ServiceServer[Any] | None) -> float:
        if served is None:
            return LOOK
        if call := served.wait(LOOK):
            self.counters.came()
            self._pass_on(served, call)
        return 0.0

    def _pass_on(self, served: ServiceServer[Any], call: Any) -> None:
        try:
            request = self._caller.new()
            self._route.kinds["_Request"]._decode(bytes(call.request), 0, request)
            served.reply(call, self._caller.call(request, self._route.service.timeout))
            self.counters.passed += 1
        except Exception as error:  # NoAnswer, or whatever a ROS may raise
            unanswered(self.counters, error)
            served.fail(call)


def unanswered(counters: Counters, error: Exception) -> str:
    """Counts a call that came to nothing, and says why."""
    if isinstance(error, ValueRejected):
        counters.reject(str(error))
        return str(error)
    counters.failed += 1
    said = str(error) if isinstance(error, ShmError | NoAnswer) else f"{type(error).__name__}: {error}"
    counters.complain(said)
    return said
