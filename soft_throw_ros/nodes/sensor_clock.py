# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""The offset between the clock of the sensors and the clock of the twin."""

from __future__ import annotations

from collections.abc import Sequence

from soft_throw_ros.storage.message import SECOND

TOLERATED = SECOND // 200
"""Transport time of a message and difference of synchronized clocks, at most. [ns]"""

_FIRST = SECOND // 5  # duration of the first observation of stamps [ns]
_LATER = 2 * SECOND  # duration of later observations of stamps [ns]
_FEWEST = 50  # samples that an observation needs [-]


class SensorClock:
    """
    An estimator of a constant offset of stamps.

    The offset is the smallest delay of a message, because the transport time of the fastest
    message cannot be distinguished from an offset. Offsets up to `TOLERATED` are not corrected.
    """

    def __init__(self) -> None:
        self.offset_ns = 0  # correction to be added to stamps [ns]
        self.problem = ''  # a sentence on the fault of the stamps and its correction, if any
        self._begin_ns: int | None = None  # start of the observation [ns]
        self._watching_ns = _FIRST
        self._count = 0
        self._whole = 0  # stamps of whole seconds
        self._least_ns = 0

    def observe(self, stamps: Sequence[int], now_ns: int) -> bool:
        """Observe stamps that have just arrived; return whether `problem` has changed."""
        self._count += len(stamps)
        self._whole += sum(stamp_ns % SECOND == 0 for stamp_ns in stamps)
        newest_ns = max(stamps)
        delay_ns = now_ns - newest_ns
        if self._begin_ns is None:
            self._begin_ns, self._least_ns = now_ns, delay_ns
        self._least_ns = min(self._least_ns, delay_ns)
        if self._count < _FEWEST or now_ns - self._begin_ns < self._watching_ns:
            return False
        problem = self.problem
        self._estimate(newest_ns)
        self._begin_ns, self._count, self._whole, self._watching_ns = None, 0, 0, _LATER
        return self.problem != problem

    def _estimate(self, newest_ns: int) -> None:
        """Use the smallest delay as offset, if it exceeds the transport time."""
        least_ns = self._least_ns
        if self._whole == self._count:
            self.offset_ns = 0
            stamp = 'of whole seconds' if newest_ns else '0'
            self.problem = f'header.stamp of the samples is {stamp}: it must be their time'
            return
        if abs(least_ns - self.offset_ns) <= TOLERATED:
            return
        if abs(least_ns) <= TOLERATED:
            self.offset_ns, self.problem = 0, ''
        else:
            size, side = abs(least_ns) / SECOND, 'behind' if least_ns > 0 else 'ahead of'
            self.offset_ns = least_ns
            self.problem = (
                f'stamps of the samples are {1e3 * size:.1f} ms {side} the clock of the twin, '
                'which is taken off'
            )
