"""Receives the messages of a ROS 2 topic through rclpy, and counts lost messages."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from shmgen.bridge.backend import ErrorSink
from shmgen.bridge.common.peers import Peers


class Inlet:
    """Takes the messages of a ROS 2 subscription, and refuses the messages of incompatible publishers.

    The graph announces the type hash of each publisher. Since Kilted each message names its publisher. Before Kilted,
    all messages of a topic are refused while any publisher is incompatible. Calls of take() must not overlap.
    """

    def __init__(
        self, subscription: Any, deliver: Callable[[bytes], None], errors: ErrorSink, peers: Peers, names_senders: bool
    ) -> None:
        """Prepare `take`. `names_senders` is True if the GID in a message identifies the publisher in the graph."""
        self._handle = subscription.handle
        self._kind = subscription.msg_type
        self._deliver, self._errors = deliver, errors
        self._peers = peers
        self._names_senders = names_senders
        self._numbers: list[int] = []
        self._publishers = -1

    def take(self) -> None:
        """Take all waiting messages of the subscription and deliver them."""
        handle, kind = self._handle, self._kind
        if handle.get_publisher_count() != self._publishers:  # its messages may be too long to arrive
            self.look()
        while (received := handle.take_message(kind, True)) is not None:
            data, about = received
            if why := self._refusal(about):
                self._errors.refuse(why)
            else:
                self._deliver(data)
        self._peers.forget()

    def look(self, *event: Any) -> None:
        """Read the present publishers of the topic from the graph. rclpy calls this method at each `matched` event."""
        count = self._handle.get_publisher_count()
        self._peers.look()
        self._publishers = count

    def _refusal(self, about: Any) -> str:
        """Return why a message must be refused, or `""`. If a publisher may be new, first call look()."""
        is_next = self._follows(about.get("publication_sequence_number"))
        sender = (about.get("publisher_gid") or {}).get("data", b"") if self._names_senders else b""
        count = self._handle.get_publisher_count()
        if not is_next or count != self._publishers or (sender and not self._peers.knows(sender)):
            self.look()
        return self._peers.refusal(sender or None)

    def _follows(self, number: int | None) -> bool:
        """Return True if `number` follows a publisher's last message. Count a gap in the numbers as lost messages."""
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
                self._errors.lose(number - before - 1)
                numbers.remove(before)
                numbers.append(number)
            else:  # a new publisher has replaced one that left
                numbers[:] = [number]
        return False
