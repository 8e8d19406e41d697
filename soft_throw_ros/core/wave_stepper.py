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
Travelling waves by a delay line: contact, release, flight, re-contact and landing.

Notes
-----
With :math:`p = v_+` and :math:`m = v_-` of Sec. IV of [1]_, at the top of the layer

.. math::

    p(t) &= V_p(t - t_s) - m(t - 2 t_s) \\
    \tau \dot V + V &= 2 p, \quad m = V - p \qquad \text{in contact} \\
    m &= p + g \tau \qquad\qquad\qquad\quad \text{in flight}

where everything counts from the static equilibrium, and the layer pushes the projectile with
:math:`F = (m_r / \tau) (2 p - V) + m_r g`. The projectile leaves when F falls below zero, and is
in contact again when the gap closes, its speed unchanged. Flight, landing and gravity are not in
[1]_'s analytical model.

The step h divides :math:`t_s`, so waves travel from grid point to grid point without any error,
and the kinks that the start of an underdamped plate sends through the layer, at odd multiples of
:math:`t_s`, fall on grid points. What has to be computed is the answer of the mass: p is known
:math:`t_s` ahead, is interpolated by the cubic through four neighbouring points (on one side of a
kink), and the equation of V is solved for it exactly, however small :math:`\tau` is. So the
first release is of fourth order in h. Releases and landings are roots within a step.

A landing makes m jump, at some place between two grid points. It is not followed as a jump: the
samples on both sides are changed so that the integrals of m and of its square are right, of what
happens and of its energy. So later events are of second order in h.

A dip of the contact force below zero, or of the gap, that begins and ends within one step is not
seen.

References
----------
.. [1] "Use of compliant actuators for throwing rigid projectiles", Phys. Rev. E (2022).

"""

from __future__ import annotations

from functools import partial
import math
from typing import Literal

import numba as nb
import numpy as np
from numpy.typing import ArrayLike, NDArray
from soft_throw_ros.core.batch import broadcast_ratios, in_threads
from soft_throw_ros.core.kernels import compiled, kernel, part
from soft_throw_ros.core.plate import PlateMotion
from soft_throw_ros.core.plate_kernels import (
    BLOCK,
    DAMPED,
    motion_at,
    piece_at,
    PLATE,
    start_block,
    velocity_of_piece,
    write_underdamped,
)
from soft_throw_ros.core.rig import Rig
from soft_throw_ros.core.stepper import (
    BACKWARDS,
    BEYOND_HORIZON,
    FirstThrows,
    LANDING,
    load_kernels,
    Loads,
    note_event,
    PLATE_FORCE,
    PLATE_POSITION,
    PLATE_VELOCITY,
    PROJECTILE_FORCE,
    PROJECTILE_POSITION,
    PROJECTILE_VELOCITY,
    RECONTACT,
    RELEASE,
    require_count,
    Stepper,
    TIME,
    TOO_FAR,
    TOO_MANY_EVENTS,
)

Floats = NDArray[np.float64]

MAX_STEPS = 8192
"""Most steps per crossing of the wave."""

MAX_STEP_RATE = 4e7
"""Most steps per second of rig time, of which a processor takes 4e8 in a second. [1/s]"""

_STEPS = 512  # per crossing, which later events need: see the tests of re-contacts
_FEWEST_STEPS = 64
_STEPS_PER_PERIOD = 160.0
_STEPS_PER_RELAXATION = 8.0
_MOST_FOR_RELAXATION = 2048
_STEP_COST = 3e-9  # of a processor [s]

_PAD = 8  # steps that are kept beyond what is read, for the cubics
_ROOM = 1024  # steps by which the memory of waves is longer than it must be, to be moved seldom
_NOISE = 1e-12  # of the plate's speed: a force below it is rounding, and no pull
_JUMP = 1e-2  # of the plate's speed: a third difference that no smooth wave has
_EVENTS_PER_STEP = 8  # a mass that chatters faster stays as it is until the next step

_MAX_PERIODS = 8.0  # of plate and of projectile on layer, for which a first release is waited
_MAX_CROSSINGS = 4096.0
_THROWS_PER_THREAD = 64

_RECIPROCAL = 1.0 / np.maximum(np.arange(25.0), 1.0)

# Three such records make a stepper: the first stands at a grid point, the second between; the
# third is what both are reset to. Lengths count from the static equilibrium, offsets are in steps.
_CORE = np.dtype(
    [
        # what stays
        ('step', 'f8'),  # h [s]
        ('steps', 'i8'),  # N = t_s / h
        ('rate', 'f8'),  # h / tau
        ('decay', 'f8'),  # e^{-h / tau}
        ('cubic', 'f8', (4,)),  # V(t + h) = decay V(t) + cubic . p, of four points,
        ('line', 'f8', (2,)),  # or of two
        ('largest_ripple', 'f8'),  # third difference of p from which on it counts as a jump
        ('relaxation', 'f8'),  # tau [s]
        ('gravity', 'f8'),  # g [m/s2]
        ('gravity_offset', 'f8'),  # g tau [m/s]
        ('release_threshold', 'f8'),  # 2 p - V at which the projectile leaves: -g tau, less noise
        ('thickness', 'f8'),
        ('impedance', 'f8'),
        ('rest_height', 'f8'),  # of the projectile's lower face [m]
        # how the plate moves, and where it has got to
        *PLATE,
        ('block', 'i8'),
        # where the waves have got to
        ('time', 'f8'),
        ('cell', 'i8'),  # grid point
        ('offset', 'f8'),  # beyond it
        ('base', 'i8'),  # grid point at index 0 of the waves
        ('filled', 'i8'),  # up to where p is known at the plate
        ('kink', 'i8'),  # next grid point at which p has a kink at the top
        # the mass and the top of the layer
        ('contact', '?'),
        ('landed', '?'),
        ('velocity', 'f8'),  # V in contact
        ('sum', 'f8'),  # of p at the top by the trapezoidal rule, over h
        ('top', 'f8'),  # height of the top less 2 P - tau V, in flight less 2 P + g tau t
        ('launch_cell', 'i8'),
        ('launch_offset', 'f8'),
        ('launch_height', 'f8'),
        ('launch_velocity', 'f8'),
        ('events', 'i8'),
        # loads up to the first release
        ('compared', 'i8'),  # grid point from which on waves p are still to be compared
        ('peak_push', 'f8'),  # of the scaled contact force 2 p - V
        ('peak_stress', 'f8'),  # of p - m + g tau at the plate
        ('peak_strain', 'f8'),  # of the same anywhere in the layer
        ('first_work', 'f8'),
        ('work', 'f8'),  # sum of power over the impedance and h
        ('power', 'f8'),  # last addend
        # at `time`
        ('plus', 'f8', (2,)),  # p at plate and top
        ('minus', 'f8', (2,)),  # m at plate and top
        ('surface', 'f8'),  # height of the top of the layer
        ('state', 'f8', (7,)),
    ],
    align=True,
)
_RECORDS, _ROWS = nb.from_dtype(_CORE)[::1], nb.float64[:, ::1]


def steps_per_crossing(rig: Rig) -> int:
    r"""
    Choose how many steps resolve one crossing of the wave, or refuse what real time cannot do.

    Returns
    -------
    int
        512, or more where the relaxation time or the plate's period is short, or less where steps
        would be more than `MAX_STEP_RATE` in a second. Errors in :math:`t f` and
        :math:`V / (A \omega)`: 1e-6 at the first release, 1e-4 up to the fifth event, 1e-3 later.

    Raises
    ------
    ValueError
        If the layer is a stack or has loss, or if `MAX_STEPS` or `MAX_STEP_RATE` are too few, with
        what would do.

    Examples
    --------
    >>> steps_per_crossing(Rig())
    512

    """
    rig.check_for_waves()
    layer, crossing = rig.layer, rig.crossing_time
    shortest = _FEWEST_STEPS / MAX_STEP_RATE
    if crossing < shortest:
        raise ValueError(
            f'layer.thickness {layer.thickness:g} m at layer.wave_speed {layer.wave_speed:g} m/s '
            f'needs {_FEWEST_STEPS / crossing:.3g} steps per second, the limit is '
            f'{MAX_STEP_RATE:g}; feasible: layer.thickness of '
            f'{1.001 * shortest * layer.wave_speed:.4g} m or more, or layer.wave_speed of '
            f'{0.999 * layer.thickness / shortest:.4g} m/s or less'
        )
    limit = math.floor(min(MAX_STEPS, MAX_STEP_RATE * crossing))
    for_plate = math.ceil(_STEPS_PER_PERIOD * crossing * rig.engine.frequency)
    if for_plate > limit:
        most = rig.engine.frequency * limit / for_plate
        raise ValueError(
            f'engine.frequency {rig.engine.frequency:g} Hz with a crossing time of '
            f'{crossing:.4g} s needs {for_plate} steps per crossing of the wave, the limit is '
            f'{limit}; feasible: engine.frequency of {0.999 * most:.4g} Hz or less'
        )
    for_mass = math.ceil(min(_STEPS_PER_RELAXATION / rig.mass_ratio, _MOST_FOR_RELAXATION))
    return min(max(_STEPS, for_mass, for_plate), limit)


@part
def _moments(x):
    """Compute e^{-x} and the integrals of e^{-x (1 - u)} u^n over [0, 1] for n = 0 ... 3."""
    if x < 1.0:
        series = 1.0
        for n in range(19, 4, -1):
            series = 1.0 - x * _RECIPROCAL[n] * series
        third = 0.25 * series
        second = (1.0 - x * third) * _RECIPROCAL[3]
        first = (1.0 - x * second) * 0.5
        zeroth = 1.0 - x * first
        return 1.0 - x * zeroth, zeroth, first, second, third
    decay = math.exp(-x)
    zeroth = (1.0 - decay) / x
    first = (1.0 - zeroth) / x
    second = (1.0 - 2.0 * first) / x
    return decay, zeroth, first, second, (1.0 - 3.0 * second) / x


@kernel
def _prepare(core, N, crossing, relaxation, gravity, impedance, speed):
    """Complete a record at rest, in which the plate's motion is, from what decides a throw."""
    s = core[2]
    s.step, s.steps, s.rate = crossing / N, N, crossing / N / relaxation
    decay, m0, m1, m2, m3 = _moments(s.rate)
    s.decay = decay
    # The cubic through p at -1, 0, 1 and 2, integrated against e^{-x (1 - u)}
    x = 2.0 * s.rate
    cubic, line = s.cubic, s.line
    cubic[0] = x * (-m1 / 3.0 + m2 / 2.0 - m3 / 6.0)
    cubic[1] = x * (m0 - m1 / 2.0 - m2 + m3 / 2.0)
    cubic[2] = x * (m1 + m2 / 2.0 - m3 / 2.0)
    cubic[3] = x * (-m1 / 6.0 + m3 / 6.0)
    line[0], line[1] = x * (m0 - m1), x * m1
    s.largest_ripple = _JUMP * speed
    s.relaxation, s.gravity, s.impedance = relaxation, gravity, impedance
    s.gravity_offset = gravity * relaxation
    s.release_threshold = -s.gravity_offset - _NOISE * speed
    s.base = -N - _PAD
    s.block = -1
    s.contact = True
    s.kink = N if s.plate_kind == DAMPED else 1 << 62
    s.peak_stress = s.peak_strain = s.gravity_offset  # at rest the weight is all there is


@kernel
def _prepare_underdamped(core, path, N, mu, kappa, zeta, gravity):
    """Make a record at rest in units of 1 / f, A omega and the layer's impedance."""
    write_underdamped(core[2], path, 1.0, 2.0 * math.pi, zeta, 1.0 / (kappa * N))
    _prepare(core, N, 1.0 / kappa, mu / kappa, 2.0 * math.pi * gravity, 1.0, 1.0)


@part
def _mass_velocity(s, d, V, a, b, c, e):
    """Solve tau V' + V = 2 p over d steps during which p = a + b u + c u^2 + e u^3."""
    decay, zeroth, first, second, third = _moments(s.rate * d)
    drive = a * zeroth + d * (b * first + d * (c * second + d * e * third))
    return decay * V + 2.0 * s.rate * d * drive


@part
def _expand(s, waves):
    """Expand p at the top after `s.cell`, through four points on one side of a kink."""
    aside = 1 if s.cell == s.kink else (-1 if s.cell + 1 == s.kink else 0)
    i = s.cell - s.base - s.steps + aside
    behind, here, ahead, beyond = waves[0, i - 1], waves[0, i], waves[0, i + 1], waves[0, i + 2]
    e = beyond - behind + 3.0 * (here - ahead)
    if abs(e) > s.largest_ripple:  # beside a jump p is a line
        i -= aside
        return waves[0, i], waves[0, i + 1] - waves[0, i], 0.0, 0.0
    e *= _RECIPROCAL[6]
    c = 0.5 * (behind + ahead) - here
    b = ahead - here - c - e
    if aside == 0:
        return here, b, c, e
    d = -float(aside)
    return here + d * (b + d * (c + d * e)), b + d * (2.0 * c + 3.0 * d * e), c + 3.0 * d * e, e


@part
def _free_flight(s, offset):
    """Compute time since the launch, height and velocity of the projectile."""
    time = (s.cell - s.launch_cell + (offset - s.launch_offset)) * s.step
    height = s.launch_height + time * (s.launch_velocity - 0.5 * s.gravity * time)
    return time, height, s.launch_velocity - s.gravity * time


@part
def _excess(s, offset, d, V, P, here, slope, a, b, c, e):
    """Compute d steps after an offset what changes sign at an event: scaled force, or gap."""
    if s.contact:
        p = a + d * (b + d * (c + d * e))
        return 2.0 * p - _mass_velocity(s, d, V, a, b, c, e) - s.release_threshold
    time, height, _ = _free_flight(s, offset + d)
    area = s.step * d * (here + 0.5 * slope * d)
    return height - s.top - 2.0 * (P + area) - s.gravity_offset * time


@part
def _is_steady(s, beyond, end, V):
    """Tell whether what is negative at the end of a step is no ripple of a jump, or rounding."""
    if s.contact:
        return 2.0 * beyond - V < s.release_threshold
    speed = s.launch_velocity - s.gravity * _free_flight(s, 1.0)[0]
    return speed < 2.0 * end + s.gravity_offset


@part
def _cross_step(s, waves, events, target):
    """
    Go through the step after `s.cell` event by event, up to an offset of `target` within it.

    Below 1 that leaves `s` there, with its state written; at 1 the step is done.
    """
    i = s.cell - s.base - s.steps
    here, end, beyond = waves[0, i], waves[0, i + 1], waves[0, i + 2]
    slope = end - here  # heights take p as linear
    a, b, c, e = _expand(s, waves)
    V, P, offset = s.velocity, s.step * s.sum, 0.0
    answer, gain = 0.0, 0.0  # integrals of m and of p^2 - m^2
    for chance in range(_EVENTS_PER_STEP + 1):
        d = 1.0 - offset
        happens = chance < _EVENTS_PER_STEP
        happens = happens and _excess(s, offset, d, V, P, here, slope, a, b, c, e) < 0.0
        if happens:
            last = _mass_velocity(s, d, V, a, b, c, e) if s.contact else 0.0
            happens = s.events == 0 or _is_steady(s, beyond, end, last)
        if happens:
            low, high = 0.0, d
            for _ in range(54):  # bisect
                d = 0.5 * (low + high)
                if _excess(s, offset, d, V, P, here, slope, a, b, c, e) < 0.0:
                    high = d
                else:
                    low = d
            d = high
        if not happens or offset + d > target:
            happens, d = False, target - offset
        p, before = here, V
        if s.contact:
            V = _mass_velocity(s, d, V, a, b, c, e)
        P += s.step * d * (here + 0.5 * slope * d)
        offset += d
        here += slope * d
        a, b, c = (
            a + d * (b + d * (c + d * e)),
            b + d * (2.0 * c + 3.0 * d * e),
            c + 3.0 * d * e,
        )
        if s.contact:
            answer += 0.5 * d * (before - p + V - here)
            gain += 0.5 * d * (before * (2.0 * p - before) + V * (2.0 * here - V))
        else:
            answer += d * (0.5 * (p + here) + s.gravity_offset)
            gain -= d * s.gravity_offset * (p + here + s.gravity_offset)
        if not happens:
            break
        time = (s.cell + offset) * s.step
        if s.contact:
            height = s.top + 2.0 * P - s.relaxation * V
            if s.events == 0:
                s.first_work = s.work + 0.5 * s.power * (2.0 * offset - 1.0)
            note_event(s, events, RELEASE, time, height, V)
            s.launch_cell, s.launch_offset = s.cell, offset
            s.launch_height, s.launch_velocity = height, V
            s.top = height - 2.0 * P
        else:
            _, height, V = _free_flight(s, offset)
            s.landed = s.landed or (V <= 0.0 and s.gravity > 0.0)
            note_event(s, events, LANDING if s.landed else RECONTACT, time, height, V)
            s.top = height - 2.0 * P + s.relaxation * V
        s.contact = not s.contact
    if target == 1.0:
        _end_step(s, waves, V, P, answer, gain)
    else:
        _write_top(s, offset, a, V, P)


@part
def _end_step(s, waves, V, P, answer, gain):
    """Write the sample of m at the next grid point, and account for the step."""
    s.cell += 1
    s.sum = P / s.step
    s.velocity = V if s.contact else 0.0
    j = s.cell - s.base
    p = waves[0, j - s.steps]
    m = V - p if s.contact else p + s.gravity_offset
    # Events make m and its slope jump. The samples on both sides of the step are changed so that
    # the integrals of m and of its square over all steps are right; otherwise they are.
    before = waves[1, j - 1]
    total = answer - 0.5 * (before + m)
    squares = 0.5 * (waves[0, j - s.steps - 1] ** 2 + p * p - before * before - m * m) - gain
    half = 0.5 * (m - before - total)
    rest = half * half - 0.5 * (total * (2.0 * before + total) - squares)
    part = -half + math.copysign(math.sqrt(max(rest, 0.0)), half)
    waves[1, j - 1] = before + total - part
    waves[1, j] = m + part
    p, m = waves[0, j], waves[1, j - s.steps]
    s.power = (p - m + s.gravity_offset) * (p + m)
    s.work += s.power


@part
def _write_top(s, offset, a, V, P):
    """Write what projectile and top do within a step, where p is a."""
    s.plus[1] = a
    if s.contact:
        s.minus[1] = V - a
        s.surface = s.top + 2.0 * P - s.relaxation * V
        s.state[PROJECTILE_POSITION] = s.rest_height + s.surface
        s.state[PROJECTILE_VELOCITY] = V
        force = s.impedance * (2.0 * a - V + s.gravity_offset)
        s.state[PROJECTILE_FORCE] = force
    else:
        time, height, velocity = _free_flight(s, offset)
        s.minus[1] = a + s.gravity_offset
        s.surface = s.top + 2.0 * P + s.gravity_offset * time
        s.state[PROJECTILE_POSITION] = s.rest_height + height
        s.state[PROJECTILE_VELOCITY] = velocity
        s.state[PROJECTILE_FORCE] = 0.0


@part
def _run_in_contact(s, waves, count):
    """Advance by up to `count` steps, stopping before one in which the force ends below 0."""
    first, N, offset = s.cell - s.base, s.steps, s.gravity_offset
    top, answer = waves[0, first - N - 1:], waves[1, first + 1:]
    leaving, coming = waves[0, first + 1:], waves[1, first + 1 - N:]
    decay, threshold = s.decay, s.release_threshold
    w0, w1, w2, w3 = s.cubic[0], s.cubic[1], s.cubic[2], s.cubic[3]
    line0, line1, largest_ripple = s.line[0], s.line[1], s.largest_ripple
    behind, here, ahead = top[0], top[1], top[2]
    V, total, work, power = s.velocity, s.sum, s.work, s.power
    done = count
    for n in range(count):
        beyond = top[n + 3]
        drive = w0 * behind + w1 * here + (w2 * ahead + w3 * beyond)
        if abs(beyond - behind + 3.0 * (here - ahead)) > largest_ripple:
            drive = line0 * here + line1 * ahead
        following = decay * V + drive
        if 2.0 * ahead - following < threshold:
            done = n
            break
        V = following
        answer[n] = V - ahead
        total += 0.5 * (here + ahead)
        power = (leaving[n] - coming[n] + offset) * (leaving[n] + coming[n])
        work += power
        behind, here, ahead = here, ahead, beyond
    s.cell += done
    s.velocity, s.sum, s.work, s.power = V, total, work, power
    return done


@part
def _run_in_flight(s, waves, count):
    """Advance by up to `count` steps, stopping before one in which the gap ends below 0."""
    first, N, offset = s.cell - s.base, s.steps, s.gravity_offset
    top, answer = waves[0, first - N + 1:], waves[1, first + 1:]
    leaving, coming = waves[0, first + 1:], waves[1, first + 1 - N:]
    twice, height = 2.0 * s.step, s.launch_height - s.top
    speed, fall = s.launch_velocity - offset, 0.5 * s.gravity
    start = s.cell + 1 - s.launch_cell - s.launch_offset
    here, total, work, power = waves[0, first - N], s.sum, s.work, s.power
    done = count
    for n in range(count):
        ahead = top[n]
        area = total + 0.5 * (here + ahead)
        time = (start + n) * s.step
        if height + time * (speed - fall * time) < twice * area:
            done = n
            break
        answer[n] = ahead + offset
        total, here = area, ahead
        power = (leaving[n] - coming[n] + offset) * (leaving[n] + coming[n])
        work += power
    s.cell += done
    s.sum, s.work, s.power = total, work, power
    return done


@part
def _fill(s, waves, path, last):
    """Let p leave the plate up to grid point `last`, which needs m a crossing earlier."""
    while s.filled < last:
        first = s.filled + 1
        count = last - s.filled
        leaving, coming = waves[0, first - s.base:], waves[1, first - s.base - s.steps:]
        if s.plate_kind == DAMPED:
            # Rotations of a phasor that is evaluated anew for every block
            k = first % BLOCK
            if first // BLOCK != s.block:
                s.block = first // BLOCK
                start_block(s, s.block * BLOCK)
            real, imaginary = s.factor * s.cosine, s.factor * s.sine
            count = min(count, BLOCK - k)
            cosines, sines = path[0, k:], path[1, k:]
            for n in range(count):
                leaving[n] = (real * sines[n] + imaginary * cosines[n]) - coming[n]
        else:
            for n in range(count):
                time = (first + n) * s.step
                leaving[n] = velocity_of_piece(path, piece_at(s, path, time), time) - coming[n]
        s.filled += count


@part
def _march(s, waves, path, events, goal):
    """Advance to grid point `goal`, or until there is no more room for events."""
    while s.cell < goal and s.events <= events.shape[0]:
        while s.kink < s.cell:
            s.kink += 2 * s.steps
        if s.filled == s.cell:
            if s.cell + 3 - s.base > waves.shape[1]:
                # Loads up to the first release look back three crossings
                shift = s.cell - s.base - _PAD - (3 if s.events == 0 else 1) * s.steps
                for j in range(s.cell + 2 - s.base - shift):
                    waves[0, j], waves[1, j] = waves[0, j + shift], waves[1, j + shift]
                s.base += shift
            room = s.base + waves.shape[1] - 2
            _fill(s, waves, path, min(goal, room, s.cell + s.steps - 1))
        count = s.filled - s.cell
        if s.contact:
            done = _run_in_contact(s, waves, max(0, min(count, s.kink - 1 - s.cell)))
        else:
            done = _run_in_flight(s, waves, count)
        if s.events == 0:
            while s.cell - s.compared >= 2 * s.steps:
                _compare_loads(s, waves, s.steps)
        if done < count:
            if s.events == 0:
                _complete_loads(s, waves)
            _cross_step(s, waves, events, 1.0)


@part
def _compare_loads(s, waves, count):
    """
    Compare `count` waves p, a crossing at most, with the waves m that meet them.

    The stress in the layer is p(a) - m(b) + g tau, of a wave p that leaves the plate at a and a
    wave m that leaves the top at b; they meet in the layer if a and b differ by a crossing at
    most, at the plate and at the top if by all of it. So extremes of m in windows of two crossings
    are wanted: in the common part of all windows, and from there on backwards and forwards.
    """
    if count == 0:
        return
    N, offset, i = s.steps, s.gravity_offset, s.compared - s.base
    p, before, after, later = waves[0, i:], waves[1, i - N:], waves[1, i:], waves[1, i + N:]
    lowest, highest = waves[2], waves[3]
    low = high = after[0]
    for n in range(1, N):
        low, high = min(low, after[n]), max(high, after[n])
    common_low, common_high = low, high
    for n in range(N - 1, -1, -1):
        low, high = min(low, before[n]), max(high, before[n])
        lowest[n], highest[n] = low, high
    low, high = common_low, common_high
    strain, stress, push = s.peak_strain, s.peak_stress, s.peak_push
    for n in range(count):
        low, high = min(low, later[n]), max(high, later[n])
        here = p[n] + offset
        strain = max(strain, here - min(low, lowest[n]), max(high, highest[n]) - here)
        stress = max(stress, abs(here - before[n]))
        push = max(push, p[n] - later[n])
    s.peak_strain, s.peak_stress, s.peak_push = strain, stress, push
    s.compared += count


@part
def _complete_loads(s, waves):
    """Compare the waves p that are in the layer, too, with what has met them by now."""
    N, i = s.steps, s.cell - s.base
    _compare_loads(s, waves, max(s.cell - N + 1 - s.compared, 0))
    low = high = waves[1, i - N]
    for k in range(N):
        # Before the first wave that is kept there was rest
        older = waves[1, i - N - k] if i - N - k >= 0 else 0.0
        newer = waves[1, i - N + k]
        low, high = min(low, older, newer), max(high, older, newer)
        p = waves[0, i - k] + s.gravity_offset
        s.peak_strain = max(s.peak_strain, p - low, high - p)
        s.peak_stress = max(s.peak_stress, abs(p - older))


@kernel
def _advance(core, waves, path, events, time):
    """Advance to `time`; the number of events so far, or what is wrong."""
    grid, s = core[0], core[1]
    if not time >= s.time:
        return BACKWARDS
    if time > grid.horizon:
        return BEYOND_HORIZON
    step = grid.step
    if time >= 4e15 * step:
        return TOO_FAR
    goal = int(time / step)
    while goal * step > time:
        goal -= 1
    while (goal + 1) * step <= time:
        goal += 1
    _march(grid, waves, path, events, goal)
    records = core.view(np.float64)
    size = records.size // 3
    for k in range(size):
        records[size + k] = records[k]
    if s.cell != goal or s.events > events.shape[0]:
        return TOO_MANY_EVENTS
    s.offset = max(0.0, min((time - goal * step) / step, 1.0 - 1e-15))
    _cross_step(s, waves, events, s.offset)
    if s.events > events.shape[0]:
        return TOO_MANY_EVENTS
    i = goal - s.base - s.steps
    m = waves[1, i] + s.offset * (waves[1, i + 1] - waves[1, i])
    height, speed, _ = motion_at(s, path, time)
    s.time = time
    s.plus[0] = speed - m
    s.minus[0] = m
    s.state[TIME] = time
    s.state[PLATE_POSITION] = height
    s.state[PLATE_VELOCITY] = speed
    s.state[PLATE_FORCE] = s.impedance * (m - s.plus[0] - s.gravity_offset)
    return s.events


@kernel
def _read_layer(core, waves, out):
    """Read heights, velocities, forces and perhaps strains of the layer from plate to top."""
    s = core[1]
    height, velocity, force = out[0], out[1], out[2]
    i = s.cell - s.base
    rest = s.offset if s.offset > 0.0 else 1.0
    # From the last grid point to now, waves go on along a line; these places are written later.
    waves[0, i + 1] = waves[0, i] + (s.plus[0] - waves[0, i]) / rest
    waves[1, i + 1] = waves[1, i] + (s.minus[1] - waves[1, i]) / rest
    last = force.size - 1
    spacing, offset, start = s.steps / last, s.gravity_offset, i - s.steps - 1
    p_wave, m_wave = waves[0, start:], waves[1, start:]
    at_plate, at_top = s.offset + (s.steps + 1), s.offset + 1.0
    for n in range(last + 1):
        place = at_plate - spacing * n
        j = np.uintp(place)
        p = p_wave[j] + (p_wave[j + np.uintp(1)] - p_wave[j]) * (place - j)
        place = at_top + spacing * n
        j = np.uintp(place)
        m = m_wave[j] + (m_wave[j + np.uintp(1)] - m_wave[j]) * (place - j)
        velocity[n] = p + m
        force[n] = p - m + offset
    for end in range(2):
        velocity[end * last] = s.plus[end] + s.minus[end]
        force[end * last] = s.plus[end] - s.minus[end] + offset
    # Heights by the trapezoidal rule, its error spread over the layer so that both ends agree
    cell = s.thickness / last
    stretch = 0.5 * cell * s.steps * s.step / s.thickness
    squeezed = 0.0
    height[0] = 0.0
    for n in range(1, last + 1):
        squeezed += force[n - 1] + force[n]
        height[n] = squeezed
    low, high = s.state[PLATE_POSITION], s.rest_height + s.surface
    error = (high - low - s.thickness + stretch * squeezed) / last
    for n in range(last + 1):
        height[n] = low + n * (cell + error) - stretch * height[n]
        if out.shape[0] > 3:
            out[3, n] = -force[n] * s.steps * s.step / s.thickness
        force[n] *= s.impedance


@kernel
def _stored_energy(core, waves):
    """Add up the energy of layer and projectile against rest, by the trapezoidal rule."""
    s = core[1]
    i, x = s.cell - s.base, s.offset
    total = 0.5 * x * (s.plus[0] ** 2 + s.minus[1] ** 2)
    for w in range(2):
        total += 0.5 * (1.0 + x) * waves[w, i] ** 2
        for n in range(1, s.steps):
            total += waves[w, i - n] ** 2
        first, second = waves[w, i - s.steps], waves[w, i - s.steps + 1]
        start = first + x * (second - first)
        total += 0.5 * first**2 - 0.5 * x * (first**2 + start**2)
    if s.contact:
        # Where the mass takes power V (2 p - V) from the waves, the rule is not exact (as it is at
        # the plate, of work and waves alike): Euler's and Maclaurin's correction
        V, force = s.state[PROJECTILE_VELOCITY], 2.0 * s.plus[1] - s.state[PROJECTILE_VELOCITY]
        slope = waves[0, i - s.steps + 1] - waves[0, i - s.steps]
        total += (s.rate * force * (force - V) + 2.0 * V * slope) / 12.0
    mass = s.impedance * s.relaxation
    height = s.state[PROJECTILE_POSITION] - s.rest_height
    lift = s.state[PLATE_POSITION] + height - s.surface
    energy = 0.5 * mass * s.state[PROJECTILE_VELOCITY] ** 2 + mass * s.gravity * lift
    return s.impedance * s.step * total + energy


@kernel
def _update_loads(core, waves):
    """Bring the loads of the second record up to the last grid point before the first release."""
    if core[0].events == 0:
        _complete_loads(core[1], waves)


_advance_compiled = compiled(_advance, _RECORDS, _ROWS, _ROWS, _ROWS, nb.float64)
_read_layer_compiled = compiled(_read_layer, _RECORDS, _ROWS, _ROWS)


class WaveStepper(Stepper):
    """
    A throw by travelling waves: a rigid projectile on a lossless layer of one material.

    See the module for the scheme and its order, and `Stepper` for what all steppers promise.

    Parameters
    ----------
    rig : Rig
        The rig.
    motion : Underdamped, SampledMotion, 'measured' or None
        How the plate moves; None is the engine's, 'measured' waits for `append_plate_states`.
    steps : int, optional
        Per crossing of the wave, 16 to `MAX_STEPS`; the default is `steps_per_crossing`.
    field_points : int
        Heights at which the layer is read, 2 or more.

    Raises
    ------
    ValueError
        If the rig cannot be stepped in real time, or an argument is out of range.

    Examples
    --------
    The rig of the paper, 10 ms after the start:

    >>> stepper = WaveStepper(Rig())
    >>> stepper.advance_to(0.010)
    1
    >>> [release] = stepper.events()
    >>> f'{release.kind} after {1e3 * release.time:.4f} ms with {release.velocity:.4f} m/s'
    'release after 7.6470 ms with 1.3750 m/s'

    """

    _changing = '_waves'

    def __init__(
        self,
        rig: Rig,
        motion: PlateMotion | Literal['measured'] | None = None,
        *,
        steps: int | None = None,
        field_points: int = 64,
    ) -> None:
        rig.check_for_waves()
        super().__init__(rig, field_points)
        if steps is None:
            steps = steps_per_crossing(rig)
        self.steps = require_count('steps', steps, low=16, high=MAX_STEPS)
        start = self._make_records(_CORE, motion, rig.crossing_time / self.steps)
        start['thickness'] = rig.layer.thickness
        start['rest_height'] = rig.layer.thickness - rig.static_sag
        _prepare(
            self._core, self.steps, rig.crossing_time, rig.relaxation_time, rig.gravity,
            rig.layer.impedance, rig.engine.speed_scale,
        )
        self._waves = _make_waves(self.steps)
        self._work_unit = rig.layer.impedance * float(start['step'])
        self._bind()
        self.reset()

    def _bind(self) -> None:
        arrays = (self._core, self._waves, self._path, self._events)
        self._advance = partial(_advance_compiled(), *arrays)
        self._read_layer = partial(_read_layer_compiled(), *arrays[:2])

    def _clear(self) -> None:
        _clear_waves(self._waves, self.steps)

    def _copy_layer(self, origin: Stepper) -> None:
        """Copy the waves that are still on their way."""
        assert isinstance(origin, WaveStepper)
        grid = origin._core[0]
        kept = int(grid['cell'] - grid['base']) - (3 if grid['events'] == 0 else 1) * self.steps
        first, last = max(kept - _PAD, 0), int(grid['filled'] - grid['base']) + 2
        self._waves[:2, first:last] = origin._waves[:2, first:last]

    @property
    def cost(self) -> float:
        """Time of a processor over time of the rig, about [-]."""
        return _STEP_COST * self.steps / self.rig.crossing_time

    @property
    def loads(self) -> Loads:
        """Largest loads up to the first release, or so far if that is to come."""
        _update_loads(self._core, self._waves)
        layer, now = self.rig.layer, self._core[1]
        push, stress = float(now['peak_push']), float(now['peak_stress'])
        contact_stress = push + float(now['gravity_offset'])
        return Loads(
            strain=max(float(now['peak_strain']), contact_stress) / layer.wave_speed,
            plate_strain=stress / layer.wave_speed,
            contact_strain=contact_stress / layer.wave_speed,
            acceleration=push / self.rig.relaxation_time,
            plate_force=stress * layer.impedance,
        )

    @property
    def work_so_far(self) -> float:
        """Work of the plate from the start to now, by the trapezoidal rule [J]."""
        now = self._core[1]
        part = (now['offset'] - 0.5) * now['power']
        return float(self._work_unit * (now['work'] + part))

    def stored_energy(self) -> float:
        """Add up the energy of layer and projectile against rest, to second order [J]."""
        return float(_stored_energy(self._core, self._waves))


def _make_waves(steps: int) -> Floats:
    """Make room for waves p and m, and for two series in `_compare_loads`."""
    return np.zeros((4, 4 * steps + _ROOM))


def _clear_waves(waves: Floats, steps: int) -> None:
    """Forget the waves: those that are read before they are written."""
    waves[:2, : steps + _PAD + 1] = 0.0


def first_throws(
    *,
    mass_ratio: ArrayLike,
    speed_ratio: ArrayLike,
    damping_ratio: ArrayLike = 0.0,
    gravity_ratio: ArrayLike = 0.0,
    unresolved: Literal['raise', 'nan'] = 'raise',
    threads: int | None = None,
) -> FirstThrows:
    r"""
    Follow many throws to their first releases: when, how fast, and what they ask of the rig.

    Projectiles are rigid, layers lossless, and the plate moves as `plate.Underdamped`. Where loads
    do not matter, `closed_form.first_releases` is exact and faster.

    Parameters
    ----------
    mass_ratio, speed_ratio, damping_ratio, gravity_ratio : array_like
        :math:`\mu = m / (\rho_s S L_s)`, :math:`\kappa = c_s / (L_s f)`, the plate's
        :math:`\zeta`, and :math:`g / (A \omega^2)`; broadcast against each other. [-]
    unresolved : {'raise', 'nan'}
        What becomes of throws without a release: the first is raised, or all are NaN.
    threads : int, optional
        Largest number of threads, all cores if not given. Results do not depend on it.

    Returns
    -------
    FirstThrows
        Of arrays with the common shape. Errors: 1e-5 in the release, 5e-4 in loads.

    Raises
    ------
    ValueError
        If a ratio is out of range, or an option is not one of its values.
    ThrowUnresolvedError
        If a projectile does not leave within 8 periods of the plate and 8 of its own on the
        layer, or 4096 crossings, unless `unresolved` is 'nan'.

    Examples
    --------
    >>> throws = first_throws(mass_ratio=[0.1, 0.234231], speed_ratio=8.24221)
    >>> throws.energy_transfer.round(3), throws.peak_strain.round(3)
    (array([4.081, 4.123]), array([1.046, 1.107]))

    """
    ratios, shape = broadcast_ratios(
        unresolved,
        mass_ratio=mass_ratio,
        speed_ratio=speed_ratio,
        damping_ratio=damping_ratio,
        gravity_ratio=gravity_ratio,
    )
    mu, kappa = ratios[:2]
    steps = np.maximum(_STEPS_PER_RELAXATION / mu, _STEPS_PER_PERIOD / kappa)
    steps = np.clip(np.ceil(steps), _FEWEST_STEPS, _STEPS).astype(np.int64)
    natural = 2.0 * math.pi * np.sqrt(mu) / kappa  # period of the mass on a massless layer
    periods = _MAX_PERIODS * (1.0 + natural)
    latest = np.minimum(periods, _MAX_CROSSINGS / kappa) + 1.0 / kappa
    found = np.full((6, mu.size), math.nan)

    def run(part: int, parts: int) -> None:
        core, path, no_events = np.zeros(3, _CORE), np.empty((2, BLOCK)), np.empty((0, 4))
        numbers = core.view(np.float64).reshape(3, -1)
        advance = _advance_compiled()
        for n in range(part, mu.size, parts):
            waves = _make_waves(int(steps[n]))
            numbers[:] = 0.0
            _prepare_underdamped(core, path, steps[n], *ratios[:, n])
            numbers[:2] = numbers[2]
            advance(core, waves, path, no_events, latest[n])
            if core[0]['events']:
                found[:, n] = _first_throw(core[0])

    in_threads(run, count=mu.size, per_thread=_THROWS_PER_THREAD, threads=threads)
    return FirstThrows.collect(found, ratios, shape, unresolved, f'{_MAX_PERIODS:g} periods')


def _first_throw(s: np.void) -> tuple[float, ...]:
    """Read the rows of `FirstThrows` from a record that has come to the first release."""
    time = (s['launch_cell'] + s['launch_offset']) * s['step']
    push, omega = s['peak_push'], 2.0 * math.pi
    strain = max(s['peak_strain'], push + s['gravity_offset'])
    work = s['first_work'] * s['step'] / s['relaxation']
    acceleration = push / (omega * s['relaxation'])
    return time, s['launch_velocity'], strain, acceleration, s['peak_stress'], work


def warm_up() -> None:
    """Compile or load all kernels that the twin needs."""
    load_kernels(WaveStepper(Rig(), 'measured', field_points=2))
