"""Carries calls between a ROS service and the PLC, in either direction."""

from __future__ import annotations

from typing import Any

from shmgen.bridge.backend import Backend, NoAnswer, RosClient
from shmgen.bridge.common.counters import Counters, describe
from shmgen.bridge.endpoint import POLL_INTERVAL, RegionEndpoint, Side, WorkerSide
from shmgen.bridge.plan import CallRoute
from shmgen.live.classes import call_class
from shmgen.runtime import Closed, ServiceClient, ServiceServer, ValueRejected


class PlcServiceServer(Side):
    """Carries a service that the PLC offers: ROS calls, and the PLC answers. Simultaneous calls run one by one."""

    def __init__(self, route: CallRoute, counters: Counters) -> None:
        super().__init__(route, counters)
        kind = call_class(ServiceClient, route.kinds)
        self.end: RegionEndpoint[ServiceClient[Any, Any]] = RegionEndpoint(lambda: kind(route.entry.name), counters)

    def start(self, backend: Backend) -> None:
        backend.serve(self.route.wire, self._answer, self.counters)

    def stop(self) -> bool:
        """End all calls, without an answer, and return True."""
        self.end.close()
        return True

    def _answer(self, request: Any, response: Any) -> None:
        self.counters.mark_received()
        try:
            answer = self.end.require().call(request, self.route.entry.timeout)
            self.route.kinds["_Response"]._decode(bytes(answer), response)
            self.counters.passed += 1
        except Exception as error:  # CallTimeout, CallFailed, or any exception of a ROS library
            self.end.discard_after(error)
            raise NoAnswer(count_unanswered(self.counters, error)) from None


class PlcServiceClient(WorkerSide):
    """Carries a service that ROS offers: the PLC calls, and ROS answers. Each service has its own thread."""

    def __init__(self, route: CallRoute, counters: Counters) -> None:
        super().__init__(route, counters)
        kind = call_class(ServiceServer, route.kinds)
        self.end: RegionEndpoint[ServiceServer[Any]] = RegionEndpoint(lambda: kind(route.entry.name), counters)

    def start(self, backend: Backend) -> None:
        self._ros_client: RosClient = backend.client(self.route.wire)
        self._thread.start()

    def _step(self, plc: ServiceServer[Any] | None) -> float:
        if plc is None:
            return POLL_INTERVAL
        if call := plc.wait(POLL_INTERVAL):
            self.counters.mark_received()
            self._forward(plc, call)
        return 0.0

    def _forward(self, plc: ServiceServer[Any], call: Any) -> None:
        try:
            request = self._ros_client.new()
            self.route.kinds["_Request"]._decode(bytes(call.request), request)
            plc.reply(call, self._ros_client.call(request, self.route.entry.timeout))
            self.counters.passed += 1
        except Exception as error:  # NoAnswer, or any exception of a ROS library
            count_unanswered(self.counters, error)
            plc.fail(call)


def count_unanswered(counters: Counters, error: Exception) -> str:
    """Count and log a call or goal that failed with `error`. Return the reason as text."""
    if isinstance(error, ValueRejected):
        counters.reject(str(error))
        return str(error)
    reason = "the bridge stops" if isinstance(error, Closed) else describe(error)
    counters.fail(reason)
    return reason
