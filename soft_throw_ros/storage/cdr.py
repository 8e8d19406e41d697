# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
Messages as bytes (CDR), written and read without ROS.

Messages of every tick are not built as message objects: their bytes (little endian) are made once,
and only stamp and numbers are overwritten. Padding is zero, so that equal messages have equal
bytes; `rclpy.serialization` leaves old memory in the padding. Thousands of joint states of one
layout are read at once. A library reads all other messages.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
import contextlib
from dataclasses import dataclass
from functools import lru_cache
import re
import struct
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray
from soft_throw_ros.storage.message import Message, SECOND

Floats = NDArray[np.float64]

_HEADER = b'\x00\x01\x00\x00'
"""CDR, little endian, no options."""

_STAMP = struct.Struct('<iI')

MAX_SCHEMA = 256 * 2**10
"""Largest length of a definition with its dependencies [characters]; images have 3000."""

_SIZED_FIELD = re.compile(
    r'^[ \t]*[A-Za-z][\w/<=]*(?:\[(?!0+\])[<=\d]*\])?[ \t]+[a-z]', re.MULTILINE
)


class MessageError(ValueError):
    """Bytes are no message of their type."""


class _Writer:
    """A writer of messages, field by field; alignment counts from the end of the header (CDR)."""

    def __init__(self) -> None:
        self.data = bytearray(_HEADER)

    def numbers(self, kind: str, *values: ArrayLike) -> None:
        """Append numbers of a type of numpy."""
        array = np.concatenate([np.ravel(value) for value in values]).astype(kind)
        if array.size:
            self.data.extend(bytes((len(_HEADER) - len(self.data)) % array.itemsize))
            self.data.extend(array.tobytes())

    def text(self, text: str) -> None:
        """Append a string: its length with the final zero, its bytes, the zero."""
        encoded = text.encode() + b'\x00'
        self.numbers('<u4', len(encoded))
        self.data.extend(encoded)


class JointStateEncoder:
    """
    Write sensor_msgs/JointState of always the same joints.

    Parameters
    ----------
    frame : str
        `header.frame_id`.
    names : sequence of str
        The joints.
    series : int
        How many of position, velocity and effort there are, in this order.

    """

    def __init__(self, frame: str, names: Sequence[str], *, series: int = 3) -> None:
        writer = _Writer()
        writer.numbers('<u4', 0, 0)
        writer.text(frame)
        writer.numbers('<u4', len(names))
        for name in names:
            writer.text(name)
        for number in range(3):
            count = len(names) if number < series else 0
            writer.numbers('<u4', count)
            writer.numbers('<f8', np.zeros(count))
        self._data = writer.data
        self._layout = _Layout(bytes(writer.data))
        self._arrays = [
            np.frombuffer(self._data, '<f8', item.size, item.begin)
            for item in self._layout.series[:series]
        ]

    def encode(self, stamp_ns: int, values: Sequence[float]) -> bytes:
        """
        Return a message as bytes to publish.

        `values` are those of one series after another, as in a `State` of plate and projectile.
        """
        data, first = self._data, 0
        _STAMP.pack_into(data, self._layout.stamp, *divmod(stamp_ns, SECOND))
        for begin, size, numbers in self._layout.series:
            numbers.pack_into(data, begin, *values[first:first + size])
            first += size
        return bytes(data)

    def encode_arrays(self, stamp_ns: int, series: Sequence[Floats]) -> bytes:
        """Return a message made of an array per series, which is quick with many joints."""
        _STAMP.pack_into(self._data, self._layout.stamp, *divmod(stamp_ns, SECOND))
        for array, values in zip(self._arrays, series, strict=True):
            array[:] = values
        return bytes(self._data)


class JointValues(NamedTuple):
    """A message sensor_msgs/JointState, its series empty where it has none."""

    stamp_ns: int
    names: tuple[str, ...]
    position: tuple[float, ...]
    velocity: tuple[float, ...]
    effort: tuple[float, ...]


@dataclass(frozen=True, kw_only=True)
class JointStates:
    """Messages sensor_msgs/JointState of the same joints."""

    stamps: NDArray[np.int64]  # (n,) Of the headers. [ns]
    names: tuple[str, ...]  # Of the joints
    # (n, joints) In SI units; (n, 0) where the messages have none
    position: Floats
    velocity: Floats
    effort: Floats


class JointStateReader:
    """
    Decoder of messages sensor_msgs/JointState, one by one or many at once.

    The reader keeps the layout of the last message. A message with the same layout takes two
    microseconds; another frame, other joints or other lengths take more. Padding is ignored.
    """

    def __init__(self) -> None:
        self._last: _Layout | None = None

    def read(self, data: bytes) -> JointValues:
        """
        Read a message.

        Raises
        ------
        MessageError
            If the bytes are no JointState.

        """
        layout = self._layout(data)
        seconds, nanoseconds = _STAMP.unpack_from(data, layout.stamp)
        position, velocity, effort = [
            item.numbers.unpack_from(data, item.begin) for item in layout.series
        ]
        stamp_ns = seconds * SECOND + nanoseconds
        return JointValues(stamp_ns, layout.names, position, velocity, effort)

    def read_all(self, datas: Sequence[bytes]) -> JointStates:
        """
        Read at least one message into arrays.

        Raises
        ------
        MessageError
            If one is no JointState, or its frame, joints or lengths differ from the first.

        """
        layout = self._layout(datas[0])
        if not all(map(layout.fits, datas)):
            names = ', '.join(layout.names)
            raise MessageError(f'messages JointState of one topic are not all of {names} alike')
        rows = np.frombuffer(b''.join(datas), np.uint8).reshape(len(datas), layout.size)
        stamps = rows[:, layout.stamp:layout.stamp + 8].copy().view([('s', '<i4'), ('ns', '<u4')])
        position, velocity, effort = [
            rows[:, item.begin:item.begin + 8 * item.size].copy().view('<f8')
            for item in layout.series
        ]
        return JointStates(
            stamps=(stamps['s'].astype(np.int64) * SECOND + stamps['ns']).ravel(),
            names=layout.names,
            position=position,
            velocity=velocity,
            effort=effort,
        )

    def _layout(self, data: bytes) -> _Layout:
        last = self._last
        if last is None or not last.fits(data):
            self._last = None  # in case that the bytes are no JointState
            self._last = last = _Layout(data)
        return last


class _Series(NamedTuple):
    """Offset, count and format of a series of numbers."""

    begin: int
    size: int
    numbers: struct.Struct


class _Layout:
    """Offsets of the fields of a sensor_msgs/JointState, and a mask of its constant bytes."""

    def __init__(self, data: bytes) -> None:
        cursor = _Cursor(data)
        self.stamp = cursor.numbers('I', 2)
        cursor.text()
        self.names = tuple(cursor.text() for _ in range(cursor.number()))
        self.series = [
            _Series(begin, count, struct.Struct(f'<{count}d'))
            for begin, count in (cursor.doubles() for _ in range(3))
        ]
        cursor.end()
        # All bytes at once, as one large number, are compared in less than a microsecond
        self.size = len(data)
        self._mask = int.from_bytes(cursor.mask, 'little')
        self._fixed = int.from_bytes(data, 'little') & self._mask

    def fits(self, data: bytes) -> bool:
        """Return whether another message has the same frame, joints and lengths."""
        is_long = len(data) == self.size
        return is_long and int.from_bytes(data, 'little') & self._mask == self._fixed


def decode(message: Message) -> Any:
    """
    Read a message of any type; return its fields as a SimpleNamespace.

    Raises
    ------
    MessageError
        If the bytes are no such message, or the definition is none.

    """
    channel = message.channel
    try:
        return _decoder_of(channel.type, channel.schema)(message.data)
    except Exception as error:  # damaged bytes may cause any error in the library
        raise MessageError(f'not a message {channel.type}: {error}') from error


@lru_cache(maxsize=256)
def _decoder_of(type_name: str, schema: str) -> Callable[[bytes], Any]:
    """
    Return a function that decodes messages of a type; making the function takes milliseconds.

    Raises
    ------
    MessageError
        If the definition is invalid or too long, or contains a type without fields: a few bytes
        of a message could stand for any number of values of such a type.

    """
    if len(schema) > MAX_SCHEMA:
        raise MessageError(f'the definition of {type_name} has more than {MAX_SCHEMA} characters')
    if not all(map(_SIZED_FIELD.search, schema.split('=' * 80)[1:])):
        raise MessageError(f'the definition of {type_name} has a part without a field')
    from mcap.records import Schema  # not needed for writing
    from mcap.well_known import MessageEncoding, SchemaEncoding
    from mcap_ros2.decoder import DecoderFactory

    definition = Schema(id=1, name=type_name, encoding=SchemaEncoding.ROS2, data=schema.encode())
    try:
        with contextlib.redirect_stdout(None), contextlib.redirect_stderr(None):  # it would print
            decoder = DecoderFactory().decoder_for(MessageEncoding.CDR, definition)
    except Exception as error:  # damage may cause any error
        raise MessageError(f'no definition of {type_name}: {error!r:.100}') from error
    if decoder is None:
        raise MessageError(f'no definition of {type_name}: {schema[:60]!r}')
    return decoder


class _Cursor:
    """
    A reader of messages, field by field; alignment counts from the end of the header (CDR).

    `mask` has ones for bytes of numbers and texts, and zeros for arrays and padding.
    """

    def __init__(self, data: bytes) -> None:
        if data[:2] != _HEADER[:2]:
            raise MessageError(f'not little-endian CDR, which begins 00 01: {data[:8].hex(" ")!r}')
        self.mask = bytearray(b'\xff\xff' + bytes(len(data) - 2))
        self._data = data
        self._at = len(_HEADER)

    def numbers(self, code: str, count: int) -> int:
        """Pass numbers of a type, and return where they begin."""
        size = struct.calcsize(code)
        begin = self._at + -(self._at - len(_HEADER)) % size
        self._pass(begin + size * count)
        return begin

    def number(self) -> int:
        """Return the next number, an unsigned one of 32 bits."""
        begin = self.numbers('I', 1)
        self.mask[begin:self._at] = b'\xff' * 4
        return int.from_bytes(self._data[begin:self._at], 'little')

    def text(self) -> str:
        """Return the next string."""
        length = self.number()
        begin = self._at
        self._pass(begin + length)
        self.mask[begin:self._at] = b'\xff' * length
        try:
            return self._data[begin:self._at].rstrip(b'\x00').decode()
        except UnicodeDecodeError as error:
            raise MessageError(f'a string is no UTF-8: {error}') from error

    def doubles(self) -> tuple[int, int]:
        """Pass a sequence of doubles, and return where it begins and how many there are."""
        count = self.number()
        return (self.numbers('d', count) if count else self._at), count

    def end(self) -> None:
        """See that nothing follows but padding."""
        if len(self._data) - self._at > 7:  # some leave as much behind
            raise MessageError(f'{len(self._data) - self._at} bytes follow the message')

    def _pass(self, end: int) -> None:
        if end > len(self._data):
            raise MessageError(f'{len(self._data)} bytes, which should be at least {end}')
        self._at = end
