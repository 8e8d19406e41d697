# SPDX-License-Identifier: Apache-2.0
"""Compute beside the ticks, for the latest request only."""

from __future__ import annotations

from collections.abc import Callable
import threading
from typing import Generic, TypeVar

Request = TypeVar('Request')
Answer = TypeVar('Answer')


class LatestWins(Generic[Request, Answer]):
    """
    One thread that answers requests; a newer request replaces one that waits.

    An answer that a newer request has overtaken is dropped.

    Parameters
    ----------
    compute : callable
        Makes the answer. What it raises is a defect, and ends the thread with a traceback.
    on_answer : callable
        Called in the thread with every answer.

    """

    def __init__(
        self,
        compute: Callable[[Request], Answer],
        on_answer: Callable[[Answer], None],
    ) -> None:
        self._compute = compute
        self._on_answer = on_answer
        self._condition = threading.Condition()
        self._waiting: list[Request] = []
        self._is_open = True
        self._thread = threading.Thread(name='worker', target=self._work, daemon=True)
        self._thread.start()

    def submit(self, request: Request) -> None:
        """Have a request answered, unless another one comes before its turn."""
        with self._condition:
            self._waiting = [request]
            self._condition.notify()

    def close(self, timeout: float) -> None:
        """Drop what waits, and wait at most `timeout` for what is being computed. [s]"""
        with self._condition:
            self._is_open = False
            self._waiting = []
            self._condition.notify()
        self._thread.join(timeout)

    def _work(self) -> None:
        while True:
            with self._condition:
                self._condition.wait_for(lambda: self._waiting or not self._is_open)
                if not self._is_open:
                    return
                request = self._waiting.pop()
            answer = self._compute(request)
            with self._condition:
                is_latest = self._is_open and not self._waiting
            if is_latest:
                self._on_answer(answer)
