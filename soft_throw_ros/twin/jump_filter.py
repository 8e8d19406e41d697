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
"""Which positions of a body have jumped, as samples of it come."""

from __future__ import annotations

import math

import numba as nb
import numpy as np
from numpy.typing import NDArray
from soft_throw_ros.core.kernels import Record

Floats = NDArray[np.float64]

TYPICAL = 0.6745  # median of the magnitude of standard normal numbers
_LIKELY, _STRONGEST = 1.5, 3.0  # accelerations that are likely and possible, in those given [-]
_SURE = 6.0  # standard errors that are no noise
_TRACKING = 1.05  # factor by which a running median is corrected at a time
_MOST_IN_A_ROW = 3  # samples that have jumped, after which it is the sensor that has

_MEMORY = np.dtype(
    [
        ('acceleration', 'f8'),  # [m/s2]
        ('noise', 'f8'),  # standard deviation [m]
        ('typical', 'f8'),  # median of distances from the line, relative to their standard error
        ('count', 'i8'),  # positions that were right, up to two
        ('before', 'f8', (2,)),  # time and position of the last but one that was right
        ('last', 'f8', (2,)),  # and of the last
        ('jumped', 'f8', (2,)),  # and of the last that had jumped
        ('in_a_row', 'i8'),  # that have jumped
    ],
    align=True,
)

_jit = nb.njit(cache=True, nogil=True, error_model='numpy')


class JumpFilter:
    """
    Tells which positions of a body have jumped.

    One is right if it is on the line through the last two, but for what the engine's
    `acceleration` [m/s2] makes of it and six standard errors, by the `noise` [m] or what was
    typical lately. If not, it has jumped unless the next one leads on from there: then it is on
    the line from the last one to the next, but for an acceleration that is a few times as large.
    Three in a row that have jumped are where the body is: the zero of the sensor has moved.
    """

    def __init__(self, acceleration: float, noise: float) -> None:
        self._memory = np.zeros(1, _MEMORY)
        self._memory['acceleration'] = acceleration
        self._memory['noise'] = noise
        self._memory['typical'] = TYPICAL

    def judge(self, times: Floats, positions: Floats, end: int, jumped: NDArray[np.bool_]) -> None:
        """Write which of the positions before `end` have jumped; those after tell, too."""
        _judge(self._memory, times, positions, end, jumped)

    def is_doubtful(self, time: float, position: float) -> bool:
        """Tell whether it takes another position to judge the next one."""
        return bool(_is_doubtful(self._memory, time, position))


@_jit
def _judge(
    memory: NDArray[np.void],
    times: Floats,
    positions: Floats,
    end: int,
    jumped: NDArray[np.bool_],
) -> None:
    """Take positions up to an end in order; those that are NaN are passed over."""
    s = memory[0]
    for n in range(end):
        jumped[n] = False
        time, position = times[n], positions[n]
        if math.isnan(position):
            continue
        if s.count < 2:
            s.count += 1
        else:
            noise, excess = _distance(s, time, position, s.before, s.last[0], s.last[1], _LIKELY)
            limit = _SURE / TYPICAL * s.typical
            jumped[n] = excess > limit * noise
            if jumped[n] and n + 1 < times.size and not math.isnan(positions[n + 1]):
                between, beyond = _distance(
                    s, time, position, s.last, times[n + 1], positions[n + 1], _STRONGEST
                )
                jumped[n] = beyond > limit * between
            s.typical *= _TRACKING if excess > s.typical * noise else 1.0 / _TRACKING
            s.typical = max(s.typical, TYPICAL)
            if jumped[n]:
                s.in_a_row += 1
                if s.in_a_row < _MOST_IN_A_ROW:
                    s.jumped[0], s.jumped[1] = time, position
                    continue
                jumped[n] = False
                s.last[0], s.last[1] = s.jumped[0], s.jumped[1]
        s.in_a_row = 0
        s.before[0], s.before[1] = s.last[0], s.last[1]
        s.last[0], s.last[1] = time, position


@_jit
def _is_doubtful(memory: NDArray[np.void], time: float, position: float) -> bool:
    """Tell whether a position is off the line through the last two."""
    s = memory[0]
    if s.count < 2 or math.isnan(position):
        return False
    noise, excess = _distance(s, time, position, s.before, s.last[0], s.last[1], _LIKELY)
    return excess > _SURE / TYPICAL * s.typical * noise  # type: ignore[no-any-return]


@_jit
def _distance(
    s: Record,
    time: float,
    position: float,
    one: Floats,
    other_time: float,
    other_position: float,
    strength: float,
) -> tuple[float, float]:
    """Return the noise of the distance from a line, and that beyond what bends the path."""
    part = (time - one[0]) / (other_time - one[0])
    distance = abs(position - one[1] - part * (other_position - one[1]))
    bend = 0.5 * abs((time - one[0]) * (time - other_time)) * strength * s.acceleration
    return s.noise * math.sqrt(1.0 + part**2 + (1.0 - part) ** 2), distance - bend


def warm_up() -> None:
    """Compile or load all kernels."""
    judge = JumpFilter(1.0, 1.0)
    judge.judge(np.arange(4.0), np.zeros(4), 4, np.zeros(4, np.bool_))
    judge.is_doubtful(5.0, 0.0)
