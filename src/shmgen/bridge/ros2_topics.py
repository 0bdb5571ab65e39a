"""Turns the messages of a topic of rclpy into calls of ours, and counts those that nobody got."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from shmgen.bridge.backend import Taker
from shmgen.bridge.cdr import Codec
from shmgen.bridge.identity import Identity

Hashes = Callable[[], dict[bytes, str]]
"""Of each publisher that the graph knows of now, its GID and the type hash that it announces."""


class Inlet:
    """Takes all that waits in a subscription. Calls must not overlap.

    The graph says what each publisher means by the type. Since Kilted each message says whose it is; before, nothing
    of a topic is taken while one of its publishers is of another definition.
    """

    def __init__(self, subscription: Any, made: Codec, taker: Taker, identity: Identity, hashes: Hashes) -> None:
        self._handle = subscription.handle
        self._kind = subscription.msg_type
        self._decode = made.decode
        self._taker = taker
        self._identity = identity
        self._hashes = hashes
        self._numbers: list[int] = []
        self._publishers = -1
        self._verdicts: dict[bytes, str] = {}

    def take(self) -> None:
        """All there is."""
        handle, kind = self._handle, self._kind
        if handle.get_publisher_count() != self._publishers:  # what it sends may be too long for a queue of this ROS
            self._ask()
        while (taken := handle.take_message(kind, True)) is not None:
            data, about = taken
            why = self._refusal(about)
            if why:
                self._taker.refuse(why)
                continue
            try:
                message = self._decode(data)
            except ValueError as error:
                self._taker.reject(str(error))
                continue
            self._taker.take(message)

    def _refusal(self, about: Any) -> str:
        """Asks the graph again whenever there may be another publisher."""
        is_next = self._follows(about.get("publication_sequence_number"))
        sender = (about.get("publisher_gid") or {}).get("data", b"")
        count = self._handle.get_publisher_count()
        if not is_next or count != self._publishers or (sender and sender not in self._verdicts):
            self._ask()
        if sender in self._verdicts:
            return self._verdicts[sender]
        return next((why for why in self._verdicts.values() if why), "")

    def _ask(self) -> None:
        """Who is there, and means what. One that is of another definition counts once itself."""
        self._publishers = self._handle.get_publisher_count()
        before = self._verdicts
        self._verdicts = {gid: self._identity.refusal(hash_) for gid, hash_ in self._hashes().items()}
        for gid, why in self._verdicts.items():
            if why and gid not in before:
                self._taker.refuse(why)

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
                self._taker.lose(number - before - 1)
                numbers.remove(before)
                numbers.append(number)
            else:  # another publisher in the place of one that has gone
                numbers[:] = [number]
        return False
