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
r"""
Throws of rigs that do what no model here does: plates that ring, layers that stiffen or stick.

For trials of what is to find out about such rigs. It shares nothing with the models of the core.

Notes
-----
In the layer, with heights y of the undeformed material and the displacement u,

.. math::

    \rho u_{tt} = -\sigma_y, \qquad
    \sigma = E (\epsilon + k \epsilon^2) + \eta \epsilon_t, \qquad \epsilon = -u_y,

where the strain :math:`\epsilon` is positive in compression and may be large: the stress is force
over the undeformed section. Leapfrog on even cells, of second order, with the viscous stress half
a step late. The layer's weight is left out, as in the models.

Contact is a common node of the layer's top and the projectile. It opens when it pulls, or sticks
for a while; when the gap closes, momentum is shared.

"""

from __future__ import annotations

from dataclasses import dataclass
import math
from typing import NamedTuple

import numba as nb
import numpy as np
from numpy.typing import ArrayLike, NDArray
from soft_throw_ros.core.plate import Underdamped
from soft_throw_ros.core.rig import Rig

Floats = NDArray[np.float64]

_CELLS = (512, 256, 192, 128, 96, 64)  # the most for which the effort is small enough
_MAX_UPDATES = 2e8  # of cells
_COURANT = 0.98  # part of the longest stable step
_RECORDED_EVERY = 5e-6  # [s]
_LEAD_IN = 30e-3  # during which a plate that rings begins to [s]
_MAX_EVENTS = 64

_TABLE_STEP = 2e-5  # of deviations [s]
_TABLE_CELLS = 128
_RINGS_BEFORE = 0.1  # a throw, in a table [s]
_LONGEST_THROW = 0.6  # in a table [s]
_FADING = 0.03  # part of the flight before the landing in which deviations fade


@dataclass(frozen=True, kw_only=True)
class Imperfections:
    """
    What a rig does that no model here does.

    Parameters
    ----------
    stiffening : float
        :math:`k`, by which the layer stiffens in compression; negative if it softens. [-]
    sticking : float
        How long the layer holds the projectile that wants to leave. [s]
    ringing : float
        Amplitude with which the plate rings at first, from a blow before, over that of the
        engine. [-]
    ringing_phase : float
        [rad]
    second_mode : float
        Amplitude of a second mode of the plate, which the throw excites, over that of the engine.
        [-]
    second_mode_frequency : float
        [Hz]
    second_mode_damping_ratio : float
        [-]

    """

    stiffening: float = 0.0
    sticking: float = 0.0
    ringing: float = 0.0
    ringing_phase: float = 0.0
    second_mode: float = 0.0
    second_mode_frequency: float = 310.0
    second_mode_damping_ratio: float = 0.02

    @property
    def are_there(self) -> bool:
        """Whether there are any."""
        return any((self.stiffening, self.sticking, self.ringing, self.second_mode))


class Change(NamedTuple):
    """A release, or a contact: when [s], and the projectile's velocity then [m/s]."""

    is_release: bool
    time: float
    velocity: float


@dataclass(frozen=True, kw_only=True)
class ImperfectThrow:
    """What became of a throw; made by `throw`."""

    rig: Rig
    imperfections: Imperfections
    changes: tuple[Change, ...]
    """Releases and contacts, in turns."""
    peak_strain: float
    """Largest compression up to the first release [-]."""
    _start: float
    _time: Floats
    _projectile: Floats

    def plate(self, time: ArrayLike) -> Floats:
        """Height of the plate [m]."""
        moments = np.asarray(time, dtype=np.float64)
        return _plate(self.rig, self.imperfections, moments, self._start)

    def projectile(self, time: ArrayLike) -> Floats:
        """Height of the projectile's lower face above the plate's rest [m]."""
        return np.interp(np.asarray(time, dtype=np.float64), self._time, self._projectile)


def throw(
    rig: Rig,
    imperfections: Imperfections | None = None,
    *,
    until: float,
    start: float = 0.0,
    cells: int | None = None,
) -> ImperfectThrow:
    """
    Throw, from rest.

    Parameters
    ----------
    rig : Rig
        With a layer of one material, which may have a loss.
    imperfections : Imperfections, optional
        None by default.
    until : float
        Time of its end. [s]
    start : float
        From when on heights are asked for, at which a plate that rings does so. [s]
    cells : int, optional
        Of the layer.

    """
    imperfections = imperfections or Imperfections()
    layer = rig.layer
    start = min(start, 0.0)
    begin = start - (_LEAD_IN if imperfections.ringing else 0.0)
    for count in (cells,) if cells else _CELLS:
        step = _stable_step(rig, imperfections, count)
        if count * (until - begin) / step <= _MAX_UPDATES:
            break
    time = begin + step * np.arange(math.ceil((until - begin) / step) + 2, dtype=np.float64)
    every = max(1, math.floor(_RECORDED_EVERY / step))
    spacing = layer.thickness / count
    force = layer.youngs_modulus * layer.section
    path = np.empty((time.size - 1) // every + 1)
    changes = np.empty((_MAX_EVENTS, 3))
    found, peak_strain = _march(
        _plate(rig, imperfections, time, start),
        step,
        -spacing * _static_strain(rig, imperfections) * np.arange(count + 1.0),
        spacing,
        layer.density * layer.section * spacing,
        force,
        imperfections.stiffening,
        force * _relaxation(rig),
        rig.projectile.mass,
        rig.gravity,
        imperfections.sticking,
        every,
        path,
        changes,
    )
    return ImperfectThrow(
        rig=rig,
        imperfections=imperfections,
        changes=tuple(
            Change(bool(kind), begin + float(moment), float(velocity))
            for kind, moment, velocity in changes[:found]
        ),
        peak_strain=float(peak_strain),
        _start=start,
        _time=time[::every],
        _projectile=layer.thickness + path,
    )


class Deviations:
    """
    What imperfections change: what is to be added to a throw of a perfect rig, as it is followed.

    Parameters
    ----------
    rig : Rig
    imperfections : Imperfections

    Notes
    -----
    The difference of two throws on the same cells, so that the cells are not seen in it. It fades
    before the projectile lands, since what comes then is chaotic.

    """

    def __init__(self, rig: Rig, imperfections: Imperfections) -> None:
        start = -_RINGS_BEFORE if imperfections.ringing else 0.0
        pure, spoilt = (
            throw(rig, each, start=start, until=_LONGEST_THROW, cells=_TABLE_CELLS)
            for each in (Imperfections(), imperfections)
        )
        self.start = start
        """Time before the throw from which on there are any [s]."""
        landings = [
            change.time
            for each in (pure, spoilt)
            for change in each.changes
            if not change.is_release and change.velocity <= 0.0 < change.time
        ]
        end = min([*landings, _LONGEST_THROW])
        time = np.arange(start, end + _TABLE_STEP, _TABLE_STEP)
        left = np.clip((end - time) / (_FADING * end), 0.0, 1.0)
        begun = np.clip((time - start) / _LEAD_IN, 0.0, 1.0) if imperfections.ringing else 1.0
        self._plate: list[float] = (
            left * begun * (spoilt.plate(time) - pure.plate(time))
        ).tolist()
        self._projectile: list[float] = (
            left * begun * (spoilt.projectile(time) - pure.projectile(time))
        ).tolist()

    def at(self, since: float) -> tuple[float, float]:
        """Return how far plate and projectile are off [m], at a time since the throw began [s]."""
        place = (since - self.start) / _TABLE_STEP
        row = math.floor(place)
        if not 0 <= row < len(self._plate) - 1:
            return 0.0, 0.0
        part = place - row
        plate, projectile = self._plate, self._projectile
        return (
            plate[row] + part * (plate[row + 1] - plate[row]),
            projectile[row] + part * (projectile[row + 1] - projectile[row]),
        )


def _plate(rig: Rig, imperfections: Imperfections, time: Floats, start: float) -> Floats:
    """Heights of the plate: the engine's step, what it rings with before, and a second mode."""
    engine = rig.engine
    motion = Underdamped.of(engine)
    height = motion.position(time)
    if imperfections.ringing:
        rate = motion.exponent
        begun = np.clip((time - start) / _LEAD_IN + 1.0, 0.0, 1.0)
        decay = np.exp(rate.real * np.maximum(time - start, 0.0))
        wave = np.sin(rate.imag * (time - start) + imperfections.ringing_phase)
        smooth = begun**3 * (10.0 - 15.0 * begun + 6.0 * begun**2)
        height = height + imperfections.ringing * engine.amplitude * smooth * decay * wave
    if imperfections.second_mode:
        since = np.maximum(time, 0.0)
        omega = 2.0 * math.pi * imperfections.second_mode_frequency
        decay = np.exp(-imperfections.second_mode_damping_ratio * omega * since)
        wave = np.sin(omega * since)
        height = height + imperfections.second_mode * engine.amplitude * decay * wave
    return height


def _relaxation(rig: Rig) -> float:
    """Viscosity over stiffness [s]."""
    return rig.layer.loss_tangent / rig.engine.angular_frequency


def _static_strain(rig: Rig, imperfections: Imperfections) -> float:
    """Strain under the projectile's weight."""
    linear = rig.static_sag / rig.layer.thickness
    return 2.0 * linear / (1.0 + math.sqrt(1.0 + 4.0 * imperfections.stiffening * linear))


def _stable_step(rig: Rig, imperfections: Imperfections, cells: int) -> float:
    """Find the longest step that is stable up to a strain of 1/2 [s]."""
    crossing = rig.crossing_time / cells
    crossing /= math.sqrt(1.0 + abs(imperfections.stiffening))
    damping = _relaxation(rig) / crossing
    return _COURANT * crossing * (math.sqrt(1.0 + damping**2) - damping)


@nb.njit(cache=True, nogil=True, error_model='numpy')
def _march(
    plate: Floats, step: float, rise: Floats, spacing: float, mass: float, stiffness: float,
    stiffening: float, viscosity: float, thrown: float, gravity: float, sticking: float,
    every: int, path: Floats, changes: Floats,
) -> tuple[int, float]:
    """Go through all steps; return the number of changes, and the largest compression."""
    cells = rise.size - 1
    velocity = np.zeros(cells + 1)  # half a step before
    height, speed = rise[cells], 0.0  # of the projectile, above where the bare layer would end
    is_contact, count, peak = True, 0, 0.0
    pull_time, force_before = math.inf, thrown * gravity
    for index in range(plate.size - 1):
        now = index * step
        if index % every == 0:
            path[index // every] = height
        rise[0] = plate[index]
        velocity[0] = (plate[index + 1] - plate[index]) / step
        before = 0.0
        top_force = 0.0
        for node in range(cells):  # the force in the cell above each node
            strain = (rise[node] - rise[node + 1]) / spacing
            rate = (velocity[node] - velocity[node + 1]) / spacing
            force = stiffness * strain * (1.0 + stiffening * strain) + viscosity * rate
            if node > 0:
                velocity[node] += step * (before - force) / mass
            before = force
            top_force = force
            if count == 0 and strain > peak:
                peak = strain
        top_mass = 0.5 * mass + (thrown if is_contact else 0.0)
        acceleration = (top_force - (thrown * gravity if is_contact else 0.0)) / top_mass
        if is_contact:
            contact_force = thrown * (acceleration + gravity)
            if contact_force >= 0.0:
                pull_time = math.inf
            elif pull_time == math.inf:
                pull_time = now - step * contact_force / (contact_force - force_before)
            force_before = contact_force
            if pull_time + sticking <= now and count < changes.shape[0]:
                moment = pull_time + sticking
                changes[count, 0] = 1.0
                changes[count, 1] = moment
                changes[count, 2] = velocity[cells] + (moment - now + 0.5 * step) * acceleration
                count += 1
                is_contact = False
                speed = velocity[cells]
                acceleration = top_force / (0.5 * mass)
        velocity[cells] += step * acceleration
        for node in range(1, cells + 1):
            rise[node] += step * velocity[node]
        if is_contact:
            height, speed = rise[cells], velocity[cells]
            continue
        speed -= step * gravity
        height += step * speed
        if height <= rise[cells]:
            together = thrown + 0.5 * mass
            height = (thrown * height + 0.5 * mass * rise[cells]) / together
            if count < changes.shape[0]:
                changes[count, 0] = 0.0
                changes[count, 1] = now + step
                changes[count, 2] = speed
                count += 1
            speed = (thrown * speed + 0.5 * mass * velocity[cells]) / together
            rise[cells], velocity[cells] = height, speed
            is_contact = True
            pull_time, force_before = math.inf, 0.0
    path[-1] = height if (plate.size - 1) % every == 0 else path[-1]
    return count, peak


def warm_up() -> None:
    """Compile or load the kernel."""
    throw(Rig(), until=1e-3, cells=8)
