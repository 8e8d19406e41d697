# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
Motions of a plate from CSV files of times and heights, which may be noisy.

A file is read again after it has changed. A journal contains the motions of its files, see
`encode`, and a repetition of the run takes them from there.
"""

from __future__ import annotations

import base64
from collections.abc import Callable, Mapping
from functools import lru_cache
import math
from pathlib import Path
from typing import Any, TypeAlias
import zlib

import numpy as np
from numpy.typing import ArrayLike
from soft_throw_ros.configuration.csv_rows import Column, Floats, read_columns
from soft_throw_ros.configuration.table import ParameterError, quote
from soft_throw_ros.core.plate import require_samples, SampledMotion
from soft_throw_ros.storage.message import SECOND
from soft_throw_ros.storage.regular_file import read_regular_file

PARAMETER = 'engine.motion_file'

_COLUMNS = {
    'time': Column(('t', 'time'), {'s': 1.0, 'ms': 1e-3}, 's'),
    'height': Column(('z', 'height', 'position', 'plate', 'z_plate', 'zp', 'z_p'),
                     {'m': 1.0, 'mm': 1e-3, 'um': 1e-6}, 'm'),
    'velocity': Column(('velocity',), {'m/s': 1.0}, 'm/s', needs_label=True),
    'acceleration': Column(('acceleration',), {'m/s2': 1.0}, 'm/s2', needs_label=True),
}
_STATES = ('height', 'velocity', 'acceleration')
_FIELDS = ('positions', 'velocities', 'accelerations', 'time_from_start')

_MAX_BYTES = 1 << 24  # largest CSV file, 100 s at 2.5 kHz; unpacked, a motion has four times more
_MIN_SAMPLES = 8  # fewest heights of a record, and fewest after the start [-]
_MAX_END_SPEED = 0.25  # largest speed of a plate at the end of a record, over its peak speed [-]
_MOTION_SIGMAS = 6.0  # standard deviations of the noise, from which on a plate moves [-]
_MAX_RISE = 2.0  # largest time from the start to half of the largest height, for 1 Hz [s]
_CERTAIN_MOTION = 0.3  # height over the largest one, at which a plate has certainly started [-]

# Returns the motion of a plate by the path of its file
MotionSource: TypeAlias = Callable[[str], SampledMotion]


def read(path: str | Path) -> SampledMotion:
    """
    Read the motion of a plate from a CSV of times and heights, see `_COLUMNS` for its labels.

    With velocities and accelerations it is exact, otherwise that of `motion_from_record`.
    """
    name = str(path)
    try:
        return _read(name, Path(name).stat().st_mtime_ns)
    except OSError as error:
        raise ParameterError(f'{name}: {error.strerror}', PARAMETER) from None


@lru_cache(maxsize=64)
def _read(name: str, _changed_ns: int) -> SampledMotion:
    """Read a file that has changed at a time [ns]."""
    try:
        text = read_regular_file(name, max_bytes=_MAX_BYTES).decode('utf-8-sig')
        return _motion(read_columns(text.splitlines(), name, _COLUMNS))
    except ValueError as error:
        reason = 'is no UTF-8 text' if isinstance(error, UnicodeDecodeError) else str(error)
        place = f'{name}: ' * (not reason.startswith(f'{name}:'))
        raise ParameterError(f'{place}{reason}', PARAMETER) from None


def _motion(columns: Mapping[str, Floats]) -> SampledMotion:
    """Return the motion in the columns of a file, which are complete or times and heights."""
    times = columns['time']
    if not set(_STATES) <= set(columns):
        return motion_from_record(times, columns['height'])
    states = np.stack([columns[key] for key in _STATES], axis=1)
    start, end = states[[0, -1], 1].tolist()
    if start != 0.0 or abs(end) > _MAX_END_SPEED * np.abs(states[:, 1]).max():
        raise ValueError(f'the plate must start and end at rest, got {start:g} and {end:g} m/s')
    states[:, 0] -= states[0, 0]
    return SampledMotion(times - times[0], states)


def motion_from_record(times: ArrayLike, heights: ArrayLike) -> SampledMotion:
    """
    Fit a motion to a record of a plate [s], [m] that rests, starts at time 0, and comes to rest.

    SciPy's smoothing spline, whose smoothness is chosen by generalised cross-validation (P. Craven
    and G. Wahba, Numer. Math. 31, 1979), would round off the start, where the acceleration jumps.
    So it is fitted to the samples since the start and to their mirror image before it, which
    together are smooth, and begins at rest by symmetry.
    """
    times, heights = require_samples(times, heights, 'heights')
    if times.size < _MIN_SAMPLES:
        raise ValueError(f'heights must be at least {_MIN_SAMPLES}, got {times.size}')
    from scipy.interpolate import make_smoothing_spline

    start, rest_height = _find_start(times, heights)
    distance = np.abs(heights - rest_height)
    risen = float(times[np.argmax(distance >= 0.5 * distance.max())]) - start
    if risen > _MAX_RISE:
        raise ValueError(
            f'the plate must rise within {_MAX_RISE:g} s, got {risen:.3g} s; name a time in '
            'another unit by a first line, as in t [ms],z [m]'
        )
    since = times - start
    moving = since > 1e-3 * float(np.median(np.diff(times)))
    if (after := int(moving.sum())) < _MIN_SAMPLES:
        raise ValueError(f'heights after the start must be at least {_MIN_SAMPLES}, got {after}')
    since, rise = since[moving], heights[moving] - rest_height
    unit = float(np.median(np.diff(since)))  # the spline takes neither small nor large numbers
    both = np.concatenate([-since[::-1], [0.0], since]) / unit
    spline = make_smoothing_spline(both, np.concatenate([rise[::-1], [0.0], rise]))
    knots = np.append(0.0, since)
    states = np.stack([spline(knots / unit, nu=n) / unit**n for n in range(3)], axis=1)
    states[:, 0] -= states[0, 0]
    states[0, 1] = 0.0
    last = abs(float(states[-1, 1]))
    if last > _MAX_END_SPEED * np.abs(states[:, 1]).max():
        raise ValueError(
            f'the plate must come to rest, got {last:g} m/s at the last sample; record longer'
        )
    return SampledMotion(knots, states)


def _find_start(times: Floats, heights: Floats) -> tuple[float, float]:
    """Return the time at which a recorded plate starts to move, and its height before that."""
    from scipy.optimize import brute

    # of white noise, from sixth differences
    noise = float(np.median(np.abs(np.diff(heights, 6)))) / (0.6745 * math.sqrt(924.0))
    moved = np.abs(heights - np.median(heights[:3]))
    threshold = max(_MOTION_SIGMAS * noise, 1e-6 * np.ptp(heights))
    if not moved.max() > 2.0 * threshold:
        raise ValueError(
            f'the plate must move, got heights from {heights.min():g} to {heights.max():g} m '
            f'with a noise of {noise:g} m'
        )
    # The last time that it was seen at rest before it was first far away
    far = int((moved > max(_CERTAIN_MOTION * moved.max(), threshold)).argmax())
    at_rest = np.flatnonzero(moved[:far] <= threshold)
    first = int(at_rest[-1]) + 1 if at_rest.size else 0
    if first < 2:
        return float(times[0]), float(heights[0])
    rest_height = float(np.median(heights[: first - 1])) if first > 3 else float(heights[0])
    t, z = times[: far + 1], heights[: far + 1] - rest_height
    earliest, latest = float(times[max(2 * first - far - 2, 0)]), float(times[first])

    def start(share: Floats) -> float:
        return earliest + float(np.clip(share.item(), 0.0, 1.0)) * (latest - earliest)

    def criterion(share: Floats, terms: int) -> float:
        """Weigh the misfit of a polynomial from rest against its terms, twice as much as BIC."""
        s = np.maximum(t - start(share), 0.0) / (t[-1] - t[0])
        basis = s[:, None] ** np.arange(2.0, 2.0 + terms)
        coefficients = np.linalg.lstsq(basis, z, rcond=None)[0]
        if coefficients[0] * z[-1] <= 0.0:  # a start the other way explains nothing
            coefficients[:] = 0.0
        misfit = np.sum((z - basis @ coefficients) ** 2) + (1e-12 * z[-1]) ** 2
        return float(t.size * np.log(misfit) + 2.0 * terms * np.log(t.size))

    minima = [
        brute(criterion, [(0.0, 1.0)], args=(terms,), Ns=41, full_output=True)[:2]
        for terms in (2, 3, 4)
    ]
    share, _ = min(minima, key=lambda item: float(item[1]))
    return start(share), rest_height


@lru_cache(maxsize=4)  # each change of the rig asks again
def encode(motion: SampledMotion) -> str:
    """Write a motion as text for a journal, which takes milliseconds."""
    rows = np.column_stack([motion.times, motion.states]).astype('<f8')
    return base64.b64encode(zlib.compress(rows.tobytes(), 1)).decode()


def decode(text: str) -> SampledMotion:
    """Decode a motion; raise ValueError if the text is none."""
    try:
        packed = base64.b64decode(text, validate=True)
        data = zlib.decompressobj().decompress(packed, 4 * _MAX_BYTES)
        rows = np.frombuffer(data, '<f8').reshape(-1, 4)
        return SampledMotion(rows[:, 0].copy(), rows[:, 1:].copy())
    except (TypeError, ValueError, zlib.error) as error:
        raise ValueError(f'no motion can be read, {error}, from {quote(text)}') from error


def to_csv(motion: SampledMotion) -> str:
    """Write a motion as CSV that `read` reads."""
    rows = np.column_stack([motion.times, motion.states]).tolist()
    lines = ['t [s],z [m],velocity [m/s],acceleration [m/s2]']
    return '\n'.join([*lines, *(','.join(map(repr, row)) for row in rows)]) + '\n'


def trajectory_points(motion: SampledMotion) -> list[dict[str, Any]]:
    """Return a motion as the fields of messages `trajectory_msgs/JointTrajectoryPoint`."""
    points = []
    for time, state in zip(motion.times.tolist(), motion.states.tolist(), strict=True):
        since = dict(zip(('sec', 'nanosec'), divmod(round(1e9 * time), SECOND), strict=True))
        states = ([value] for value in state)
        points.append(dict(zip(_FIELDS, (*states, since), strict=True)))
    return points
