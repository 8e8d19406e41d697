# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""The rows of the table: one for each fault of rig or measurement."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import NamedTuple, TypeAlias

import numpy as np
from soft_throw_ros.core.rig import Rig
from soft_throw_ros.identification.fit_description import FIXED, IDEAL_BENCH
from soft_throw_ros.simulated_rig.imperfect_rig import Imperfections, ImperfectThrow
from soft_throw_ros.simulated_rig.sensor_faults import SensorFaults
from trials.bench import Bench, measured_options, RigRange, Trial, truth_of

Random: TypeAlias = np.random.Generator

_AMPLITUDES = (2.00e-3, 1.94e-3, 2.05e-3)  # of three throws in one fit [m]


class Row(NamedTuple):
    """A row of the table."""

    name: str  # from which the seeds of its trials are derived
    draw: Callable[[Random], Trial]
    is_clean: bool = False  # whether the data have no fault: every warning is a false alarm


def _single(bench: Bench, *arguments: str, is_exact: bool = False) -> Callable[[Random], Trial]:
    """Return a drawer of single throws, whose sizes are known with errors unless `is_exact`."""

    def draw(random: Random) -> Trial:
        thrown = bench.draw_throw(random)
        record = bench.measure(thrown, random)
        options = measured_options(thrown.rig, None if is_exact else random)
        return Trial(records=(record,), arguments=(*options, *arguments), truth=truth_of(thrown))

    return draw


def _measured_with(**faults: float) -> Callable[[Random], Trial]:
    """Return a drawer of single throws with noise and a fault of the sensors."""
    return _single(Bench(faults=SensorFaults(**faults)))


def _uncertain(random: Random) -> Trial:
    """Return a trial with errors of 5 % in mass and lengths, which the arguments state."""
    bench, arguments = Bench(), []
    thrown = bench.draw_throw(random)
    options = measured_options(thrown.rig)
    for option, text in zip(options[::2], options[1::2], strict=True):
        if option != '--density':
            value = float(text) * max(1.0 + 0.05 * random.standard_normal(), 0.5)
            arguments += [option, f'{value:.9g}+-5%']
    record = bench.measure(thrown, random)
    return Trial(records=(record,), arguments=tuple(arguments), truth=truth_of(thrown))


def _as_expected(random: Random) -> Trial:
    """Return a trial with errors of scale, delay and drift as large as the command expects."""
    scale, delay, drift = random.standard_normal(3).tolist()
    faults = SensorFaults(projectile_scale=1.0 + 0.005 * scale, projectile_delay=1e-4 * delay)
    return _single(Bench(faults=faults, drift=0.02 * drift))(random)


def _three_throws(random: Random) -> Trial:
    """Return a trial with three throws of different amplitudes, whose fit has one for each."""
    bench = Bench()
    first = bench.draw_throw(random).rig

    def of_amplitude(amplitude: float) -> Rig:
        return replace(first, engine=replace(first.engine, amplitude=amplitude))

    throws = [bench.throw(of_amplitude(amplitude), random) for amplitude in _AMPLITUDES]
    mean = bench.throw(of_amplitude(float(np.mean(_AMPLITUDES))), random)
    return Trial(
        records=tuple(bench.measure(thrown, random) for thrown in throws),
        arguments=measured_options(first, random),
        truth=truth_of(mean),
    )


def _catches_up(thrown: ImperfectThrow) -> bool:
    """Return whether the first re-contact is with a rising projectile."""
    return len(thrown.events) > 1 and thrown.events[1].velocity > 0.0


_LOSSY = RigRange(loss_tangent=(0.02, 0.2))
_HELD = [name for name, treatment in IDEAL_BENCH.items() if treatment == FIXED]
_HOLD = tuple(word for name in _HELD for word in ('--hold', name))
_FIT_LOSS = ('-p', 'layer.loss_tangent:=0.05+-0.5')
_RINGING, _SECOND_MODE = Imperfections(ringing=0.02), Imperfections(second_mode=0.01)
_SLOW = RigRange(amplitude=(0.1e-3, 0.3e-3), frequency=(20.0, 45.0))
_LIGHT = RigRange(mass_ratio=(0.02, 0.2))
_OUTLIERS = SensorFaults(outlier_rate=0.005, outlier_size=3e-3)
_OWN_DAMPING = Imperfections(ringing=0.02, ringing_damping_ratio=0.01)

ROWS = (
    Row('clean', _single(Bench()), is_clean=True),
    Row('clean, known exactly', _single(Bench(), *_HOLD, is_exact=True), is_clean=True),
    Row('clean, with loss', _single(Bench(rigs=_LOSSY), *_FIT_LOSS), is_clean=True),
    Row('0.5 % outliers of 0.3 to 3 mm', _single(Bench(faults=_OUTLIERS))),
    Row('drift of 2 % of A', _single(Bench(drift=0.02))),
    Row('plate rings before, 2 % of A', _single(Bench(imperfections=_RINGING))),
    Row('plate rings before, damped by 0.01', _single(Bench(imperfections=_OWN_DAMPING))),
    Row('second mode of 1 % at 310 Hz', _single(Bench(imperfections=_SECOND_MODE))),
    Row('second mode of 1 % at 3 to 7 f', _single(
        Bench(imperfections=_SECOND_MODE, has_modes=True)
    )),
    Row('stamps off by 20 % of an interval', _single(
        Bench(faults=SensorFaults(stamp_error=4e-5), rate=5000.0)
    )),
    Row('3 % of samples missing', _measured_with(missing_rate=0.03)),
    Row('messages lost in runs, 5 %', _single(Bench(lost_runs=0.05))),
    Row('fast waves (two minima)', _single(Bench(rigs=RigRange(wave_speed=(14.0, 20.0))))),
    Row('neo-Hookean layer', _single(Bench(is_neo_hookean=True))),
    Row('mass and size known to 5 %, stated', _uncertain),
    Row('all imperfections of typical size', _as_expected),
    Row('projectile scale 0.5 % off', _measured_with(projectile_scale=1.005)),
    Row('projectile 0.1 ms late', _measured_with(projectile_delay=1e-4)),
    Row('rounded to 20 um', _single(Bench(faults=SensorFaults(rounding=20e-6), noise=4e-6))),
    Row('rounded to 50 um', _single(Bench(faults=SensorFaults(rounding=50e-6), noise=5e-6))),
    Row('three throws of different A, A free per throw', _three_throws),
    Row('slow throw', _single(Bench(rigs=_SLOW, duration=0.15))),
    Row('re-contact', _single(Bench(rigs=_LIGHT, accept=_catches_up))),
    Row('56 samples', _single(Bench(rate=1000.0, duration=0.056))),
    Row('a bit of everything', _single(Bench(
        rigs=_LOSSY, drift=0.005, is_neo_hookean=True,
        faults=replace(
            _OUTLIERS, missing_rate=0.02, stamp_error=2e-5, projectile_scale=1.001, rounding=5e-6
        ),
    ), *_FIT_LOSS)),
)

ROWS_BY_NAME = {row.name: row for row in ROWS}
