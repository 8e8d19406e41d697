# Copyright 2026 soft_throw_ros developers
#
# Licensed under the Apache License, Version 2.0 (the "License");
# you may not use this file except in compliance with the License.
# You may obtain a copy of the License at
#
#     http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software
# distributed under the License is distributed on an "AS IS" BASIS,
# WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied.
# See the License for the specific language governing permissions and
# limitations under the License.
"""Compute beside the ticks, for the latest request only."""

from __future__ import annotations

from collections.abc import Callable
import threading
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
        waits for the answer any more; then any answer will do.
    on_answer : callable
        Called in the thread with every answer.
    interval : float
        Time from an answer to the next beginning, so that a storm of requests costs little. [s]

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
        self._request: Request
        self._is_waiting = threading.Event()
        self._is_closing = threading.Event()
        self._thread = threading.Thread(name='worker', target=self._work, daemon=True)
        self._thread.start()

    def submit(self, request: Request) -> None:
        """Have a request answered in place of all earlier ones."""
        self._request = request
        self._is_waiting.set()

    def close(self, timeout: float) -> None:
        """Cancel everything, and wait at most `timeout` for the thread to end [s]."""
        self._is_closing.set()
        self._is_waiting.set()
        self._thread.join(timeout)

    def _work(self) -> None:
        while self._is_waiting.wait() and not self._is_closing.is_set():
            self._is_waiting.clear()
            answer = self._compute(self._request, self._is_waiting.is_set)
            if not self._is_waiting.is_set():
                self._on_answer(answer)
            self._is_closing.wait(self._interval)
