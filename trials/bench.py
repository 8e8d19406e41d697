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
"""Rigs on a bench that only exists here: random ones, thrown with, and measured with faults."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
import math

import numpy as np
from numpy.typing import NDArray
from soft_throw_ros.core.plate import Underdamped
from soft_throw_ros.core.rig import Engine, Layer, Projectile, Rig
from soft_throw_ros.identification.fit_description import PARAMETERS, values_of
from soft_throw_ros.twin.imperfect_rig import Imperfections, ImperfectThrow, throw
from soft_throw_ros.twin.sensor_faults import draw_chances, SensorFaults

Floats = NDArray[np.float64]

NOISE = 20e-6
"""Standard deviation of heights, if nothing else is said. [m]"""

MASS_ERROR = 0.01
"""Standard error with which masses are known, if nothing is said. [-]"""

LENGTH_ERROR = 1e-4
"""Standard error with which thickness and diameter are known, if nothing is said. [m]"""

_START = (14e-3, 18e-3)  # from when to when throws begin in it [s]
_SLOWEST = 0.5  # projectile that is thrown, over the plate
_LATEST = 1.2  # release, in plate periods
_QUICK_CELLS = 32  # to see whether a rig is worth a throw
_DRAWS = 1000  # of rigs until one throws as it should


@dataclass(frozen=True, kw_only=True)
class Trial:
    """Something to identify, and what would be right."""

    records: tuple[Floats, ...]
    """Of each throw or layer: times [s], and heights of plate and projectile, or both ends [m]."""
    arguments: tuple[str, ...] = ()
    """Of the command, beside the files."""
    truth: Mapping[str, float] = field(default_factory=dict)
    """What it should find, by the names it has for it; `ejection.*` is how the projectile left."""
    thicknesses: tuple[float, ...] = ()
    """Of free layers that ring, one for each record, if it is these [m]."""


@dataclass(frozen=True, kw_only=True)
class RigRange:
    """From where to where random rigs are; times, lengths and ratios evenly in the logarithm."""

    frequency: tuple[float, float] = (45.0, 90.0)
    amplitude: tuple[float, float] = (1e-3, 3e-3)
    damping_ratio: tuple[float, float] = (0.02, 0.15)
    wave_speed: tuple[float, float] = (6.0, 11.0)
    thickness: tuple[float, float] = (6e-3, 20e-3)
    mass_ratio: tuple[float, float] = (0.2, 2.0)
    loss_tangent: tuple[float, float] = (0.0, 0.0)

    def draw(self, random: np.random.Generator) -> Rig:
        """Draw one."""

        def one_of(limits: tuple[float, float]) -> float:
            return float(np.exp(random.uniform(*np.log(limits))))

        layer = Layer(thickness=one_of(self.thickness), wave_speed=one_of(self.wave_speed))
        engine = Engine(
            frequency=one_of(self.frequency),
            amplitude=one_of(self.amplitude),
            damping_ratio=random.uniform(*self.damping_ratio),
        )
        layer = replace(layer, loss_tangent=random.uniform(*self.loss_tangent))
        projectile = Projectile(mass=one_of(self.mass_ratio) * layer.mass)
        return Rig(engine=engine, layer=layer, projectile=projectile)


@dataclass(frozen=True, kw_only=True)
class Bench:
    """How a throw is done and measured."""

    rigs: RigRange = field(default_factory=RigRange)
    imperfections: Imperfections = field(default_factory=Imperfections)
    faults: SensorFaults = field(default_factory=lambda: SensorFaults(noise=NOISE))
    stiffening: float = 0.0
    """Relative change of the stress at the largest strain of the throw [-]."""
    drift: float = 0.0
    """Of heights over the record, over the amplitude [-]."""
    rate: float = 5000.0
    """Of samples [Hz]."""
    duration: float = 0.1
    """Of a record [s]."""
    lost_runs: float = 0.0
    """Share of samples that are lost some dozens in a row [-]."""
    accept: Callable[[ImperfectThrow], bool] = lambda _: True
    """Whether a throw is one that is wanted."""

    def draw_throw(self, random: np.random.Generator) -> ImperfectThrow:
        """Throw with random rigs until one throws well enough to be of interest."""
        for _ in range(_DRAWS):
            rig = self.rigs.draw(random)
            quick = throw(rig, until=_LATEST / rig.engine.frequency, cells=_QUICK_CELLS)
            if is_good(quick) and self.accept(quick):
                found = self.throw(rig, random)
                if is_good(found) and self.accept(found):
                    return found
        raise RuntimeError(f'none of {_DRAWS} rigs throws as it should')

    def throw(self, rig: Rig, random: np.random.Generator) -> ImperfectThrow:
        """Throw, with the imperfections of this bench."""
        imperfections = self.imperfections
        if imperfections.ringing:
            phase = random.uniform(0.0, 2.0 * math.pi)
            imperfections = replace(imperfections, ringing_phase=phase)
        until, start = self.duration, -_START[1]
        if self.stiffening:
            strain = throw(rig, until=0.02, cells=64).peak_strain
            imperfections = replace(imperfections, stiffening=self.stiffening / strain)
        return throw(rig, imperfections, until=until, start=start)

    def measure(self, thrown: ImperfectThrow, random: np.random.Generator) -> Floats:
        """Look at a throw."""
        drift = self.drift * thrown.rig.engine.amplitude / self.duration
        faults = replace(self.faults, drift=self.faults.drift + drift)
        time = np.arange(0.0, self.duration, 1.0 / self.rate)
        start = random.uniform(*_START)
        sample = faults.measure(
            time,
            lambda moments: thrown.plate(moments - start),
            lambda moments: thrown.projectile(moments - start),
            draw_chances(random, time.size),
        )
        columns = np.column_stack([sample.stamp, sample.plate, sample.projectile])
        is_seen = np.asarray(sample.is_seen)
        while self.lost_runs and (~is_seen).mean() < self.lost_runs:
            first = int(random.integers(time.size))
            is_seen[first:first + int(random.integers(4, 24))] = False
        return np.asarray(columns[is_seen])


def is_good(thrown: ImperfectThrow) -> bool:
    """Whether the projectile rests until the throw, and then leaves soon and fast."""
    if not thrown.changes:
        return False
    release = thrown.changes[0]
    engine = thrown.rig.engine
    fast = _SLOWEST * Underdamped.of(engine).peak_velocity
    return 0.0 < release.time < _LATEST / engine.frequency and release.velocity > fast


def truth_of(thrown: ImperfectThrow, faults: SensorFaults) -> dict[str, float]:
    """Tell what is right of a rig, of how it throws, and of how it is measured."""
    rig, (release, *later) = thrown.rig, thrown.changes
    last = release  # before it comes down, which is what averages see
    for change in later:
        if not change.is_release and change.velocity <= 0.0:
            break
        last = change
    peak = Underdamped.of(rig.engine).peak_velocity
    truth = {
        **values_of(rig, PARAMETERS),
        'projectile.scale': faults.projectile_scale,
        'projectile.delay': faults.projectile_delay,
        'projectile.sticking': thrown.imperfections.sticking,
    }
    for how, change in (('ejection', release), ('averages', last)):
        truth[f'{how}.time'] = change.time
        truth[f'{how}.speed'] = change.velocity
        truth[f'{how}.peak_plate_speed'] = peak
        truth[f'{how}.energy_transfer'] = (change.velocity / peak) ** 2
    return truth


def known_of(rig: Rig, random: np.random.Generator | None = None) -> tuple[str, ...]:
    """
    Tell the command what somebody knows who has measured the parts of a rig.

    Exactly, or, with random numbers, as well as the paper's authors did.

    """
    if random is not None:
        mass, thickness, diameter = random.standard_normal(3).tolist()
        layer = replace(
            rig.layer,
            thickness=rig.layer.thickness + LENGTH_ERROR * thickness,
            diameter=rig.layer.diameter + LENGTH_ERROR * diameter,
        )
        projectile = replace(rig.projectile, mass=rig.projectile.mass * (1.0 + MASS_ERROR * mass))
        rig = replace(rig, layer=layer, projectile=projectile)
    known = {
        'thickness': rig.layer.thickness,
        'density': rig.layer.density,
        'diameter': rig.layer.diameter,
        'mass': rig.projectile.mass,
    }
    return tuple(part for name, value in known.items() for part in (f'--{name}', f'{value:.9g}'))
