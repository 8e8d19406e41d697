# SPDX-License-Identifier: Apache-2.0
"""Tracks from files: CSV, and bags with messages JointState, whole or as they are written."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
import math
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from soft_throw_ros.identification.fit import FitError
from soft_throw_ros.identification.plate_fit import fit_plate
from soft_throw_ros.identification.tracks import (
    FEWEST,
    find_throws,
    read_csv,
    ThrowTracks,
    Track,
    TrackError,
)
from soft_throw_ros.recording.bag_reader import BagReader
from soft_throw_ros.recording.cdr import decode_joint_states, MessageError
from soft_throw_ros.recording.message import Message

Floats = NDArray[np.float64]

_BODIES = ('plate', 'projectile')
_TYPE = 'sensor_msgs/msg/JointState'
_BETTER = ('/measured_joint_states', '/joint_states')
"""How topics end that are read before others: what is measured, then what the twin says."""

_FEW = 10  # throws that a record of one may be taken for because of its noise
_WHOLE = 1.5  # times the noise that one motion leaves of a record at most, if it is that of one


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
        is_bag = Path(path).is_dir() or path.endswith(('.mcap', '.mcap.zstd'))
        return self.cut(self._read_bag(path) if is_bag else self._read_csv(path, _BODIES), path)

    def cut(self, tracks: Mapping[str, Track], path: str) -> list[ThrowTracks]:
        """
        Cut what was read from a file into throws.

        Raises
        ------
        TrackError
            If too little is left.

        """
        whole = self.throw_of(tracks, path)
        try:
            whole = whole.between(self.start, self.end)
            if len(find_throws(whole.plate)) < _FEW and _is_one(whole):
                return [whole]
            return whole.throws()
        except TrackError as error:
            raise TrackError(f'{whole.name}: {error}') from None

    def throw_of(self, tracks: Mapping[str, Track], path: str) -> ThrowTracks:
        """Put together what was read of plate and projectile."""
        plate, projectile = (
            self._known(tracks[body]) if body in tracks else None for body in _BODIES
        )
        if plate is None:
            raise TrackError(f'{path}: less than {FEWEST} positions of the plate')
        return ThrowTracks(name=Path(path).name, plate=plate, projectile=projectile)

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

    def cut_layer(self, ends: tuple[Track, Track], path: str) -> tuple[Track, Track]:
        """
        Leave out what is not to be looked at of the ends of a free layer.

        Raises
        ------
        TrackError
            If too little is left.

        """
        try:
            bottom, top = (self._known(end).between(self.start, self.end) for end in ends)
        except TrackError as error:
            raise TrackError(f'{path}: {error}') from None
        return bottom, top

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

    def _read_bag(self, path: str) -> dict[str, Track]:
        record = Record(path, self.topic)
        with BagReader(path) as reader:
            names = {channel.topic for channel in reader.channels if channel.type == _TYPE}
            for message in reader.messages(names):
                record.add(message)
        return record.tracks()


def _is_one(record: ThrowTracks) -> bool:
    """Tell whether one motion explains a record, however it looks to who cuts it in its noise."""
    try:
        residual = fit_plate(record.plate).fit.residuals[0]
    except FitError:
        return False
    return residual.rms < _WHOLE * record.plate.noise


class Record:
    """
    Heights of plate and projectile from messages of a bag, as far as they have come.

    Parameters
    ----------
    path : str
        Of the bag, for messages.
    topic : str, optional
        To read; otherwise one that is measured, or the twin's if none is.

    """

    def __init__(self, path: str, topic: str | None = None) -> None:
        self._path = path
        self._topic = topic
        self._waiting: dict[str, list[bytes]] = {}
        self._rows: dict[str, Floats] = {}
        self._unreadable: dict[str, str] = {}
        self._origin: int | None = None  # [ns]

    def add(self, message: Message) -> None:
        """Take a message; those of other types are passed over."""
        if message.channel.type == _TYPE:
            self._waiting.setdefault(message.channel.topic, []).append(message.data)

    def tracks(self) -> dict[str, Track]:
        """
        Return the tracks, over the time since the first message of the bag.

        Raises
        ------
        TrackError
            If there is no plate, or several and none was asked for.

        """
        for topic, datas in self._waiting.items():
            try:
                rows = self._read(datas)
            except MessageError as error:
                self._unreadable[topic] = str(error)
                continue
            rows = np.concatenate([self._rows.get(topic, rows[:0]), rows])
            rows = rows[np.argsort(rows[:, 0], kind='stable')]
            self._rows[topic] = rows[np.append(True, np.diff(rows[:, 0]) > 0.0)]  # came twice
        self._waiting.clear()
        rows = self._rows[self._choose()]
        tracks = {}
        for body, heights in zip(_BODIES, rows.T[1:], strict=True):
            seen = np.isfinite(heights)
            if seen.sum() >= FEWEST:
                tracks[body] = Track(time=rows[seen, 0], position=heights[seen])
        return tracks

    def forget(self, before: float) -> None:
        """Drop what is older. [s]"""
        self._rows = {topic: rows[rows[:, 0] >= before] for topic, rows in self._rows.items()}

    def _read(self, datas: Sequence[bytes]) -> Floats:
        """Read times and heights; some messages may be of other joints, as of the plate alone."""
        alike: dict[int, list[bytes]] = {}
        for data in datas:
            alike.setdefault(len(data), []).append(data)
        parts = []
        for some in alike.values():
            states = decode_joint_states(some)
            if self._origin is None:
                self._origin = int(states.stamps[0])
            rows = np.full((states.stamps.size, 1 + len(_BODIES)), np.nan)
            rows[:, 0] = 1e-9 * (states.stamps - self._origin)
            for column, body in enumerate(_BODIES, 1):
                if body in states.names and states.position.size:
                    rows[:, column] = states.position[:, states.names.index(body)]
            parts.append(rows)
        return np.concatenate(parts)

    @property
    def is_ambiguous(self) -> bool:
        """Whether there are several topics to read, and none is better than the others."""
        return len(self._best()) > 1

    def _choose(self) -> str:
        """Choose the topic to read."""
        best = self._best()
        if len(best) == 1:
            return best[0]
        if self._topic in self._unreadable:
            raise TrackError(f'{self._path}: {self._topic}: {self._unreadable[self._topic]}')
        found = self._found()
        there = ', '.join(found) or 'none'
        raise TrackError(
            f'{self._path}: no topic {self._topic or "of its own"} has positions of a joint '
            f'plate; those that have: {there}' + (' (choose with --topic)' if found else '')
        )

    def _found(self) -> list[str]:
        """List the topics that have positions of a plate."""
        return sorted(topic for topic, rows in self._rows.items() if np.isfinite(rows[:, 1]).any())

    def _best(self) -> list[str]:
        """List those of them to read."""
        found = self._found()
        if self._topic is not None:
            return [topic for topic in found if topic == self._topic]
        ranks = [[topic for topic in found if topic.endswith(ending)] for ending in _BETTER]
        return next(filter(None, ranks), found)


class Growing:
    """
    The throws of a record that grows, each as soon as it is over.

    Parameters
    ----------
    path : str
        Of the bag.
    source : Source
        How to read it.

    """

    def __init__(self, path: str, source: Source) -> None:
        self.record = Record(path, source.topic)
        self._path = path
        self._source = source
        self._count = 0
        self._end = -math.inf  # of the last throw [s]

    def throws(self, *, is_complete: bool) -> list[ThrowTracks]:
        """
        Return throws that were not returned before.

        Parameters
        ----------
        is_complete : bool
            Whether nothing will come any more, so that the last one is as over as it gets.

        Raises
        ------
        TrackError
            If it is complete, and has no plate; or has several, and none was asked for.

        """
        try:
            whole = self._source.throw_of(self.record.tracks(), self._path)
        except TrackError:
            if is_complete or self.record.is_ambiguous:
                raise
            return []
        now = whole.plate.time[-1]
        spans = [
            (start, end)
            for start, end in find_throws(whole.plate)
            if 0.5 * (start + min(end, now)) > self._end and (end <= now or is_complete)
        ]
        if is_complete and not spans and self._count == 0:
            spans = [(-math.inf, math.inf)]
        found = []
        for start, end in spans:
            self._count += 1
            self._end = end
            if self._source.start <= start and end <= self._source.end:
                name = f'{whole.name}, throw {self._count}'
                found.append(replace(whole.between(start, end), name=name))
        if spans:  # the rest before the last throw shows where the plate comes back to
            start, end = spans[-1]
            self.record.forget(start - (end - start))
        return found
