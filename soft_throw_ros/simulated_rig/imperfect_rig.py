# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
r"""
Throws of rigs with faults that no model of the core has, such as a plate that rings.

Such throws test the identification. The kernel shares no code with the steppers of the core, so
that an error in a stepper cannot be in the data and in the fit at the same time.

Notes
-----
In the layer, with heights y of the undeformed material and the displacement u,

.. math::

    \rho u_{tt} = -\sigma_y, \qquad
    \sigma = E (\epsilon + k \epsilon^2 + k_3 \epsilon^3) + \eta \epsilon_t, \qquad
    \epsilon = -u_y,

where the strain :math:`\epsilon` is positive in compression and may be large: the stress is force
over the undeformed section. The scheme is leapfrog on even cells, of second order; the viscous
stress lags by half a step. The weight of the layer is neglected, as in the models of the core.

In contact, the top node of the layer and the projectile are one node. The contact opens when its
force becomes a pull, or after the sticking time; when the gap closes, both share their momentum.

"""

from __future__ import annotations

from dataclasses import dataclass, replace
import math
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray
from soft_throw_ros.core.kernels import kernel
from soft_throw_ros.core.plate import Underdamped
from soft_throw_ros.core.rig import Rig

Floats = NDArray[np.float64]

# Numbers of cells; the finest grid within the limit of updates is used. [-]
_CELLS = (512, 256, 192, 128, 96, 64)

# Largest number of updates of a cell in one throw; they take about a second. [-]
_MAX_UPDATES = 2e8

# Time step over the longest stable one; the margin is for rounding. [-]
_COURANT = 0.98

# Spacing of the recorded heights, well below the sampling interval of any sensor. [s]
_RECORDED_EVERY = 5e-6

# Duration of the smooth growth of the plate's ringing to its amplitude. [s]
_LEAD_IN = 30e-3

# Largest number of recorded releases and contacts in a throw. [-]
_MAX_EVENTS = 64

# Newton steps to the strain under the projectile's weight, from the root of a quadratic law. [-]
_NEWTON_STEPS = 3

# Spacing of tabulated deviations, which are interpolated linearly. [s]
_TABLE_STEP = 2e-5

# Number of cells of both throws of a table, which then take about 0.1 s. [-]
_TABLE_CELLS = 128

# Duration of tabulated ringing before the throw starts. [s]
_RINGS_BEFORE = 0.1

# Longest time after the start with tabulated deviations. [s]
_LONGEST_THROW = 0.6

# Duration of the fading of deviations before the first landing, over the landing time. [-]
_FADING = 0.03


@dataclass(frozen=True, kw_only=True)
class Imperfections:
    """
    Faults of the plate and the layer that no model of the core has.

    Amplitudes of the plate are relative to that of the engine.
    """

    stiffening: float = 0.0  # k of the quadratic stress; negative softens in compression [-]
    cubic_stiffening: float = 0.0  # k_3 of the cubic stress, in compression and tension [-]
    sticking: float = 0.0  # time of adhesion after the contact force becomes a pull [s]
    ringing: float = 0.0  # amplitude of the plate's vibration before the throw [-]
    ringing_phase: float = 0.0  # at the start of the record [rad]
    ringing_damping_ratio: float | None = None  # None for that of the engine [-]
    second_mode: float = 0.0  # amplitude of a second mode, which the throw excites [-]
    second_mode_frequency: float = 310.0  # [Hz]
    second_mode_damping_ratio: float = 0.02  # [-]

    @property
    def are_present(self) -> bool:
        """Whether the rig has any imperfection."""
        laws = self.stiffening, self.cubic_stiffening
        return any((*laws, self.sticking, self.ringing, self.second_mode))


class ContactChange(NamedTuple):
    """A release or a contact, its time [s] and the velocity of the projectile [m/s]."""

    is_release: bool
    time: float
    velocity: float


@dataclass(frozen=True, kw_only=True)
class ImperfectThrow:
    """Events and paths of a simulated throw, as returned by `throw`."""

    rig: Rig
    imperfections: Imperfections
    changes: tuple[ContactChange, ...]
    """Releases and contacts, alternating."""
    peak_strain: float
    """Largest compression up to the first release [-]."""
    _start: float
    _time: Floats
    _projectile: Floats

    def plate(self, time: ArrayLike) -> Floats:
        """Height of the plate [m]."""
        return _plate(
            self.rig, self.imperfections, np.asarray(time, dtype=np.float64), self._start
        )

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
    Simulate a throw from rest.

    Parameters
    ----------
    rig : Rig
        Rig with a layer of one material, with or without loss.
    imperfections : Imperfections, optional
        Faults of the rig; no faults by default.
    until : float
        End of the simulation, after the start of the throw. [s]
    start : float
        Time of the first height that is needed; a ringing plate has its full amplitude then. [s]
    cells : int, optional
        Number of cells of the layer; by default the most within a limit of updates. [-]

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
    change_count, peak_strain = _march(
        _plate(rig, imperfections, time, start),
        step,
        -spacing * _static_strain(rig, imperfections) * np.arange(count + 1.0),
        spacing,
        layer.density * layer.section * spacing,
        force,
        imperfections.stiffening,
        imperfections.cubic_stiffening,
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
            ContactChange(bool(kind), begin + float(moment), float(velocity))
            for kind, moment, velocity in changes[:change_count]
        ),
        peak_strain=float(peak_strain),
        _start=start,
        _time=time[::every],
        _projectile=layer.thickness + path,
    )


class Deviations:
    """
    Tabulated differences between the paths of an imperfect rig and a perfect one.

    Parameters
    ----------
    rig : Rig
        Rig without its faults.
    imperfections : Imperfections
        Faults of the rig.

    Notes
    -----
    Both throws are computed on the same cells, so that errors of discretization cancel in the
    difference. It fades before the projectile lands, because the bounces that follow are chaotic.

    """

    def __init__(self, rig: Rig, imperfections: Imperfections) -> None:
        start = -_RINGS_BEFORE if imperfections.ringing else 0.0
        perfect, imperfect = (
            throw(rig, faults, start=start, until=_LONGEST_THROW, cells=_TABLE_CELLS)
            for faults in (Imperfections(), imperfections)
        )
        self.start = start
        """Time of the first deviation, negative if it is before the throw [s]."""
        landings = [
            change.time
            for thrown in (perfect, imperfect)
            for change in thrown.changes
            if not change.is_release and change.velocity <= 0.0 < change.time
        ]
        end = min([*landings, _LONGEST_THROW])
        time = np.arange(start, end + _TABLE_STEP, _TABLE_STEP)
        fade_out = np.clip((end - time) / (_FADING * end), 0.0, 1.0)
        fade_in = np.clip((time - start) / _LEAD_IN, 0.0, 1.0) if imperfections.ringing else 1.0
        plate = imperfect.plate(time) - perfect.plate(time)
        projectile = imperfect.projectile(time) - perfect.projectile(time)
        rows = np.stack([plate, projectile], axis=1) * (fade_in * fade_out)[:, None]
        self._rows: list[list[float]] = rows.tolist()

    def at(self, since: float) -> tuple[float, float]:
        """Return the deviations of plate and projectile [m], at a time since the start [s]."""
        position = (since - self.start) / _TABLE_STEP
        row = math.floor(position)
        if not 0 <= row < len(self._rows) - 1:
            return 0.0, 0.0
        weight = position - row
        (plate, projectile), (next_plate, next_projectile) = self._rows[row:row + 2]
        return (
            plate + weight * (next_plate - plate),
            projectile + weight * (next_projectile - projectile),
        )


def _plate(rig: Rig, imperfections: Imperfections, time: Floats, start: float) -> Floats:
    """Return heights of the plate: the step of the engine, ringing, and a second mode."""
    engine = rig.engine
    motion = Underdamped.of(engine)
    height = motion.position(time)
    if imperfections.ringing:
        rate = motion.exponent
        if imperfections.ringing_damping_ratio is not None:
            own = replace(engine, damping_ratio=imperfections.ringing_damping_ratio)
            rate = Underdamped.of(own).exponent
        growth = np.clip((time - start) / _LEAD_IN + 1.0, 0.0, 1.0)
        decay = np.exp(rate.real * np.maximum(time - start, 0.0))
        wave = np.sin(rate.imag * (time - start) + imperfections.ringing_phase)
        envelope = decay * growth**3 * (10.0 - 15.0 * growth + 6.0 * growth**2)
        height = height + imperfections.ringing * engine.amplitude * envelope * wave
    if imperfections.second_mode:
        since = np.maximum(time, 0.0)
        omega = 2.0 * math.pi * imperfections.second_mode_frequency
        decay = np.exp(-imperfections.second_mode_damping_ratio * omega * since)
        wave = np.sin(omega * since)
        height = height + imperfections.second_mode * engine.amplitude * decay * wave
    return height


def _relaxation(rig: Rig) -> float:
    """Return the viscosity over the modulus [s]."""
    return rig.layer.loss_tangent / rig.engine.angular_frequency


def _static_strain(rig: Rig, imperfections: Imperfections) -> float:
    """Return the compressive strain under the weight of the projectile."""
    weight = rig.projectile.mass * rig.gravity
    linear = weight / (rig.layer.stiffness * rig.layer.thickness)
    strain = 2.0 * linear / (1.0 + math.sqrt(1.0 + 4.0 * imperfections.stiffening * linear))
    for _ in range(_NEWTON_STEPS):
        quadratic = imperfections.stiffening * strain
        cubic = imperfections.cubic_stiffening * strain**2
        excess = strain * (1.0 + quadratic + cubic) - linear
        strain -= excess / (1.0 + 2.0 * quadratic + 3.0 * cubic)
    return strain


def _stable_step(rig: Rig, imperfections: Imperfections, cells: int) -> float:
    """Return the longest step that is stable up to a strain of 1/2 [s]."""
    crossing = rig.crossing_time / cells
    cubic = 0.75 * abs(imperfections.cubic_stiffening)
    crossing /= math.sqrt(1.0 + abs(imperfections.stiffening) + cubic)
    damping = _relaxation(rig) / crossing
    return _COURANT * crossing * (math.sqrt(1.0 + damping**2) - damping)


@kernel
def _march(
    plate: Floats, step: float, displacement: Floats, spacing: float, mass: float,
    stiffness: float, stiffening: float, cubic: float, viscosity: float,
    projectile_mass: float, gravity: float, sticking: float, every: int, path: Floats,
    changes: Floats,
) -> tuple[int, float]:
    """March through all steps; return the number of contact changes and the peak strain."""
    cells = displacement.size - 1
    velocity = np.zeros(cells + 1)  # half a step behind the displacement
    height, speed = displacement[cells], 0.0  # of the projectile, from the unloaded top
    is_contact, count, peak = True, 0, 0.0
    pull_time, force_before = math.inf, projectile_mass * gravity
    for index in range(plate.size - 1):
        now = index * step
        if index % every == 0:
            path[index // every] = height
        displacement[0] = plate[index]
        velocity[0] = (plate[index + 1] - plate[index]) / step
        force_below = 0.0
        top_force = 0.0
        for node in range(cells):  # the force in the cell above each node
            strain = (displacement[node] - displacement[node + 1]) / spacing
            rate = (velocity[node] - velocity[node + 1]) / spacing
            law = strain * (1.0 + strain * (stiffening + cubic * strain))
            force = stiffness * law + viscosity * rate
            if node > 0:
                velocity[node] += step * (force_below - force) / mass
            force_below = force
            top_force = force
            if count == 0 and strain > peak:
                peak = strain
        top_mass = 0.5 * mass + (projectile_mass if is_contact else 0.0)
        acceleration = (top_force - (projectile_mass * gravity if is_contact else 0.0)) / top_mass
        if is_contact:
            contact_force = projectile_mass * (acceleration + gravity)
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
            displacement[node] += step * velocity[node]
        if is_contact:
            height, speed = displacement[cells], velocity[cells]
            continue
        speed -= step * gravity
        height += step * speed
        if height <= displacement[cells]:
            total_mass = projectile_mass + 0.5 * mass
            height = (projectile_mass * height + 0.5 * mass * displacement[cells]) / total_mass
            if count < changes.shape[0]:
                changes[count, 0] = 0.0
                changes[count, 1] = now + step
                changes[count, 2] = speed
                count += 1
            speed = (projectile_mass * speed + 0.5 * mass * velocity[cells]) / total_mass
            displacement[cells], velocity[cells] = height, speed
            is_contact = True
            pull_time, force_before = math.inf, 0.0
    path[-1] = height if (plate.size - 1) % every == 0 else path[-1]
    return count, peak


def warm_up() -> None:
    """Compile the kernel, or load it from the cache on disk."""
    throw(Rig(), until=1e-3, cells=8)
