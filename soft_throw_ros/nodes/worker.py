# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""A worker thread for slow computations that serves only the latest request."""

from __future__ import annotations

from collections.abc import Callable
import threading
import traceback
from typing import Generic, TypeVar

Request = TypeVar('Request')
Result = TypeVar('Result')


class LatestOnlyWorker(Generic[Request, Result]):
    """
    One thread that computes results for requests; a newer request cancels all earlier ones.

    `compute` takes a request, and a function that returns whether the request is cancelled; the
    result is then dropped, otherwise `on_result` receives it in the thread. An exception ends one
    computation, and not the thread: `failures` counts it, `log` receives the traceback, and
    `on_failure` returns the result. `interval` is the time from a result to the next computation,
    so that a storm of requests costs little [s].
    """

    def __init__(
        self,
        compute: Callable[[Request, Callable[[], bool]], Result],
        on_result: Callable[[Result], None],
        *,
        on_failure: Callable[[Request, Exception], Result],
        log: Callable[[str], object],
        interval: float = 0.0,
    ) -> None:
        self.failures = 0
        self._compute = compute
        self._on_result = on_result
        self._on_failure = on_failure
        self._log = log
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
            result = self._result_of(self._request)
            if not self._is_waiting.is_set():
                self._on_result(result)
            self._is_closing.wait(self._interval)

    def _result_of(self, request: Request) -> Result:
        try:
            return self._compute(request, self._is_waiting.is_set)
        except Exception as error:  # noqa: BLE001  later requests must still be answered
            self.failures += 1
            text = ''.join(traceback.format_exception(error))
            self._log(f'failure {self.failures} of a computation in the background: {text}')
            return self._on_failure(request, error)
