# Copyright 2026 soft_throw_ros developers
#
# Licensed under the Apache License, Version 2.0 (the "License");
# you may not use this file except in compliance with the License.
# You may obtain a copy of the License at
#
#     http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software
# distributed under the License is distributed on an "AS IS" BASIS,
# WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied.
# See the License for the specific language governing permissions and
# limitations under the License.
"""What is recorded: messages, and the channels they come through."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

LATEST = 2**63 - 1
"""The latest time that ROS knows. [ns]"""


class BagError(ValueError):
    """
    A bag cannot be read or written; the message names its path, and what would be right.

    It is one line, whatever is quoted of the bag.
    """

    def __init__(self, message: str) -> None:
        super().__init__(' '.join(message.splitlines()))


@dataclass(frozen=True, kw_only=True, eq=False)
class Channel:
    """A topic in a bag; two channels are the same if they are one object."""

    topic: str  # Its full name
    type: str  # As `sensor_msgs/msg/JointState`  # noqa: A003
    schema: str  # Definition of the type and of all that it depends on, from `schemas.find_schema`
    type_hash: str = ''  # `RIHS01_...`, or empty
    # What its publishers offer: a list of profiles in YAML, as rosbag2 writes it, or empty
    qos: str = ''
    # How the schema is written; those of others may be in `ros2idl`
    schema_encoding: str = 'ros2msg'

    @property
    def is_latched(self) -> bool:
        """Whether a publisher keeps messages for those who subscribe later."""
        return 'durability: transient_local' in self.qos


class Message(NamedTuple):
    """A message, as it came."""

    channel: Channel  # What it came through
    data: bytes  # Serialised as CDR
    log_time: int  # When it was received. [ns]
    publish_time: int  # When it was published. [ns]
    sequence: int = 0  # Its number at the publisher; a bag keeps the lower 32 bits
