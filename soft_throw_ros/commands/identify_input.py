# SPDX-License-Identifier: Apache-2.0
"""Tracks from files: CSV, and bags with messages JointState."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
import math
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from soft_throw_ros.identification.least_squares import FitError
from soft_throw_ros.identification.plate_fit import fit_plate
from soft_throw_ros.identification.track_csv import read_csv
from soft_throw_ros.identification.tracks import (
    FEWEST,
    find_throws,
    split_into_throws,
    ThrowTracks,
    Track,
    TrackError,
)
from soft_throw_ros.recording.bag_reader import BagReader
from soft_throw_ros.recording.cdr import decode_joint_states, MessageError

Floats = NDArray[np.float64]

_BODIES = ('plate', 'projectile')
_TYPE = 'sensor_msgs/msg/JointState'
_PREFERRED = ('/measured_joint_states', '/joint_states')
"""How topics end that are read before others: what is measured, then what the twin says."""

_MAX_FALSE_THROWS = 10  # that a record of one may be taken for because of its noise
_ONE_MOTION = 1.5  # times the noise that one motion leaves of a record at most, if it is of one


@dataclass(frozen=True, kw_only=True)
class TrackReader:
    """
    How to read files.

    Parameters
    ----------
    unit : str
        Of heights in CSV files; bags are in metres.
    topic : str, optional
        To read from bags, if several have a plate.
    noise : float, optional
        Standard deviation of heights, if it is known. [m]
    start, end : float
        What to leave out before and after, on the clock of the file. [s]

    """

    unit: str = 'm'
    topic: str | None = None
    noise: float | None = None
    start: float = -math.inf
    end: float = math.inf

    def throws(self, path: str) -> list[ThrowTracks]:
        """
        Read the throws of a file.

        Raises
        ------
        ValueError
            Naming the file, and if it is text the line, if something is wrong.

        """
        is_bag = Path(path).is_dir() or path.endswith(('.mcap', '.mcap.zstd'))
        return self.split(
            _read_bag(path, self.topic) if is_bag else self._read_csv(path, _BODIES), path
        )

    def free_layer(self, path: str) -> tuple[Track, Track]:
        """
        Read bottom and top of a free layer from a CSV file.

        Raises
        ------
        ValueError
            As for `throws`.

        """
        tracks = self._read_csv(path, ('bottom', 'top'))
        if 'top' not in tracks:
            raise TrackError(f'{path}: must have a time and both ends of the layer, got one end')
        return self.cut_layer((tracks['bottom'], tracks['top']), path)

    def split(self, tracks: Mapping[str, Track], path: str) -> list[ThrowTracks]:
        """
        Cut what was read from a file into throws.

        Raises
        ------
        TrackError
            If too little is left.

        """
        plate, projectile = (
            self._with_noise(tracks[body]) if body in tracks else None for body in _BODIES
        )
        if plate is None:
            raise TrackError(f'{path}: less than {FEWEST} positions of the plate')
        whole = ThrowTracks(name=Path(path).name, plate=plate, projectile=projectile)
        try:
            whole = whole.between(self.start, self.end)
            if len(find_throws(whole.plate)) < _MAX_FALSE_THROWS and _is_one_motion(whole):
                return [whole]
            return split_into_throws(whole)
        except TrackError as error:
            raise TrackError(f'{whole.name}: {error}') from None

    def cut_layer(self, ends: tuple[Track, Track], path: str) -> tuple[Track, Track]:
        """
        Leave out what is not to be looked at of the ends of a free layer.

        Raises
        ------
        TrackError
            If too little is left.

        """
        try:
            bottom, top = (self._with_noise(end).between(self.start, self.end) for end in ends)
        except TrackError as error:
            raise TrackError(f'{path}: {error}') from None
        return bottom, top

    def _with_noise(self, track: Track) -> Track:
        return track if self.noise is None else replace(track, known_noise=self.noise)

    def _read_csv(self, path: str, bodies: Sequence[str]) -> dict[str, Track]:
        try:
            with Path(path).open(encoding='utf-8-sig', newline='') as file:
                return read_csv(file, path, bodies, unit=self.unit)
        except OSError as error:
            raise TrackError(f'{path}: {error.strerror}') from None
        except UnicodeDecodeError:
            raise TrackError(f'{path}: is no UTF-8 text') from None


def _is_one_motion(record: ThrowTracks) -> bool:
    """Tell whether one motion explains a record that noise makes look like several throws."""
    try:
        residual = fit_plate(record.plate).fit.residuals[0]
    except FitError:
        return False
    return residual.rms < _ONE_MOTION * record.plate.noise


def _read_bag(path: str, topic: str | None) -> dict[str, Track]:
    """Read plate and projectile from the topic that was asked for, or the best of a bag."""
    datas: dict[str, list[bytes]] = {}
    with BagReader(path) as reader:
        names = {channel.topic for channel in reader.channels if channel.type == _TYPE}
        for message in reader.messages(names):
            datas.setdefault(message.channel.topic, []).append(message.data)
    rows: dict[str, Floats] = {}
    for name, some in datas.items():
        try:
            rows[name] = _read_positions(some)
        except MessageError as error:
            if name == topic:
                raise TrackError(f'{path}: {topic}: {error}') from None
    found = sorted(name for name, each in rows.items() if np.isfinite(each[:, 1]).any())
    if topic is None:
        ranks = [[name for name in found if name.endswith(ending)] for ending in _PREFERRED]
        best = next(filter(None, ranks), found)
    else:
        best = [name for name in found if name == topic]
    if len(best) != 1:
        raise TrackError(
            f'{path}: no topic {topic or "of its own"} has positions of a joint plate; those '
            f'that have: {", ".join(found) or "none"}' + (' (choose with --topic)' * bool(found))
        )
    time, *heights = rows[best[0]].T
    return {
        body: Track(time=time[np.isfinite(each)], position=each[np.isfinite(each)])
        for body, each in zip(_BODIES, heights, strict=True)
        if np.isfinite(each).sum() >= FEWEST
    }


def _read_positions(datas: Sequence[bytes]) -> Floats:
    """
    Read times since the first message, and heights of both bodies, NaN where one has none.

    Some messages may be of other joints, as of the plate alone.
    """
    by_length: dict[int, list[bytes]] = {}
    for data in datas:
        by_length.setdefault(len(data), []).append(data)
    stamps, heights = [], []
    for some in by_length.values():
        states = decode_joint_states(some)
        stamps.append(states.stamps)
        columns = np.full((states.stamps.size, len(_BODIES)), np.nan)
        for column, body in enumerate(_BODIES):
            if body in states.names and states.position.size:
                columns[:, column] = states.position[:, states.names.index(body)]
        heights.append(columns)
    stamps_ns, first = np.unique(np.concatenate(stamps), return_index=True)
    time = 1e-9 * (stamps_ns - stamps_ns[0])
    return np.column_stack([time, np.concatenate(heights)[first]])
