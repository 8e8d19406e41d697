# SPDX-License-Identifier: Apache-2.0
"""Compute beside the ticks, for the latest request only."""

from __future__ import annotations

from collections.abc import Callable
import threading
import time
from typing import Generic, TypeVar

Request = TypeVar('Request')
Answer = TypeVar('Answer')


class LatestOnlyWorker(Generic[Request, Answer]):
    """
    One thread that answers requests; a newer request replaces all earlier ones.

    What is being computed for an earlier request is cancelled, and its answer is dropped.

    Parameters
    ----------
    compute : callable
        Makes the answer to a request. Its second argument tells, when called, whether nobody
        waits for the answer any more; then any answer will do. What it raises is a defect, and
        ends the thread with a traceback.
    on_answer : callable
        Called in the thread with every answer.
    interval : float
        Least time from one beginning to the next, so that a storm of requests costs little. [s]

    """

    def __init__(
        self,
        compute: Callable[[Request, Callable[[], bool]], Answer],
        on_answer: Callable[[Answer], None],
        *,
        interval: float = 0.0,
    ) -> None:
        self._compute = compute
        self._on_answer = on_answer
        self._interval = interval
        self._condition = threading.Condition()
        self._waiting: list[Request] = []
        self._is_open = True
        self._thread = threading.Thread(name='worker', target=self._work, daemon=True)
        self._thread.start()

    def submit(self, request: Request) -> None:
        """Have a request answered in place of all earlier ones."""
        with self._condition:
            self._waiting = [request]
            self._condition.notify()

    def close(self, timeout: float) -> None:
        """Cancel everything, and wait at most `timeout` for the thread to end. [s]"""
        with self._condition:
            self._is_open = False
            self._waiting = []
            self._condition.notify()
        self._thread.join(timeout)

    def _is_cancelled(self) -> bool:
        return bool(self._waiting) or not self._is_open

    def _work(self) -> None:
        while (request := self._next_request()) is not None:
            begin = time.monotonic()
            answer = self._compute(request[0], self._is_cancelled)
            if not self._is_cancelled():
                self._on_answer(answer)
            with self._condition:
                remaining = begin + self._interval - time.monotonic()
                self._condition.wait_for(lambda: not self._is_open, max(remaining, 0.0))

    def _next_request(self) -> list[Request] | None:
        """Wait for a request; None if there will be none."""
        with self._condition:
            self._condition.wait_for(self._is_cancelled)
            request, self._waiting = self._waiting, []
            return request if self._is_open else None
