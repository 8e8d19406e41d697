# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""The rig, the settings and the throws of a twin over time, from the lines of its journal."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable
import contextlib
from dataclasses import dataclass, replace
from typing import Any
import zlib

import numpy as np
from numpy.typing import NDArray
from soft_throw_ros.configuration import rig_of, Settings, TWIN
from soft_throw_ros.configuration.interface import find_topic
from soft_throw_ros.core.rig import Rig
from soft_throw_ros.storage.cdr import decode
from soft_throw_ros.storage.message import Message, SECOND
from soft_throw_ros.twin import journal
from soft_throw_ros.twin.results import Floats
from soft_throw_ros.twin.session import TickSchedule

Stamps = NDArray[np.int64]

DECODING_ERRORS = (  # of damaged bytes, or another program's messages on a topic of that name
    ValueError, LookupError, TypeError, AttributeError, ArithmeticError, RecursionError,
    zlib.error,
)


@dataclass(frozen=True, kw_only=True)
class ThrowStart:
    """Start of a throw [ns]; `time_scale` is time of the rig over time of the stamps [-]."""

    stamp: int
    number: int
    time_scale: float
    ejection_time: float | None = None  # from the start; None if there is none so far [s]
    is_over: bool = False  # whether its end has been reported

    def seconds_to(self, stamps: Any) -> Any:
        """Return the time of the rig from the start to a stamp or an array of stamps [s]."""
        return (stamps - self.stamp) * (self.time_scale / SECOND)

    def stamps_at(self, seconds: Floats) -> Stamps:
        """Return the stamps for times of the rig since the start [ns]."""
        return self.stamp + np.rint(seconds * (SECOND / self.time_scale)).astype(np.int64)


class TwinJournal:
    """The rig, the settings and the throw of a twin after the lines of its journal so far."""

    def __init__(self) -> None:
        self.rig: Rig | None = None  # None while unknown
        self.settings: Settings = TWIN.defaults()
        self.throw: ThrowStart | None = None
        # Heights of a measured plate and projectile before the throw [m]
        self.rest_heights: tuple[float, float] | None = None
        self.clock_offset_ns = 0  # of the stamps of measurements [ns]

    @property
    def time_scale(self) -> float:
        """Time of the rig over time of the stamps [-]."""
        is_measured = self.settings['engine.motion'] == 'measured'
        return 1.0 if is_measured else float(self.settings['time_scale'])

    @staticmethod
    def reads(message: Message) -> bool:
        """Return False for a line that `read` would ignore, such as most lines."""
        head = 8  # of the text: encapsulation and length [bytes]
        return not message.data.startswith((b'{"kind":"checksum"', b'{"kind":"samples"'), head)

    def read(self, message: Message) -> None:
        """Apply a line; raise one of `DECODING_ERRORS` if it is damaged."""
        entry = journal.decode(str(decode(message).data))
        match entry['kind']:
            case 'start':
                self._take_effect(entry)
            case 'throw':
                self._start_throw(entry)
            case 'result' if self.throw and entry['result'].get('throw') == self.throw.number:
                result, time = entry['result'], entry['result'].get('ejection_time')
                time = time if isinstance(time, float) and time > 0.0 else None
                is_over = result.get('stage') == 'final'
                self.throw = replace(self.throw, ejection_time=time, is_over=is_over)

    def _take_effect(self, entry: journal.Entry) -> None:
        """Apply the known settings of an entry, with defaults for missing ones."""
        settings = TWIN.defaults()
        for name in settings.keys() & entry['settings'].keys():
            settings[name] = TWIN.check_value(name, entry['settings'][name])
        if self.rig is None or settings != self.settings:
            self.rig = rig_of(settings, journal.motion_source(entry))  # which opens no file
        self.settings = settings

    def _start_throw(self, entry: journal.Entry) -> None:
        if 'onset' in entry:
            onset = journal.decode_onset(entry['onset'])
            stamp, self.clock_offset_ns = onset.onset_ns, onset.clock_offset_ns
            self.rest_heights = onset.rest.plate, onset.rest.projectile
        else:
            stamp = TickSchedule(**entry['schedule']).deadline(entry['step'])
            self.rest_heights = None
        self._take_effect(entry)
        self.throw = ThrowStart(stamp=stamp, number=entry['throw'], time_scale=self.time_scale)


def find_throws(messages: Iterable[Message]) -> dict[str, list[ThrowStart]]:
    """Return the throws of each twin in journals; of a repeated one, that which is complete."""
    throws: dict[str, dict[int, ThrowStart]] = defaultdict(dict)  # by twin and stamp
    journals: dict[str, TwinJournal] = defaultdict(TwinJournal)
    for message in filter(TwinJournal.reads, messages):
        node, _ = find_topic(message.channel.topic, message.channel.type) or ('', None)
        with contextlib.suppress(*DECODING_ERRORS):  # the view counts the message as unreadable
            journals[node].read(message)
        throw = journals[node].throw
        if throw and (throw.is_over or not throws[node].get(throw.stamp, throw).is_over):
            throws[node][throw.stamp] = throw
    return {node: list(by_stamp.values()) for node, by_stamp in throws.items()}
