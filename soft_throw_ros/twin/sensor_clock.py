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
"""How far the clock that stamps the samples of a rig is off that of the twin."""

from __future__ import annotations

from collections.abc import Iterable

from soft_throw_ros.twin.tick_schedule import SECOND

TOLERATED = SECOND // 200  # what a message may take, or clocks that are kept together differ [ns]
_FIRST, _LATER = SECOND // 5, 2 * SECOND  # how long samples are watched before they tell [ns]
_FEWEST = 50  # samples that do
_SINCE_BOOT = 300_000_000 * SECOND  # nothing has been running for ten years, ...
_TIME_OF_DAY = 1_000_000_000 * SECOND  # ... and this was in 2001


class SensorClock:
    """
    Estimates a constant offset of stamps, to be taken off.

    What no message has been quicker than is the offset: the time that every message takes cannot
    be told from it, and counts as offset if it is more than 5 ms. Up to that nothing is changed.

    Attributes
    ----------
    offset_ns : int
        To be added to stamps. [ns]
    problem : str
        What is wrong with the stamps and what has been done, in a sentence; empty if nothing.

    """

    def __init__(self) -> None:
        self.offset_ns = 0
        self.problem = ''
        self._begin_ns: int | None = None  # since when samples are watched
        self._watching_ns = _FIRST
        self._count = 0
        self._least_ns = 0

    def observe(self, stamps: Iterable[int], now_ns: int, *, limit_ns: int) -> bool:
        """Look at stamps that have just come; return whether there is another `problem` now."""
        newest_ns = -1
        for stamp_ns in stamps:
            self._count += 1
            newest_ns = max(newest_ns, stamp_ns)
        delay_ns = now_ns - newest_ns
        if self._begin_ns is None:
            self._begin_ns, self._least_ns = now_ns, delay_ns
        self._least_ns = min(self._least_ns, delay_ns)
        if self._count < _FEWEST or now_ns - self._begin_ns < self._watching_ns:
            return False
        problem = self.problem
        self._estimate(newest_ns, now_ns, limit_ns)
        self._begin_ns, self._count, self._watching_ns = None, 0, _LATER
        return self.problem != problem

    def _estimate(self, newest_ns: int, now_ns: int, limit_ns: int) -> None:
        """Take over what no message was quicker than, if it is more than messages take."""
        least_ns = self._least_ns
        if abs(least_ns - self.offset_ns) <= TOLERATED and abs(self.offset_ns) <= limit_ns:
            return
        if abs(least_ns) <= TOLERATED:
            self.offset_ns, self.problem = 0, ''
            return
        if newest_ns < _SINCE_BOOT and now_ns > _TIME_OF_DAY:
            self.offset_ns = least_ns
            self.problem = (
                'stamps of the samples count from the boot of the sensor: they are taken to be '
                f'{least_ns / SECOND:.3f} s behind the clock of the twin'
            )
            return
        size, side = abs(least_ns) / SECOND, 'behind' if least_ns > 0 else 'ahead of'
        text = f'stamps of the samples are {1e3 * size:.1f} ms {side} the clock of the twin'
        if abs(least_ns) <= limit_ns:
            self.offset_ns = least_ns
            self.problem = f'{text}, which is taken off'
        else:
            self.offset_ns = 0
            self.problem = (
                f'{text}, beyond measured.clock_limit {limit_ns / SECOND:g} s: '
                'keep the clocks together (chrony, PTP), or raise measured.clock_limit'
            )
