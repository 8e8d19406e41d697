# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Recorded messages and their channels."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

SECOND = 1_000_000_000  # [ns]

LATEST = 2**63 - 1
"""The latest time that ROS knows. [ns]"""


class BagError(ValueError):
    """A bag cannot be read or written; the message is one line, even if it quotes several."""

    def __init__(self, message: str) -> None:
        super().__init__(' '.join(message.splitlines()))


@dataclass(frozen=True, kw_only=True, eq=False)
class Channel:
    """A topic in a bag; two channels are the same if they are one object."""

    topic: str  # Full name
    type: str  # Such as `sensor_msgs/msg/JointState`  # noqa: A003
    schema: str  # Definition of the type and its dependencies, from `schemas.find_schema`
    type_hash: str = ''  # `RIHS01_...`, or empty
    qos: str = ''  # Profiles of the publishers: a list in YAML, in the form of rosbag2, or empty
    schema_encoding: str = 'ros2msg'  # Other recorders may write `ros2idl`


class Message(NamedTuple):
    """A serialised message with its times."""

    channel: Channel
    data: bytes  # Serialised as CDR
    log_time: int  # Time of receiving. [ns]
    publish_time: int  # Time of publishing. [ns]
    sequence: int = 0  # Sequence number of the publisher; a bag keeps the lower 32 bits

    @property
    def published(self) -> int:
        """Time of publishing, or of receiving if the recorder did not note the former [ns]."""
        return self.publish_time or self.log_time

    @property
    def has_valid_times(self) -> bool:
        """Whether MCAP and ROS can hold its times."""
        return 0 <= (self.log_time | self.publish_time) <= LATEST

    def checked(self) -> Message:
        """Return the message; raise ValueError if its times are invalid."""
        if not self.has_valid_times:
            raise ValueError(
                f'{self.channel.topic}: times must be at least 0 and below 2**63 ns, got '
                f'{self.log_time} and {self.publish_time}'
            )
        return self
