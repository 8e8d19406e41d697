# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Random rigs on a simulated bench: their throws, and measurements of these with faults."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
import math

import numpy as np
from numpy.typing import NDArray
from soft_throw_ros.core.plate import Underdamped
from soft_throw_ros.core.rig import Engine, Layer, Projectile, Rig
from soft_throw_ros.identification.fit_description import PARAMETERS, values_of
from soft_throw_ros.simulated_rig.imperfect_rig import Imperfections, ImperfectThrow, throw
from soft_throw_ros.simulated_rig.sensor_faults import draw_chances, SensorFaults

Floats = NDArray[np.float64]

NOISES = (10e-6, 30e-6)  # default range of the standard deviation of heights [m]
RATES = (3000.0, 8000.0)  # default range of the sample rate [Hz]
MODES = (3.0, 7.0)  # range of the frequency of a second mode, over that of the plate [-]
# Standard errors of the command by default: relative for the mass, of lengths in metres
ERRORS = {'mass': 0.01, 'thickness': 1e-4, 'diameter': 1e-4}

_START = (14e-3, 18e-3)  # range of the start of a throw in its record [s]
_SLOWEST = 0.5  # smallest ejection speed, over the peak speed of the plate [-]
_LATEST = 1.2  # latest release [plate periods]
_SEEN = 1.0 / RATES[1]  # shortest first release: no camera sees a shorter one [s]
_DRAWS = 1000  # largest number of rigs that are drawn for one throw


@dataclass(frozen=True, kw_only=True)
class Trial:
    """Simulated measurements with the true parameters."""

    records: tuple[Floats, ...]  # for each throw times [s], heights of plate and projectile [m]
    arguments: tuple[str, ...] = ()  # of the command, without the files
    truth: Mapping[str, float] = field(default_factory=dict)  # by the names of the results


@dataclass(frozen=True, kw_only=True)
class RigRange:
    """Ranges of random rigs; damping and loss are uniform, the logarithms of all others are."""

    frequency: tuple[float, float] = (40.0, 100.0)
    amplitude: tuple[float, float] = (1e-3, 3e-3)
    damping_ratio: tuple[float, float] = (0.01, 0.18)
    wave_speed: tuple[float, float] = (4.0, 14.0)
    thickness: tuple[float, float] = (6e-3, 25e-3)
    mass_ratio: tuple[float, float] = (0.15, 2.5)
    loss_tangent: tuple[float, float] = (0.0, 0.0)

    def draw(self, random: np.random.Generator) -> Rig:
        """Draw a rig."""

        def log_uniform(limits: tuple[float, float]) -> float:
            return float(np.exp(random.uniform(*np.log(limits))))

        thickness, wave_speed = map(log_uniform, (self.thickness, self.wave_speed))
        frequency, amplitude = map(log_uniform, (self.frequency, self.amplitude))
        damping_ratio = random.uniform(*self.damping_ratio)
        engine = Engine(frequency=frequency, amplitude=amplitude, damping_ratio=damping_ratio)
        tangent = random.uniform(*self.loss_tangent)
        layer = Layer(thickness=thickness, wave_speed=wave_speed, loss_tangent=tangent)
        projectile = Projectile(mass=log_uniform(self.mass_ratio) * layer.mass)
        return Rig(engine=engine, layer=layer, projectile=projectile)


@dataclass(frozen=True, kw_only=True)
class Bench:
    """A rig with faults, and the conditions of its measurements."""

    rigs: RigRange = field(default_factory=RigRange)
    imperfections: Imperfections = field(default_factory=Imperfections)
    faults: SensorFaults = field(default_factory=SensorFaults)
    noise: float | None = None  # standard deviation of heights; drawn from `NOISES` if None [m]
    is_neo_hookean: bool = False  # whether the layer stiffens by its strain
    has_modes: bool = False  # whether the frequency of a second mode is drawn from `MODES`
    drift: float = 0.0  # of the heights over the record, over the amplitude [-]
    rate: float | None = None  # of the samples; drawn from `RATES` if None [Hz]
    duration: float = 0.1  # of a record [s]
    lost_runs: float = 0.0  # share of samples that are lost in runs of 4 to 23 [-]
    accept: Callable[[ImperfectThrow], bool] = lambda _: True  # additional condition for a throw

    def draw_throw(self, random: np.random.Generator) -> ImperfectThrow:
        """Simulate random rigs until a throw is good and accepted; return this throw."""
        for _ in range(_DRAWS):
            rig = self.rigs.draw(random)
            if self.is_neo_hookean:
                rig = replace(rig, layer=replace(rig.layer, stress_strain_law='neo_hookean'))
            if self._accepts(throw(rig, until=_LATEST / rig.engine.frequency)):
                thrown = self.throw(rig, random)
                if self._accepts(thrown):
                    return thrown
        raise RuntimeError(f'none of {_DRAWS} random rigs has an acceptable throw')

    def _accepts(self, thrown: ImperfectThrow) -> bool:
        """Return whether the projectile rests until the throw, and leaves soon, fast and seen."""
        if not thrown.events:
            return False
        (release, *later), engine = thrown.events, thrown.rig.engine
        fast = _SLOWEST * Underdamped.of(engine).peak_velocity
        is_soon = 0.0 < release.time < _LATEST / engine.frequency
        is_seen = not later or later[0].time - release.time > _SEEN
        return is_soon and is_seen and release.velocity > fast and self.accept(thrown)

    def throw(self, rig: Rig, random: np.random.Generator) -> ImperfectThrow:
        """Simulate a throw with the imperfections of this bench."""
        imperfections = self.imperfections
        if imperfections.ringing:
            phase = random.uniform(0.0, 2.0 * math.pi)
            imperfections = replace(imperfections, ringing_phase=phase)
        if self.has_modes:
            frequency = random.uniform(*MODES) * rig.engine.frequency
            imperfections = replace(imperfections, second_mode_frequency=frequency)
        return throw(rig, imperfections, until=self.duration, start=-_START[1])

    def measure(self, thrown: ImperfectThrow, random: np.random.Generator) -> Floats:
        """Measure a throw with the faults of the sensors; return the received samples."""
        drift = self.drift * thrown.rig.engine.amplitude / self.duration
        noise = random.uniform(*NOISES) if self.noise is None else self.noise
        faults = replace(self.faults, noise=noise, drift=self.faults.drift + drift)
        rate = random.uniform(*RATES) if self.rate is None else self.rate
        time = np.arange(0.0, self.duration, 1.0 / rate)
        start = random.uniform(*_START)
        sample = faults.measure(
            time,
            lambda moments: thrown.plate(moments - start),
            lambda moments: thrown.projectile(moments - start),
            draw_chances(random, time.size),
        )
        columns = np.column_stack([sample.stamp, sample.plate, sample.projectile])
        is_received = np.asarray(sample.is_received)
        while self.lost_runs and (~is_received).mean() < self.lost_runs:
            first = int(random.integers(time.size))
            is_received[first:first + int(random.integers(4, 24))] = False
        return np.asarray(columns[is_received])


def truth_of(thrown: ImperfectThrow) -> dict[str, float]:
    """Return the true parameters of the rig, and the true first release."""
    rig, release = thrown.rig, thrown.events[0]
    peak, values = Underdamped.of(rig.engine).peak_velocity, values_of(rig, PARAMETERS)
    if rig.layer.stress_strain_law != 'linear':  # it has the wave speed at rest only there
        values['layer.rest_wave_speed'] = values.pop('layer.wave_speed')
    return {
        **values,
        'ejection.time': release.time,
        'ejection.speed': release.velocity,
        'ejection.peak_plate_speed': peak,
        'ejection.energy_transfer': (release.velocity / peak) ** 2,
    }


def measured_options(rig: Rig, random: np.random.Generator | None = None) -> tuple[str, ...]:
    """Return options with the masses and lengths of a rig; `random` adds errors of the paper."""
    measured = {
        'thickness': rig.layer.thickness,
        'density': rig.layer.density,
        'diameter': rig.layer.diameter,
        'mass': rig.projectile.mass,
    }
    if random is not None:
        for name, error in ERRORS.items():
            unit = measured[name] if name == 'mass' else 1.0
            measured[name] += unit * error * float(random.standard_normal())
    return tuple(
        word for name, value in measured.items() for word in (f'--{name}', f'{value:.9g}')
    )
