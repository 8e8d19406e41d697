# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Positions of joints in the messages JointState of a bag."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass, field
import math

from soft_throw_ros.storage.bag_reader import BagReader
from soft_throw_ros.storage.cdr import JointStateReader, MessageError


@dataclass
class RecordedPositions:
    """Positions of joints on one topic."""

    # by stamp [ns], NaN for a joint that a message lacks; of equal stamps the first one counts
    rows: dict[int, list[float]] = field(default_factory=dict)
    unreadable: int = 0  # number of messages that are no JointState


def read_positions(
    reader: BagReader, topics: Collection[str], joints: Sequence[str]
) -> dict[str, RecordedPositions]:
    """Read the positions of joints on topics of JointState, in the order of receiving."""
    recorded = {topic: RecordedPositions() for topic in topics}
    decoders = {topic: JointStateReader() for topic in topics}
    for message in reader.messages(topics):
        topic = message.channel.topic
        try:
            values = decoders[topic].read(message.data)
        except MessageError:
            recorded[topic].unreadable += 1
            continue
        # A message may lack a joint, or all positions
        positions = dict(zip(values.names, values.position))  # noqa: B905
        row = [positions.get(joint, math.nan) for joint in joints]
        recorded[topic].rows.setdefault(values.stamp_ns, row)
    return recorded
