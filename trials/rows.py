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
"""What is tried: a row of the table for each thing that happens on a bench."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
import math
from typing import TypeAlias

import numpy as np
from soft_throw_ros.core.rig import Rig
from soft_throw_ros.identification.fit_description import HELD
from soft_throw_ros.twin.imperfect_rig import Imperfections, ImperfectThrow
from soft_throw_ros.twin.sensor_faults import SensorFaults
from trials.bench import Bench, Floats, known_of, NOISE, RigRange, Trial, truth_of

Random: TypeAlias = np.random.Generator

_SHOTS = (2.00e-3, 1.94e-3, 2.05e-3)  # amplitudes of three throws in one fit [m]
_RINGING_PERIODS = 12.0  # of a free layer that are seen
_SQUEEZED = 0.05  # of its thickness, before


@dataclass(frozen=True)
class Row:
    """A row of the table: its name, what its trials are, and whether the data are clean."""

    name: str
    draw: Callable[[Random], Trial]
    is_clean: bool = False


def _try(bench: Bench, random: Random, *arguments: str, is_exact: bool = False) -> Trial:
    """Throw once, with a rig whose parts are known to some error, or exactly."""
    thrown = bench.draw_throw(random)
    return Trial(
        records=(bench.measure(thrown, random),),
        arguments=(*known_of(thrown.rig, None if is_exact else random), *arguments),
        truth=truth_of(thrown, bench.faults),
    )


def _one_throw(bench: Bench, *arguments: str, is_exact: bool = False) -> Callable[[Random], Trial]:
    """Try one throw on a bench."""
    return lambda random: _try(bench, random, *arguments, is_exact=is_exact)


def _measured_with(**faults: float) -> Callable[[Random], Trial]:
    """Try one throw that is measured with a fault beside noise."""
    return _one_throw(Bench(faults=SensorFaults(noise=NOISE, **faults)))


def _one_spike(random: Random) -> Trial:
    """Try a clean throw with one height that is 3 mm off."""
    trial = _one_throw(Bench())(random)
    record = trial.records[0].copy()
    record[random.integers(len(record)), random.integers(1, 3)] += random.choice([-3e-3, 3e-3])
    return replace(trial, records=(record,))


def _badly_known(random: Random) -> Trial:
    """Try a throw of which mass, thickness and diameter are known to 5 %, which is said."""
    bench = Bench()
    thrown = bench.draw_throw(random)
    known = known_of(thrown.rig)
    arguments = []
    for option, text in zip(known[::2], known[1::2], strict=True):
        if option != '--density':
            told = float(text) * max(1.0 + 0.05 * random.standard_normal(), 0.5)
            arguments += [option, f'{told:.9g}+-5%']
    return Trial(
        records=(bench.measure(thrown, random),),
        arguments=tuple(arguments),
        truth=truth_of(thrown, bench.faults),
    )


def _as_expected(random: Random) -> Trial:
    """Try a throw in which all that is known to some error is off by such errors."""
    scale, delay, drift = random.standard_normal(3).tolist()
    faults = replace(_NOISY, projectile_scale=1.0 + 0.005 * scale, projectile_delay=1e-4 * delay)
    return _try(Bench(faults=faults, drift=0.02 * drift), random)


def _three_shots(*arguments: str) -> Callable[[Random], Trial]:
    """Try three throws of unlike amplitudes in one fit."""
    bench = Bench()

    def draw(random: Random) -> Trial:
        first = bench.draw_throw(random).rig

        def of_amplitude(amplitude: float) -> Rig:
            return replace(first, engine=replace(first.engine, amplitude=amplitude))

        throws = [bench.throw(of_amplitude(each), random) for each in _SHOTS]
        mean = bench.throw(of_amplitude(float(np.mean(_SHOTS))), random)
        return Trial(
            records=tuple(bench.measure(each, random) for each in throws),
            arguments=(*known_of(first, random), *arguments),
            truth=truth_of(mean, bench.faults),
        )

    return draw


def _free_layers(losses: tuple[float, ...]) -> Callable[[Random], Trial]:
    """Try free layers that ring, of loss tangents at 63.2 Hz so many times that of the first."""

    def draw(random: Random) -> Trial:
        wave_speed, loss = random.uniform(6.0, 11.0), random.uniform(0.02, 0.06)
        thicknesses = random.uniform(10e-3, 20e-3, len(losses)).tolist()
        records = [
            _ring(random, thickness / wave_speed, loss * factor, thickness)
            for thickness, factor in zip(thicknesses, losses, strict=True)
        ]
        return Trial(
            records=tuple(records),
            arguments=('--thickness-error', '1e-5', '--fit', 'layer.loss_tangent'),
            truth={'layer.wave_speed': wave_speed, 'layer.loss_tangent': loss},
            thicknesses=tuple(thicknesses),
        )

    return draw


def _ring(random: Random, crossing: float, loss: float, thickness: float) -> Floats:
    """Let go of a layer that was squeezed evenly: the sum of its modes, each with its loss."""
    start, omega_1 = 5e-3, math.pi / crossing
    duration = start + _RINGING_PERIODS * 2.0 * crossing
    time = np.arange(0.0, duration, 1e-4)
    since = np.maximum(time - start, 0.0)
    theta = loss / (2.0 * math.pi * 63.2)
    change = np.zeros_like(time)
    for order in range(1, 60, 2):
        omega = order * omega_1
        half = 0.5 * theta * omega
        # Both roots of s^2 + theta omega^2 s + omega^2, which are real for modes that creep
        root = np.sqrt(complex(half**2 - 1.0))
        fast, slow = omega * (-half - root), omega * (-half + root)
        wave = (fast * np.exp(slow * since) - slow * np.exp(fast * since)) / (fast - slow)
        change -= 8.0 / (math.pi * order) ** 2 * wave.real
    change[time < start] = -1.0
    top = thickness * (1.0 + _SQUEEZED * change) + NOISE * random.standard_normal(time.size)
    bottom = NOISE * random.standard_normal(time.size)
    return np.column_stack([time, bottom, top])


def _catches_up(thrown: ImperfectThrow) -> bool:
    """Whether the layer catches up with the projectile soon after it left."""
    changes = thrown.changes
    return len(changes) > 1 and changes[1].velocity > 0.0


_NOISY = SensorFaults(noise=NOISE)
_LOSSY = RigRange(loss_tangent=(0.02, 0.2))
_HOLD = tuple(part for name in HELD if HELD[name] == 'held' for part in ('--hold', name))
_FIT_LOSS = ('--fit', 'layer.loss_tangent')
_RINGING, _SECOND_MODE = Imperfections(ringing=0.02), Imperfections(second_mode=0.01)
_STICKING = Imperfections(sticking=2e-4)
_AMPLITUDE_PER_THROW = ('--fit', 'engine.amplitude=free per throw')
_SLOW = RigRange(amplitude=(0.1e-3, 0.3e-3), frequency=(20.0, 45.0))
_LIGHT = RigRange(mass_ratio=(0.02, 0.2))
_OUTLIERS = replace(_NOISY, outlier_rate=0.005, outlier_size=3e-3)

ROWS = (
    Row('clean', _one_throw(Bench()), is_clean=True),
    Row('clean, known exactly', _one_throw(Bench(), *_HOLD, is_exact=True), is_clean=True),
    Row('clean, with loss', _one_throw(Bench(rigs=_LOSSY), *_FIT_LOSS), is_clean=True),
    Row('one sample 3 mm off', _one_spike),
    Row('0.5 % outliers of 0.3 to 3 mm', _one_throw(Bench(faults=_OUTLIERS))),
    Row('drift of 2 % of A', _one_throw(Bench(drift=0.02))),
    Row('plate rings before, 2 % of A', _one_throw(Bench(imperfections=_RINGING))),
    Row('second mode of 1 % at 310 Hz', _one_throw(Bench(imperfections=_SECOND_MODE))),
    Row('stamps off by 20 % of an interval', _measured_with(stamp_error=4e-5)),
    Row('3 % of samples missing', _measured_with(missing_rate=0.03)),
    Row('messages lost in runs, 5 %', _one_throw(Bench(lost_runs=0.05))),
    Row('fast waves (two minima)', _one_throw(Bench(rigs=RigRange(wave_speed=(14.0, 20.0))))),
    Row('layer stiffens by 10 %', _one_throw(Bench(stiffening=0.1))),
    Row('layer softens by 10 %', _one_throw(Bench(stiffening=-0.1))),
    Row('mass and size known to 5 %, said', _badly_known),
    Row('all off as is expected', _as_expected),
    Row('projectile scale 0.5 % off', _measured_with(projectile_scale=1.005)),
    Row('projectile 0.1 ms late', _measured_with(projectile_delay=1e-4)),
    Row('layer sticks for 0.2 ms', _one_throw(Bench(imperfections=_STICKING))),
    Row('rounded to 20 um', _one_throw(Bench(faults=SensorFaults(noise=4e-6, rounding=20e-6)))),
    Row('three shots of unlike A, said', _three_shots(*_AMPLITUDE_PER_THROW)),
    Row('three shots of unlike A, not said', _three_shots()),
    Row('slow throw', _one_throw(Bench(rigs=_SLOW, duration=0.15))),
    Row('re-contact', _one_throw(Bench(rigs=_LIGHT, accept=_catches_up))),
    Row('56 samples', _one_throw(Bench(rate=1000.0, duration=0.056))),
    Row('free layers', _free_layers((1.0, 1.0)), is_clean=True),
    Row('free layers, losses 1 : 1.5', _free_layers((1.0, 1.5))),
    Row('a bit of everything', _one_throw(Bench(
        rigs=_LOSSY, drift=0.005, stiffening=0.02,
        faults=replace(
            _OUTLIERS, missing_rate=0.02, stamp_error=2e-5, projectile_scale=1.001, rounding=5e-6
        ),
    ), *_FIT_LOSS)),
)
"""All rows, in their order."""

ROWS_BY_NAME = {row.name: row for row in ROWS}
"""The same, by their names."""
