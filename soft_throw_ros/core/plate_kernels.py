# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
The plate's motion inside compiled steppers.

A stepper's record has the fields `PLATE`, and beside it there is a *path*. That of an underdamped
plate are powers of e^{lambda h}, from step to step of a block. That of any other is an array of
shape (7, n) with a column for each piece, its start time in the first row and the six coefficients
of a quintic in height in the others. It is a ring: pieces of a plate that is measured while the
stepper runs overwrite those that it has passed.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray
from soft_throw_ros.core.kernels import kernel, Record, subroutine
from soft_throw_ros.core.plate import motion_of, quintic, Underdamped
from soft_throw_ros.core.rig import Engine

Floats = NDArray[np.float64]

MAX_PIECES_AHEAD = 4096
"""Most states of a measured plate that can be known ahead of the stepper."""

DAMPED, PIECES = 0, 1
"""Kinds of plate motion."""

BLOCK = 256
"""Steps of an underdamped plate from one exact evaluation to the next, by rotations. [-]"""

_ROWS = 7

_quintic = subroutine(quintic)

PLATE = [
    ('plate_kind', 'i8'),
    ('amplitude', 'f8'),  # of the underdamped plate, with its exponent and velocity factor
    ('growth', 'f8'),
    ('turn', 'f8'),
    ('factor', 'f8'),
    ('cosine', 'f8'),  # e^{lambda t} at the start of the block
    ('sine', 'f8'),
    ('piece', 'i8'),  # number of the present piece
    ('pieces', 'i8'),  # how many are known; number 0 is rest before the first state
    ('horizon', 'f8'),  # until when the plate is known [s]
    ('last', 'f8', (4,)),  # time, height, velocity and acceleration appended last
]
"""Fields of a record, for `numpy.dtype`."""


def write_motion(
    core: NDArray[np.void], engine: Engine, step: float, *, is_measured: bool
) -> Floats:
    """Write a motion into the third record, whose fields `PLATE` are zero; return its path."""
    record = core[2]
    plate = None if is_measured else motion_of(engine)
    record['horizon'] = 0.0 if plate is None else math.inf
    if isinstance(plate, Underdamped):
        exponent = plate.exponent
        record['plate_kind'] = DAMPED
        record['amplitude'] = plate.amplitude
        record['growth'] = exponent.real
        record['turn'] = exponent.imag
        record['factor'] = plate.velocity_factor
        turns = np.exp(exponent * step * np.arange(BLOCK))
        return np.array([turns.real, turns.imag])
    record['plate_kind'] = PIECES
    record['pieces'] = 1
    record['last'][0] = -math.inf
    if plate is None:
        return np.zeros((_ROWS, MAX_PIECES_AHEAD + 2))  # one more to extrapolate with
    path = np.zeros((_ROWS, plate.times.size + 1))
    pieces = append_states(record['last'], 1, path, plate.times, plate.states)
    path[:2, -1] = plate.end_time, plate.states[-1, 0]  # there it stays
    record['pieces'] = pieces + 1
    return path


@subroutine
def write_underdamped(
    s: Record, path: Floats, speed: float, omega: float, zeta: float, step: float
) -> None:
    """Write an underdamped plate, unchecked, whose speed scale A omega is `speed`."""
    root = math.sqrt(1.0 - zeta * zeta)
    s.plate_kind, s.horizon, s.amplitude = DAMPED, math.inf, speed / omega
    s.growth, s.turn, s.factor = -zeta * omega, root * omega, speed / root
    size = math.exp(s.growth * step)
    cosine, sine = size * math.cos(s.turn * step), size * math.sin(s.turn * step)
    path[0, 0], path[1, 0] = 1.0, 0.0
    for k in range(1, BLOCK):
        path[0, k] = path[0, k - 1] * cosine - path[1, k - 1] * sine
        path[1, k] = path[0, k - 1] * sine + path[1, k - 1] * cosine


@subroutine
def start_block(s: Record, index: int) -> None:
    """Evaluate e^{lambda t} of an underdamped plate at the first step of a block."""
    time = index * s.step
    fading = s.growth * time
    size = 0.0 if fading < -600.0 else math.exp(fading)
    s.cosine, s.sine = size * math.cos(s.turn * time), size * math.sin(s.turn * time)


@subroutine
def piece_at(s: Record, path: Floats, time: float) -> int:
    """Advance to the piece at `time`, which must not decrease, and return its column."""
    capacity = path.shape[1]
    while s.piece + 1 < s.pieces and path[0, (s.piece + 1) % capacity] <= time:
        s.piece += 1
    return s.piece % capacity  # type: ignore[no-any-return]


@subroutine
def velocity_of_piece(path: Floats, k: int, time: float) -> float:
    """Evaluate the velocity of piece k."""
    u = time - path[0, k]
    return path[2, k] + u * (  # type: ignore[no-any-return]
        2.0 * path[3, k] + u * (3.0 * path[4, k] + u * (4.0 * path[5, k] + u * 5.0 * path[6, k]))
    )


@subroutine
def motion_at(s: Record, path: Floats, time: float) -> tuple[float, float, float]:
    """Evaluate height, velocity and acceleration of the plate."""
    if s.plate_kind == DAMPED:
        half_sine, half_cosine = math.sin(0.5 * s.turn * time), math.cos(0.5 * s.turn * time)
        fading = math.expm1(s.growth * time)
        decayed = 1.0 + fading
        # 1 - cos as 2 sin^2, so that the first micrometres keep their digits (as `Underdamped`).
        sine, versine = 2.0 * half_sine * half_cosine, 2.0 * half_sine * half_sine
        rise = versine * decayed - fading + s.growth / s.turn * decayed * sine  # Eq. (D2)
        turning = s.turn * (1.0 - versine) + s.growth * sine
        return s.amplitude * rise, s.factor * decayed * sine, s.factor * decayed * turning
    k = piece_at(s, path, time)
    u = time - path[0, k]
    height = path[1, k] + u * (
        path[2, k] + u * (path[3, k] + u * (path[4, k] + u * (path[5, k] + u * path[6, k])))
    )
    acceleration = 2.0 * path[3, k] + u * (
        6.0 * path[4, k] + u * (12.0 * path[5, k] + u * 20.0 * path[6, k])
    )
    return height, velocity_of_piece(path, k, time), acceleration


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
