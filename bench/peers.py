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
"""
What one would write without this package: a delay line, finite differences, SciPy.

Each is kindly done: arrays are allocated once, the moment of release is interpolated, and its
condition is the force on the projectile, without the half cell of layer that moves with it.

Units: the layer's thickness, mass and crossing time, and the plate's amplitude. So waves have
speed 1, the projectile has mass mu, and the plate angular frequency w = 2 pi / kappa.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numba as nb
import numpy as np
from scipy.integrate import solve_ivp
from scipy.optimize import differential_evolution
from soft_throw_ros.core.plate import peak_velocity_ratio
from soft_throw_ros.core.rig import Rig
from soft_throw_ros.design.plate_motion import PlateLimits

_jit = nb.njit(cache=True, nogil=True, error_model='numpy')

LONGEST = 400.0
"""After this many crossings one gives up."""

LONGEST_MOTION = 25.0
"""Crossings for which a plate is accelerated: as long as the best one takes."""


class Release(NamedTuple):
    """Ejection phase t_e f and energy transfer alpha; NaN if there was none."""

    ejection_phase: float
    energy_transfer: float


class Case(NamedTuple):
    """A throw: mass ratio, speed ratio, damping ratio, and gravity in the units above."""

    mu: float
    kappa: float
    zeta: float = 0.0
    gravity: float = 0.0

    @classmethod
    def of(cls, rig: Rig) -> Case:
        """Take it from a rig."""
        gravity = rig.gravity * rig.crossing_time**2 / rig.engine.amplitude
        return cls(rig.mass_ratio, rig.speed_ratio, rig.engine.damping_ratio, gravity)

    @property
    def omega(self) -> float:
        """Angular frequency of the plate."""
        return 2.0 * math.pi / self.kappa

    def release(self, time: float, speed: float) -> Release:
        """Put a release into the usual numbers."""
        fastest = self.omega * peak_velocity_ratio(self.zeta)
        return Release(time / self.kappa, (speed / fastest) ** 2)


# Eqs. (2)-(3) by semi-implicit Euler


def rigid_numba(case: Case, *, cells: int) -> Release:
    """Throw a rigid projectile, in loops that numba compiles."""
    return case.release(*rigid_kernel(case.mu, case.omega, case.zeta, cells))


def rigid_numpy(case: Case, *, cells: int) -> Release:
    """Throw a rigid projectile, a row of cells at a time."""
    mu, omega, zeta, dt = case.mu, case.omega, case.zeta, 1.0 / cells
    u, v = np.zeros((2, cells + 1))
    strain = np.zeros(cells)
    mass = np.full(cells, dt)
    mass[-1] = mu + 0.5 * dt
    for i in range(1, int(LONGEST * cells)):
        before = strain[-1]
        v[1:-1] += dt * np.diff(strain) / mass[:-1]
        v[-1] -= dt * before / mass[-1]
        u[1:] += dt * v[1:]
        u[0] = _plate.py_func(omega, zeta, i * dt)
        np.subtract(u[1:], u[:-1], out=strain)
        strain *= cells
        if before < 0.0 <= strain[-1]:
            return case.release((i - 1 + before / (before - strain[-1])) * dt, v[-1])
    return Release(math.nan, math.nan)


@_jit
def rigid_kernel(mu, omega, zeta, cells) -> tuple[float, float]:
    """First release without gravity: time and speed."""
    u = np.zeros(cells + 1)
    v = np.zeros(cells + 1)
    dt = 1.0 / cells
    pull = 0.0
    for i in range(1, int(LONGEST * cells)):
        before, pull = pull, u[cells] - u[cells - 1]
        if before < 0.0 <= pull:
            part = before / (before - pull)
            return (i - 2 + part) * dt, v[cells]
        for j in range(1, cells):
            v[j] += cells * (u[j + 1] - 2.0 * u[j] + u[j - 1])
        v[cells] -= pull / (mu + 0.5 * dt)
        for j in range(1, cells + 1):
            u[j] += dt * v[j]
        u[0] = _plate(omega, zeta, i * dt)
    return math.nan, math.nan


@_jit
def driven_kernel(mu, gravity, travel, accelerations, interval, cells) -> float:
    """Speed at the first release from a plate of speed 1 at most, accelerated piece by piece."""
    u = np.zeros(cells + 1)
    v = np.zeros(cells + 1)
    dt = 1.0 / cells
    plate = lowest = highest = 0.0
    for i in range(int(LONGEST * cells)):
        pull = (u[cells] - u[cells - 1]) * cells
        if pull > mu * gravity:
            return v[cells]
        for j in range(1, cells):
            v[j] += cells * (u[j + 1] - 2.0 * u[j] + u[j - 1])
        v[cells] -= dt * pull / (mu + 0.5 * dt)
        for j in range(1, cells + 1):
            u[j] += dt * v[j]
        piece = int(i * dt / interval)
        if piece < accelerations.size:
            plate = min(max(plate + dt * accelerations[piece], -1.0), 1.0)
        u[0] += dt * plate
        lowest, highest = min(lowest, u[0]), max(highest, u[0])
        if highest - lowest > travel:
            return 0.0
    return 0.0


def searched_motion(rig: Rig, limits: PlateLimits, *, pieces: int, cells: int) -> float:
    """Search for the accelerations that throw best, by SciPy; alpha. The plate need not brake."""
    time, speed = rig.crossing_time, limits.speed
    gravity, travel = rig.gravity * time / speed, limits.travel / (speed * time)
    most, interval = limits.acceleration * time / speed, LONGEST_MOTION / pieces
    found = differential_evolution(
        lambda parts: (
            -driven_kernel(rig.mass_ratio, gravity, travel, most * parts, interval, cells)
        ),
        [(-1.0, 1.0)] * pieces,
        rng=1,
    )
    return float(found.fun**2)


@_jit
def march_kernel(mu, omega, zeta, gravity, frame_steps, strain) -> float:
    """Go on through flights and landings, fill `strain` every so many steps, return t_e."""
    cells = strain.shape[1]
    u = np.zeros(cells + 1)
    v = np.zeros(cells + 1)
    dt = 1.0 / cells
    half = 0.5 * dt
    height = 0.0
    speed = 0.0
    contact = True
    first = math.nan
    pull = -mu * gravity
    for i in range(1, strain.shape[0] * frame_steps + 1):
        for j in range(1, cells):
            v[j] += cells * (u[j + 1] - 2.0 * u[j] + u[j - 1])
        push = (u[cells - 1] - u[cells]) + (0.0 if contact else mu * gravity * dt)
        v[cells] += push / (half + (mu if contact else 0.0))
        for j in range(1, cells + 1):
            u[j] += dt * v[j]
        u[0] = _plate(omega, zeta, i * dt)
        if contact:
            height = u[cells]
            speed = v[cells]
            before, pull = pull, (u[cells] - u[cells - 1]) * cells - mu * gravity
            contact = pull <= 0.0
            if not contact and math.isnan(first):
                first = (i - pull / (pull - before)) * dt
        else:
            speed -= gravity * dt
            height += dt * speed
            if height <= u[cells]:
                contact = True
                v[cells] = (mu * speed + half * v[cells]) / (mu + half)
        if i % frame_steps == 0:
            for j in range(cells):
                strain[i // frame_steps - 1, j] = (u[j + 1] - u[j]) * cells
    return first


# Travelling waves in a delay line


@_jit
def delay_line_kernel(mu, omega, zeta, gravity, steps, crossings) -> float:
    """
    Go on through flights and landings by so many steps per crossing, return t_e.

    The wave v- at the top, two crossings of it, is all that is remembered. v+ is linear over a
    step, the projectile's equation is solved exactly, releases are interpolated, and landings are
    taken at the end of a step. All counts from the static equilibrium.
    """
    dt = 1.0 / steps
    decay = math.exp(-dt / mu)
    first, second = 1.0 - mu / dt * (1.0 - decay), mu / dt * (1.0 - decay) - decay
    line = np.zeros(2 * steps)
    root = math.sqrt(1.0 - zeta * zeta)
    angle = root * omega * dt  # the plate's velocity turns by this in a step, and decays
    turn = math.exp(-zeta * omega * dt) * complex(math.cos(angle), math.sin(angle))
    plate = complex(omega / root, 0.0)
    weight = mu * gravity
    rising = 0.0
    top = 0.0
    height = 0.0
    speed = 0.0
    contact = True
    push = 0.0
    released = math.nan
    for i in range(1, int(crossings * steps) + 1):
        place = i % (2 * steps)
        before = rising
        rising = -line[place]
        if i > steps:
            plate *= turn
            rising += plate.imag
        if contact:
            speed = decay * speed + 2.0 * (first * rising + second * before)
            height += dt * speed
            top = height
            line[place] = speed - rising
            last, push = push, 2.0 * rising - speed + weight
            if push < 0.0 and i > steps:
                contact = False
                if math.isnan(released):
                    released = (i - push / (push - last)) * dt
        else:
            speed -= gravity * dt
            height += dt * speed
            line[place] = rising + weight
            top += dt * (rising + line[place])
            if height <= top and speed < rising + line[place]:
                contact = True
                push = weight
    return released


@_jit
def _plate(omega, zeta, time):
    """Height of the plate, (D2)."""
    root = math.sqrt(1.0 - zeta * zeta)
    angle = root * omega * time
    decay = math.exp(-zeta * omega * time)
    return 1.0 - decay * (math.cos(angle) + zeta / root * math.sin(angle))


# the method of lines with SciPy


def method_of_lines(
    case: Case, *, cells: int, method: str = 'DOP853', tolerance: float = 1e-8
) -> Release:
    """Throw a rigid projectile by `scipy.integrate.solve_ivp`."""
    mu, omega, zeta = case.mu, case.omega, case.zeta
    mass = np.full(cells, 1.0 / cells)
    mass[-1] = mu + 0.5 / cells
    u = np.zeros(cells + 1)
    rates = np.zeros(2 * cells)
    strain = np.zeros(cells + 1)  # and nothing pulls at the top

    def motion(t: float, state: np.ndarray) -> np.ndarray:
        u[0] = _plate.py_func(omega, zeta, t)
        u[1:] = state[:cells]
        strain[:-1] = cells * np.diff(u)
        rates[:cells] = state[cells:]
        rates[cells:] = np.diff(strain) / mass
        return rates.copy()

    def pull(t: float, state: np.ndarray) -> float:
        return float(state[cells - 1] - state[cells - 2]) if t > 1.0 else -1.0

    pull.terminal, pull.direction = True, 1.0  # type: ignore[attr-defined]
    done = solve_ivp(
        motion,
        (0.0, LONGEST),
        np.zeros(2 * cells),
        method,
        events=pull,
        rtol=tolerance,
        atol=1e-3 * tolerance,
    )
    if not done.t_events[0].size:
        return Release(math.nan, math.nan)
    return case.release(done.t_events[0][0], done.y_events[0][0][-1])
