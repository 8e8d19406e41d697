# SPDX-License-Identifier: Apache-2.0
"""
How the plate moves, for compiled models that go forward in time.

A model's record has the fields `PLATE`, and beside it there is a path: a table with a column for
each piece of the motion, the time at which the piece starts in its first row, and the six
coefficients of the height in the others. An underdamped plate needs none.
"""

from __future__ import annotations

import math
from typing import Any, Literal

import numba as nb
import numpy as np
from numpy.typing import ArrayLike, NDArray
from soft_throw_ros.core.plate import PlateMotion, Sampled, Underdamped
from soft_throw_ros.core.rig import Engine

Floats = NDArray[np.float64]

FEED_SEGMENTS = 4096
"""Most measured samples by which what is fed can be ahead of the model."""

PIECE_ROWS = 7
"""Rows of a path."""

DAMPED, PIECES = 0, 1
"""Kinds of plate motion."""

PLATE = [
    ('kind', 'i8'),
    ('amplitude', 'f8'),  # of the underdamped plate, ...
    ('growth', 'f8'),
    ('turn', 'f8'),
    ('factor', 'f8'),
    ('piece', 'i8'),  # where the sampled plate has got to
    ('pieces', 'i8'),
    ('horizon', 'f8'),  # until when it is known
    ('samples', 'i8'),
    ('recent', 'f8', (2, 5)),  # times and values fed last, or time and state in the first row
    ('origin', 'f8'),  # of the positions fed
    ('slope', 'f8'),  # at the start of the next piece
    ('curvature', 'f8'),
    ('height', 'f8'),  # of the plate, from the velocities fed
]
"""Fields of a record, for `numpy.dtype`."""

_jit = nb.njit(cache=True, nogil=True, error_model='numpy')


def write_motion(
    record: NDArray[np.void], motion: PlateMotion | Literal['measured'] | None, engine: Engine
) -> Floats:
    """
    Write a motion into a record, and return its path.

    Parameters
    ----------
    record : ndarray
        Of a type with the fields `PLATE`, and zero; written to.
    motion : Underdamped, Sampled, 'measured' or None
        None is that of `engine`; 'measured' waits for `take_samples`.
    engine : Engine
        Of the rig.

    Returns
    -------
    ndarray, shape (7, n)
        A column more than pieces: at rest before the first one. If a sampled motion holds, the
        last column is where it stays.

    Raises
    ------
    ValueError
        If the motion is of another kind, begins before time 0, or its pieces are of more than
        fifth degree.

    """
    record['horizon'] = math.inf
    if motion is None:
        motion = Underdamped.of(engine)
    if isinstance(motion, Underdamped):
        exponent = motion.exponent
        record['kind'] = DAMPED
        record['amplitude'] = motion.amplitude
        record['growth'] = exponent.real
        record['turn'] = exponent.imag
        record['factor'] = motion.velocity_factor
        return np.zeros((PIECE_ROWS, 1))
    record['kind'] = PIECES
    record['pieces'] = 1  # at rest
    if isinstance(motion, Sampled):
        return _lay_out(record, motion)
    if motion != 'measured':
        raise ValueError(
            "motion must be Underdamped, Sampled, 'measured' or None, "
            f'got {motion!r}; Sampled.from_velocities takes any other'
        )
    record['horizon'] = 0.0
    return np.zeros((PIECE_ROWS, FEED_SEGMENTS + 1))  # one to coast


def _lay_out(record: NDArray[np.void], motion: Sampled) -> Floats:
    """Return the pieces of a sampled motion, a column each."""
    coefficients, knots = motion.path.c, motion.path.x
    degree = coefficients.shape[0] - 1
    if coefficients.ndim != 2 or degree > PIECE_ROWS - 2:
        raise ValueError(
            f'a sampled motion must have pieces of degree {PIECE_ROWS - 2} at most, '
            f'got coefficients of shape {coefficients.shape}'
        )
    if motion.start_time < 0.0:
        raise ValueError(
            'a sampled motion must begin at time 0 or later, got a first sample at '
            f'{motion.start_time:g} s'
        )
    count = knots.size - 1
    path = np.zeros((PIECE_ROWS, count + 2))
    path[0, 1:] = knots
    path[1 : degree + 2, 1:-1] = coefficients[::-1]
    record['pieces'] = count + 1
    if motion.after == 'error':
        record['horizon'] = motion.end_time
        return path
    record['pieces'] = count + 2
    path[1, -1] = motion.path(motion.end_time)
    return path


def end_of_motion(motion: Sampled) -> Floats:
    """Expand a sampled motion about its end, as a column of a path: it is what stops there."""
    column = np.zeros(PIECE_ROWS)
    column[0] = motion.end_time
    column[1] = motion.path(motion.end_time)
    for order in range(1, 5):
        derivative = motion.path.derivative(order)(motion.end_time)
        column[1 + order] = derivative / math.factorial(order)
    return column


@_jit
def piece_at(s: Any, path: Floats, time: float) -> int:
    """Find the piece of the plate's motion at `time` and go there; return its column."""
    capacity = path.shape[1]
    while s.piece + 1 < s.pieces and path[0, (s.piece + 1) % capacity] <= time:
        s.piece += 1
    return s.piece % capacity  # type: ignore[no-any-return]


@_jit
def speed_of_piece(path: Floats, k: int, time: float) -> float:
    """Compute the velocity of the plate from piece k."""
    u = time - path[0, k]
    return path[2, k] + u * (  # type: ignore[no-any-return]
        2.0 * path[3, k] + u * (3.0 * path[4, k] + u * (4.0 * path[5, k] + u * 5.0 * path[6, k]))
    )


@_jit
def plate_at(s: Any, path: Floats, time: float) -> tuple[float, float]:
    """Compute height and velocity of the plate."""
    if s.kind == DAMPED:
        sine = math.sin(s.turn * time)
        decayed = math.exp(s.growth * time)
        # as in plate.Underdamped: 1 - cos as 2 sin^2
        rise = 2.0 * math.sin(0.5 * s.turn * time) ** 2 * decayed - math.expm1(s.growth * time)
        rise += s.growth / s.turn * decayed * sine
        return s.amplitude * rise, s.factor * decayed * sine
    k = piece_at(s, path, time)
    u = time - path[0, k]
    height = path[1, k] + u * (
        path[2, k] + u * (path[3, k] + u * (path[4, k] + u * (path[5, k] + u * path[6, k])))
    )
    return height, speed_of_piece(path, k, time)


@_jit
def motion_at(s: Any, path: Floats, time: float) -> tuple[float, float, float]:
    """Compute height, velocity and acceleration of the plate."""
    if s.kind == DAMPED:
        half_sine, half_cosine = math.sin(0.5 * s.turn * time), math.cos(0.5 * s.turn * time)
        fading = math.expm1(s.growth * time)
        decayed = 1.0 + fading
        sine, versine = 2.0 * half_sine * half_cosine, 2.0 * half_sine * half_sine
        rise = versine * decayed - fading + s.growth / s.turn * decayed * sine
        turning = s.turn * (1.0 - versine) + s.growth * sine
        return s.amplitude * rise, s.factor * decayed * sine, s.factor * decayed * turning
    height, speed = plate_at(s, path, time)
    k = piece_at(s, path, time)
    u = time - path[0, k]
    acceleration = 2.0 * path[3, k] + u * (
        6.0 * path[4, k] + u * (12.0 * path[5, k] + u * 20.0 * path[6, k])
    )
    return height, speed, acceleration


@_jit
def take_samples(s: Any, path: Floats, times: Floats, values: Floats, of_positions: bool) -> bool:
    """
    Take in measured samples, and tell if the first piece has become known.

    A quartic through five samples gives slope (and curvature) at the middle one. Positions are
    joined by quintics with those, velocities by cubics.
    """
    begins = False
    recent_times, recent = s.recent[0], s.recent[1]
    for n in range(times.size):
        if s.samples == 0:
            s.origin = values[n] if of_positions else 0.0
            s.horizon = times[n]
        for k in range(4):
            recent_times[k] = recent_times[k + 1]
            recent[k] = recent[k + 1]
        recent_times[4] = times[n]
        recent[4] = values[n] - s.origin
        s.samples += 1
        if s.samples < 5:
            continue
        first = 2
        if s.samples == 5:  # nothing is known before the first sample
            first = 1
            s.slope, s.curvature = _quartic_slopes(recent_times, recent, 0)
        for k in range(first, 3):
            slope, curvature = _quartic_slopes(recent_times, recent, k)
            column = s.pieces % path.shape[1]
            piece = path[:, column]
            D = recent_times[k] - recent_times[k - 1]
            left = recent[k - 1]
            piece[0] = recent_times[k - 1]
            if of_positions:
                _join(piece, D, left, s.slope, s.curvature, recent[k], slope, curvature)
            else:
                rise = recent[k] - left
                v, w = s.slope * D, slope * D
                c = 3.0 * rise - 2.0 * v - w
                e = v + w - 2.0 * rise
                piece[1] = s.height
                piece[2] = left
                piece[3] = 0.5 * s.slope
                piece[4] = c / (3.0 * D * D)
                piece[5] = 0.25 * e / D**3
                piece[6] = 0.0
                s.height += D * (left + v * 0.5 + c * (1.0 / 3.0) + 0.25 * e)
            s.slope, s.curvature = slope, curvature
            s.pieces += 1
            s.horizon = recent_times[k]
        begins = begins or s.samples == 5
    return begins


@_jit
def _join(piece, D, left, slope, curvature, right, next_slope, next_curvature):
    """Write the quintic that goes from one state to another in the time D."""
    rise = right - left
    v, w = slope * D, next_slope * D
    q, r = curvature * D * D, next_curvature * D * D
    piece[1] = left
    piece[2] = slope
    piece[3] = 0.5 * curvature
    piece[4] = (10.0 * rise - 4.0 * w - 6.0 * v + 0.5 * r - 1.5 * q) / D**3
    piece[5] = (7.0 * w + 8.0 * v - 15.0 * rise + 1.5 * q - r) / D**4
    piece[6] = (6.0 * rise - 3.0 * (v + w) + 0.5 * (r - q)) / D**5


@_jit
def take_states(s: Any, path: Floats, times: Floats, states: Floats) -> bool:
    """
    Take in states of the plate, and tell if the first piece has become known.

    Rows of `states` are position, velocity and acceleration; quintics join them.
    """
    begins = False
    last = s.recent[0]
    for n in range(times.size):
        if s.samples > 0:
            piece = path[:, s.pieces % path.shape[1]]
            piece[0] = last[0]
            _join(
                piece,
                times[n] - last[0],
                last[1],
                last[2],
                last[3],
                states[n, 0],
                states[n, 1],
                states[n, 2],
            )
            s.pieces += 1
            begins = begins or s.samples == 1
        last[0] = times[n]
        last[1:4] = states[n]
        s.samples += 1
        s.horizon = times[n]
    return begins


@_jit
def coast(s: Any, path: Floats) -> None:
    """
    Let the plate go on for ever from where it is known, with the acceleration it has there.

    The piece stands where the next one that is fed will stand. At rest before anything is fed.
    """
    if s.samples == 0 or math.isinf(s.horizon):
        s.horizon = math.inf
        return
    k = (s.pieces - 1) % path.shape[1]
    u = s.horizon - path[0, k]
    piece = path[:, s.pieces % path.shape[1]]
    piece[0] = s.horizon
    piece[1] = path[1, k] + u * (
        path[2, k] + u * (path[3, k] + u * (path[4, k] + u * (path[5, k] + u * path[6, k])))
    )
    piece[2] = speed_of_piece(path, k, s.horizon)
    piece[3] = path[3, k] + u * (3.0 * path[4, k] + u * (6.0 * path[5, k] + u * 10.0 * path[6, k]))
    piece[4:] = 0.0
    s.pieces += 1
    s.horizon = math.inf


@_jit
def _quartic_slopes(x, y, at):
    """First and second derivative at x[at] of the quartic through five points (Newton's form)."""
    c = np.empty(5)
    for k in range(5):
        c[k] = y[k]
    for order in range(1, 5):
        for k in range(4, order - 1, -1):
            c[k] = (c[k] - c[k - 1]) / (x[k] - x[k - order])
    value, slope, curvature = c[4], 0.0, 0.0
    for k in range(3, -1, -1):
        u = x[at] - x[k]
        curvature = curvature * u + 2.0 * slope
        slope = slope * u + value
        value = value * u + c[k]
    return slope, curvature


def checked_samples(
    times: ArrayLike, values: ArrayLike | None, kind: str, *, after: float
) -> tuple[Floats, Floats]:
    """Return times and values to feed as arrays, or raise ValueError."""
    times = np.ascontiguousarray(times, dtype=np.float64)
    values = np.ascontiguousarray(values, dtype=np.float64)
    if times.ndim != 1 or times.shape != values.shape:
        raise ValueError(
            f'times and {kind} must be series of one length, '
            f'got shapes {times.shape} and {values.shape}'
        )
    for label, array in (('times', times), (kind, values)):
        if not np.isfinite(array).all():
            first = int(np.flatnonzero(~np.isfinite(array))[0])
            raise ValueError(f'{label} must be finite, got {array[first]} at index {first}')
    if times.size and times[0] < 0.0:
        raise ValueError(f'times must not be negative, got {times[0]}')
    backward = np.flatnonzero(np.diff(times, prepend=after) <= 0.0)
    if backward.size:
        first = int(backward[0])
        before = times[first - 1] if first else after
        raise ValueError(
            f'times must increase, got {times[first]} after {before} at index {first}'
        )
    return times, values
