"""The protocol of rmw_zenoh without the serialization: keys, tokens that announce endpoints, and attachments.

Source: rmw_zenoh's design.md, attachment_helpers and liveliness_utils, from Jazzy (0.2) to Lyrical.
"""

from __future__ import annotations

import itertools
import json
import struct
import time
from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import xxhash
import zenoh
from zenoh.handlers import Callback

from shmgen.bridge.backend import QUEUE
from shmgen.bridge.codec.type_identity import type_name
from shmgen.bridge.common.peers import Peers
from shmgen.core.model import TypeName

_DEFAULT = """{
  mode: "peer",
  connect: {endpoints: {peer: ["tcp/localhost:7447"]}, retry: {period_init_ms: 500, period_max_ms: 2000}},
  listen: {endpoints: {router: ["tcp/[::]:7447"], peer: ["tcp/localhost:0"]}},
  scouting: {multicast: {enabled: false}, gossip: {enabled: true}},
  timestamping: {enabled: true},
}"""
"""The default configuration of rmw_zenoh, except the time until a restarted router is found again."""
_BATCH = 8192
"""Maximum bytes of one batch, the unit that a receiver reads.

A queued message keeps its whole batch buffer allocated, even if the batch has no other message. With zenoh's default of
65535 bytes, the queues after a network outage took 64 MiB more memory, and large messages were not faster.
"""
_ATTACHMENT = struct.Struct("<qqB16s")
"""Sequence number of the writer, nanoseconds since 1970, length of the writer's name, and the name."""
_LABEL = b"\x0fsequence_number"
"""Label before the number in attachments of rmw_zenoh_cpp 0.2.0 to 0.2.3, which label each part."""
_HASH = 11
"""Index of the type hash among the parts of a liveliness token."""
_ROUTER = "`ros2 run rmw_zenoh_cpp rmw_zenohd`, or start the bridge with ZENOH_CONFIG_OVERRIDE='mode=\"router\"'"


def open_session(environment: Mapping[str, str], largest: int, log: Callable[[str], None]) -> Any:
    """Open a session from the environment variables of rmw_zenoh, by default to the router of this machine.

    If there is no router, the session keeps looking for one. The session does not receive messages of more than
    `largest` bytes. Raises ValueError if the configuration is invalid or the session cannot be opened.
    """
    uri = environment.get("ZENOH_SESSION_CONFIG_URI", "")
    what = "its own configuration"
    try:
        what = f"ZENOH_SESSION_CONFIG_URI is {uri!r}"
        config = zenoh.Config.from_file(uri) if uri else zenoh.Config.from_json5(_DEFAULT)
        config.insert_json5("transport/link/rx/max_message_size", str(largest))
        config.insert_json5("transport/link/tx/batch_size", str(_BATCH))
        for pair in filter(None, map(str.strip, environment.get("ZENOH_CONFIG_OVERRIDE", "").split(";"))):
            what = f"ZENOH_CONFIG_OVERRIDE has {pair!r}"
            key, _, value = pair.partition("=")
            config.insert_json5(key.strip(), value.strip())
        what = "cannot join"
        session = zenoh.open(config)
    except zenoh.ZError as error:
        raise ValueError(f"zenoh: {what}: {error}") from None
    if config.get_json("mode") != '"router"' and not [*session.info.routers_zid(), *session.info.peers_zid()]:
        places = json.loads(config.get_json("connect/endpoints"))
        where = places.get("peer", []) if isinstance(places, dict) else places
        log(f"zenoh: no router runs at {', '.join(where)}; start one: {_ROUTER}")
    return session


def attachment(number: int, writer: bytes) -> bytes:
    """Return the attachment of a message, a request or a response: its sequence number and the writer's name."""
    return _ATTACHMENT.pack(number, time.time_ns(), len(writer), writer)


def parse_attachment(sample: Any) -> tuple[int, bytes]:
    """Return the sequence number and the writer's name of a sample, or 0 and `b""` without an attachment of ROS 2."""
    data = sample.attachment.to_bytes() if sample.attachment is not None else b""
    if data.startswith(_LABEL):
        return int.from_bytes(data[len(_LABEL) : len(_LABEL) + 8], "little", signed=True), data[-16:]
    if len(data) < _ATTACHMENT.size:
        return 0, b""
    number, _, _, writer = _ATTACHMENT.unpack_from(data)
    return number, writer


def endpoint_gid(token: str) -> bytes:
    """Return the gid that rmw_zenoh derives from a liveliness token: its XXH3-128 hash, low byte first."""
    digest: bytes = xxhash.xxh3_128_digest(token.encode())
    return digest[::-1]


class Place(NamedTuple):
    """The name of a topic or service, its type name and its type hash."""

    name: str
    type: TypeName
    hash: str

    @property
    def mangled(self) -> str:
        """The name of the topic or service and of its type, as part of a liveliness token of rmw_zenoh."""
        return f"{self.name.replace('/', '%')}/{type_name(self.type)}"


class Token(NamedTuple):
    """The liveliness token of an endpoint: the gid of the endpoint, and the function that withdraws the token."""

    gid: bytes
    withdraw: Callable[[], None]


class Graph:
    """Announces the bridge's node and endpoints in a ROS domain, by the liveliness tokens of rmw_zenoh."""

    def __init__(self, session: Any, node: str, domain: int, log: Callable[[str], None]) -> None:
        """Publish the liveliness token of the node. `node` is its namespace and name, such as `%cell1/bridge`."""
        self.session, self.log = session, log
        self._domain, self._node = domain, node
        self._numbers = itertools.count()
        self._token = self._declare("NN", "")

    def key(self, place: Place) -> str:
        """Return the zenoh key of a topic or service. The hash `*` makes the key match all definitions of the type."""
        return f"{self._domain}/{place.name.strip('/')}/{type_name(place.type)}/{place.hash}"

    def show(self, kind: str, place: Place, qos: str) -> Token:
        """Publish the liveliness token of a publisher (`kind` MP), subscription (MS), server (SS) or client (SC)."""
        return self._declare(kind, f"/{place.mangled}/{place.hash}/{qos}")

    def watch(self, kind: str, place: Place, peers: Peers) -> Callable[[], None]:
        """Keep `peers` equal to the peers of `kind` (see show) at `place`. Return a function that stops the updates."""

        def update(token: Any) -> None:
            key = str(token.key_expr)
            if token.kind == zenoh.SampleKind.PUT:
                peers.add(key, key.split("/")[_HASH])
            else:
                peers.remove(key)

        tokens = f"@ros2_lv/{self._domain}/*/*/*/{kind}/*/*/*/{place.mangled}/*/**"
        declare = self.session.liveliness().declare_subscriber
        stop: Callable[[], None] = declare(tokens, Callback(update, indirect=False), history=True).undeclare
        return stop

    def _declare(self, kind: str, rest: str) -> Token:
        place = f"@ros2_lv/{self._domain}/{self.session.zid()}/0/{next(self._numbers)}"
        key = f"{place}/{kind}/%/{self._node}{rest}"
        return Token(endpoint_gid(key), self.session.liveliness().declare_token(key).undeclare)


def quality(best_effort: bool = False, latch: bool = False, depth: int = QUEUE) -> str:
    """Return the QoS as part of a token. Omitted policies mean reliable and volatile, rmw_zenoh's default."""
    return f"{'2' if best_effort else ''}:{'1' if latch else ''}:,{depth}:,:,:,,"
