# SPDX-License-Identifier: Apache-2.0
"""Identification beside a recorder: throw after throw, as its bag grows."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Sequence
import contextlib
import sys
import time

from soft_throw_ros.commands.identify_input import Growing, Source
from soft_throw_ros.identification.tracks import ThrowTracks
from soft_throw_ros.recording.follow import follow
from soft_throw_ros.recording.message import BagError, Message

Refresh = Callable[[Sequence[ThrowTracks]], None]

_PAUSE = 0.2  # between looks at a bag that has not grown [s]


def watch(folder: str, source: Source, refresh: Refresh, *, last: int) -> None:
    """
    Identify again after every throw, until the bag is complete or somebody presses Ctrl-C.

    Parameters
    ----------
    folder : str
        A bag that is being written.
    source : Source
        How to read it.
    refresh : callable
        Is given the last throws. What it refuses is said, and the newest throw left out.
    last : int
        How many of them.

    Raises
    ------
    ValueError
        If the folder is no such bag, or complete without a throw.

    """
    growing = Growing(folder, source)
    kept: deque[ThrowTracks] = deque(maxlen=last)

    def take(throws: list[ThrowTracks]) -> None:
        if not throws:
            return
        try:
            refresh([*kept, *throws][-last:])
        except ValueError as error:
            if len(throws) == 1:
                name = throws[0].name
                reason = str(error).removeprefix(f'{name}: ')
                print(f'identify: {name} is left out: {reason}', file=sys.stderr)
            for throw in throws if len(throws) > 1 else ():
                take([throw])
        else:
            kept.extend(throws)

    def look() -> None:
        take(growing.throws(is_complete=False))
        time.sleep(_PAUSE)

    print(f'identify: watching {folder} until it is complete; Ctrl-C ends it', file=sys.stderr)
    with contextlib.suppress(KeyboardInterrupt):
        try:
            for item in follow(folder, look):
                if isinstance(item, Message):
                    growing.record.add(item)
        except BagError as error:
            if not kept:
                raise
            print(f'identify: {error}', file=sys.stderr)
        take(growing.throws(is_complete=True))
