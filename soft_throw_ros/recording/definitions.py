# SPDX-License-Identifier: Apache-2.0
"""
The channels of an MCAP file or stream, by what it says of them.

A definition stands in a file several times. One with a checksum is believed. One without, which
may be damaged, is held against what is installed here.
"""

from __future__ import annotations

import contextlib
import re

from mcap import records as mcap
from soft_throw_ros.recording import qos
from soft_throw_ros.recording.cdr import decoder_of, MessageError
from soft_throw_ros.recording.message import BagError, Channel, LATEST, Message
from soft_throw_ros.recording.schemas import (
    find_schema,
    installed_prefixes,
    is_complete,
    Schema,
    SchemaError,
)

Known = dict[tuple[object, ...], Channel]

_TOPIC = re.compile(r'(/[A-Za-z_]\w*)+', re.ASCII)


class DamageError(ValueError):
    """Bytes are not what they should be; the message says why."""


class Definitions:
    """
    The channels of a file or stream, by their numbers in it.

    `known` has the channels of all files of a bag, so that what is the same is one object.

    Attributes
    ----------
    doubts : list of str
        What is left out of channels whose definition has no checksum.

    """

    def __init__(self, known: Known) -> None:
        self.doubts: list[str] = []
        self._known = known
        self._schemas: dict[int, mcap.Schema] = {}
        self._records: dict[int, mcap.Channel] = {}
        self._checked: set[tuple[type, int]] = set()
        self._channels: dict[int, Channel | None] = {}

    def add(self, record: mcap.Schema | mcap.Channel, *, is_checked: bool = True) -> None:
        """Take a definition; one whose checksum is not right by now only if there is no other."""
        records = self._schemas if isinstance(record, mcap.Schema) else self._records
        if is_checked:
            self._checked.add((type(record), record.id))
        elif record.id in records:
            return
        records[record.id] = record  # type: ignore[assignment]  # of the kind that is in there
        self._channels.clear()

    def all(self) -> dict[int, Channel]:
        """Return those that are defined, or raise BagError if one is not of ROS 2."""
        for number, record in self._records.items():
            if number not in self._channels and record.schema_id in self._schemas:
                self._channels[number] = self._make(record, self._schemas[record.schema_id])
        return {number: channel for number, channel in self._channels.items() if channel}

    def message(self, record: mcap.Message) -> Message:
        """Return a message, or raise DamageError."""
        channel = self._channels.get(record.channel_id) or self.all().get(record.channel_id)
        if channel is None:
            raise DamageError(f'nothing defines channel {record.channel_id} of a message')
        if (record.log_time | record.publish_time) > LATEST:
            raise DamageError('a message has no valid times')
        return Message(channel, record.data, record.log_time, record.publish_time, record.sequence)

    def _make(self, record: mcap.Channel, schema: mcap.Schema) -> Channel | None:
        """Make a channel, of what can be trusted; None if that is not enough."""
        said = Schema(
            text=schema.data.decode(errors='replace'),
            type_hash=record.metadata.get('topic_type_hash', ''),
        )
        encoding: str = schema.encoding
        if not {(mcap.Schema, schema.id), (mcap.Channel, record.id)} <= self._checked:
            trusted = self._trusted(record.topic, schema, said)
            if trusted is not None:
                is_idl = encoding == 'ros2idl' and trusted.text == said.text
                said, encoding = trusted, 'ros2idl' if is_idl else 'ros2msg'
            elif record.message_encoding == 'cdr':
                return None
        if record.message_encoding != 'cdr':
            raise BagError(
                f'{record.topic} has messages in {record.message_encoding!r}, not in '
                "'cdr' as those of ROS 2 are"
            )
        try:
            profiles = qos.from_yaml(record.metadata.get('offered_qos_profiles'))
        except ValueError:
            profiles = ()  # recorders of others write what they like
        channel = Channel(
            topic=record.topic,
            type=schema.name,
            schema=said.text,
            type_hash=said.type_hash,
            qos=profiles,
            schema_encoding=encoding,
        )
        return self._known.setdefault(tuple(vars(channel).values()), channel)

    def _trusted(self, topic: str, schema: mcap.Schema, said: Schema) -> Schema | None:
        """Return what may be believed of a definition without a checksum, None if not enough."""
        if not _TOPIC.fullmatch(topic):
            return None
        installed = None
        with contextlib.suppress(SchemaError):
            installed = find_schema(schema.name, installed_prefixes())
        if installed is not None and (
            said.text == installed.text or said.type_hash == installed.type_hash != ''
        ):
            return installed
        with contextlib.suppress(MessageError):
            if schema.encoding != 'ros2idl':
                decoder_of(schema.name, said.text)
            if schema.encoding == 'ros2idl' or is_complete(schema.name, said.text):
                if said.type_hash:
                    self.doubts.append(f'the type hash of {topic}, which has no checksum')
                return Schema(text=said.text, type_hash='')
        if installed is not None:
            self.doubts.append(f'the definition of {schema.name}: that installed here is taken')
        return installed
