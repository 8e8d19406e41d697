# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Bounded time to the end of a process, even if the middleware hangs."""

from __future__ import annotations

import ctypes

_CLOCK_MONOTONIC = 1
_SIGEV_THREAD = 2


class _Event(ctypes.Structure):
    """Linux's `struct sigevent`, for a function that is called in a thread of its own."""

    _fields_ = (
        ('value', ctypes.c_int64),
        ('signal', ctypes.c_int),
        ('notify', ctypes.c_int),
        ('function', ctypes.c_void_p),
        ('attributes', ctypes.c_void_p),
        ('reserved', ctypes.c_int64 * 4),
    )


def exit_after(seconds: float, code: int) -> ctypes.c_void_p:
    """
    End the process after a time [s] unless the timer that is returned is cancelled.

    The middleware may hang in a call that holds the lock of Python's interpreter, and then no
    thread of Python runs any more. So a thread of the C library ends the process.
    """
    libc = ctypes.CDLL(None)
    function = ctypes.cast(libc._exit, ctypes.c_void_p).value
    event = _Event(value=code, notify=_SIGEV_THREAD, function=function)
    timer = ctypes.c_void_p()
    if libc.timer_create(_CLOCK_MONOTONIC, ctypes.byref(event), ctypes.byref(timer)):
        raise OSError('the system has no timer left')
    whole, fraction = divmod(round(1e9 * seconds), 1_000_000_000)
    times = (ctypes.c_long * 4)(0, 0, whole, fraction)  # the zero interval disables repetition
    libc.timer_settime(timer, 0, times, None)
    return timer


def cancel_exit(timer: ctypes.c_void_p) -> None:
    """Cancel a timer of `exit_after`."""
    ctypes.CDLL(None).timer_delete(timer)
