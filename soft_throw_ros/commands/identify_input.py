# SPDX-License-Identifier: Apache-2.0
"""Tracks from files: CSV, and bags with messages JointState."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
import math
from pathlib import Path

import numpy as np
from soft_throw_ros.identification.tracks import (
    FEWEST,
    read_csv,
    ThrowTracks,
    Track,
    TrackError,
)

_TYPE = 'sensor_msgs/msg/JointState'
_MEASURED = 'measured_joint_states'


@dataclass(frozen=True, kw_only=True)
class Source:
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
        bodies = ('plate', 'projectile')
        is_bag = Path(path).is_dir() or path.endswith(('.mcap', '.mcap.zstd'))
        tracks = _read_bag(path, self.topic) if is_bag else self._read_csv(path, bodies)
        whole = ThrowTracks(
            name=Path(path).name,
            plate=self._known(tracks['plate']),
            projectile=self._known(tracks['projectile']) if 'projectile' in tracks else None,
        )
        return [part for cut in [self._cut(whole)] for part in cut.throws()]

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
        try:
            bottom, top = (
                self._known(tracks[end]).between(self.start, self.end) for end in ('bottom', 'top')
            )
        except TrackError as error:
            raise TrackError(f'{path}: {error}') from None
        return bottom, top

    def _cut(self, whole: ThrowTracks) -> ThrowTracks:
        try:
            return whole.between(self.start, self.end)
        except TrackError as error:
            raise TrackError(f'{whole.name}: {error}') from None

    def _known(self, track: Track) -> Track:
        return track if self.noise is None else replace(track, known_noise=self.noise)

    def _read_csv(self, path: str, bodies: Sequence[str]) -> dict[str, Track]:
        try:
            with Path(path).open(encoding='utf-8-sig', newline='') as file:
                return read_csv(file, path, bodies, unit=self.unit)
        except OSError as error:
            raise TrackError(f'{path}: {error.strerror}') from None
        except UnicodeDecodeError:
            raise TrackError(f'{path}: is no UTF-8 text') from None


def _read_bag(path: str, topic: str | None) -> dict[str, Track]:
    """Read plate and projectile from messages of one topic, by their stamps."""
    from soft_throw_ros.recording.bag import BagReader
    from soft_throw_ros.recording.cdr import decode_joint_states, MessageError

    with BagReader(path) as reader:
        found = {}
        for name in sorted({each.topic for each in reader.channels if each.type == _TYPE}):
            datas = [message.data for message in reader.messages(name)]
            try:
                states = decode_joint_states(datas) if datas else None
            except MessageError as error:
                raise TrackError(f'{path}: {name}: {error}') from None
            if states is not None and 'plate' in states.names and states.position.size:
                found[name] = states
    chosen = topic or next(
        (name for name in found if len(found) == 1 or name.endswith(_MEASURED)), None
    )
    if chosen is None or chosen not in found:
        there = ', '.join(found) or 'none'
        raise TrackError(
            f'{path}: no topic {chosen or "of its own"} has positions of a joint plate; '
            f'those that have: {there}' + (' (choose with --topic)' if found else '')
        )
    states = found[chosen]
    order = np.argsort(states.stamps, kind='stable')
    order = order[np.append(True, np.diff(states.stamps[order]) > 0)]  # what came twice
    time = 1e-9 * (states.stamps[order] - states.stamps[order[0]])
    tracks: dict[str, Track] = {}
    for body in ('plate', 'projectile'):
        if body in states.names:
            position = states.position[order, states.names.index(body)]
            seen = np.isfinite(position)
            if seen.sum() >= FEWEST:
                tracks[body] = Track(time=time[seen], position=position[seen])
    if 'plate' not in tracks:
        raise TrackError(f'{path}: {chosen} has less than {FEWEST} positions of the plate')
    return tracks
