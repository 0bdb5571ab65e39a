"""Turns two regions into questions and their answers: what clients and servers of services and of actions share.

A question has the number of its sample, and an answer carries the number of its question. So a late answer, to a call
given up or to a former client, is known from its number, and a restarted server knows by the position of the samples
what was asked before its time (docs/protocol.md, "Services").
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from math import inf
from typing import Any, Generic, TypeVar

from shmgen.core import abi
from shmgen.runtime.errors import LockTimeout
from shmgen.runtime.messages.message import Message
from shmgen.runtime.publisher import Publisher
from shmgen.runtime.region import header as h
from shmgen.runtime.region.claim import WATCH
from shmgen.runtime.region.region import WRITER_LOCK
from shmgen.runtime.subscriber import Subscriber

Q = TypeVar("Q", bound=Message)
A = TypeVar("A", bound=Message)
T = TypeVar("T")

_LOOK = 2e-3
"""Seconds between two looks for a server."""
_FRESH = abi.CLAIM_MS / 1000
"""Seconds for which a heartbeat seen to move counts."""
_LONGEST_WAIT = 1.0
_HEARTBEAT = abi.SIGN_MS / 1000
"""Seconds between two signs of life of a server that waits."""


class Caller(Generic[Q, A]):
    """The asking end. `number` is that of the question not answered yet, 0 = none.

    `key` is the name of the field that holds the number in an answer.
    """

    def __init__(self, questions: Publisher[Q], answers: Subscriber[A], key: str) -> None:
        self.number = 0
        self._questions = questions
        self._answers = answers
        self._key = key
        self._beat = -1
        self._looked = 0.0

    def ask(self, question: Any, deadline: float | None = None) -> int:
        """Sends a question and gives the one before up; returns its number. Raises as Publisher.publish.

        `deadline`, by time.monotonic(): how long it may wait for the lock, where that is needed.
        """
        self.number = 0
        self._answers._skip()  # what is there answers nothing that is still to come
        self._questions._publish_by(question, deadline)
        self.number = self._questions.sequence
        return self.number

    def tell(self, message: Any) -> None:
        """Sends what asks for no answer. Raises as Publisher.publish."""
        self._questions.publish(message)

    def poll(self) -> A | None:
        """The answer, once. Answers come in the order of their questions, so the newest is enough."""
        return self._own(self._answers.read())

    def wait(self, timeout: float) -> A | None:
        """The answer as soon as it comes, or None after `timeout` seconds."""
        deadline = time.monotonic() + timeout
        while self.number:
            left = max(0.0, deadline - time.monotonic())
            if answer := self._own(self._answers.wait(left)):
                return answer
            if not left:
                break
        return None

    def server_is_ready(self) -> bool:
        """Whether somebody serves now. Takes up to a second where a PLC served and may have stopped."""
        return self.wait_for_server(WATCH if self._answers._words[h.WRITER] == h.PLC else 0.0)

    def wait_for_server(self, timeout: float) -> bool:
        """Whether somebody serves, as soon as somebody does or after `timeout` seconds."""
        deadline = time.monotonic() + timeout
        while not self._server_lives():
            left = deadline - time.monotonic()
            if left <= 0:
                return False
            time.sleep(min(_LOOK, left))
        return True

    def close(self) -> None:
        self._questions.close()
        self._answers.close()

    def _own(self, answer: A | None) -> A | None:
        if answer is None or not self.number or getattr(answer, self._key) != self.number:
            return None
        self.number = 0
        return answer

    def _server_lives(self) -> bool:
        """A process holds its record lock, and has put its name there; a PLC can only be seen to count."""
        words, now = self._answers._words, time.monotonic()
        if words[h.WRITER] != h.PLC and self._answers._region.byte_is_locked(WRITER_LOCK):
            return True
        before, self._beat = self._beat, words[h.HEARTBEAT]
        known, self._looked = now - self._looked < _FRESH, now
        return bool(words[h.WRITER] == h.PLC and known and self._beat != before)


class Callee(Generic[Q, A]):
    """The answering end. `number` is that of the question begun last, 0 = none: no other can be answered."""

    def __init__(self, questions: Subscriber[Q], answers: Publisher[A]) -> None:
        """`questions` holds nothing unread: see `passed_over`."""
        self.number = 0
        self._questions = questions
        self._answers = answers
        self._begun_at = 0

    def take(self, timeout: float) -> tuple[int, Q] | None:
        """The newest question with its number, once, as soon as there is one, or None after `timeout` seconds.

        Tells the other side that it lives.
        """
        deadline = time.monotonic() + timeout
        while True:
            self._answers.heartbeat()
            left = max(0.0, deadline - time.monotonic())
            question = self._questions.wait(min(left, _HEARTBEAT)) if left else self._questions.read()
            if question is not None:
                self._answers._assure()  # or another server has taken over, and serves it
                return self._questions.sequence, question
            if not left:
                return None

    def begin(self, number: int) -> None:
        """From now on this question waits for its answer, and no other."""
        self.number, self._begun_at = number, self._answers.sequence

    def awaits(self, number: int) -> bool:
        """Whether that question still waits for its answer.

        By what was published, so that an exception out of a signal handler behind that makes no second answer.
        """
        return number == self.number and self._answers.sequence == self._begun_at

    def answer(self, number: int, answer: Any) -> bool:
        """False, and nothing sent, if that question waits no more. Raises as Publisher.publish."""
        if not self.awaits(number):
            return False
        self._answers.publish(answer)
        return True

    def insist(self, answer: Callable[[], object], deadline: float = inf) -> None:
        """Calls `answer`, which sends one, until the lock lets it through: of a lock no server ends.

        Gives up at the deadline, by time.monotonic(), and for a newer question, since nobody waits for this any more.
        """
        told = False
        while True:
            try:
                answer()
                return
            except LockTimeout:
                if not told:
                    log_exception(f"{self._answers.topic}: the reply to {self.number} waits for the lock")
                told = True
            if time.monotonic() >= deadline or self._questions.ready(0.0):
                return
            self._answers.heartbeat()
            time.sleep(_LOOK)

    def client_lives(self) -> bool:
        """A process holds its record lock; a PLC's heartbeat has moved within the last second."""
        questions = self._questions
        if questions._words[h.WRITER] == h.PLC:
            return not questions.is_stale(_FRESH)
        return questions._region.byte_is_locked(WRITER_LOCK)

    def close(self) -> None:
        self._questions.close()
        self._answers.close()


def deadline_of(timeout: float | None) -> float:
    """By time.monotonic(); None: never."""
    return inf if timeout is None else time.monotonic() + timeout


def until(deadline: float, wait: Callable[[float], T | None]) -> Iterator[T]:
    """What `wait` gives, until that instant by time.monotonic()."""
    while (left := deadline - time.monotonic()) > 0:
        found = wait(min(left, _LONGEST_WAIT))
        if found is not None:
            yield found


def log_exception(text: str) -> None:
    """Into the log `shmgen`, with the traceback of the exception that is being handled."""
    import logging  # takes longer to load than the rest of the runtime

    logging.getLogger("shmgen").exception(text)


def passed_over(questions: Subscriber[Q]) -> None:
    """Takes what lies there for read: whether a server before this one has done it nobody knows.

    Comes before the claim that shows clients a server, so that no call is lost between the two.
    """
    questions._skip()
