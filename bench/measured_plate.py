# SPDX-License-Identifier: Apache-2.0
"""A measured plate at 5 kHz: reading, smoothing and following it, per sample."""

from __future__ import annotations

from collections.abc import Callable
from itertools import cycle
import math
from typing import Any, NamedTuple

import numpy as np
from soft_throw_ros.configuration import rig_of, TWIN
from soft_throw_ros.core.plate import Underdamped
from soft_throw_ros.core.smoothing import smooth
from soft_throw_ros.recording.cdr import decode, JointStateEncoder, JointStateReader
from soft_throw_ros.twin.plate_estimator import Sample
from soft_throw_ros.twin.session import Session
from soft_throw_ros.twin.tick_schedule import SECOND, TickSchedule

from bench.race import head, race

RATE = 5000.0
PER_TICK = 5
THROW_TICKS = 15
"""From the start until the projectile is well away."""

SETTINGS = {**TWIN.defaults(), 'engine.motion': 'measured'}

_JOINT_STATE = """\
std_msgs/Header header
string[] name
float64[] position
float64[] velocity
float64[] effort
================================================================================
MSG: std_msgs/Header
builtin_interfaces/Time stamp
string frame_id
================================================================================
MSG: builtin_interfaces/Time
int32 sec
uint32 nanosec
"""


class Way(NamedTuple):
    """A call, and how many samples it is for."""

    call: Callable[[], Any]
    samples: float = 1.0


def rows() -> list[str]:
    """Return the rows of a Markdown table, the head first."""
    ways = _ways()
    times = race({name: way.call for name, way in ways.items()})
    lines = head(f'one sample of {RATE:g} in a second', 'us, min', 'median', 'of a core, %')
    for name, way in ways.items():
        least, median = (1e6 * time / way.samples for time in times[name])
        lines.append(f'| {name} | {least:.3g} | {median:.3g} | {1e-4 * median * RATE:.2g} |')
    return lines


def _ways() -> dict[str, Way]:
    data = JointStateEncoder('rig', ('plate', 'projectile'), series=1).encode(SECOND, (0.1, 0.2))
    read = JointStateReader().read
    times = np.arange(16) / RATE
    positions = times**3
    near = times[:11]
    rest = _Rest()
    return {
        'read its message': Way(lambda: read(data)),
        'the same by mcap_ros2': Way(
            lambda: decode('sensor_msgs/msg/JointState', _JOINT_STATE, data)
        ),
        'smooth a plate': Way(
            lambda: smooth([1.6e-3], times, positions, window=2e-3, position_noise=5e-6)
        ),
        'the same by numpy.polyfit': Way(lambda: np.polyfit(near - 1.6e-3, positions[:11], 3)),
        'session with a plate at rest': Way(rest.tick, PER_TICK),
        'session with a throw, from 30 ms before it': Way(_throw, sum(map(len, _BATCHES))),
    }


class _Rest:
    """A session of which the plate does not move."""

    def __init__(self) -> None:
        self._session = Session(SETTINGS)
        self._heights = cycle(5e-6 * np.random.default_rng(1).standard_normal(997))

    def tick(self) -> None:
        now = round(self._session.step * SECOND / self._session.rate)
        self._session.measure(
            [
                Sample(now - round(k * SECOND / RATE), float(next(self._heights)))
                for k in range(PER_TICK, 0, -1)
            ]
        )
        self._session.advance()


def _throw() -> None:
    """Go through a rest and a throw, with a session of its own."""
    session = Session(SETTINGS)
    session.set_tick_schedule(TickSchedule(step=0, time_ns=SECOND, rate=session.rate))
    for samples in _BATCHES:
        session.measure(samples)
        session.advance()
    assert session.throws == 1


def _batches() -> list[list[Sample]]:
    """Measure a plate that starts after it has been at rest for long enough."""
    plate = Underdamped.of(rig_of(SETTINGS).engine)
    onset = 0.03
    stamps = np.arange(0.0, onset + 1e-3 * THROW_TICKS, 1.0 / RATE)
    heights = plate.position(stamps - onset)
    samples = [
        Sample(SECOND + round(stamp * SECOND), height, math.nan, math.nan)
        for stamp, height in zip(stamps.tolist(), heights.tolist(), strict=True)
    ]
    return [samples[first : first + PER_TICK] for first in range(0, len(samples), PER_TICK)]


_BATCHES = _batches()
