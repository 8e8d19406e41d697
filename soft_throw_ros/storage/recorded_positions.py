# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Positions of joints in the messages JointState of a bag."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
import contextlib
import json
import math
from typing import Any

from soft_throw_ros.storage.bag_reader import BagReader
from soft_throw_ros.storage.cdr import decode, JointStateReader, MessageError


class RecordedPositions:
    """Positions of joints on one topic."""

    def __init__(self, settings: Mapping[str, Any]) -> None:
        # by stamp [ns], NaN for a joint that a message lacks; of equal stamps the first one counts
        self.rows: dict[int, list[float]] = {}
        self.unreadable = 0  # number of messages that are no JointState
        self.names: set[str] = set()  # of all joints of the topic
        # time of the rig over that of the stamps
        self.time_scale: float = settings.get('time_scale', 1.0)


def read_positions(
    reader: BagReader, topics: Collection[str], joints: Sequence[str]
) -> dict[str, RecordedPositions]:
    """
    Read the positions of joints on topics of JointState, in the order of receiving.

    The journal beside a topic gives the `joint_names.*` and the time scale of its twin.
    """
    settings = {topic: _settings_beside(reader, topic) for topic in topics}
    recorded = {topic: RecordedPositions(settings[topic]) for topic in topics}
    decoders = {topic: JointStateReader() for topic in topics}
    for message in reader.messages(topics):
        topic = message.channel.topic
        try:
            states = decoders[topic].read_all([message.data])
        except MessageError:
            recorded[topic].unreadable += 1
            continue
        # A message may lack a joint, or all positions
        positions = dict(zip(states.names, states.position[0].tolist()))  # noqa: B905
        recorded[topic].names.update(states.names)
        names = [str(settings[topic].get(f'joint_names.{joint}', joint)) for joint in joints]
        row = [positions.get(name, math.nan) for name in names]
        recorded[topic].rows.setdefault(int(states.stamps[0]), row)
    return recorded


def _settings_beside(reader: BagReader, topic: str) -> Mapping[str, Any]:
    """Return the settings with which the journal beside a topic starts; empty without any."""
    for message in reader.messages([f'{topic.rpartition("/")[0]}/journal']):
        with contextlib.suppress(ValueError, KeyError, TypeError, AttributeError, RecursionError):
            settings = dict(json.loads(decode(message).data)['settings'])
            return {**settings, 'time_scale': float(settings.get('time_scale', 1.0))}
    return {}
