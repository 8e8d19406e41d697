# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""A worker thread for slow computations that serves only the latest request."""

from __future__ import annotations

from collections.abc import Callable
import threading
from typing import Generic, TypeVar

Request = TypeVar('Request')


class LatestOnlyWorker(Generic[Request]):
    """
    One thread that serves requests; a newer request cancels all earlier ones.

    `serve` takes a request, and a function that returns whether the request is cancelled. It must
    not raise an exception. `interval` is the time from the end of a call to the next one, so that
    a storm of requests costs little [s].
    """

    def __init__(
        self, serve: Callable[[Request, Callable[[], bool]], None], *, interval: float = 0.0
    ) -> None:
        self._serve = serve
        self._interval = interval
        self._request: Request
        self._is_waiting = threading.Event()
        self._is_closing = threading.Event()
        self._thread = threading.Thread(name='worker', target=self._work, daemon=True)
        self._thread.start()

    def submit(self, request: Request) -> None:
        """Replace all earlier requests by this one."""
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
            self._serve(self._request, self._is_waiting.is_set)
            self._is_closing.wait(self._interval)
