"""What rmw_zenoh puts on the wire beside the messages: keys, tokens that say who is there, and a number with each.

Source: rmw_zenoh's design.md, its attachment_helpers and its liveliness_utils, of Jazzy (0.2) to Lyrical.
"""

from __future__ import annotations

import itertools
import json
import os
import struct
import time
from collections.abc import Callable, Mapping
from typing import Any, NamedTuple, cast

import zenoh
from zenoh.handlers import Callback

from shmgen.bridge.backend import QUEUE
from shmgen.bridge.codec.type_identity import Identity, type_name
from shmgen.core.model import TypeName

_DEFAULT = """{
  mode: "peer",
  connect: {endpoints: {peer: ["tcp/localhost:7447"]}, retry: {period_init_ms: 500, period_max_ms: 2000}},
  listen: {endpoints: {router: ["tcp/[::]:7447"], peer: ["tcp/localhost:0"]}},
  scouting: {multicast: {enabled: false}, gossip: {enabled: true}},
  timestamping: {enabled: true},
}"""
"""As rmw_zenoh's own, but for the time until a router that is back is found."""
_BATCH = 8192
"""Bytes at most in one read of what peers send. A message that waits holds all of them, even where it came alone; with
zenoh's own 65535, what waits after a cut of the network took 64 MiB more, and large messages cross no faster.
"""
_ATTACHMENT = struct.Struct("<qqB16s")
"""The message's number, nanoseconds since 1970, and the name of the writer, who numbers his own, behind its length."""
_HASH = 11
"""The part of a token that is the type's hash."""
_ROUTER = "`ros2 run rmw_zenoh_cpp rmw_zenohd`, or with ZENOH_CONFIG_OVERRIDE='mode=\"router\"' the bridge is one"


def opened(environment: Mapping[str, str], largest: int, tell: Callable[[str], None]) -> Any:
    """A session where rmw_zenoh's variables say, or else at the router of this machine; one that is not there is looked
    for as long as the session lasts. Messages of more than `largest` bytes are not received. Raises ValueError.
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
        tell(f"zenoh: no router at {', '.join(where)} yet; start one: {_ROUTER}")
    return session


def attachment(number: int, writer: bytes) -> bytes:
    """What goes beside a message, a request or a response."""
    return _ATTACHMENT.pack(number, time.time_ns(), len(writer), writer)


def attached(sample: Any) -> tuple[int, bytes]:
    """The number of what has come, and its writer's name; 0 of a writer that is none of ROS 2."""
    data = sample.attachment.to_bytes() if sample.attachment is not None else b""
    if len(data) < _ATTACHMENT.size:
        return 0, b""
    number, _, _, writer = _ATTACHMENT.unpack_from(data)
    return number, writer


def writer() -> bytes:
    """A name that no other writer has."""
    return os.urandom(16)


class Place(NamedTuple):
    """A topic or a service."""

    name: str
    type: TypeName
    hash: str

    @property
    def mangled(self) -> str:
        """As tokens have it."""
        return f"{self.name.replace('/', '%')}/{type_name(self.type)}"


class Graph:
    """A domain, and what this node says of itself there; what it declares lasts as long as the session."""

    def __init__(self, session: Any, node: str, domain: int, tell: Callable[[str], None]) -> None:
        self.session, self.tell = session, tell
        self._domain, self._node = domain, node
        self._numbers = itertools.count()
        self._token = self._declared("NN", "")

    def key(self, place: Place) -> str:
        """With `*` as hash: of all that call the type so."""
        return f"{self._domain}/{place.name.strip('/')}/{type_name(place.type)}/{place.hash}"

    def show(self, kind: str, place: Place, qos: str) -> Callable[[], None]:
        """Tells everybody of a publisher (MP), subscription (MS), server (SS) or client (SC); gives what ends it."""
        token = self._declared(kind, f"/{place.mangled}/{place.hash}/{qos}")
        return cast(Callable[[], None], token.undeclare)

    def identity(self, place: Place, accepts_other: bool = False) -> Identity:
        """What a peer has to mean by the type."""
        return Identity(*place, self.tell, accepts_other)

    def peers(
        self, kind: str, place: Place, identity: Identity, meet: Callable[[str], None] = lambda why: None
    ) -> Peers:
        """All of a kind, from now on; `meet` as Peers has it."""
        tokens = f"@ros2_lv/{self._domain}/*/*/*/{kind}/*/*/*/{place.mangled}/*/**"
        return Peers(self.session, tokens, identity, meet)

    def _declared(self, kind: str, rest: str) -> Any:
        place = f"@ros2_lv/{self._domain}/{self.session.zid()}/0/{next(self._numbers)}"
        return self.session.liveliness().declare_token(f"{place}/{kind}/%/%/{self._node}{rest}")


class Peers:
    """Who is at the other end, by their tokens. Its attributes may be read from any thread."""

    def __init__(self, session: Any, tokens: str, identity: Identity, meet: Callable[[str], None]) -> None:
        """`meet` is told why one that is there may not be heard; nothing, as soon as all may."""
        self._identity, self._meet = identity, meet
        self._there: dict[str, str] = {}
        self._met = ""
        heard = session.liveliness().declare_subscriber(tokens, Callback(self._came, indirect=False), history=True)
        self.close: Callable[[], None] = heard.undeclare

    def _came(self, token: Any) -> None:
        key = str(token.key_expr)
        if token.kind == zenoh.SampleKind.PUT:
            self._there[key] = self._identity.refusal(key.split("/")[_HASH])
        else:
            self._there.pop(key, None)
        if self.stranger != self._met:
            self._met = self.stranger
            self._meet(self._met)

    @property
    def is_any(self) -> bool:
        """Whether there is one that means by the type what we do."""
        return not all(tuple(self._there.values()))

    @property
    def stranger(self) -> str:
        """Why one that is there may not be heard."""
        return next(filter(None, tuple(self._there.values())), "")


def quality(best_effort: bool = False, latch: bool = False, depth: int = QUEUE) -> str:
    """As tokens have it: what is not said is reliable and volatile, as rmw_zenoh's own default."""
    return f"{'2' if best_effort else ''}:{'1' if latch else ''}:,{depth}:,:,:,,"
