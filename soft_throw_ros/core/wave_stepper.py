# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
r"""
Throws by travelling waves: a rigid projectile on a lossless layer of one material.

Notes
-----
The kernels are a delay line with contact, release, flight and landing. With :math:`p = v_+` and
:math:`m = v_-` of Sec. IV of [1]_, at the top of the layer

.. math::

    p(t) &= V_p(t - t_s) - m(t - 2 t_s) \\
    \tau \dot V + V &= 2 p, \quad m = V - p \qquad \text{in contact} \\
    m &= p + g \tau \qquad\qquad\qquad\quad \text{in flight}

where everything counts from the static equilibrium, and the layer pushes the projectile with
:math:`F = (m_r / \tau) (2 p - V) + m_r g`. Flight, landing and gravity are not in [1]_'s
analytical model.

The step h divides :math:`t_s`: waves travel from grid point to grid point without any error, and
the kinks of a damped step, at odd multiples of :math:`t_s`, fall on grid points. A cubic through
four points on one side of a kink interpolates p, and the equation of V is solved exactly for it,
however small :math:`\tau` is: the first release is of fourth order in h. Heights are sums of p by
the trapezoidal rule, of second order.

Releases and landings are roots within a step, one in each step; a dip of the contact force or gap
below zero within one step is not seen. A landing makes m jump between two grid points; the nearer
one takes the value that keeps the area under m, and with it the momentum of the wave. So later
events are of second order in h, but a release by the jump itself is only known to a step.

References
----------
.. [1] "Use of compliant actuators for throwing rigid projectiles", Phys. Rev. E (2022).

"""

from __future__ import annotations

from collections.abc import Mapping
import math
from typing import Any

import numpy as np
from soft_throw_ros.core import stepper
from soft_throw_ros.core.batch import Cancelled
from soft_throw_ros.core.kernels import Floats, inlined, kernel, stepper_kernels, subroutine
from soft_throw_ros.core.rig import Rig, scales_of
from soft_throw_ros.core.stepper import CAPACITY, enter_piece, motion_at, Stepper

_STEPS = 512
"""Fewest steps per crossing of the wave for 1e-3 at later events. [-]"""

_STEP_COST = 3e-9
"""Time of a processor for a step. [s]"""

_SPARE_STEPS = 1000
"""Spare steps in memory, so that waves are rarely moved; 1024 make copies 10 times as slow. [-]"""

_COUNTS = np.arange(1024.0)
"""Whole numbers, which are slow to convert. [-]"""

# The first record is the state at a grid point, the second that between two grid points. Lengths
# count from the static equilibrium, offsets are in steps.
RECORD = np.dtype(
    [
        # constants
        ('step', 'f8'),  # h [s]
        ('steps', 'i8'),  # N = t_s / h
        ('rate', 'f8'),  # h / tau
        ('decay', 'f8'),  # e^{-h / tau}
        ('cubic', 'f8', (4,)),  # V(t + h) = decay V(t) + cubic . p, of four points
        ('relaxation', 'f8'),  # tau [s]
        ('gravity', 'f8'),  # g [m/s2]
        ('gravity_offset', 'f8'),  # g tau [m/s]
        ('release_threshold', 'f8'),  # 2 p - V at which the projectile leaves: -g tau, less noise
        ('thickness', 'f8'),
        ('impedance', 'f8'),
        *stepper.COMMON,
        # where the waves have got to
        ('cell', 'i8'),  # grid point
        ('offset', 'f8'),  # beyond it
        ('base', 'i8'),  # grid point at index 0 of the waves
        ('filled', 'i8'),  # up to where p is known at the plate
        ('kink', 'i8'),  # next grid point at which p has a kink, at the top
        # the mass and the top of the layer
        ('velocity', 'f8'),  # V in contact
        ('sum', 'f8'),  # of p at the top by the trapezoidal rule, over h
        ('top', 'f8'),  # height of the top less 2 P - tau V, in flight less 2 P + g tau t
        ('launch_cell', 'i8'),
        ('launch_offset', 'f8'),
        ('launch_height', 'f8'),
        ('launch_velocity', 'f8'),
        # loads up to the first release
        ('stride', 'i8'),  # between the grid points in time and depth whose strains are compared
        ('compared', 'i8'),  # next of these grid points in time
        ('peak_contact_force', 'f8'),  # of the scaled contact force 2 p - V
        ('peak_plate_stress', 'f8'),  # of p - m + g tau at the plate
        ('peak_strain', 'f8'),  # of the same in the layer
        ('power_sum', 'f8'),  # sum of power over the impedance and h, without the steps in flight
        ('power', 'f8'),  # last addend
        # at `time`
        ('upward', 'f8'),  # p at the plate
        ('downward', 'f8'),  # m at the top
    ],
    align=True,
)
"""State of a throw by travelling waves."""


@subroutine
def _moments(x):
    """Compute e^{-x} and the integrals of e^{-x (1 - u)} u^n over [0, 1] for n = 0 ... 3."""
    if x < 1.0:
        series = 1.0
        for n in range(19, 4, -1):
            series = 1.0 - x / n * series
        third = 0.25 * series
        second = (1.0 - x * third) / 3.0
        first = (1.0 - x * second) * 0.5
        zeroth = 1.0 - x * first
        return 1.0 - x * zeroth, zeroth, first, second, third
    decay = math.exp(-x)
    zeroth = (1.0 - decay) / x
    first = (1.0 - zeroth) / x
    second = (1.0 - 2.0 * first) / x
    return decay, zeroth, first, second, (1.0 - 3.0 * second) / x


@kernel
def _prepare(core, numbers):
    """Complete the third record but for the plate's motion, and return the waves."""
    s, N = core[2], int(numbers[0])
    strains, thickness, crossing, relaxation, gravity, impedance, speed = (
        numbers[1], numbers[2], numbers[3], numbers[4], numbers[5], numbers[6], numbers[7]
    )
    s.step, s.steps, s.rate = crossing / N, N, crossing / N / relaxation
    decay, m0, m1, m2, m3 = _moments(s.rate)
    s.decay = decay
    # The cubic through p at -1, 0, 1 and 2, integrated against e^{-x (1 - u)}
    x = 2.0 * s.rate
    cubic = s.cubic
    cubic[0] = x * (-m1 / 3.0 + m2 / 2.0 - m3 / 6.0)
    cubic[1] = x * (m0 - m1 / 2.0 - m2 + m3 / 2.0)
    cubic[2] = x * (m1 + m2 / 2.0 - m3 / 2.0)
    cubic[3] = x * (-m1 / 6.0 + m3 / 6.0)
    s.thickness, s.impedance = thickness, impedance
    s.relaxation, s.gravity = relaxation, gravity
    s.rest_height = thickness - gravity * relaxation * crossing  # sag m g L / (E S)
    s.gravity_offset = gravity * relaxation
    s.release_threshold = -s.gravity_offset - stepper.FORCE_NOISE * speed
    s.base = -2 * N
    s.contact, s.kink = True, N
    # A divisor of N, so that kinks, where strains are largest, are compared
    s.stride = max(1, int(N / strains))
    while N % s.stride > 0:
        s.stride -= 1
    s.peak_plate_stress = s.peak_strain = s.gravity_offset  # at rest the weight is all there is
    return np.zeros((2, 4 * N + _SPARE_STEPS))


@subroutine
def _mass_velocity(s, d, V, a, b, c, e):
    """Solve tau V' + V = 2 p over d steps during which p = a + b u + c u^2 + e u^3."""
    decay, zeroth, first, second, third = _moments(s.rate * d)
    drive = a * zeroth + d * (b * first + d * (c * second + d * e * third))
    return decay * V + 2.0 * s.rate * d * drive


@subroutine
def _expand(s, waves):
    """Expand p at the top after `s.cell` in a cubic through points on one side of a kink."""
    aside = 1 if s.cell == s.kink else (-1 if s.cell + 1 == s.kink else 0)
    i = s.cell - s.base - s.steps + aside
    behind, here, ahead, beyond = waves[0, i - 1], waves[0, i], waves[0, i + 1], waves[0, i + 2]
    e = (beyond - behind + 3.0 * (here - ahead)) / 6.0
    c = 0.5 * (behind + ahead) - here
    b = ahead - here - c - e
    return _shift(-float(aside), here, b, c, e)


@subroutine
def _shift(d, a, b, c, e):
    """Expand a cubic about another point."""
    return (
        a + d * (b + d * (c + d * e)),
        b + d * (2.0 * c + 3.0 * d * e),
        c + 3.0 * d * e,
        e,
    )


@subroutine
def _rise(s, waves, d):
    """Integrate 2 p at the top from the start until d steps after `s.cell`, along lines [m]."""
    i = s.cell - s.base - s.steps
    here = waves[0, i]
    return 2.0 * s.step * (s.sum + d * (here + 0.5 * d * (waves[0, i + 1] - here)))


@subroutine
def _top_at(s, waves, d, begin, V, cubic):
    """Compute p, V, heights of projectile and top, and force from release or gap, at a step d."""
    p, _, _, _ = _shift(d - begin, *cubic)
    rise = _rise(s, waves, d)
    if s.contact:
        V = _mass_velocity(s, d - begin, V, *cubic)
        height = s.top + rise - s.relaxation * V
        return p, V, height, height, 2.0 * p - V - s.release_threshold
    time = (s.cell - s.launch_cell + (d - s.launch_offset)) * s.step
    height = s.launch_height + time * (s.launch_velocity - 0.5 * s.gravity * time)
    lift = s.gravity_offset * time
    V = s.launch_velocity - s.gravity * time
    return p, V, height, s.top + rise + lift, height - s.top - rise - lift


@subroutine
def _find_event(s, waves, cubic):
    """Return the offset of an event in the step, 2 if there is none."""
    p, V, _, _, excess = _top_at(s, waves, 1.0, 0.0, s.velocity, cubic)
    gap_opens = not s.contact and 2.0 * p + s.gravity_offset <= V
    if gap_opens or not excess < 0.0:
        return 2.0
    low, high = 0.0, 1.0
    for _ in range(54):  # bisect
        d = 0.5 * (low + high)
        is_over = _top_at(s, waves, d, 0.0, s.velocity, cubic)[4] < 0.0
        low, high = (low, d) if is_over else (d, high)
    return high


@subroutine
def _write_work(s, offset):
    """Write the work of the plate until some steps after `s.cell`."""
    s.work = s.impedance * s.step * (s.power_sum + (offset - 0.5) * s.power)


@subroutine
def _change_contact(s, waves, events, d, cubic):
    """Release or land the projectile d steps after `s.cell`, and return its velocity."""
    _, V, height, _, _ = _top_at(s, waves, d, 0.0, s.velocity, cubic)
    if s.events == 0:
        _compare_strains_at(s, waves, s.cell)
        _write_work(s, d)
    stepper.note_event(s, events, (s.cell + d) * s.step, height, V)
    s.top = height - _rise(s, waves, d)
    if s.contact:
        s.top += s.relaxation * V
    else:
        s.launch_cell, s.launch_offset = s.cell, d
        s.launch_height, s.launch_velocity = height, V
    return V


@subroutine
def _cross_step(s, waves, events, target):
    """Finish the step after `s.cell` if `target` is 1, else write the state at this offset."""
    cubic = _expand(s, waves)
    begin, V, jump = 0.0, s.velocity, 0.0
    event = _find_event(s, waves, cubic)
    if event <= target:
        begin, V = event, _change_contact(s, waves, events, event, cubic)
        cubic = _shift(event, *cubic)
        if s.contact:  # m jumps from p + g tau to V - p
            jump = V - 2.0 * cubic[0] - s.gravity_offset
    p, V, height, surface, _ = _top_at(s, waves, target, begin, V, cubic)
    if target < 1.0:
        s.surface = surface
        s.downward = V - p if s.contact else p + s.gravity_offset
        force = s.impedance * (2.0 * p - V + s.gravity_offset)
        s.state[stepper.PROJECTILE_POSITION] = s.rest_height + height
        s.state[stepper.PROJECTILE_VELOCITY] = V
        s.state[stepper.PROJECTILE_FORCE] = force if s.contact else 0.0
        return
    j = s.cell + 1 - s.base
    p = waves[0, j - s.steps]
    s.sum = _rise(s, waves, 1.0) / (2.0 * s.step)
    s.cell += 1
    s.velocity = V if s.contact else 0.0
    waves[1, j] = V - p if s.contact else p + s.gravity_offset  # m = V - p, Sec. IV
    waves[1, j - 1 if begin < 0.5 else j] += (0.5 - begin) * jump  # keeps the area under m
    if s.events == 0:
        s.peak_contact_force = max(s.peak_contact_force, 2.0 * p - V)
        p, m = waves[0, j], waves[1, j - s.steps]
        stress = p - m + s.gravity_offset
        s.peak_plate_stress = max(s.peak_plate_stress, abs(stress))
        s.power = stress * (p + m)
        s.power_sum += s.power


@subroutine
def _run(s, waves, count):
    """Advance by up to `count` steps, stopping before an event; return the number of steps."""
    first, N, offset = s.cell - s.base, s.steps, s.gravity_offset
    top, downward = waves[0, first - N - 1:], waves[1, first + 1:]
    leaving, coming = waves[0, first + 1:], waves[1, first + 1 - N:]
    decay, threshold = s.decay, s.release_threshold
    w0, w1, w2, w3 = s.cubic[0], s.cubic[1], s.cubic[2], s.cubic[3]
    behind, here, ahead = top[0], top[1], top[2]
    V, total, work, power = s.velocity, s.sum, s.power_sum, s.power
    peak_force, peak_stress = s.peak_contact_force, s.peak_plate_stress
    in_contact, done = s.contact, count
    step, twice, gap, fall = s.step, 2.0 * s.step, s.launch_height - s.top, 0.5 * s.gravity
    start, speed = s.cell + 1 - s.launch_cell - s.launch_offset, s.launch_velocity - offset
    for n in range(count):
        beyond, area = top[n + 3], total + 0.5 * (here + ahead)
        if in_contact:
            drive = w0 * behind + w1 * here + (w2 * ahead + w3 * beyond)
            following = decay * V + drive  # tau V' + V = 2 p, Sec. IV
            force = 2.0 * ahead - following
            if force < threshold:
                done = n
                break
            V = following
            downward[n] = V - ahead
            stress = leaving[n] - coming[n] + offset
            power = stress * (leaving[n] + coming[n])
            work += power
            peak_force, peak_stress = max(peak_force, force), max(peak_stress, abs(stress))
        else:
            time = (start + n) * step
            if gap + time * (speed - fall * time) < twice * area:
                done = n
                break
            downward[n] = ahead + offset
        total, behind, here, ahead = area, here, ahead, beyond
    s.cell += done
    s.velocity, s.sum = V, total
    if s.events == 0:
        s.power_sum, s.power = work, power
        s.peak_contact_force, s.peak_plate_stress = peak_force, peak_stress
    return done


@subroutine
def _fill(s, waves, path, last):
    """Compute p at the plate up to grid point `last`, from m a crossing earlier."""
    while s.filled < last:
        first = s.filled + 1
        time = first * s.step
        if not s.piece_begin <= time < s.piece_end:
            enter_piece(s, path, time)
        begin, end = s.piece_begin, s.piece_end
        count = int(min((end - time) / s.step, last - first, _COUNTS.size - 1)) + 1
        while count > 1 and (first + count - 1) * s.step >= end:
            count -= 1
        leaving, coming = waves[0, first - s.base:], waves[1, first - s.base - s.steps:]
        p = s.coefficients
        a, b, c, d, e = p[1], 2.0 * p[2], 3.0 * p[3], 4.0 * p[4], 5.0 * p[5]
        start, step = float(first), s.step
        for n in range(count):
            u = (start + _COUNTS[n]) * step - begin
            velocity = a + u * (b + u * (c + u * (d + u * e)))
            leaving[n] = velocity - coming[n]  # p(t) = V_p(t - t_s) - m(t - 2 t_s), Sec. IV
        s.filled += count


@subroutine
def _march(s, waves, path, events, goal):
    """Advance to grid point `goal`, or until there is no more room for events."""
    while s.cell < goal and s.events <= events.shape[0]:
        while s.kink < s.cell:
            s.kink += 2 * s.steps
        if s.filled == s.cell:
            if s.cell + 3 - s.base > waves.shape[1]:
                shift = s.cell - 2 - s.steps - s.base  # the cubic before a kink begins 2 earlier
                for j in range(s.cell + 2 - s.base - shift):
                    waves[0, j], waves[1, j] = waves[0, j + shift], waves[1, j + shift]
                s.base += shift
            last_column = s.base + waves.shape[1] - 2
            _fill(s, waves, path, min(goal, last_column, s.cell + s.steps - 1))
        count = s.filled - s.cell
        if s.contact:
            count = min(count, max(0, s.kink - 1 - s.cell))
        done = _run(s, waves, count)
        while s.events == 0 and s.compared <= s.cell:
            _compare_strains_at(s, waves, s.compared)
            s.compared += s.stride
        if done < count or count == 0:
            _cross_step(s, waves, events, 1.0)


@subroutine
def _compare_strains_at(s, waves, cell):
    """Compare strains in the layer at a grid point in time, not earlier than a crossing ago."""
    N, i = s.steps, cell - s.base
    for k in range(0, N + 1, s.stride):  # steps above the plate
        stress = waves[0, i - k] - waves[1, i - N + k] + s.gravity_offset
        s.peak_strain = max(s.peak_strain, abs(stress))


@kernel
def _advance(core, waves, path, events, time):
    """Advance to `time`; return the number of events so far, or an error code."""
    grid, s = core[0], core[1]
    step = grid.step
    goal = stepper.steps_until(s, step, time)
    if goal < 0:
        return goal
    _march(grid, waves, path, events, goal)
    core[1] = core[0]
    if s.events <= events.shape[0]:
        s.offset = max(0.0, min((time - goal * step) / step, 1.0 - 1e-15))
        _cross_step(s, waves, events, s.offset)
    if s.events == 0:
        _write_work(s, s.offset)
    force, stress, strain = s.peak_contact_force, s.peak_plate_stress, s.peak_strain
    wave_speed = s.thickness / (s.steps * s.step)
    s.loads[0] = max(strain, stress, force + s.gravity_offset) / wave_speed
    s.loads[1], s.loads[2] = force / s.relaxation, stress * s.impedance
    if s.events > events.shape[0]:
        return s.events
    i = goal - s.base - s.steps
    m = waves[1, i] + s.offset * (waves[1, i + 1] - waves[1, i])
    state = s.state
    state[stepper.TIME] = time
    state[stepper.PLATE_POSITION], state[stepper.PLATE_VELOCITY], _ = motion_at(s, path, time)
    s.upward = state[stepper.PLATE_VELOCITY] - m
    state[stepper.PLATE_FORCE] = s.impedance * (m - s.upward - s.gravity_offset)
    return s.events


@inlined
def _between(wave, index):
    """Interpolate between grid points along a line."""
    j = np.uintp(index)  # unsigned, so that no index counts from the end
    return wave[j] + (wave[j + np.uintp(1)] - wave[j]) * (index - j)


@kernel
def _read_layer(core, waves, out):
    """Read heights, velocities, forces and strains of the layer from plate to top."""
    s = core[1]
    height, velocity, force = out[0], out[1], out[2]
    i = s.cell - s.base
    # Waves go on along a line to now, until a step overwrites its end
    offset = s.offset if s.offset > 0.0 else 1.0
    waves[0, i + 1] = waves[0, i] + (s.upward - waves[0, i]) / offset
    waves[1, i + 1] = waves[1, i] + (s.downward - waves[1, i]) / offset
    last = force.size - 1
    spacing, start = s.steps / last, i - s.steps - 1
    at_plate, at_top = s.offset + (s.steps + 1), s.offset + 1.0
    for n in range(last + 1):
        p = _between(waves[0, start:], at_plate - spacing * n)
        m = _between(waves[1, start:], at_top + spacing * n)
        velocity[n] = p + m
        force[n] = p - m + s.gravity_offset
    # Heights by the trapezoidal rule, its error spread over the layer so that both ends agree
    cell = s.thickness / last
    stretch = 0.5 * cell * s.steps * s.step / s.thickness
    height[0] = 0.0
    for n in range(last):
        height[n + 1] = height[n] + (force[n] + force[n + 1])
    low, high = s.state[stepper.PLATE_POSITION], s.rest_height + s.surface
    error = (high - low - s.thickness + stretch * height[last]) / last
    for n in range(last + 1):
        height[n] = low + n * (cell + error) - stretch * height[n]
        out[3, n] = -force[n] * s.steps * s.step / s.thickness
        force[n] *= s.impedance


_kernels = stepper_kernels(RECORD, _advance, _read_layer, arrays=2)


@kernel
def _follow(core, waves, number, plates, numbers, latest, rows):
    """Go on with the throws of a batch, see `stepper.follow_batch`."""
    left, path, no_events = stepper.SLICE, np.empty((7, 0)), np.empty((0, 4))
    while number < latest.size and left > stepper.ROUNDING:
        if not waves.size:
            stepper.begin_throw(core, plates[:, number])
            waves = _prepare(core, numbers[number])
            core[0] = core[1] = core[2]
        cost, begin = _STEP_COST / core[0].step, core[1].state[stepper.TIME]
        until = min(latest[number], begin + stepper.SLICE / cost)
        left -= cost * (until - begin)
        if _advance(core, waves, path, no_events, until) or until == latest[number]:
            stepper.write_release(core, rows[:, number])
            number, waves = number + 1, np.empty((0, 0))
    return number, waves


def _numbers_of(rigs: Any, steps: Any) -> Floats:
    """Return the numbers for `_prepare` of each rig, shape (n, 8)."""
    # Strains to compare in a crossing, for the largest to 1e-3
    strains = np.maximum(0.5 * stepper.needed_cells(rigs), stepper.PER_PERIOD / rigs.speed_ratio)
    columns = (
        steps, strains, rigs.layer.thickness, rigs.crossing_time, rigs.relaxation_time,
        rigs.gravity, rigs.layer.impedance, rigs.engine.speed_scale,
    )
    return np.stack(np.atleast_1d(*columns), axis=-1)


class WaveStepper(Stepper):
    r"""
    A throw by travelling waves: a rigid projectile on a lossless layer of one material.

    Parameters
    ----------
    rig, **options
        As for `throw.make_stepper`.
    steps : int, optional
        Per crossing of the wave, 16 to `CAPACITY`; by default 512, or more where the relaxation
        time or the plate's period is short, but not beyond `stepper.MAX_COST`. The default
        has errors of 1e-6 at the first release, and 1e-3 at the next four events of 95 % of rigs,
        in :math:`t f` and :math:`V / (A \omega)`.

    Raises
    ------
    ValueError
        If the rig cannot be stepped in real time, or an argument is out of range.

    Examples
    --------
    >>> stepper = WaveStepper(Rig())
    >>> stepper.advance_to(0.010)
    1
    >>> [release] = stepper.events()
    >>> f'{release.kind} after {1e3 * release.time:.4f} ms with {release.velocity:.4f} m/s'
    'release after 7.6470 ms with 1.3750 m/s'

    """

    def __init__(self, rig: Rig, *, steps: int | None = None, **options: Any) -> None:
        if rig.layer.needs_cells:
            count = len(rig.layer.sheets)
            raise ValueError(f'layer must be linear without loss, got {count} sheets, {rig.layer}')
        cost = _STEP_COST / rig.crossing_time
        if steps is None:
            steps = stepper.cells_in_real_time(rig, cost, 1, fewest=_STEPS)
            steps -= steps % 32
        self.steps = stepper.require_count('steps', steps, low=16, high=CAPACITY)
        core = np.zeros(3, RECORD)
        waves = _prepare(core, _numbers_of(rig, self.steps)[0])
        self.cost = _STEP_COST / float(core[2]['step'])
        super().__init__(rig, core, waves, _kernels(), **options)


def throw_batch(
    values: Mapping[str, Floats], until: Floats, cancelled: Cancelled | None = None
) -> Floats:
    """
    Compute loads for `throw.throw_many`, without loss, unchecked.

    `until` has the exact times of the first releases [s]: a light projectile may leave and be
    caught again within a step. Arguments and result are else those of `cell_stepper.throw_batch`.
    Errors in loads and work: 1e-3 for 95 % of rigs.
    """
    rigs = scales_of(values)
    steps = 32 * np.ceil(np.minimum(stepper.needed_cells(rigs), _STEPS) / 32.0).astype(np.int64)
    latest = until + rigs.crossing_time / steps
    numbers = _numbers_of(rigs, steps)
    return stepper.follow_batch(_follow, RECORD, rigs, numbers, latest, cancelled)
