# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
The plate's motion inside compiled steppers: pieces, each a quintic in height.

A stepper's record has the fields `PLATE`, with the present piece. Pieces of a damped step are made
when they are needed. Those of another motion are in a *path*, a ring with a column for each piece:
its start time, and the six coefficients.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray
from soft_throw_ros.core.kernels import inlined, kernel, Record, subroutine
from soft_throw_ros.core.plate import damped_state, quintic
from soft_throw_ros.core.rig import Engine

Floats = NDArray[np.float64]

CAPACITY = 4096
"""
Most entries of each table of a stepper, whose memory does not grow: cells of a layer, steps of a
crossing, events of a throw, states of a measured plate ahead of the stepper. [-]
"""

_PIECES_PER_PERIOD = 32.0
"""Pieces in a period of a damped step, whose speeds err by 1e-8 of the largest. [-]"""

_quintic, _damped_state = subroutine(quintic), subroutine(damped_state)

PLATE = [
    ('amplitude', 'f8'),  # of a damped step [m]
    ('growth', 'f8'),  # its exponent [1/s]
    ('turn', 'f8'),
    ('duration', 'f8'),  # of its pieces, 0 for another motion [s]
    ('piece_begin', 'f8'),  # of the present piece [s]
    ('piece_end', 'f8'),  # infinite if no other piece is known [s]
    ('coefficients', 'f8', (6,)),  # of the present piece, lowest order first
    ('piece', 'i8'),  # its number
    ('pieces', 'i8'),  # how many are known; number 0 is rest before the first state
    ('horizon', 'f8'),  # until when the plate is known [s]
    ('last', 'f8', (4,)),  # time, height, velocity and acceleration at the end of all pieces
]
"""Fields of a record, for `numpy.dtype`."""

NO_PATH = np.empty((7, 0))
"""Path of a damped step."""


@kernel
def write_damped(core: Record, amplitude: float, omega: float, zeta: float) -> None:
    """Write a damped step into the third record, unchecked."""
    s = core[2]
    s.amplitude, s.growth, s.turn = amplitude, -zeta * omega, math.sqrt(1.0 - zeta * zeta) * omega
    s.duration, s.horizon = 1.0 / (_PIECES_PER_PERIOD * omega / (2.0 * math.pi)), math.inf


def write_motion(core: NDArray[np.void], engine: Engine, *, is_measured: bool) -> Floats:
    """Write a motion into the third record, whose fields `PLATE` are zero; return its path."""
    record, motion = core[2], engine.motion
    if motion is None and not is_measured:
        write_damped(core, engine.amplitude, engine.angular_frequency, engine.damping_ratio)
        return NO_PATH
    record['pieces'] = 1
    record['last'][0] = -math.inf
    if motion is None or is_measured:
        return np.zeros((7, CAPACITY + 2))  # one more to extrapolate with
    record['horizon'] = math.inf
    path = np.zeros((7, motion.times.size + 1))
    pieces = append_states(record['last'], 1, path, motion.times, motion.states)
    path[:2, -1] = motion.end_time, motion.states[-1, 0]  # there it stays
    record['pieces'] = pieces + 1
    return path


@subroutine
def enter_piece(s: Record, path: Floats, time: float) -> None:
    """Write the piece at `time`, which must not decrease, into the record."""
    c = s.coefficients
    if s.duration > 0.0:
        s.piece = int(time / s.duration) + 1
        while s.piece * s.duration > time:
            s.piece -= 1
        s.piece_begin, s.piece_end = s.piece * s.duration, (s.piece + 1) * s.duration
        state = _damped_state(s.piece_begin, s.amplitude, s.growth, s.turn)
        later = _damped_state(s.piece_end, s.amplitude, s.growth, s.turn)
        c[0], c[1], c[2], c[3], c[4], c[5] = _quintic(
            s.piece_end - s.piece_begin, *state, *later
        )
        return
    capacity = path.shape[1]
    while s.piece + 1 < s.pieces and path[0, (s.piece + 1) % capacity] <= time:
        s.piece += 1
    s.piece_begin = path[0, s.piece % capacity]
    s.piece_end = path[0, (s.piece + 1) % capacity] if s.piece + 1 < s.pieces else math.inf
    for n in range(6):
        c[n] = path[n + 1, s.piece % capacity]


@inlined
def motion_at(s: Record, path: Floats, time: float) -> tuple[float, float, float]:
    """Evaluate height, velocity and acceleration of the plate."""
    if not s.piece_begin <= time < s.piece_end:
        enter_piece(s, path, time)
    u, c = time - s.piece_begin, s.coefficients
    height = c[0] + u * (c[1] + u * (c[2] + u * (c[3] + u * (c[4] + u * c[5]))))
    velocity = c[1] + u * (
        2.0 * c[2] + u * (3.0 * c[3] + u * (4.0 * c[4] + u * 5.0 * c[5]))
    )
    acceleration = 2.0 * c[2] + u * (6.0 * c[3] + u * (12.0 * c[4] + u * 20.0 * c[5]))
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


@kernel
def extrapolate(core: Record, path: Floats) -> None:
    """Extend the plate's motion for ever, with its acceleration at the horizon."""
    s, last = core[0], core[0].last
    if math.isfinite(s.horizon) and last[0] >= 0.0:
        piece = path[:, s.pieces % path.shape[1]]
        piece[0], piece[1], piece[2] = last[0], last[1], last[2]
        piece[3], piece[4:] = 0.5 * last[3], 0.0
        s.pieces += 1
    s.piece_end = -math.inf  # the present piece may end now
    s.horizon = core[1].horizon = math.inf
