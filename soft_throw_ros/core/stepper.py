# SPDX-License-Identifier: Apache-2.0
r"""
The travelling-wave model advanced in real time: contact, release, flight and landing.

Notes
-----
With :math:`p = v_+` and :math:`m = v_-` of Sec. IV of [1]_, at the top of the layer

.. math::

    p(t) &= V_p(t - t_s) - m(t - 2 t_s) \\
    \tau \dot V + V &= 2 p, \quad m = V - p \qquad \text{in contact} \\
    m &= p + g \tau \qquad\qquad\qquad\quad \text{in flight}

where everything counts from the static equilibrium, and the layer pushes the projectile with
:math:`F = (m_r / \tau) (2 p - V) + m_r g`. The projectile leaves when F falls below zero, be it
gradually or in a jump (an echo of a landing), and lands when the gap closes, its speed unchanged.
Flight, landing and gravity are not in [1]_'s analytical model.

The step h divides :math:`t_s`, so the waves travel from grid point to grid point without any
error, and the kinks that the start of the plate sends through the layer at odd multiples of
:math:`t_s` fall on grid points. What has to be computed is the answer of the mass: p is known
:math:`t_s` ahead, is interpolated by the cubic through four neighbouring points (beside a kink:
on one side of it), and the equation of V is solved for it exactly, however small :math:`\tau`
is. Fourth order in h; with the cubic centred on the step, no wave that is reflected by the mass
grows. Release, landing and everything between grid points are roots and values of that solution.

A release is a kink, and a landing a jump, that comes back every :math:`2 t_s` off the grid. Its
place between two grid points and its size in value and three derivatives are kept (a "front") and
carried over each reflection by the same equations; the cubics are freed of it and it is added
where it belongs, so that later events are of fourth order too. Each reflection by the mass makes
it steeper (the Laguerre functions of `soft_throw_ros.core.travelling_wave`). When after
:math:`0.3 \tau / h` reflections the first of them is noise between two grid points, or after 64
events (fewer if steps are short, for time's sake), all fronts are let go: from then on events are
of first order in the jumps before them, and energy is no longer kept to 1e-7 but decays by some
percent. A lossless bounce is chaotic by then.

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
from numpy.typing import NDArray
from soft_throw_ros.core.moving_plate import (
    DAMPED,
    end_of_motion,
    piece_at,
    PLATE,
    plate_at,
    speed_of_piece,
    take_samples,
    take_states,
    write_motion,
)
from soft_throw_ros.core.plate import PlateMotion, Sampled
from soft_throw_ros.core.rig import Rig
from soft_throw_ros.core.stepping import (
    BACKWARDS,
    BEYOND_HORIZON,
    checked_count,
    MAX_EVENTS,
    Peaks,
    PLATE_FORCE,
    PLATE_POSITION,
    PLATE_VELOCITY,
    PROJECTILE_FORCE,
    PROJECTILE_POSITION,
    PROJECTILE_VELOCITY,
    ThrowStepper,
    TIME,
    TOO_FAR,
    TOO_MANY_EVENTS,
)

Floats = NDArray[np.float64]

MAX_STEPS = 8192
"""Most steps per crossing of the wave."""

MAX_STEP_RATE = 2e7
"""Most steps per second of rig time, of which a processor takes 4e8 in a second. [1/s]"""

_MIN_STEPS = 64
_STEPS_PER_PERIOD = 160.0
_STEPS_PER_RELAXATION = 8.0

_PAD = 8  # steps that are kept beyond the crossing time, for the cubics
_ROOM = 1024  # steps by which the waves' memory is longer than need be, to be moved seldom
_BLOCK = 256  # steps between exact evaluations of the underdamped plate
_MAX_FRONTS = 64
_FRONT_COST = 80.0  # of a front on its way up and down, in steps
_NOISE = 1e-12  # of the plate's speed, which is no pull
_EVENTS_PER_STEP = 8  # a mass that chatters faster stays as it is until the next step
_FRONT_LIFE = 0.3  # in tau / h reflections by the mass, after which a front is noise

_CELL, _OFFSET, _AGE, _SIZE, _NEXT = 0, 1, 2, 3, 7  # columns of fronts, the last two fourfold
_FRONT_COLUMNS = 11

_RECIPROCAL = 1.0 / np.maximum(np.arange(25.0), 1.0)
_NODES, _NODE_WEIGHTS = np.polynomial.legendre.leggauss(4)

_jit = nb.njit(cache=True, nogil=True, error_model='numpy')

# Two such records make a stepper: the first stands at a grid point, the second between.
# Lengths are relative to the static equilibrium, offsets and fronts are in steps.
_CORE = np.dtype(
    [
        # what stays
        ('step', 'f8'),  # h [s]
        ('steps', 'i8'),  # N = t_s / h
        ('rate', 'f8'),  # h / tau
        ('decay', 'f8'),  # e^{-h / tau}
        ('moments', 'f8', (4,)),  # of it, see `_moments`
        ('weights', 'f8', (4,)),  # V(t + h) = decay V(t) + weights . p
        ('relaxation', 'f8'),  # tau [s]
        ('gravity', 'f8'),  # g [m/s2]
        ('drop', 'f8'),  # g tau [m/s]
        ('floor', 'f8'),  # 2 p - V at which the projectile leaves: -g tau, less noise
        ('wave_speed', 'f8'),
        ('impedance', 'f8'),
        ('mass', 'f8'),
        ('rest_height', 'f8'),  # of the projectile's lower face [m]
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
        ('stop', 'i8'),  # next cell that needs care
        ('kink', 'i8'),  # next grid point at which p has a kink at the top
        ('fronts', 'i8'),
        ('next_front', 'i8'),  # where their queue begins
        ('room', 'i8'),  # for fronts
        ('rough', '?'),  # whether there are jumps that are no front
        # the mass and the top of the layer
        ('contact', '?'),
        ('velocity', 'f8'),  # V in contact
        ('sum', 'f8'),  # of p, for its integral P = h (sum + ...) + anchor
        ('anchor', 'f8'),
        ('top', 'f8'),  # height of the top less 2 P - tau V, in flight less 2 P + g tau t
        ('launch_cell', 'i8'),
        ('launch_offset', 'f8'),
        ('launch_height', 'f8'),
        ('launch_velocity', 'f8'),
        ('events', 'i8'),
        ('falling', '?'),
        # what was largest
        ('push', 'f8'),  # 2 p - V
        ('load', 'f8'),  # p - m + g tau at the plate
        ('first_push', 'f8'),
        ('first_load', 'f8'),
        ('work', 'f8'),  # sum of power over Z
        ('power', 'f8'),  # last addend
        ('most_work', 'f8'),
        ('highest', 'f8'),
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

    Parameters
    ----------
    rig : Rig
        The rig.

    Returns
    -------
    int
        At least 64, 8 per relaxation time :math:`\tau` and 160 per period of the plate: errors
        of the first release stay below 1e-6 in :math:`t_e f` and :math:`V_e / (A \omega)`.

    Raises
    ------
    ValueError
        If the layer is graded or has loss, or more than `MAX_STEPS` steps, or `MAX_STEP_RATE` in
        a second, would be needed; it says which number, which limit and what would do.

    Examples
    --------
    >>> steps_per_crossing(Rig())
    64

    """
    rig.check_for_waves()
    layer, crossing = rig.layer, rig.crossing_time
    shortest = _MIN_STEPS / MAX_STEP_RATE
    if crossing < shortest:
        raise ValueError(
            f'layer.thickness {layer.thickness:g} m at layer.wave_speed {layer.wave_speed:g} m/s '
            f'needs {_MIN_STEPS / crossing:.3g} steps per second, the limit is '
            f'{MAX_STEP_RATE:g}; feasible: layer.thickness of '
            f'{1.001 * shortest * layer.wave_speed:.4g} m or more, or layer.wave_speed of '
            f'{0.999 * layer.thickness / shortest:.4g} m/s or less'
        )
    limit = math.floor(min(MAX_STEPS, MAX_STEP_RATE * crossing))
    for_mass = math.ceil(_STEPS_PER_RELAXATION / rig.mass_ratio)
    if for_mass > limit:
        least = rig.projectile.mass * for_mass / limit
        raise ValueError(
            f'projectile.mass {rig.projectile.mass:g} kg on a layer of {layer.mass:.4g} kg needs '
            f'{for_mass} steps per crossing of the wave, the limit is {limit}; '
            f'feasible: projectile.mass of {1.001 * least:.4g} kg or more'
        )
    for_plate = math.ceil(_STEPS_PER_PERIOD * crossing * rig.engine.frequency)
    if for_plate > limit:
        most = rig.engine.frequency * limit / for_plate
        raise ValueError(
            f'engine.frequency {rig.engine.frequency:g} Hz with a crossing time of '
            f'{crossing:.4g} s needs {for_plate} steps per crossing of the wave, the limit is '
            f'{limit}; feasible: engine.frequency of {0.999 * most:.4g} Hz or less'
        )
    return max(_MIN_STEPS, for_mass, for_plate)


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
def _follow(s, d, V, a, b, c, e):
    """Take V over d steps during which p = a + b u + c u^2 + e u^3."""
    if d == 1.0:
        drive = a * s.moments[0] + b * s.moments[1] + c * s.moments[2] + e * s.moments[3]
        return s.decay * V + 2.0 * s.rate * drive
    decay, zeroth, first, second, third = _moments(s.rate * d)
    drive = a * zeroth + d * (b * first + d * (c * second + d * e * third))
    return decay * V + 2.0 * s.rate * d * drive


@_jit
def _value(d, a, b, c, e):
    """Evaluate a cubic."""
    return a + d * (b + d * (c + d * e))


@_jit
def _area(d, a, b, c, e):
    """Integrate a cubic from 0."""
    return d * (a + d * (0.5 * b + d * (c * _RECIPROCAL[3] + d * 0.25 * e)))


@_jit
def _expand(d, a, b, c, e):
    """Expand a cubic about d."""
    return a + d * (b + d * (c + d * e)), b + d * (2.0 * c + 3.0 * d * e), c + 3.0 * d * e, e


@_jit
def _downward(V, rate, a, b, c, e):
    """Expand m = V - p in contact as a cubic, where p = a + b u + c u^2 + e u^3."""
    first = rate * (2.0 * a - V)
    second = 0.5 * rate * (2.0 * b - first)
    third = rate * _RECIPROCAL[3] * (2.0 * c - second)
    return V - a, first - b, second - c, third - e


@_jit
def _front_at(s, fronts, n, cell):
    """
    Place the n-th front of the queue: which it is, steps after `cell`, where its size stands.

    Fronts that have just passed the top are what they will be when they come back.
    """
    f = (s.next_front + n) % _MAX_FRONTS
    distance = int(fronts[f, _CELL]) - cell
    if distance < -s.steps:
        return f, distance + 2 * s.steps, _NEXT
    return f, distance, _SIZE


@_jit
def _front_size(fronts, f, column, d):
    """Evaluate the jump across a front, d steps beyond it."""
    return _value(
        d, fronts[f, column], fronts[f, column + 1], fronts[f, column + 2], fronts[f, column + 3]
    )


@_jit
def _aside(s, cell):
    """Tell by how many points the cubic is moved aside from a kink at a grid point."""
    if cell == s.kink:
        return 1
    return -1 if cell + 1 == s.kink else 0


@_jit
def _cubic(s, fronts, waves, w, i, aside, cell, sign):
    """
    Interpolate wave w after index i as a cubic, as it is before the fronts within the step.

    `cell` is when that wave arrives (next) at the top as p, which it does times `sign`.
    """
    i += aside
    behind, here, ahead, beyond = waves[w, i - 1], waves[w, i], waves[w, i + 1], waves[w, i + 2]
    for n in range(s.fronts):
        f, distance, column = _front_at(s, fronts, n, cell)
        if distance > 3 and column == _SIZE:
            break
        if -4 < distance < 4:
            place = distance + fronts[f, _OFFSET] - aside
            beside = distance - aside
            if distance >= 0:  # what is beyond the front is taken back, ...
                if beside < 0:
                    here -= sign * _front_size(fronts, f, column, -place)
                if beside < 1:
                    ahead -= sign * _front_size(fronts, f, column, 1.0 - place)
                if beside < 2:
                    beyond -= sign * _front_size(fronts, f, column, 2.0 - place)
            else:  # ... or what is before it is taken along
                if beside >= -1:
                    behind += sign * _front_size(fronts, f, column, -1.0 - place)
                if beside >= 0:
                    here += sign * _front_size(fronts, f, column, -place)
                if beside >= 1:
                    ahead += sign * _front_size(fronts, f, column, 1.0 - place)
    e = (beyond - behind + 3.0 * (here - ahead)) * _RECIPROCAL[6]
    c = 0.5 * (behind + ahead) - here
    b = ahead - here - c - e
    if aside != 0:
        return _expand(-float(aside), here, b, c, e)
    return here, b, c, e


@_jit
def _front_within(s, fronts, cell, passed):
    """Find the first front within a step that is not among the passed: offset, which, column."""
    offset, first, where = 1.0, -1, _SIZE
    for n in range(s.fronts):
        f, distance, column = _front_at(s, fronts, n, cell)
        if distance > 0 and column == _SIZE:
            break
        if distance == 0 and fronts[f, _OFFSET] <= offset and not (passed >> f) & 1:
            offset, first, where = fronts[f, _OFFSET], f, column
    return offset, first, where


@_jit
def _within(s, fronts, waves, w, i, cell, sign, offset):
    """Interpolate wave w at `offset` after index i, see `_cubic`."""
    a, b, c, e = _cubic(s, fronts, waves, w, i, _aside(s, cell), cell, sign)
    value = _value(offset, a, b, c, e)
    for n in range(s.fronts):
        f, distance, column = _front_at(s, fronts, n, cell)
        if distance > 0 and column == _SIZE:
            break
        if distance == 0 and fronts[f, _OFFSET] < offset:
            value += sign * _front_size(fronts, f, column, offset - fronts[f, _OFFSET])
    return value


@_jit
def _queue_front(s, fronts, cell):
    """Make room for a front among those that arrive earlier or later."""
    n = s.fronts
    f = (s.next_front + n) % _MAX_FRONTS
    while n > 0:
        before = (f - 1) % _MAX_FRONTS
        if fronts[before, _CELL] <= cell:
            break
        for k in range(_FRONT_COLUMNS):
            fronts[f, k] = fronts[before, k]
        f = before
        n -= 1
    s.fronts += 1
    fronts[f, _CELL] = cell
    return f


@_jit
def _add_front(s, fronts, cell, offset, a, b, c, e):
    """Remember a front that arrives as p at the top, unless the waves have become too rough."""
    if s.fronts >= s.room:
        s.rough = True
    if s.rough:
        return
    f = _queue_front(s, fronts, cell)
    fronts[f, _OFFSET] = offset
    fronts[f, _AGE] = 0.0
    fronts[f, _SIZE] = a
    fronts[f, _SIZE + 1] = b
    fronts[f, _SIZE + 2] = c
    fronts[f, _SIZE + 3] = e
    s.stop = min(s.stop, cell - 1)


@_jit
def _reflect(s, fronts, f, whole):
    """Work out what a front will be when it comes back, if nothing happens as it arrives."""
    answer = 0.0  # of V
    for n in range(4):
        size = fronts[f, _SIZE + n]
        if s.contact:
            fronts[f, _NEXT + n] = size - answer
            answer = s.rate * _RECIPROCAL[n + 1] * (2.0 * size - answer)
        else:
            fronts[f, _NEXT + n] = -size
    if whole and s.contact:
        fronts[f, _AGE] += 1.0
        s.rough = s.rough or fronts[f, _AGE] * s.rate > _FRONT_LIFE


@_jit
def _arrive(s, fronts):
    """Send on what has passed, find the next cell that needs care; tell if this one does."""
    cell = s.cell
    if cell > s.kink:
        s.kink += 2 * s.steps
    careful = cell + 1 >= s.kink
    s.stop = cell + 1 if careful else s.kink - 1
    while s.fronts > 0:
        first = s.next_front
        if fronts[first, _CELL] > cell - 3:
            break
        s.next_front = (first + 1) % _MAX_FRONTS
        s.fronts -= 1
        if not s.rough:
            age, offset = fronts[first, _AGE], fronts[first, _OFFSET]
            a, b = fronts[first, _NEXT], fronts[first, _NEXT + 1]
            c, e = fronts[first, _NEXT + 2], fronts[first, _NEXT + 3]
            f = _queue_front(s, fronts, fronts[first, _CELL] + 2 * s.steps)
            fronts[f, _AGE], fronts[f, _OFFSET] = age, offset
            fronts[f, _SIZE], fronts[f, _SIZE + 1] = a, b
            fronts[f, _SIZE + 2], fronts[f, _SIZE + 3] = c, e
    for n in range(s.fronts):
        f = (s.next_front + n) % _MAX_FRONTS
        distance = int(fronts[f, _CELL]) - cell
        if distance > 1:
            s.stop = min(s.stop, cell + distance - 1)
            break
        careful = careful or distance >= -1
        s.stop = cell + 1
    return careful


@_jit
def _note(s, events, kind, cell, offset, velocity):
    """Write down an event, and tell whether there was room."""
    if s.events == MAX_EVENTS:
        return False
    events[s.events, 0] = kind
    events[s.events, 1] = (cell + offset) * s.step
    events[s.events, 2] = velocity
    s.events += 1
    return True


@_jit
def _leave(s, cell, offset, V, P):
    """Let the projectile go."""
    height = s.top + 2.0 * P - s.relaxation * V
    s.contact = False
    s.launch_cell = cell
    s.launch_offset = offset
    s.launch_height = height
    s.launch_velocity = V
    s.top = height - 2.0 * P
    s.highest = max(s.highest, height)
    if s.events == 1:
        s.first_push = s.push
        s.first_load = s.load


@_jit
def _airborne(s, cell, offset):
    """Time since the launch, height and velocity of the projectile."""
    time = (cell - s.launch_cell + (offset - s.launch_offset)) * s.step
    height = s.launch_height + time * (s.launch_velocity - 0.5 * s.gravity * time)
    return time, height, s.launch_velocity - s.gravity * time


@_jit
def _highest_of_flight(s, time, height):
    """Highest point of the flight up to now."""
    if s.launch_velocity > 0.0 and s.launch_velocity < s.gravity * time:
        return s.launch_height + 0.5 * s.launch_velocity**2 / s.gravity
    return max(height, s.launch_height)


@_jit
def _pulls(s, d, V, a, b, c, e):
    """Tell if the force on the projectile would be a pull after d steps in contact."""
    return 2.0 * _value(d, a, b, c, e) - _follow(s, d, V, a, b, c, e) < s.floor


@_jit
def _gap(s, cell, offset, d, P, a, b, c, e):
    """Find the gap in flight, d steps after `offset`."""
    time, height, _ = _airborne(s, cell, offset + d)
    return height - (s.top + 2.0 * (P + s.step * _area(d, a, b, c, e)) + s.drop * time)


@_jit
def _integral(s, waves, i):
    """Integrate p at the top up to index i: cubics over each step, summed up."""
    ends = (waves[0, i - 1] - waves[0, i + 1]) * _RECIPROCAL[24] - 0.5 * waves[0, i]
    return s.step * (s.sum + ends) + s.anchor


@_jit
def _event_within(s, cell, offset, length, V, last, P, a, b, c, e):
    """Find after how many steps force or gap falls below 0, if it does so by the end; else -1."""
    low, high = 0.0, length
    if s.contact:
        if 2.0 * a - V < s.floor:
            return 0.0
        if 2.0 * _value(length, a, b, c, e) - last >= s.floor:
            return -1.0
        while True:
            middle = 0.5 * (low + high)
            if not low < middle < high:
                return high
            if _pulls(s, middle, V, a, b, c, e):
                high = middle
            else:
                low = middle
    _, _, speed = _airborne(s, cell, offset + length)
    opening = speed >= 2.0 * _value(length, a, b, c, e) + s.drop
    if opening or _gap(s, cell, offset, length, P, a, b, c, e) >= 0.0:
        return -1.0
    while True:
        middle = 0.5 * (low + high)
        if not low < middle < high:
            return high
        if _gap(s, cell, offset, middle, P, a, b, c, e) < 0.0:
            high = middle
        else:
            low = middle


@_jit
def _cross(s, waves, fronts, events, until):
    """
    Go through the step after `s.cell` event by event and front by front.

    Up to `until` if that is below 1, writing the state of `s` and changing nothing else that is
    not worked out again; else through the whole step to the next grid point. False if there were
    too many events.
    """
    cell = s.cell
    i = cell - s.base - s.steps
    a, b, c, e = _cubic(s, fronts, waves, 0, i, _aside(s, cell), cell, 1.0)
    V = s.velocity
    P = _integral(s, waves, i)
    if s.contact:
        s.highest = max(s.highest, s.top + 2.0 * P - s.relaxation * V)
    whole = until >= 1.0
    target = min(until, 1.0)
    offset = 0.0
    passed = 0
    events_left = _EVENTS_PER_STEP
    while True:
        end, arriving, _ = _front_within(s, fronts, cell, passed)
        last = _follow(s, end - offset, V, a, b, c, e) if s.contact else 0.0
        length = -1.0
        if events_left > 0:
            length = _event_within(s, cell, offset, end - offset, V, last, P, a, b, c, e)
        happens = length >= 0.0
        following = offset + length if happens else end
        done = target < following or (arriving < 0 and not happens)
        if done:
            following = target
        length = following - offset
        if s.contact:
            V = last if following == end else _follow(s, length, V, a, b, c, e)
        P += s.step * _area(length, a, b, c, e)
        a, b, c, e = _expand(length, a, b, c, e)
        offset = following
        if done:
            break
        if not happens:
            passed |= 1 << arriving
            _reflect(s, fronts, arriving, whole)
            if s.contact:
                before = _downward(V, s.rate, a, b, c, e)
            a += fronts[arriving, _SIZE]
            b += fronts[arriving, _SIZE + 1]
            c += fronts[arriving, _SIZE + 2]
            e += fronts[arriving, _SIZE + 3]
            if s.contact:
                s.push = max(s.push, 2.0 * a - V)
                if 2.0 * a - V < s.floor and events_left > 0:  # an echo tears it off
                    events_left -= 1
                    if not _note(s, events, 0.0, cell, offset, V):
                        return False
                    _leave(s, cell, offset, V, P)
                    fronts[arriving, _NEXT] = before[0] - (a + s.drop)
                    fronts[arriving, _NEXT + 1] = before[1] - b
                    fronts[arriving, _NEXT + 2] = before[2] - c
                    fronts[arriving, _NEXT + 3] = before[3] - e
            continue
        events_left -= 1
        sign = 1.0  # m changes from free to loaded, and comes back as its opposite
        if s.contact:
            if not _note(s, events, 0.0, cell, offset, V):
                return False
            _leave(s, cell, offset, V, P)
            sign = -1.0
        else:
            time, height, V = _airborne(s, cell, offset)
            if not _note(s, events, 1.0, cell, offset, V):
                return False
            s.highest = max(s.highest, _highest_of_flight(s, time, height))
            s.push = max(s.push, 2.0 * a - V)
            s.top = height - 2.0 * P + s.relaxation * V
            s.falling = V < 0.0
            s.contact = True
        if whole:
            loaded = _downward(V, s.rate, a, b, c, e)
            _add_front(
                s,
                fronts,
                cell + 2 * s.steps,
                offset,
                sign * (a + s.drop - loaded[0]),
                sign * (b - loaded[1]),
                sign * (c - loaded[2]),
                sign * (e - loaded[3]),
            )
    if whole:
        _settle(s, waves, V, P)
        return True
    s.plus[1] = a
    if s.contact:
        s.minus[1] = V - a
        s.surface = s.top + 2.0 * P - s.relaxation * V
        s.state[PROJECTILE_POSITION] = s.rest_height + s.surface
        s.state[PROJECTILE_VELOCITY] = V
        force = s.mass / s.relaxation * (2.0 * a - V) + s.mass * s.gravity
        s.state[PROJECTILE_FORCE] = force
    else:
        time, height, velocity = _airborne(s, cell, offset)
        s.highest = max(s.highest, _highest_of_flight(s, time, height))
        s.minus[1] = a + s.drop
        s.surface = s.top + 2.0 * P + s.drop * time
        s.state[PROJECTILE_POSITION] = s.rest_height + height
        s.state[PROJECTILE_VELOCITY] = velocity
        s.state[PROJECTILE_FORCE] = 0.0
    return True


@_jit
def _settle(s, waves, V, P):
    """Arrive at the next grid point, with V in contact, and P there."""
    s.cell += 1
    j = s.cell - s.base
    i = j - s.steps
    if s.contact:
        s.velocity = V
        waves[1, j] = V - waves[0, i]
        s.push = max(s.push, 2.0 * waves[0, i] - V)
        if (V < 0.0) != s.falling:
            s.falling = not s.falling
            s.highest = max(s.highest, s.top + 2.0 * P - s.relaxation * V)
    else:
        s.velocity = 0.0
        waves[1, j] = waves[0, i] + s.drop
    s.sum = 0.0
    s.anchor = 0.0
    s.anchor = P - _integral(s, waves, i)
    strain = (waves[0, j] - waves[1, i]) + s.drop
    s.load = max(s.load, abs(strain))
    s.power = strain * (waves[0, j] + waves[1, i])
    s.work += s.power
    s.most_work = max(s.most_work, s.work)


@_jit
def _run_in_contact(s, waves, count):
    """Advance by up to `count` steps, stopping before one in which the force ends below 0."""
    first, N = s.cell - s.base, s.steps
    behind, here, ahead = waves[0, first - N - 1], waves[0, first - N], waves[0, first - N + 1]
    decay = s.decay
    w0, w1, w2, w3 = s.weights[0], s.weights[1], s.weights[2], s.weights[3]
    step, relaxation, anchor, top = s.step, s.relaxation, s.anchor, s.top
    drop, floor = s.drop, s.floor
    V, total, falling = s.velocity, s.sum, s.falling
    push, load, work, power, most_work = s.push, s.load, s.work, s.power, s.most_work
    done = count
    for n in range(count):
        i = first + 1 + n
        beyond = waves[0, i - N + 1]
        following = decay * V + ((w0 * behind + w1 * here) + (w2 * ahead + w3 * beyond))
        force = 2.0 * ahead - following
        if force < floor:
            done = n
            break
        waves[1, i] = following - ahead
        total += ahead
        push = max(push, force)
        if (following < 0.0) != falling:  # the top turns: the parabola through its highest point
            falling = not falling
            P = step * (total - 0.5 * ahead + (here - beyond) * _RECIPROCAL[24]) + anchor
            height = top + 2.0 * P - relaxation * following
            height += 0.5 * step * following * following / abs(V - following)
            s.highest = max(s.highest, height)
        p, m = waves[0, i], waves[1, i - N]
        strain = (p - m) + drop
        power = strain * (p + m)
        work += power
        load = max(load, abs(strain))
        most_work = max(most_work, work)
        V = following
        behind, here, ahead = here, ahead, beyond
    s.cell += done
    s.velocity, s.sum, s.falling = V, total, falling
    s.push, s.load, s.work, s.power, s.most_work = push, load, work, power, most_work
    return done


@_jit
def _run_in_flight(s, waves, count):
    """Advance by up to `count` steps, stopping before one in which the gap ends below 0."""
    first, N = s.cell - s.base, s.steps
    here, ahead = waves[0, first - N], waves[0, first - N + 1]
    step, drop = s.step, s.drop
    speed = s.launch_velocity - drop
    fall = 0.5 * s.gravity
    height = s.launch_height - s.top - 2.0 * s.anchor
    start = s.cell + 1 - s.launch_cell - s.launch_offset
    total = s.sum
    load, work, power, most_work = s.load, s.work, s.power, s.most_work
    done = count
    for n in range(count):
        i = first + 1 + n
        beyond = waves[0, i - N + 1]
        following = total + ahead
        area = step * (following - 0.5 * ahead + (here - beyond) * _RECIPROCAL[24])
        time = (start + n) * step
        if height + time * (speed - fall * time) < 2.0 * area:
            done = n
            break
        waves[1, i] = ahead + drop
        total = following
        p, m = waves[0, i], waves[1, i - N]
        strain = (p - m) + drop
        power = strain * (p + m)
        work += power
        load = max(load, abs(strain))
        most_work = max(most_work, work)
        here, ahead = ahead, beyond
    s.cell += done
    s.sum = total
    s.load, s.work, s.power, s.most_work = load, work, power, most_work
    return done


@_jit
def _phasor_at(s, time):
    """Compute factor e^{lambda t} of the underdamped plate."""
    fading = s.growth * time
    if fading < -600.0:  # spares everything after it from subnormal numbers
        return 0.0, 0.0
    size = s.factor * math.exp(fading)
    return size * math.cos(s.turn * time), size * math.sin(s.turn * time)


@_jit
def _swing(waves, path, j, back, k, count, real, imaginary):
    """Fill p with the underdamped plate: apart, so that it is done in vectors."""
    leaving, coming = waves[0, j : j + count], waves[1, back : back + count]
    cosines, sines = path[0, k : k + count], path[1, k : k + count]
    for n in range(count):
        leaving[n] = (real * sines[n] + imaginary * cosines[n]) - coming[n]


@_jit
def _fill(s, waves, path, last):
    """Let p leave the plate up to grid point `last`, at most one crossing ahead of the top."""
    while s.filled < last:
        first = s.filled + 1
        count = last - s.filled
        j = first - s.base
        N = s.steps
        if s.kind == DAMPED:
            block = first // _BLOCK
            k = first - block * _BLOCK
            if block != s.block:
                s.block = block
                s.phasor[0], s.phasor[1] = _phasor_at(s, block * _BLOCK * s.step)
            real, imaginary = s.phasor[0], s.phasor[1]
            count = min(count, _BLOCK - k)
            _swing(waves, path, j, j - N, k, count, real, imaginary)
        else:
            for n in range(count):
                time = (first + n) * s.step
                speed = speed_of_piece(path, piece_at(s, path, time), time)
                waves[0, j + n] = speed - waves[1, j + n - N]
        s.filled += count


@_jit
def _slide(s, waves):
    """Move what is still needed of the waves to the start of the memory."""
    shift = s.cell - s.steps - _PAD - s.base
    count = s.filled - s.base + 1 - shift
    for w in range(2):
        for j in range(count):
            waves[w, j] = waves[w, j + shift]
    s.base += shift


@_jit
def _march(s, waves, path, fronts, events, goal):
    """Advance to grid point `goal`; False if there were too many events."""
    while s.cell < goal:
        if s.filled == s.cell:
            if s.cell + 3 - s.base > waves.shape[1]:
                _slide(s, waves)
            last = min(s.base + waves.shape[1] - 2, s.cell + s.steps)
            _fill(s, waves, path, min(goal, last))
        if s.cell >= s.stop and _arrive(s, fronts):
            if not _cross(s, waves, fronts, events, 2.0):
                return False
            continue
        count = min(s.filled, s.stop) - s.cell
        done = _run_in_contact(s, waves, count) if s.contact else _run_in_flight(s, waves, count)
        if done < count and not _cross(s, waves, fronts, events, 2.0):
            return False
    return True


@_jit
def _advance(time, core, waves, path, fronts, events):
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
    if grid.cell > goal or not _march(grid, waves, path, fronts, events, goal):
        return TOO_MANY_EVENTS
    core[1] = core[0]
    s = core[1]
    s.offset = max(0.0, min((time - goal * step) / step, 1.0 - 1e-15))
    if not _cross(s, waves, fronts, events, s.offset):
        return TOO_MANY_EVENTS
    i = goal - s.base - s.steps
    m = _within(s, fronts, waves, 1, i, goal + s.steps, -1.0, s.offset)
    height, speed = plate_at(s, path, time)
    s.time = time
    s.plus[0] = speed - m
    s.minus[0] = m
    s.state[TIME] = time
    s.state[PLATE_POSITION] = height
    s.state[PLATE_VELOCITY] = speed
    s.state[PLATE_FORCE] = s.impedance * (m - s.plus[0]) - s.mass * s.gravity
    return s.events


@_jit
def _reset(core, waves):
    """Put everything back to rest."""
    core[0] = core[2]
    core[1] = core[2]
    waves[:] = 0.0


@_jit
def _read_field(core, waves, strain, velocity):
    """Read strain and velocity of the layer from plate to top."""
    s = core[1]
    i = s.cell - s.base
    rest = s.offset if s.offset > 0.0 else 1.0
    # what is between grid points now is on a line to a next one, which is overwritten later
    waves[0, i + 1] = waves[0, i] + (s.plus[0] - waves[0, i]) / rest
    waves[1, i + 1] = waves[1, i] + (s.minus[1] - waves[1, i]) / rest
    last = strain.size - 1
    spacing = s.steps / last
    inverse = 1.0 / s.wave_speed
    for n in range(last + 1):
        place = i + (s.offset - spacing * n)
        j = int(place)
        p = waves[0, j] + (waves[0, j + 1] - waves[0, j]) * (place - j)
        place = i + (s.offset - spacing * (last - n))
        j = int(place)
        m = waves[1, j] + (waves[1, j + 1] - waves[1, j]) * (place - j)
        strain[n] = (m - p - s.drop) * inverse
        velocity[n] = p + m
    for end in range(2):
        strain[end * last] = (s.minus[end] - s.plus[end] - s.drop) * inverse
        velocity[end * last] = s.plus[end] + s.minus[end]


@_jit
def _sample_field(times, out, velocity, core, waves, path, fronts, events):
    """Advance through `times` and write the strain at each into a row; the last row and status."""
    for row in range(times.size):
        status = _advance(times[row], core, waves, path, fronts, events)
        if status < 0:
            return row, status
        _read_field(core, waves, out[row], velocity)
    return times.size, 0


@_jit
def _square(s, fronts, waves, w, i, aside, cell, sign, low, high):
    """Integrate the square of wave w from `low` to `high` after index i, see `_cubic`."""
    if s.rough:  # no cubic fits the jumps, but the sum of squares is kept
        following = waves[w, min(i + 1, s.cell - s.base)]
        return 0.5 * (high - low) * (waves[w, i] ** 2 + following**2)
    a, b, c, e = _cubic(s, fronts, waves, w, i, aside, cell, sign)
    start = 0.0
    total = 0.0
    passed = 0
    while True:
        end, arriving, column = _front_within(s, fronts, cell, passed)
        left, right = max(start, low), min(end, high)
        if left < right:
            half = 0.5 * (right - left)
            for n in range(4):
                value = _value(left - start + half * (1.0 + _NODES[n]), a, b, c, e)
                total += half * _NODE_WEIGHTS[n] * value * value
        if arriving < 0:
            return total
        a, b, c, e = _expand(end - start, a, b, c, e)
        a += sign * fronts[arriving, column]
        b += sign * fronts[arriving, column + 1]
        c += sign * fronts[arriving, column + 2]
        e += sign * fronts[arriving, column + 3]
        passed |= 1 << arriving
        start = end


@_jit
def _stored_energy(core, waves, fronts):
    """Sum up the energy of layer and projectile against rest."""
    s = core[1]
    i = s.cell - s.base
    total = 0.0
    for w in range(2):
        # p at the plate is p at the top one crossing later, m at the top comes as -p after two
        delay, sign = (s.steps, 1.0) if w == 0 else (2 * s.steps, -1.0)
        for n in range(s.steps, -1, -1):
            cell = s.cell - n + delay
            aside = _aside(s, cell) if n > 1 else n - 2  # no point after this one is known yet
            low = s.offset if n == s.steps else 0.0
            high = s.offset if n == 0 else 1.0
            total += _square(s, fronts, waves, w, i - n, aside, cell, sign, low, high)
    motion = 0.5 * s.mass * s.state[PROJECTILE_VELOCITY] ** 2
    height = s.state[PROJECTILE_POSITION] - s.rest_height
    lift = s.state[PLATE_POSITION] + height - s.surface
    return s.impedance * s.step * total + motion + s.mass * s.gravity * lift


@_jit
def _feed(core, path, fronts, times, values, of_positions):
    """Take in measured samples of the plate."""
    s = core[0]
    if take_samples(s, path, times, values, of_positions):
        _start_front(s, fronts, path, 1, 1.0)
    core[1].horizon = s.horizon


@_jit
def _feed_states(core, path, fronts, times, states):
    """Take in states of the plate."""
    s = core[0]
    if take_states(s, path, times, states):
        _start_front(s, fronts, path, 1, 1.0)
    core[1].horizon = s.horizon


@_jit
def _start_front(s, fronts, path, k, sign):
    """Send the front through the layer that piece k begins (or ends, with `sign` -1) with."""
    time = path[0, k]
    cell = max(int(time / s.step), 0)
    while cell > 0 and cell * s.step >= time:
        cell -= 1
    h = s.step
    _add_front(
        s,
        fronts,
        cell + s.steps,
        time / h - cell,
        sign * path[2, k],
        sign * 2.0 * path[3, k] * h,
        sign * 3.0 * path[4, k] * h**2,
        sign * 4.0 * path[5, k] * h**3,
    )


class Stepper(ThrowStepper):
    """
    A throw in real time: state and field of the rig at any time, going forward.

    Parameters
    ----------
    rig : Rig
        The rig; its layer must be of one material, and lossless.
    motion : Underdamped, Sampled, 'measured' or None
        How the plate moves; None is `Underdamped.of(rig.engine)`, 'measured' waits for `feed`.
        A sampled motion must not begin before time 0.
    steps : int, optional
        Steps per crossing of the wave, 16 to `MAX_STEPS`, however long they take; the default is
        `steps_per_crossing`.
    field_points : int
        Heights at which `read_field` and `sample_field` give the layer, 2 or more.

    Raises
    ------
    ValueError
        If the rig cannot be stepped in real time (see `steps_per_crossing`), or an argument is
        out of range.

    Notes
    -----
    See the module for the scheme and its order.

    Examples
    --------
    The rig of the paper, 10 ms after the start:

    >>> stepper = Stepper(Rig())
    >>> stepper.advance_to(0.010)
    1
    >>> [release] = stepper.events()
    >>> f'{release.kind} after {1e3 * release.time:.4f} ms with {release.velocity:.4f} m/s'
    'release after 7.6470 ms with 1.3750 m/s'

    """

    _advance = staticmethod(_advance)
    _sample = staticmethod(_sample_field)
    _changing = ('_core', '_waves', '_fronts')

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
        self.steps = (
            steps_per_crossing(rig)
            if steps is None
            else checked_count('steps', steps, low=16, high=MAX_STEPS)
        )
        self._core = np.zeros(3, _CORE)
        self._waves = np.zeros((2, 4 * self.steps + _ROOM))
        self._fronts = np.zeros((_MAX_FRONTS, _FRONT_COLUMNS))
        self._path = self._prepare(motion)
        self._start_fronts = self._fronts.copy()
        self._memory = (self._core, self._waves, self._path, self._fronts, self._events)
        self._scratch = np.zeros(field_points)
        self.state = self._core['state'][1]
        self.state.flags.writeable = False
        self.reset()

    def _prepare(self, motion: PlateMotion | Literal['measured'] | None) -> Floats:
        """Write the record that `reset` goes back to, and return the table of the plate."""
        rig = self.rig
        start = self._core[2]
        step = rig.crossing_time / self.steps
        rate = step / rig.relaxation_time
        decay, *moments = _moments(rate)
        powers = np.linalg.inv(np.vander([-1.0, 0.0, 1.0, 2.0], increasing=True))
        start['step'] = step
        start['steps'] = self.steps
        start['rate'] = rate
        start['decay'] = decay
        start['moments'] = moments
        start['weights'] = 2.0 * rate * (np.array(moments) @ powers)
        start['relaxation'] = rig.relaxation_time
        start['gravity'] = rig.gravity
        start['drop'] = rig.gravity * rig.relaxation_time
        start['floor'] = -start['drop'] - _NOISE * rig.engine.speed_scale
        start['wave_speed'] = rig.layer.wave_speed
        start['impedance'] = rig.layer.impedance
        start['mass'] = rig.projectile.mass
        start['rest_height'] = rig.layer.thickness - rig.static_sag
        start['base'] = -self.steps - _PAD
        share = (2.0 * MAX_STEP_RATE * step - 1.0) * 2.0 * self.steps / _FRONT_COST
        start['room'] = min(max(int(share), 2), _MAX_FRONTS)
        start['block'] = -1
        start['contact'] = True
        # at rest the weight is all there is
        start['load'] = start['drop']
        self._is_fed = motion == 'measured'
        path = write_motion(start, motion, rig.engine)
        if start['kind'] == DAMPED:
            start['kink'] = self.steps
            exponent = complex(start['growth'], start['turn'])
            turns = np.exp(exponent * step * np.arange(_BLOCK))
            return np.array([turns.real, turns.imag])
        start['kink'] = 1 << 62
        if isinstance(motion, Sampled):
            _start_front(start, self._fronts, path, 1, 1.0)
            if motion.after == 'hold':
                ending = end_of_motion(motion)[:, None]
                _start_front(start, self._fronts, ending, 0, -1.0)
        return path

    def _put_to_rest(self) -> None:
        self._fronts[:] = self._start_fronts
        _reset(self._core, self._waves)

    def _take_samples(self, times: Floats, values: Floats, of_positions: bool) -> None:
        _feed(self._core, self._path, self._fronts, times, values, of_positions)

    def _take_states(self, times: Floats, states: Floats) -> None:
        _feed_states(self._core, self._path, self._fronts, times, states)

    def _read_field(self, strain: Floats, velocity: Floats) -> None:
        """
        Write strain and velocity.

        Both waves are interpolated linearly between grid points, except at plate and top, which
        agree with `state`.
        """
        _read_field(self._core, self._waves, strain, velocity)

    def _peaks(self, prefix: str) -> Peaks:
        """Give speeds their units: a wave's speed is strain and force."""
        layer, now = self.rig.layer, self._core[1]
        push, load = float(now[f'{prefix}push']), float(now[f'{prefix}load'])
        return Peaks(
            plate_strain=load / layer.wave_speed,
            contact_strain=(push + float(now['drop'])) / layer.wave_speed,
            acceleration=push / self.rig.relaxation_time,
            plate_force=load * layer.impedance,
        )

    @property
    def work(self) -> float:
        """
        Work of the plate so far, up to the last grid point. [J]

        By the trapezoidal rule, that is to second order in the step, and to first in the jumps
        that landings send down; `stored_energy` is the same and exacter.
        """
        now = self._core[1]
        return float(self._work_unit() * (now['work'] - 0.5 * now['power']))

    @property
    def peak_work(self) -> float:
        """Largest work of the plate so far: what the engine has to have handed out. [J]"""
        return float(self._work_unit() * self._core['most_work'][1])

    def _work_unit(self) -> float:
        """Return the work of one step at unit power. [J s2/m2]"""
        return float(self.rig.layer.impedance * self._core['step'][1])

    def stored_energy(self) -> float:
        """
        Add up the energy of layer and projectile against rest, at the present time. [J]

        It is the work of the plate, since nothing is lost; it takes microseconds. Fourth order in
        the step; less beside a kink at the top, and in the very step of a landing.
        """
        return float(_stored_energy(self._core, self._waves, self._fronts))


def warm_up() -> None:
    """Compile or load all kernels."""
    stepper = Stepper(Rig(), 'measured', field_points=2)
    stepper.feed(np.arange(8.0), velocities=np.zeros(8))
    stepper.advance_to(stepper.horizon / 1024.0)
    stepper.read_field(np.empty(2), np.empty(2))
    stepper.sample_field(np.array([stepper.state[TIME]]), np.empty((1, 2)))
    stepper.stored_energy()
    stepper.reset()
    stepper.feed_states(np.arange(2.0), np.zeros((2, 3)))
    stepper.scout().depart(stepper)
