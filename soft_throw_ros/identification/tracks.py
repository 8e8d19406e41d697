# SPDX-License-Identifier: Apache-2.0
"""Tracks: heights of bodies over time, read from text, cut into throws, and how noisy they are."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
import math
import re

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import maximum_filter1d, minimum_filter1d, uniform_filter1d
from scipy.signal import spectrogram
from soft_throw_ros.core import checks

Floats = NDArray[np.float64]

UNITS = {'m': 1.0, 'mm': 1e-3, 'um': 1e-6}
"""Units of height. [m]"""

FEWEST = 12
"""Samples of a track at least."""

NAMES = {
    'plate': ('plate', 'z_plate', 'zp', 'z_p'),
    'projectile': ('projectile', 'z_projectile', 'zm', 'z_m'),
    'bottom': ('bottom', 'z_bottom', 'lower', 'z_lower'),
    'top': ('top', 'z_top', 'upper', 'z_upper'),
}
"""Bodies, and what their columns may be called."""

_TIME = ('t', 'time')
_MISSING = ('', 'nan')
_SWINGS = 6.0  # plate periods that are kept of a throw among others
_SEEN = 2.0  # plate periods of the last one of several throws that must be seen
_QUIET = 0.5  # plate periods that it rests between two throws at least, and ...
_BEFORE = 0.25  # that are kept of it
_SMOOTH = 0.125  # plate periods that are averaged over to see where it rests
_ABOVE_NOISE = 25.0  # how often as strong as noise, at its frequency, a swing is at least
_SEGMENT = 2**15  # samples of one spectrum
_DIFFERENCES = 4  # order of the differences that noise is taken from


class TrackError(ValueError):
    """A track is not what it should be; the message says where."""


@dataclass(frozen=True, kw_only=True)
class Track:
    """
    Heights of one body, where it was seen.

    Parameters
    ----------
    time : ndarray, shape (n,)
        Increasing. [s]
    position : ndarray, shape (n,)
        Upwards, from any zero. [m]
    known_noise : float, optional
        Standard deviation of the positions; estimated from them if not given. [m]
    least_noise : float
        What an estimate is at least. [m]

    Attributes
    ----------
    noise : float
        Standard deviation of the positions, known or estimated. [m]

    Raises
    ------
    TrackError
        If the series do not fit, are shorter than `FEWEST`, are not finite or do not increase.
    ValueError
        If the noise is not finite and positive.

    """

    time: Floats
    position: Floats
    known_noise: float | None = None
    least_noise: float = 0.0
    noise: float = field(init=False)

    def __post_init__(self) -> None:
        time = np.asarray(self.time, dtype=np.float64)
        position = np.asarray(self.position, dtype=np.float64)
        if time.ndim != 1 or time.shape != position.shape or time.size < FEWEST:
            raise TrackError(
                f'a track is two series of the same length, at least {FEWEST}, '
                f'got shapes {time.shape} and {position.shape}'
            )
        for name, values in (('time', time), ('position', position)):
            if not np.isfinite(values).all():
                raise TrackError(f'{name} must be finite, got {values[~np.isfinite(values)][0]}')
        if (np.diff(time) <= 0.0).any():
            place = int(np.flatnonzero(np.diff(time) <= 0.0)[0])
            raise TrackError(f'time must increase, got {time[place + 1]} after {time[place]}')
        object.__setattr__(self, 'time', time)
        object.__setattr__(self, 'position', position)
        if self.known_noise is None:
            noise = max(noise_of(position), self.least_noise)
        else:
            noise = checks.positive('known_noise', self.known_noise)
        object.__setattr__(self, 'noise', noise)

    @property
    def interval(self) -> float:
        """Usual time between samples. [s]"""
        return float(np.median(np.diff(self.time)))

    @property
    def duration(self) -> float:
        """Time from the first sample to the last. [s]"""
        return float(self.time[-1] - self.time[0])

    def between(self, start: float, end: float) -> Track:
        """
        Return the part from `start` to `end` [s], both included.

        Raises
        ------
        TrackError
            If it is too short.

        """
        inside = (self.time >= start) & (self.time <= end)
        if inside.sum() < FEWEST:
            raise TrackError(
                f'only {inside.sum()} samples from {start:g} s to {end:g} s, where at least '
                f'{FEWEST} are needed; the track goes from {self.time[0]:g} s '
                f'to {self.time[-1]:g} s'
            )
        return replace(self, time=self.time[inside], position=self.position[inside])


@dataclass(frozen=True, kw_only=True)
class ThrowTracks:
    """
    What was seen of one throw.

    Parameters
    ----------
    name : str
        Where it comes from, for messages.
    plate : Track
    projectile : Track, optional

    """

    name: str
    plate: Track
    projectile: Track | None = None

    def between(self, start: float, end: float) -> ThrowTracks:
        """
        Return the part from `start` to `end`. [s]

        Raises
        ------
        TrackError
            If there is too little of the plate; of the projectile there may be none.

        """
        projectile = None
        if self.projectile is not None:
            inside = (self.projectile.time >= start) & (self.projectile.time <= end)
            if inside.sum() >= FEWEST:
                projectile = self.projectile.between(start, end)
        return ThrowTracks(
            name=self.name, plate=self.plate.between(start, end), projectile=projectile
        )

    def throws(self) -> list[ThrowTracks]:
        """
        Cut a long record into its throws.

        Notes
        -----
        A throw begins where the plate leaves its lowest place of rest. If it comes back there,
        what is kept is `_BEFORE` periods before and at most `_SWINGS` periods after that, so that
        the plate must not be put back earlier. If there are several, the last one is left out if
        the record ends `_SEEN` periods after its start or sooner. A record in which the plate
        rests there only once, or never, is one throw and stays whole.

        """
        spans = find_throws(self.plate)
        if not spans:
            return [self]
        cut = [self.between(*span) for span in spans]
        if len(cut) == 1:
            return cut
        return [
            ThrowTracks(
                name=f'{self.name}, throw {number}', plate=part.plate, projectile=part.projectile
            )
            for number, part in enumerate(cut, 1)
        ]


def noise_of(position: Floats) -> float:
    r"""
    Estimate the standard deviation of white noise on a smooth motion. [m]

    Notes
    -----
    From differences of fourth order, which a motion of n samples per period passes on by
    :math:`(2 \pi / n)^4 / \sqrt{70}`; those beyond five median deviations, at kinks and slips,
    are left out. Never 0, so that one can divide by it.

    """
    steps = np.diff(position, _DIFFERENCES) / math.sqrt(math.comb(2 * _DIFFERENCES, _DIFFERENCES))
    usual = 1.4826 * float(np.median(np.abs(steps)))
    kept = steps[np.abs(steps) <= 5.0 * usual]
    noise = float(np.sqrt(np.mean(kept**2))) if usual > 0.0 else 0.0
    return max(noise, 1e-9 * float(np.ptp(position)), 1e-15)


def find_throws(plate: Track) -> list[tuple[float, float]]:
    """Find begin and end [s] of the throws in a record to which the plate comes back to rest."""
    time = plate.time
    period = _dominant_period(plate)
    size = max(3, round(_QUIET * period / plate.interval))
    if size >= time.size:
        return []
    width = max(1, round(_SMOOTH * period / plate.interval))
    position = uniform_filter1d(plate.position, width)
    low = minimum_filter1d(position, size)
    high = maximum_filter1d(position, size)
    tolerance = 6.0 * plate.noise / math.sqrt(width) + 0.005 * float(np.ptp(position))
    quiet = high - low < 2.0 * tolerance
    if not quiet.any():
        return []
    rest = float(np.min(0.5 * (low + high)[quiet]))
    at_rest = quiet & (np.abs(position - rest) < tolerance)
    edges = np.diff(at_rest.astype(np.int8))
    begins = np.flatnonzero(edges == 1) + 1
    ends = np.minimum(np.flatnonzero(edges == -1) + size // 2, time.size - 1)
    lift = rest + 0.3 * (float(position.max()) - rest)
    starts = []
    for end in ends.tolist():
        soon = (time >= time[end - size // 2]) & (time <= time[end] + period)
        if (position[soon] > lift).any():
            starts.append(float(time[end]))
    returns = [float(time[begin]) for begin in begins]
    if len(starts) < 2 and not any(back > start for start in starts for back in returns):
        return []
    if len(starts) > 1 and time[-1] < starts[-1] + _SEEN * period:
        starts.pop()
    limits = [*starts[1:], math.inf]
    return [
        (start - _BEFORE * period, min(start + _SWINGS * period, limit - _BEFORE * period))
        for start, limit in zip(starts, limits, strict=True)
    ]


def _dominant_period(plate: Track) -> float:
    """Find the period of the strongest swing of the plate's velocity."""
    count = max(16, round(plate.duration / plate.interval) + 1)
    even, step = np.linspace(plate.time[0], plate.time[-1], count, retstep=True)
    velocity = np.diff(np.interp(even, plate.time, plate.position)) / step
    frequency, _, powers = spectrogram(velocity, 1.0 / step, nperseg=min(velocity.size, _SEGMENT))
    noise = 8.0 / step * (plate.noise * np.sin(np.pi * step * frequency)) ** 2
    strength = powers.max(axis=1) - _ABOVE_NOISE * noise
    return 1.0 / float(frequency[max(1, int(np.argmax(strength)))])


def read_csv(
    lines: Iterable[str], name: str, bodies: Sequence[str], *, unit: str = 'm'
) -> dict[str, Track]:
    """
    Read tracks from lines of text.

    Parameters
    ----------
    lines : iterable of str
        A time [s] and the heights of bodies in each, separated by commas, semicolons, tabs or
        blanks. A first line may name the columns (`t` or `time`, and `NAMES`, a unit in brackets
        may follow); others are then passed over. Without one they are time and `bodies` in this
        order. Lines that begin with # are comments; a height that is empty or nan was not seen.
        Unless commas separate, one may also be the decimal sign.
    name : str
        What to call the text if something is wrong.
    bodies : sequence of str
        Bodies to read. The first must be there, the others may be missing altogether.
    unit : str
        Of the heights, one of `UNITS`.

    Returns
    -------
    dict of str to Track

    Raises
    ------
    TrackError
        With the number of the line, if something is wrong.

    Examples
    --------
    >>> lines = ['t [s]; plate [mm]'] + [f'{t}; {t * t}' for t in range(20)]
    >>> track = read_csv(lines, 'example', ('plate',), unit='mm')['plate']
    >>> round(float(track.position[3]), 6)
    0.009

    """
    scale = UNITS[unit]
    numbered = _Rows(lines)
    columns: dict[str, int] = {}
    values: dict[str, list[float]] = {}
    times: list[float] = []
    width = 0
    for number, cells in numbered:
        where = f'{name}:{number}'
        if not columns:
            is_header = not any(map(_is_number, cells))
            columns = _header(cells, bodies, unit, where) if is_header else _order(cells, bodies)
            values = {body: [] for body in columns if body != 'time'}
            width = len(cells)
            if not values:
                raise TrackError(
                    f'{where}: must have a time and the height of the {bodies[0]}, '
                    f'got {cells[0]!r} alone'
                )
            if is_header:
                continue
        if len(cells) != width:
            raise TrackError(f'{where}: must have {width} values as above, got {len(cells)}')
        time = _number(cells[columns['time']], 'time', where)
        if math.isnan(time):
            raise TrackError(f'{where}: time must be a finite number, got {"nan"!r}')
        if times and time <= times[-1]:
            raise TrackError(f'{where}: time must increase, got {time:g} after {times[-1]:g}')
        times.append(time)
        for body, series in values.items():
            series.append(scale * _number(cells[columns[body]], body, where))
    if not columns:
        raise TrackError(f'{name}: is empty; a time and the height of the {bodies[0]} are needed')
    return dict(_tracks(times, values, bodies[0], name))


def csv_lines(tracks: Mapping[str, Track]) -> Iterator[str]:
    """
    Write tracks as lines of text that `read_csv` reads.

    Examples
    --------
    >>> track = Track(time=0.5 * np.arange(20.0), position=1e-3 * np.arange(20.0))
    >>> list(csv_lines({'plate': track}))[:3]
    ['t [s],plate [m]', '0,0', '0.5,0.001']

    """
    yield ','.join(['t [s]', *(f'{body} [m]' for body in tracks)])
    heights = [
        dict(zip(track.time.tolist(), track.position.tolist(), strict=True))
        for track in tracks.values()
    ]
    for time in sorted(set().union(*heights)):
        cells = [f'{each[time]:.9g}' if time in each else '' for each in heights]
        yield ','.join([f'{time:.9g}', *cells])


class _Rows:
    """The cells of lines that are no comments, with the lines' numbers."""

    def __init__(self, lines: Iterable[str]) -> None:
        self._lines = enumerate(lines, 1)
        self._separator: str | None = ''

    def __iter__(self) -> Iterator[tuple[int, list[str]]]:
        for number, line in self._lines:
            text = line.strip(' \r\n\ufeff')
            if text.strip() and not text.startswith('#'):
                yield number, self._split(text)

    def _split(self, text: str) -> list[str]:
        if self._separator == '':
            found = (separator for separator in (';', '\t', ',') if separator in text)
            self._separator = next(found, None)
        cells = text.split(self._separator)
        if self._separator != ',':
            cells = [re.sub(r'(?<=\d),(?=\d)', '.', cell) for cell in cells]
        return [cell.strip().strip('"\'') for cell in cells]


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True


def _number(text: str, what: str, where: str) -> float:
    if text.lower() in _MISSING:
        return math.nan
    if not _is_number(text) or math.isinf(float(text)):
        raise TrackError(f'{where}: {what} must be a finite number, got {text!r}')
    return float(text)


def _order(cells: Sequence[str], bodies: Sequence[str]) -> dict[str, int]:
    """Take columns without names as they come."""
    return {body: place for place, body in enumerate(('time', *bodies)) if place < len(cells)}


def _header(cells: Sequence[str], bodies: Sequence[str], unit: str, where: str) -> dict[str, int]:
    """Find columns by their names."""
    known = {'time': (_TIME, 's'), **{body: (NAMES[body], unit) for body in bodies}}
    columns: dict[str, int] = {}
    for place, cell in enumerate(cells):
        label, _, bracket = re.sub(r'[\[(]', '\n', cell, count=1).partition('\n')
        for body, (names, expected) in known.items():
            if label.strip().lower() in names:
                given = bracket.rstrip(' )]').replace('\N{MICRO SIGN}', 'u')
                if bracket and given != expected:
                    hint = '' if body == 'time' or given not in UNITS else f'; see --unit {given}'
                    raise TrackError(f'{where}: {body} is read in {expected}, got {cell!r}{hint}')
                if body in columns:
                    raise TrackError(f'{where}: {body} must be there once, got {cell!r} too')
                columns[body] = place
    for body in ('time', bodies[0]):
        if body not in columns:
            raise TrackError(
                f'{where}: no column is named {known[body][0][0]!r}, got {", ".join(cells)}'
            )
    return columns


def _tracks(
    times: list[float], values: dict[str, list[float]], first: str, name: str
) -> Iterator[tuple[str, Track]]:
    """Leave out what was not seen."""
    time = np.array(times)
    for body, series in values.items():
        position = np.array(series)
        seen = np.isfinite(position)
        if seen.sum() >= FEWEST:
            yield body, Track(time=time[seen], position=position[seen])
        elif body == first or seen.any():
            raise TrackError(
                f'{name}: {seen.sum()} heights of the {body}, where at least {FEWEST} are needed'
            )
