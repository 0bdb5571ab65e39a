"""The topics of rclpy: hands on their messages, and counts those that nobody got."""

from __future__ import annotations

from typing import Any

from shmgen.bridge.backend import MessageSink
from shmgen.bridge.codec.cdr import Codec
from shmgen.bridge.ros2.peers import Peers


class Inlet:
    """Takes all that waits in a subscription. Calls of take() must not overlap.

    The graph says what each publisher means by the type. Since Kilted each message says whose it is; before, nothing
    of a topic is taken while one of its publishers is of another definition.
    """

    def __init__(self, subscription: Any, made: Codec, sink: MessageSink, peers: Peers, names_senders: bool) -> None:
        """`names_senders`: whether a message, if it says whose it is, says it as the graph does."""
        self._handle = subscription.handle
        self._kind = subscription.msg_type
        self._decode = made.decode
        self._sink = sink
        self._peers = peers
        self._names_senders = names_senders
        self._numbers: list[int] = []
        self._publishers = -1

    def take(self) -> None:
        """All there is."""
        handle, kind = self._handle, self._kind
        if handle.get_publisher_count() != self._publishers:  # what it sends may be too long for a queue of this ROS
            self.look()
        while (taken := handle.take_message(kind, True)) is not None:
            data, about = taken
            why = self._refusal(about)
            if why:
                self._sink.refuse(why)
                continue
            try:
                message = self._decode(data)
            except ValueError as error:
                self._sink.reject(str(error))
                continue
            self._sink.take(message)
        self._peers.forget()

    def look(self, *event: Any) -> None:
        """At its publishers: one has come, or may have."""
        count = self._handle.get_publisher_count()
        self._peers.look()
        self._publishers = count

    def _refusal(self, about: Any) -> str:
        """Looks at the graph again whenever there may be another publisher."""
        is_next = self._follows(about.get("publication_sequence_number"))
        sender = (about.get("publisher_gid") or {}).get("data", b"") if self._names_senders else b""
        count = self._handle.get_publisher_count()
        if not is_next or count != self._publishers or (sender and not self._peers.knows(sender)):
            self.look()
        return self._peers.refusal(sender)

    def _follows(self, number: int | None) -> bool:
        """Whether it is the one after another. Every publisher counts its own from 1, and a gap is lost."""
        if number is None:
            return True
        numbers = self._numbers
        for index, before in enumerate(numbers):
            if number == before + 1:
                numbers[index] = number
                return True
        if len(numbers) < max(self._handle.get_publisher_count(), 1):
            numbers.append(number)
        else:
            before = max((before for before in numbers if before < number), default=0)
            if before:
                self._sink.lose(number - before - 1)
                numbers.remove(before)
                numbers.append(number)
            else:  # another publisher in the place of one that has gone
                numbers[:] = [number]
        return False
