"""Libraries from PyPI to compare, as functions like the functions in peers/__init__.py.

A library is imported only when its function is called.
"""

from __future__ import annotations

import asyncio
import struct
import threading
import time
from collections.abc import Callable
from typing import Any

from .payload import Pose, block, decoder, encoder, filler, read_all_bytes


def iceoryx2(role: str, mode: str, size: int, name: str) -> Callable[..., Any]:
    """Return a sender or receiver that uses iceoryx2 with a structure, which is written and read in place.

    In event mode, iceoryx2's event service wakes the receiver. The receiver reads all bytes of a sample of more than
    4096 bytes, for comparison with `borrow()`.
    """
    import iceoryx2 as iox

    iox.set_log_level(iox.LogLevel.Fatal)
    structure = Pose if size == 56 else block(size)
    node = iox.NodeBuilder.new().create(iox.ServiceType.Ipc)
    service = node.service_builder(iox.ServiceName.new(name)).publish_subscribe(structure)
    service = service.subscriber_max_buffer_size(1).open_or_create()  # the newest sample only, like all other libraries
    event = node.service_builder(iox.ServiceName.new(name)).event().open_or_create()
    if role == "send":
        publisher = service.publisher_builder().create()
        notifier = event.notifier_builder().create()
        fill = filler(size)

        def send(stamp: int) -> None:
            sample = publisher.loan_uninit()
            fill(sample.payload().contents, stamp)
            sample.assume_init().send()
            if mode == "event":
                notifier.notify()

        send.keep = node  # type: ignore[attr-defined]
        return send
    subscriber = service.subscriber_builder().create()
    listener = event.listener_builder().create()

    def receive() -> int | None:
        if mode == "event":
            listener.blocking_wait()
        sample = subscriber.receive()
        if sample is None:
            return None
        message = sample.payload().contents
        stamp = int(message.x if size == 56 else message.stamp)
        if size > 4096:
            read_all_bytes(message.data)
        sample.delete()
        return stamp

    receive.keep = node  # type: ignore[attr-defined]
    return receive


def cyclonedds(role: str, mode: str, size: int, name: str) -> Callable[..., Any]:
    """Return a sender or receiver that uses DDS with a sequence of octets and the QoS best effort, keep last 1."""
    from dataclasses import dataclass

    from cyclonedds.core import ReadCondition, SampleState, ViewState, WaitSet
    from cyclonedds.domain import DomainParticipant
    from cyclonedds.idl import IdlStruct
    from cyclonedds.idl.types import sequence, uint8
    from cyclonedds.pub import DataWriter
    from cyclonedds.qos import Policy, Qos
    from cyclonedds.sub import DataReader
    from cyclonedds.topic import Topic
    from cyclonedds.util import duration

    body = {"__annotations__": {"data": sequence[uint8]}, "__module__": __name__}
    Sample = dataclass(type("Sample", (IdlStruct,), body))
    participant = DomainParticipant()
    topic = Topic(participant, name, Sample, qos=Qos(Policy.Reliability.BestEffort, Policy.History.KeepLast(1)))
    if role == "send":
        writer = DataWriter(participant, topic)
        encode = encoder(size)
        return lambda stamp: writer.write(Sample(data=encode(stamp)))
    reader = DataReader(participant, topic)
    decode = decoder(size)
    waiter = WaitSet(participant)
    waiter.attach(ReadCondition(reader, ViewState.Any | SampleState.NotRead))

    def receive() -> int | None:
        if mode == "event":
            waiter.wait(duration(seconds=1))
        samples = [sample for sample in reader.take(1) if isinstance(sample, Sample)]
        return decode(bytes(samples[0].data)) if samples else None

    return receive


def zenoh(role: str, mode: str, size: int, name: str) -> Callable[..., Any]:
    """Return a sender or receiver that uses a zenoh peer. Zenoh's own thread receives.

    The two peers have fixed addresses, because the loopback has no multicast.
    """
    import zenoh as z

    config = z.Config()
    address = f'["tcp/127.0.0.1:{20000 + sum(name.encode()) * 41 % 20000}"]'
    config.insert_json5("connect/endpoints" if role == "send" else "listen/endpoints", address)
    config.insert_json5("scouting/multicast/enabled", "false")
    session = z.open(config)
    if role == "send":
        publisher = session.declare_publisher(name)
        encode = encoder(size)

        def send(stamp: int) -> None:
            publisher.put(encode(stamp))

        send.keep = session  # type: ignore[attr-defined]
        return send
    subscriber = session.declare_subscriber(name, z.handlers.FifoChannel(16))
    decode = decoder(size)

    def receive() -> int | None:
        sample = subscriber.recv() if mode == "event" else subscriber.try_recv()
        return decode(sample.payload.to_bytes()) if sample is not None else None

    receive.keep = session  # type: ignore[attr-defined]
    return receive


def pyzmq(role: str, mode: str, size: int, name: str) -> Callable[..., Any]:
    """Return a sender or receiver that uses PUSH and PULL sockets over a Unix socket."""
    import zmq

    context = zmq.Context()
    if role == "send":
        endpoint = context.socket(zmq.PUSH)
        endpoint.connect(f"ipc://@{name}")
        encode = encoder(size)
        return lambda stamp: endpoint.send(encode(stamp))
    endpoint = context.socket(zmq.PULL)
    endpoint.bind(f"ipc://@{name}")
    endpoint.setsockopt(zmq.RCVTIMEO, 1000)
    decode = decoder(size)
    flags = 0 if mode == "event" else zmq.NOBLOCK

    def receive() -> int | None:
        try:
            return decode(endpoint.recv(flags))
        except zmq.Again:
            return None

    return receive


def modbus(role: str, mode: str, size: int, name: str) -> Callable[..., Any]:
    """Return a sender that writes holding registers over TCP, or the server that receives each write."""
    from pymodbus import client

    port = 40000 + sum(name.encode()) * 31 % 20000
    if role == "send":
        endpoint = client.ModbusTcpClient("127.0.0.1", port=port)
        end = time.monotonic() + 10
        while not endpoint.connect() and time.monotonic() < end:
            time.sleep(0.05)
        encode, registers = encoder(size), struct.Struct(f">{size // 2}H")
        return lambda stamp: endpoint.write_registers(0, list(registers.unpack(encode(stamp))))
    return _modbus_server(port, size)


def _modbus_server(port: int, size: int) -> Callable[[], int | None]:
    from pymodbus.server import StartTcpServer
    from pymodbus.simulator import DataType, SimData, SimDevice

    arrived = threading.Event()
    stamps: list[int] = []
    decode, registers_format = decoder(size), struct.Struct(f">{size // 2}H")

    async def action(code: int, start: int, *rest: Any) -> None:
        written_registers = rest[-1]
        if written_registers:
            stamps.append(decode(registers_format.pack(*written_registers)))
            arrived.set()

    registers = SimData(0, values=[0] * (size // 2), datatype=DataType.REGISTERS)
    device = SimDevice(1, simdata=[registers], action=action)
    threading.Thread(
        target=StartTcpServer, kwargs={"context": device, "address": ("127.0.0.1", port)}, daemon=True
    ).start()

    def receive() -> int | None:
        arrived.wait(1)
        arrived.clear()
        return stamps.pop(0) if stamps else None

    return receive


def opcua(role: str, mode: str, size: int, name: str) -> Callable[..., Any]:
    """Return a sender that writes a byte string to an OPC UA server, or the server that receives each write."""
    from asyncua import Client, Server, ua

    url = f"opc.tcp://127.0.0.1:{40000 + sum(name.encode()) * 37 % 20000}"
    loop = asyncio.new_event_loop()
    threading.Thread(target=loop.run_forever, daemon=True).start()

    def run(work: Any) -> Any:
        return asyncio.run_coroutine_threadsafe(work, loop).result(20)

    if role == "send":
        client = Client(url)
        end = time.monotonic() + 10
        while time.monotonic() < end:
            try:
                run(client.connect())
                break
            except OSError:
                time.sleep(0.1)
        variable = client.get_node(ua.NodeId("sample", 2))
        encode = encoder(size)
        return lambda stamp: run(
            variable.write_attribute(
                ua.AttributeIds.Value, ua.DataValue(ua.Variant(encode(stamp), ua.VariantType.ByteString))
            )
        )
    arrived = threading.Event()
    stamps: list[int] = []
    decode = decoder(size)

    async def serve() -> Any:
        server = Server()
        await server.init()
        server.set_endpoint(url)
        await server.register_namespace("benchmark")
        variable = await server.nodes.objects.add_variable(
            ua.NodeId("sample", 2), "sample", bytes(size), ua.VariantType.ByteString
        )
        await variable.set_writable()

        async def on_write(_: Any, value: Any) -> None:
            stamps.append(decode(value.Value.Value))
            arrived.set()

        server.iserver.aspace.add_datachange_callback(variable.nodeid, ua.AttributeIds.Value, on_write)
        await server.start()
        return server

    server = run(serve())

    def receive() -> int | None:
        arrived.wait(1)
        arrived.clear()
        return stamps.pop(0) if stamps else None

    receive.keep = server  # type: ignore[attr-defined]
    return receive


LIBRARIES: dict[str, Callable[..., Callable[..., Any]]] = {
    "iceoryx2": iceoryx2,
    "cyclonedds": cyclonedds,
    "eclipse-zenoh": zenoh,
    "pyzmq": pyzmq,
    "Modbus TCP (pymodbus)": modbus,
    "OPC UA (asyncua)": opcua,
}
PACKAGES = {name: name for name in ("iceoryx2", "cyclonedds", "eclipse-zenoh", "pyzmq")} | {
    "Modbus TCP (pymodbus)": "pymodbus",
    "OPC UA (asyncua)": "asyncua",
}
