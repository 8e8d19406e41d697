# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
The plate's motion inside compiled steppers: pieces, each a quintic in height.

A stepper's record has the fields `PLATE`, and beside it there is a *path*, an array of shape
(7, n) with a column for each piece: its start time, and the six coefficients. It is a ring. Pieces
of a damped step are made when they are needed; pieces of a plate that is measured while the
stepper runs overwrite those that it has passed.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray
from soft_throw_ros.core.kernels import kernel, Record, subroutine
from soft_throw_ros.core.plate import quintic
from soft_throw_ros.core.rig import Engine

Floats = NDArray[np.float64]

MAX_PIECES_AHEAD = 4096
"""Most states of a measured plate that can be known ahead of the stepper."""

_PIECES_PER_PERIOD = 64.0
"""Pieces in a period of a damped step, whose heights err by 2e-11 of its amplitude. [-]"""

_ROWS, _DAMPED_COLUMNS = 7, 4

_quintic = subroutine(quintic)

PLATE = [
    ('amplitude', 'f8'),  # of a damped step [m]
    ('growth', 'f8'),  # its exponent [1/s]
    ('turn', 'f8'),
    ('duration', 'f8'),  # of its pieces, 0 for another motion [s]
    ('piece', 'i8'),  # number of the present piece
    ('pieces', 'i8'),  # how many are known; number 0 is rest before the first state
    ('horizon', 'f8'),  # until when the plate is known [s]
    ('last', 'f8', (4,)),  # time, height, velocity and acceleration appended last
]
"""Fields of a record, for `numpy.dtype`."""


def make_damped_path() -> Floats:
    """Make the path of a damped step, for `write_damped`."""
    return np.empty((_ROWS, _DAMPED_COLUMNS))


@kernel
def write_damped(core: Record, path: Floats, amplitude: float, omega: float, zeta: float) -> None:
    """Write a damped step into the third record, unchecked."""
    s = core[2]
    s.amplitude, s.growth, s.turn = amplitude, -zeta * omega, math.sqrt(1.0 - zeta * zeta) * omega
    s.duration, s.horizon = 2.0 * math.pi / (_PIECES_PER_PERIOD * omega), math.inf
    path[0] = math.nan


def write_motion(core: NDArray[np.void], engine: Engine, *, is_measured: bool) -> Floats:
    """Write a motion into the third record, whose fields `PLATE` are zero; return its path."""
    record, motion = core[2], engine.motion
    if motion is None and not is_measured:
        path = make_damped_path()
        write_damped(core, path, engine.amplitude, engine.angular_frequency, engine.damping_ratio)
        return path
    record['pieces'] = 1
    record['last'][0] = -math.inf
    if motion is None or is_measured:
        return np.zeros((_ROWS, MAX_PIECES_AHEAD + 2))  # one more to extrapolate with
    record['horizon'] = math.inf
    path = np.zeros((_ROWS, motion.times.size + 1))
    pieces = append_states(record['last'], 1, path, motion.times, motion.states)
    path[:2, -1] = motion.end_time, motion.states[-1, 0]  # there it stays
    record['pieces'] = pieces + 1
    return path


@subroutine
def _damped_state(s: Record, time: float) -> tuple[float, float, float]:
    """Evaluate height, velocity and acceleration of a damped step."""
    half_sine, half_cosine = math.sin(0.5 * s.turn * time), math.cos(0.5 * s.turn * time)
    fading = math.expm1(s.growth * time)
    decayed = 1.0 + fading
    # 1 - cos as 2 sin^2, so that the first micrometres keep their digits (as `Underdamped`).
    sine, versine = 2.0 * half_sine * half_cosine, 2.0 * half_sine * half_sine
    rise = versine * decayed - fading + s.growth / s.turn * decayed * sine  # Eq. (D2)
    turning = s.turn * (1.0 - versine) + s.growth * sine
    factor = s.amplitude * (s.turn + s.growth * s.growth / s.turn)
    return s.amplitude * rise, factor * decayed * sine, factor * decayed * turning


@subroutine
def _make_damped_piece(s: Record, path: Floats, k: int) -> None:
    """Write the present piece of a damped step into column k."""
    start, end = s.piece * s.duration, (s.piece + 1) * s.duration
    height, velocity, acceleration = _damped_state(s, start)
    next_height, next_velocity, next_acceleration = _damped_state(s, end)
    column = path[:, k]
    column[0] = start
    column[1], column[2], column[3], column[4], column[5], column[6] = _quintic(
        end - start, height, velocity, acceleration, next_height, next_velocity, next_acceleration
    )


@subroutine
def piece_at(s: Record, path: Floats, time: float) -> int:
    """Advance to the piece at `time`, which must not decrease, and return its column."""
    capacity = path.shape[1]
    if s.duration > 0.0:
        s.piece = int(time / s.duration)
        if s.piece * s.duration > time:
            s.piece -= 1
        elif (s.piece + 1) * s.duration <= time:
            s.piece += 1
        k = s.piece % capacity
        if path[0, k] != s.piece * s.duration:
            _make_damped_piece(s, path, k)
        return k  # type: ignore[no-any-return]
    while s.piece + 1 < s.pieces and path[0, (s.piece + 1) % capacity] <= time:
        s.piece += 1
    return s.piece % capacity  # type: ignore[no-any-return]


@subroutine
def end_of_piece(s: Record, path: Floats) -> float:
    """Return the end of the present piece, infinite if no other one is known."""
    if s.duration > 0.0:
        return (s.piece + 1) * s.duration  # type: ignore[no-any-return]
    if s.piece + 1 < s.pieces:
        return path[0, (s.piece + 1) % path.shape[1]]  # type: ignore[no-any-return]
    return math.inf


@subroutine
def motion_at(s: Record, path: Floats, time: float) -> tuple[float, float, float]:
    """Evaluate height, velocity and acceleration of the plate."""
    k = piece_at(s, path, time)
    u = time - path[0, k]
    height = path[1, k] + u * (
        path[2, k] + u * (path[3, k] + u * (path[4, k] + u * (path[5, k] + u * path[6, k])))
    )
    velocity = path[2, k] + u * (
        2.0 * path[3, k] + u * (3.0 * path[4, k] + u * (4.0 * path[5, k] + u * 5.0 * path[6, k]))
    )
    acceleration = 2.0 * path[3, k] + u * (
        6.0 * path[4, k] + u * (12.0 * path[5, k] + u * 20.0 * path[6, k])
    )
    return height, velocity, acceleration


@kernel
def append_states(last: Floats, pieces: int, path: Floats, times: Floats, states: Floats) -> int:
    """Append states (height, velocity, acceleration), joined by quintics; count all pieces."""
    for n in range(times.size):
        if last[0] >= 0.0:
            piece, new = path[:, pieces % path.shape[1]], states[n]
            piece[0] = last[0]
            piece[1], piece[2], piece[3], piece[4], piece[5], piece[6] = _quintic(
                times[n] - last[0], last[1], last[2], last[3], new[0], new[1], new[2]
            )
            pieces += 1
        last[0], last[1], last[2], last[3] = times[n], states[n, 0], states[n, 1], states[n, 2]
    return pieces


def extrapolate(core: NDArray[np.void], path: Floats) -> None:
    """Extend the plate's motion for ever, with its acceleration at the horizon."""
    s = core[0]
    time, height, velocity, acceleration = s['last'].tolist()
    if math.isfinite(s['horizon']) and time >= 0.0:
        piece = time, height, velocity, 0.5 * acceleration, 0.0, 0.0, 0.0
        path[:, s['pieces'] % path.shape[1]] = piece
        s['pieces'] += 1
    core['horizon'][:2] = math.inf
