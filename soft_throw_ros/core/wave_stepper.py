# SPDX-License-Identifier: Apache-2.0
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
:math:`F = (m_r / \tau) (2 p - V) + m_r g`. The projectile leaves when F falls below zero, be it
gradually or in a jump (an echo of a landing), and is in contact again when the gap closes, its
speed unchanged. Flight, landing and gravity are not in [1]_'s analytical model.

The step h divides :math:`t_s`, so waves travel from grid point to grid point without any error,
and the kinks that the start of an underdamped plate sends through the layer, at odd multiples of
:math:`t_s`, fall on grid points. What has to be computed is the answer of the mass: p is known
:math:`t_s` ahead, is interpolated by the cubic through four neighbouring points (on one side of a
kink), and the equation of V is solved for it exactly, however small :math:`\tau` is. So the first
release is of fourth order in h. Releases and landings are roots within a step.

A landing makes m jump, at some place between two grid points. Such a front comes back every
:math:`2 t_s`, its size unchanged but for its sign: reflected by a mass that stays, by a free top,
and by the plate. So fronts stand in a queue, in the order in which they arrive, and in the steps
beside one p is a line on either side of it: later events are of second order in h. When the queue
is full (64), the next jump J is not tracked; (1/2 - w) J is added to the sample after it, which
keeps its integral if w is the part of the step before it.

A dip of the contact force below zero, or of the gap, that begins and ends within one step is not
seen.

References
----------
.. [1] "Use of compliant actuators for throwing rigid projectiles", Phys. Rev. E (2022).

"""

from __future__ import annotations

import math
from typing import Literal

import numba as nb
import numpy as np
from numpy.typing import ArrayLike, NDArray
from soft_throw_ros.core.batch import broadcast_ratios, in_threads
from soft_throw_ros.core.plate import PlateMotion
from soft_throw_ros.core.plate_kernels import (
    BLOCK,
    DAMPED,
    motion_at,
    piece_at,
    PLATE,
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

_PAD = 8  # steps that are kept beyond the crossing time, for the cubics
_ROOM = 1024  # steps by which the memory of waves is longer than it must be, to be moved seldom
_NOISE = 1e-12  # of the plate's speed: a force below it is rounding, and no pull
_FRONTS = 6  # row of the waves' memory: arrival, offset and size of each front
_MAX_FRONTS = 64
_EVENTS_PER_STEP = 8  # a mass that chatters faster stays as it is until the next step

_MAX_PERIODS = 8.0  # of plate and of projectile on layer, for which a first release is waited
_MAX_CROSSINGS = 4096.0
_THROWS_PER_THREAD = 64

_RECIPROCAL = 1.0 / np.maximum(np.arange(25.0), 1.0)

_jit = nb.njit(cache=True, nogil=True, error_model='numpy')

# Two such records make a stepper: the first stands at a grid point, the second between; the
# third is what both are reset to. Lengths count from the static equilibrium, offsets are in steps.
_CORE = np.dtype(
    [
        # what stays
        ('step', 'f8'),  # h [s]
        ('steps', 'i8'),  # N = t_s / h
        ('rate', 'f8'),  # h / tau
        ('decay', 'f8'),  # e^{-h / tau}
        ('moments', 'f8', (4,)),  # of it, see `_moments`
        ('weights', 'f8', (2, 4)),  # V(t + h) = decay V(t) + weights . p, for a cubic and a line
        ('relaxation', 'f8'),  # tau [s]
        ('gravity', 'f8'),  # g [m/s2]
        ('gravity_offset', 'f8'),  # g tau [m/s]
        ('release_threshold', 'f8'),  # 2 p - V at which the projectile leaves: -g tau, less noise
        ('wave_speed', 'f8'),
        ('thickness', 'f8'),
        ('impedance', 'f8'),
        ('mass', 'f8'),
        ('rest_height', 'f8'),  # of the projectile's lower face [m]
        ('event_limit', 'i8'),  # after which a march ends
        # how the plate moves, and where it has got to
        *PLATE,
        ('block', 'i8'),
        ('phasor', 'f8', (2,)),  # at the start of the block
        # where the waves have got to
        ('time', 'f8'),
        ('cell', 'i8'),  # grid point
        ('offset', 'f8'),  # beyond it
        ('base', 'i8'),  # grid point at index 0 of the waves
        ('filled', 'i8'),  # up to where p is known at the plate
        ('kink', 'i8'),  # next grid point at which p has a kink at the top
        ('front_begin', 'i8'),  # numbers of the fronts that are under way
        ('front_end', 'i8'),
        ('front_passed', 'i8'),  # the next one at the plate, where power jumps within a step
        ('last_front', 'i8'),  # grid point after which the latest one arrived
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
        # loads, up to the first release
        ('peak_push', 'f8'),  # of the scaled contact force 2 p - V
        ('peak_stress', 'f8'),  # of p - m + g tau at the plate
        ('peak_strain', 'f8'),  # of the same anywhere in the layer, up to `tracked`
        ('tracked', 'i8'),  # grid point, see `_track_strain`
        ('queues', 'i8', (4,)),  # where the two queues of candidates begin and end
        ('first_work', 'f8'),
        ('work', 'f8'),  # sum of power over the impedance and h
        ('front_work', 'f8'),  # what that sum misses where power jumps
        ('power', 'f8'),  # last addend
        # at `time`
        ('plus', 'f8', (2,)),  # p at plate and top
        ('minus', 'f8', (2,)),  # m at plate and top
        ('surface', 'f8'),  # height of the top of the layer
        ('state', 'f8', (7,)),
    ],
    align=True,
)


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


@_jit
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


@_jit
def _prepare(s, N, crossing, relaxation, gravity, noise):
    """Write what follows from a rig into a record that is at rest."""
    h = crossing / N
    s.step, s.steps, s.rate = h, N, h / relaxation
    decay, m0, m1, m2, m3 = _moments(s.rate)
    s.decay = decay
    s.moments[0], s.moments[1], s.moments[2], s.moments[3] = m0, m1, m2, m3
    # The cubic through p at -1, 0, 1 and 2, integrated against e^{-x (1 - u)}
    x = 2.0 * s.rate
    cubic, line = s.weights[0], s.weights[1]
    cubic[0] = x * (-m1 / 3.0 + m2 / 2.0 - m3 / 6.0)
    cubic[1] = x * (m0 - m1 / 2.0 - m2 + m3 / 2.0)
    cubic[2] = x * (m1 + m2 / 2.0 - m3 / 2.0)
    cubic[3] = x * (-m1 / 6.0 + m3 / 6.0)
    line[1], line[2] = x * (m0 - m1), x * m1
    s.relaxation, s.gravity = relaxation, gravity
    s.gravity_offset = gravity * relaxation
    s.release_threshold = -s.gravity_offset - noise
    s.base = -N - _PAD
    s.block = -1
    s.contact = True
    s.kink = N if s.plate_kind == DAMPED else 1 << 62
    s.peak_stress = s.peak_strain = s.gravity_offset  # at rest the weight is all there is
    s.tracked = -1
    s.last_front = -(1 << 62)


@_jit
def _mass_velocity(s, d, V, a, b, c, e):
    """Solve tau V' + V = 2 p over d steps during which p = a + b u + c u^2 + e u^3."""
    if d == 1.0:
        drive = a * s.moments[0] + b * s.moments[1] + c * s.moments[2] + e * s.moments[3]
        return s.decay * V + 2.0 * s.rate * drive
    decay, zeroth, first, second, third = _moments(s.rate * d)
    drive = a * zeroth + d * (b * first + d * (c * second + d * e * third))
    return decay * V + 2.0 * s.rate * d * drive


@_jit
def _cubic(waves, i, aside):
    """Expand p at the top after index i, through four points that lie on one side of a kink."""
    i += aside
    behind, here, ahead, beyond = waves[0, i - 1], waves[0, i], waves[0, i + 1], waves[0, i + 2]
    e = (beyond - behind + 3.0 * (here - ahead)) * _RECIPROCAL[6]
    c = 0.5 * (behind + ahead) - here
    b = ahead - here - c - e
    if aside == 0:
        return here, b, c, e
    d = -float(aside)
    return here + d * (b + d * (c + d * e)), b + d * (2.0 * c + 3.0 * d * e), c + 3.0 * d * e, e


@_jit
def _free_flight(s, offset):
    """Compute time since the launch, height and velocity of the projectile."""
    time = (s.cell - s.launch_cell + (offset - s.launch_offset)) * s.step
    height = s.launch_height + time * (s.launch_velocity - 0.5 * s.gravity * time)
    return time, height, s.launch_velocity - s.gravity * time


@_jit
def _change_after(s, offset, length, V, last, P, a, b, c, e, here, slope):
    """Find after how many steps force or gap falls below 0, if it does by the end; else -1."""
    in_contact = s.contact
    if in_contact:
        if 2.0 * a - V < s.release_threshold:
            return 0.0
        end = a + length * (b + length * (c + length * e))
        if 2.0 * end - last >= s.release_threshold:
            return -1.0
    else:
        time, height, speed = _free_flight(s, offset + length)
        area = s.step * length * (here + 0.5 * slope * length)
        opens = speed >= 2.0 * (here + slope * length) + s.gravity_offset
        if opens or height >= s.top + 2.0 * (P + area) + s.gravity_offset * time:
            return -1.0
    low, high = 0.0, length
    while True:  # bisect until no number is between
        middle = 0.5 * (low + high)
        if not low < middle < high:
            return high
        if in_contact:
            p = a + middle * (b + middle * (c + middle * e))
            is_over = 2.0 * p - _mass_velocity(s, middle, V, a, b, c, e) < s.release_threshold
        else:
            time, height, _ = _free_flight(s, offset + middle)
            area = s.step * middle * (here + 0.5 * slope * middle)
            is_over = height < s.top + 2.0 * (P + area) + s.gravity_offset * time
        if is_over:
            high = middle
        else:
            low = middle


@_jit
def _push_front(s, waves, offset, jump):
    """Remember a jump of p that arrives in two crossings; False if there is no room."""
    if s.front_end - s.front_begin >= _MAX_FRONTS:
        return False
    front = waves[_FRONTS, 3 * (s.front_end % _MAX_FRONTS) :]
    front[0], front[1], front[2] = s.cell + 2 * s.steps, offset, jump
    s.front_end += 1
    return True


@_jit
def _next_front(s, waves, number):
    """Return the cell in which a front arrives, far away if there is none of that number."""
    if number >= s.front_end:
        return 1 << 62
    return int(waves[_FRONTS, 3 * (number % _MAX_FRONTS)])


@_jit
def _expand_step(s, waves, number):
    """Expand p at the top after `s.cell`: value and slope for heights, and powers for the mass."""
    cell = s.cell
    i = cell - s.base - s.steps
    here = waves[0, i]
    slope = waves[0, i + 1] - here  # heights take p as linear, of second order as the gap is
    k = number
    while _next_front(s, waves, k) == cell:
        slope -= waves[_FRONTS, 3 * (k % _MAX_FRONTS) + 2]
        k += 1
    if _next_front(s, waves, number) <= cell + 1 or cell - s.last_front <= 1:
        return here, slope, here, slope, 0.0, 0.0
    aside = 1 if cell == s.kink else (-1 if cell + 1 == s.kink else 0)
    a, b, c, e = _cubic(waves, i, aside)
    return here, slope, a, b, c, e


@_jit
def _end_step(s, waves, V, P, error):
    """Write the sample of m at the next grid point, and account for the step."""
    p = waves[0, s.cell + 1 - s.base - s.steps]
    s.cell += 1
    s.sum = P / s.step
    s.velocity = V if s.contact else 0.0
    j = s.cell - s.base
    waves[1, j] = (V - p if s.contact else p + s.gravity_offset) + error
    if s.contact and s.events == 0:
        s.peak_push = max(s.peak_push, 2.0 * p - V)
    m = waves[1, j - s.steps]
    stress = waves[0, j] - m + s.gravity_offset
    s.power = stress * (waves[0, j] + m)
    s.work += s.power
    if s.events == 0:
        s.peak_stress = max(s.peak_stress, abs(stress))


@_jit
def _write_top(s, offset, a, V, P):
    """Write what projectile and top do within a step, where p is a."""
    s.plus[1] = a
    if s.contact:
        s.minus[1] = V - a
        s.surface = s.top + 2.0 * P - s.relaxation * V
        s.state[PROJECTILE_POSITION] = s.rest_height + s.surface
        s.state[PROJECTILE_VELOCITY] = V
        s.state[PROJECTILE_FORCE] = s.mass * ((2.0 * a - V) / s.relaxation + s.gravity)
    else:
        time, height, velocity = _free_flight(s, offset)
        s.minus[1] = a + s.gravity_offset
        s.surface = s.top + 2.0 * P + s.gravity_offset * time
        s.state[PROJECTILE_POSITION] = s.rest_height + height
        s.state[PROJECTILE_VELOCITY] = velocity
        s.state[PROJECTILE_FORCE] = 0.0


@_jit
def _cross_step(s, waves, events, target):
    """
    Go through the step after `s.cell` event by event, up to an offset of `target` within it.

    Below 1 that leaves `s` there, with its state written; at 1 the step is done.
    """
    cell, is_whole = s.cell, target == 1.0
    number = s.front_begin
    here, slope, a, b, c, e = _expand_step(s, waves, number)
    V, P, offset, error = s.velocity, s.step * s.sum, 0.0, 0.0
    events_left = _EVENTS_PER_STEP
    while True:
        arrives = _next_front(s, waves, number) == cell
        front = waves[_FRONTS, 3 * (number % _MAX_FRONTS) :]
        arrives = arrives and front[1] <= target
        rest = max((front[1] if arrives else target) - offset, 0.0)
        last = _mass_velocity(s, rest, V, a, b, c, e) if s.contact else 0.0
        length = -1.0
        if events_left > 0:
            length = _change_after(s, offset, rest, V, last, P, a, b, c, e, here, slope)
        happens = length >= 0.0
        if not happens:
            length = rest
        if s.contact:
            V = _mass_velocity(s, length, V, a, b, c, e) if happens else last
        P += s.step * length * (here + 0.5 * slope * length)
        here += slope * length
        a, b, c = (
            a + length * (b + length * (c + length * e)),
            b + length * (2.0 * c + 3.0 * length * e),
            c + 3.0 * length * e,
        )
        offset += length
        if not happens and not arrives:
            break
        jump = 0.0 if happens else front[2]
        # How p, reflected by the mass and by the plate, jumps in two crossings
        echo = jump if s.contact else -jump
        a += jump
        here += jump
        if s.contact and (happens or 2.0 * a - V < s.release_threshold):  # torn off by the jump
            echo = V - 2.0 * a + jump - s.gravity_offset
            height = s.top + 2.0 * P - s.relaxation * V
            if s.events == 0:
                s.first_work = s.work + 0.5 * s.power * (2.0 * offset - 1.0)
            note_event(s, events, RELEASE, (cell + offset) * s.step, height, V)
            s.contact = False
            s.launch_cell, s.launch_offset = cell, offset
            s.launch_height, s.launch_velocity = height, V
            s.top = height - 2.0 * P
        elif happens:
            _, height, V = _free_flight(s, offset)
            s.landed = s.landed or (V <= 0.0 and s.gravity > 0.0)
            kind = LANDING if s.landed else RECONTACT
            note_event(s, events, kind, (cell + offset) * s.step, height, V)
            echo = 2.0 * a + s.gravity_offset - V
            s.contact = True
            s.top = height - 2.0 * P + s.relaxation * V
        if happens:
            events_left -= 1
        else:
            number += 1
            s.last_front = cell
        if is_whole:
            s.front_begin = number
            if not _push_front(s, waves, offset, echo):
                error += (offset - 0.5) * echo
    if is_whole:
        _end_step(s, waves, V, P, error)
    else:
        _write_top(s, offset, a, V, P)


@_jit
def _run_in_contact(s, waves, count, weights):
    """Advance by up to `count` steps, stopping before one in which the force ends below 0."""
    first, N = s.cell - s.base, s.steps
    top = waves[0, first - N - 1 :]
    behind, here, ahead = top[0], top[1], top[2]
    decay, threshold, offset = s.decay, s.release_threshold, s.gravity_offset
    w0, w1, w2, w3 = weights[0], weights[1], weights[2], weights[3]
    V, total = s.velocity, s.sum
    peak_push, peak_stress, work, power = s.peak_push, s.peak_stress, s.work, s.power
    done = count
    for n in range(count):
        beyond = top[n + 3]
        following = decay * V + ((w0 * behind + w1 * here) + (w2 * ahead + w3 * beyond))
        push = 2.0 * ahead - following
        if push < threshold:
            done = n
            break
        waves[1, first + 1 + n] = following - ahead
        total += 0.5 * (here + ahead)
        peak_push = max(peak_push, push)
        p, m = waves[0, first + 1 + n], waves[1, first + 1 + n - N]
        stress = p - m + offset
        power = stress * (p + m)
        work += power
        peak_stress = max(peak_stress, abs(stress))
        V = following
        behind, here, ahead = here, ahead, beyond
    s.cell += done
    s.velocity, s.sum, s.work, s.power = V, total, work, power
    if s.events == 0:
        s.peak_push, s.peak_stress = peak_push, peak_stress
    return done


@_jit
def _run_in_flight(s, waves, count):
    """Advance by up to `count` steps, stopping before one in which the gap ends below 0."""
    first, N = s.cell - s.base, s.steps
    step, offset = s.step, s.gravity_offset
    speed, fall = s.launch_velocity - offset, 0.5 * s.gravity
    height = s.launch_height - s.top
    start = s.cell + 1 - s.launch_cell - s.launch_offset
    here, total, work, power = waves[0, first - N], s.sum, s.work, s.power
    done = count
    for n in range(count):
        ahead = waves[0, first + 1 + n - N]
        area = total + 0.5 * (here + ahead)
        time = (start + n) * step
        if height + time * (speed - fall * time) < 2.0 * step * area:
            done = n
            break
        waves[1, first + 1 + n] = ahead + offset
        total, here = area, ahead
        p, m = waves[0, first + 1 + n], waves[1, first + 1 + n - N]
        power = (p - m + offset) * (p + m)
        work += power
    s.cell += done
    s.sum, s.work, s.power = total, work, power
    return done


@_jit
def _fill(s, waves, path, last):
    """Let p leave the plate up to grid point `last`, at most one crossing ahead of the top."""
    while s.filled < last:
        first = s.filled + 1
        count = last - s.filled
        j, N = first - s.base, s.steps
        if s.plate_kind == DAMPED:
            # Rotations of a phasor that is evaluated anew for every block
            k = first % BLOCK
            if first // BLOCK != s.block:
                s.block = first // BLOCK
                time = s.block * BLOCK * s.step
                fading = s.growth * time
                size = 0.0 if fading < -600.0 else s.factor * math.exp(fading)
                s.phasor[0] = size * math.cos(s.turn * time)
                s.phasor[1] = size * math.sin(s.turn * time)
            real, imaginary = s.phasor[0], s.phasor[1]
            count = min(count, BLOCK - k)
            leaving, coming = waves[0, j : j + count], waves[1, j - N : j - N + count]
            cosines, sines = path[0, k : k + count], path[1, k : k + count]
            for n in range(count):
                leaving[n] = (real * sines[n] + imaginary * cosines[n]) - coming[n]
        else:
            for n in range(count):
                time = (first + n) * s.step
                speed = velocity_of_piece(path, piece_at(s, path, time), time)
                waves[0, j + n] = speed - waves[1, j + n - N]
        s.filled += count


@_jit
def _shift_buffer(s, waves):
    """Move what is still needed of the waves to the start of their memory."""
    shift = s.cell - 2 * s.steps - _PAD - s.base
    count = s.filled - s.base + 1 - shift
    for w in range(2):
        for j in range(count):
            waves[w, j] = waves[w, j + shift]
    s.base += shift


@_jit
def _march(s, waves, path, events, goal):
    """Advance to grid point `goal`, or until there are more events than `s.event_limit`."""
    while s.cell < goal and s.events <= s.event_limit:
        if s.filled == s.cell:
            if s.cell + 3 - s.base > waves.shape[1]:
                _shift_buffer(s, waves)
            last = min(s.base + waves.shape[1] - 2, s.cell + s.steps)
            _fill(s, waves, path, min(goal, last))
        if s.cell > s.kink:
            s.kink += 2 * s.steps
        arrival = _next_front(s, waves, s.front_begin)
        if s.cell >= min(s.kink - 1, arrival):
            _cross_step(s, waves, events, 1.0)
        else:
            if s.contact:
                beside_front = s.cell + 1 >= arrival or s.cell - s.last_front <= 1
                count = 1 if beside_front else min(s.filled, min(s.kink, arrival) - 1) - s.cell
                weights = s.weights[1 if beside_front else 0]
                done = _run_in_contact(s, waves, count, weights)
            else:
                count = min(s.filled, s.kink - 1, arrival) - s.cell
                done = _run_in_flight(s, waves, count)
            if done < count:
                _cross_step(s, waves, events, 1.0)
        if s.tracked < s.cell:
            _track_strain(s, waves)
        while _next_front(s, waves, s.front_passed) - s.steps < s.cell:
            front = waves[_FRONTS, 3 * (s.front_passed % _MAX_FRONTS) :]
            j = int(front[0]) - s.steps - s.base
            plate_speed = waves[0, j] + waves[1, j - s.steps]
            s.front_work += (1.0 - 2.0 * front[1]) * plate_speed * front[2]
            s.front_passed += 1


@_jit
def _track_strain(s, waves):
    """
    Follow the largest strain in the layer, grid point by grid point, up to the first release.

    The strain is (m(b) - p(a) - g tau) / c_s, of a wave m that leaves the top at b and a wave p
    that leaves the plate at a; they meet inside the layer if a and b differ by a crossing at most.
    So extremes of m in a window of two crossings are wanted, and two queues of candidates, whose
    values fall (or rise) from the oldest to the newest, have them in front.
    """
    N, capacity = s.steps, waves.shape[1]
    for n in range(s.tracked + 1, s.cell + 1):
        m = waves[1, n - s.base]
        p = waves[0, n - N - s.base]
        for k in range(2):
            sign = 1.0 - 2.0 * k
            index, value = waves[2 + 2 * k], waves[3 + 2 * k]
            begin, end = s.queues[2 * k], s.queues[2 * k + 1]
            while end > begin and sign * value[(end - 1) % capacity] <= sign * m:
                end -= 1
            index[end % capacity], value[end % capacity] = n, m
            while index[begin % capacity] < n - 2 * N:
                begin += 1
            s.queues[2 * k], s.queues[2 * k + 1] = begin, end + 1
            strain = abs(p - value[begin % capacity] + s.gravity_offset)
            s.peak_strain = max(s.peak_strain, strain)
    s.tracked = s.cell
    if s.events > 0:
        s.peak_strain = _strain_so_far(s, waves)
        s.tracked = 1 << 62


@_jit
def _strain_so_far(s, waves):
    """Complete the largest strain: where waves p of the last crossing have met waves m by now."""
    i, N = s.cell - s.base, s.steps
    lowest = highest = waves[1, i - N]
    peak = s.peak_strain
    for k in range(N):
        older, newer = waves[1, i - N - k], waves[1, i - N + k]
        lowest = min(lowest, older, newer)
        highest = max(highest, older, newer)
        p = waves[0, i - k] + s.gravity_offset
        peak = max(peak, abs(p - lowest), abs(p - highest))
    return peak


@_jit
def _advance(time, core, waves, path, events):
    """Advance to `time`; the number of events so far, or what is wrong."""
    grid = core[0]
    if not time >= core[1].time:
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
    core[1] = core[0]
    s = core[1]
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
    s.state[PLATE_FORCE] = s.impedance * (m - s.plus[0]) - s.mass * s.gravity
    return s.events


@_jit
def _read_layer(core, waves, out):
    """Read heights, velocities and forces of the layer from plate to top."""
    s = core[1]
    height, velocity, force = out[0], out[1], out[2]
    i = s.cell - s.base
    rest = s.offset if s.offset > 0.0 else 1.0
    # From the last grid point to now, waves go on along a line; these places are written later.
    waves[0, i + 1] = waves[0, i] + (s.plus[0] - waves[0, i]) / rest
    waves[1, i + 1] = waves[1, i] + (s.minus[1] - waves[1, i]) / rest
    last = force.size - 1
    spacing = s.steps / last
    p_wave, m_wave = waves[0], waves[1]
    for n in range(last + 1):
        place = i + (s.offset - spacing * n)
        j = np.uintp(place)
        p = p_wave[j] + (p_wave[j + np.uintp(1)] - p_wave[j]) * (place - j)
        place = i + (s.offset - spacing * (last - n))
        j = np.uintp(place)
        m = m_wave[j] + (m_wave[j + np.uintp(1)] - m_wave[j]) * (place - j)
        velocity[n] = p + m
        force[n] = p - m
    for end in range(2):
        velocity[end * last] = s.plus[end] + s.minus[end]
        force[end * last] = s.plus[end] - s.minus[end]
    # Heights by the trapezoidal rule, its error spread over the layer so that both ends agree
    z, cell = s.state[PLATE_POSITION], s.thickness / last
    stretch = 0.5 * cell / s.wave_speed
    for n in range(last + 1):
        if n > 0:
            z += cell - stretch * (force[n - 1] + force[n] + 2.0 * s.gravity_offset)
        height[n] = z
    error = (s.rest_height + s.surface - z) / last
    for n in range(last + 1):
        height[n] += n * error
        force[n] = s.impedance * (force[n] + s.gravity_offset)


@_jit
def _stored_energy(core, waves):
    """Add up the energy of layer and projectile against rest, by the trapezoidal rule."""
    s = core[1]
    i, x = s.cell - s.base, s.offset
    total = 0.5 * x * (s.plus[0] ** 2 + s.minus[1] ** 2)
    for w in range(2):
        total += 0.5 * x * waves[w, i] ** 2 + 0.5 * waves[w, i] ** 2
        for n in range(1, s.steps):
            total += waves[w, i - n] ** 2
        first, second = waves[w, i - s.steps], waves[w, i - s.steps + 1]
        start = first + x * (second - first)
        total += 0.5 * first**2 - 0.5 * x * (first**2 + start**2)
    for number in range(s.front_begin, s.front_end):  # squares jump within a step
        left = _next_front(s, waves, number) - 2 * s.steps
        w = 1 if left + s.steps >= s.cell else 0
        j = left - s.base if w == 1 else left + s.steps - s.base
        if j < i:
            offset = waves[_FRONTS, 3 * (number % _MAX_FRONTS) + 1]
            total += (0.5 - offset) * (waves[w, j + 1] ** 2 - waves[w, j] ** 2)
    motion = 0.5 * s.mass * s.state[PROJECTILE_VELOCITY] ** 2
    height = s.state[PROJECTILE_POSITION] - s.rest_height
    lift = s.state[PLATE_POSITION] + height - s.surface
    return s.impedance * s.step * total + motion + s.mass * s.gravity * lift


@_jit
def _reset(core, waves):
    """Put everything back to rest."""
    core[0] = core[2]
    core[1] = core[2]
    waves[:] = 0.0


@_jit
def _copy_waves(waves, origin, core):
    """Copy the waves that are still on their way."""
    s = core[0]
    first, last = s.cell - 2 * s.steps - _PAD - s.base, s.filled + 2 - s.base
    first = max(first, 0)
    for w in range(2):
        waves[w, first:last] = origin[w, first:last]
    waves[_FRONTS, : 3 * _MAX_FRONTS] = origin[_FRONTS, : 3 * _MAX_FRONTS]
    if s.events == 0:  # the queues of `_track_strain`
        waves[2:_FRONTS] = origin[2:_FRONTS]


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

    _advance = staticmethod(_advance)
    _restart = staticmethod(_reset)
    _changing = ('_core', '_waves')

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
        noise = _NOISE * rig.engine.speed_scale
        _prepare(start, self.steps, rig.crossing_time, rig.relaxation_time, rig.gravity, noise)
        start['event_limit'] = len(self._events)
        start['wave_speed'] = rig.layer.wave_speed
        start['thickness'] = rig.layer.thickness
        start['impedance'] = rig.layer.impedance
        start['mass'] = rig.projectile.mass
        start['rest_height'] = rig.layer.thickness - rig.static_sag
        self._waves = np.zeros((7, 4 * self.steps + _ROOM))
        self._scratch = np.zeros((3, field_points))
        self._work_unit = rig.layer.impedance * float(start['step'])
        self._memory = (self._core, self._waves, self._path, self._events)
        self.reset()

    def _copy_from(self, origin: Stepper) -> None:
        """Copy records, and the waves that are still on their way."""
        assert isinstance(origin, WaveStepper)
        self._core.view(np.uint8)[:] = origin._core.view(np.uint8)
        _copy_waves(self._waves, origin._waves, self._core)

    def _read_layer(self, out: Floats) -> None:
        """Write the layer; between grid points both waves are lines."""
        _read_layer(self._core, self._waves, out)

    def _read_strain(self, strain: Floats) -> None:
        """Write the strain, which is the force over the layer's stiffness."""
        _read_layer(self._core, self._waves, self._scratch)
        stiffness = self.rig.layer.wave_speed * self.rig.layer.impedance
        np.divide(self._scratch[2], -stiffness, out=strain)

    @property
    def cost(self) -> float:
        """Time of a processor over time of the rig, about. [-]"""
        return _STEP_COST * self.steps / self.rig.crossing_time

    @property
    def loads(self) -> Loads:
        """Largest loads up to the first release, or so far if that is to come."""
        layer, now = self.rig.layer, self._core[1]
        push, stress = float(now['peak_push']), float(now['peak_stress'])
        contact_stress = push + float(now['gravity_offset'])
        inside = float(now['peak_strain'])
        if now['events'] == 0 or now['tracked'] < 1 << 62:
            inside = float(_strain_at_now(self._core, self._waves))
        return Loads(
            strain=max(inside, stress, contact_stress) / layer.wave_speed,
            plate_strain=stress / layer.wave_speed,
            contact_strain=contact_stress / layer.wave_speed,
            acceleration=push / self.rig.relaxation_time,
            plate_force=stress * layer.impedance,
        )

    @property
    def work_so_far(self) -> float:
        """Work of the plate up to the last grid point, by the trapezoidal rule. [J]"""
        now = self._core[1]
        part = (now['offset'] - 0.5) * now['power']
        return float(self._work_unit * (now['work'] + now['front_work'] + part))

    def stored_energy(self) -> float:
        """Add up the energy of layer and projectile against rest, to second order. [J]"""
        return float(_stored_energy(self._core, self._waves))


@_jit
def _strain_at_now(core, waves):
    """Find the largest strain up to the last grid point."""
    return _strain_so_far(core[1], waves)


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
    steps = np.maximum(_STEPS_PER_RELAXATION / ratios[0], _STEPS_PER_PERIOD / ratios[1])
    steps = np.clip(np.ceil(steps), _FEWEST_STEPS, _STEPS).astype(np.int64)
    found = np.full((6, ratios.shape[1]), math.nan)

    def run(part: int, parts: int) -> None:
        core = np.zeros(2, _CORE)
        waves = np.zeros((7, 4 * int(steps.max(initial=0)) + _ROOM))
        _first_throws(ratios, steps, core, waves, found, part, parts)

    in_threads(run, count=ratios.shape[1], per_thread=_THROWS_PER_THREAD, threads=threads)
    return FirstThrows.collect(found, ratios, shape, unresolved, f'{_MAX_PERIODS:g} periods')


@_jit
def _first_throws(ratios, steps, core, waves, found, part, parts):
    """Follow every throw of `parts`, from number `part` on, in units of 1 / f and A omega."""
    event = np.empty((1, 4))
    path = np.empty((2, BLOCK))
    for n in range(part, steps.size, parts):
        mu, kappa, zeta, gravity = ratios[0, n], ratios[1, n], ratios[2, n], ratios[3, n]
        core[0] = core[1]
        s = core[0]
        write_underdamped(s, path, 1.0, 2.0 * math.pi, zeta, 1.0 / (kappa * steps[n]))
        _prepare(s, steps[n], 1.0 / kappa, mu / kappa, 2.0 * math.pi * gravity, _NOISE)
        waves[:, : s.steps + _PAD + 1] = 0.0
        natural = 2.0 * math.pi * math.sqrt(mu) / kappa  # period of the mass on a massless layer
        latest = min(_MAX_PERIODS * (1.0 + natural) * kappa, _MAX_CROSSINGS) + 1.0
        _march(s, waves, path, event, int(latest) * s.steps)
        if s.events == 0:
            continue
        found[0, n], found[1, n] = event[0, 1], event[0, 3]
        contact_stress = s.peak_push + s.gravity_offset
        found[2, n] = max(s.peak_strain, s.peak_stress, contact_stress)
        found[3, n] = s.peak_push / (2.0 * math.pi * s.relaxation)
        found[4, n] = s.peak_stress
        found[5, n] = s.first_work * s.step / s.relaxation


def warm_up() -> None:
    """Compile or load all kernels that the twin needs."""
    load_kernels(WaveStepper(Rig(), 'measured', field_points=2))
