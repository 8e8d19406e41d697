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
import struct
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from soft_throw_ros.storage.message import Message, SECOND

Floats = NDArray[np.float64]

_HEADER = b'\x00\x01\x00\x00'
"""CDR, little endian, no options."""

_STAMP = struct.Struct('<iI')


class MessageError(ValueError):
    """Bytes are no message of their type."""


class JointStateEncoder:
    """
    Write sensor_msgs/JointState of always the same joints.

    `series` is how many of position, velocity and effort there are, in this order.
    """

    def __init__(self, frame: str, names: Sequence[str], *, series: int = 3) -> None:
        data = bytearray(_HEADER + bytes(8))
        for text in (frame, None, *names):
            _align(data, 4)
            encoded = b'' if text is None else text.encode() + b'\x00'
            data += struct.pack('<I', len(names) if text is None else len(encoded)) + encoded
        for number in range(3):
            count = len(names) if number < series else 0
            _align(data, 4)
            data += struct.pack('<I', count)
            if count:
                _align(data, 8)
                data += bytes(8 * count)
        self._data = data
        self._layout = _Layout(bytes(data))
        self._arrays = [
            np.frombuffer(data, '<f8', item.size, item.begin)
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


def _align(data: bytearray, size: int) -> None:
    """Append zeros up to the next multiple of a size, which counts from the end of the header."""
    data += bytes((len(_HEADER) - len(data)) % size)


def stamp_of(data: bytes) -> int:
    """Return the stamp of a message that begins with a header; 0 if it is shorter [ns]."""
    if len(data) < len(_HEADER) + _STAMP.size:
        return 0
    seconds, nanoseconds = _STAMP.unpack_from(data, len(_HEADER))
    return int(seconds * SECOND + nanoseconds)


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
        """Read a message; raise MessageError if the bytes are no JointState."""
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

        MessageError is raised if one is no JointState, or its frame, joints or lengths differ
        from the first.
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
    """
    Offsets of the fields of a sensor_msgs/JointState, and a mask of its constant bytes.

    The mask has ones for lengths and texts, and zeros for stamp, series and padding.
    """

    def __init__(self, data: bytes) -> None:
        if data[:2] != _HEADER[:2]:
            raise MessageError(f'not little-endian CDR, which begins 00 01: {data[:8].hex(" ")!r}')
        self.size = len(data)
        self._data = data
        self._at = self.stamp = len(_HEADER)
        self._ones = bytearray(b'\xff\xff' + bytes(self.size - 2))
        self._take(8)
        self._text()
        self.names = tuple(self._text() for _ in range(self._number()))
        self.series = []
        for _ in range(3):
            if count := self._number():
                self._at += -(self._at - len(_HEADER)) % 8
            self.series.append(_Series(self._at, count, struct.Struct(f'<{count}d')))
            self._take(8 * count)
        if self.size - self._at > 7:  # some leave padding behind
            raise MessageError(f'{self.size - self._at} bytes follow the message')
        # All bytes at once, as one large number, are compared in less than a microsecond
        self._mask = int.from_bytes(self._ones, 'little')
        self._fixed = int.from_bytes(data, 'little') & self._mask

    def _take(self, size: int, *, is_constant: bool = False) -> bytes:
        """Return the next bytes."""
        begin, self._at = self._at, self._at + size
        if self._at > self.size:
            raise MessageError(f'{self.size} bytes, which should be at least {self._at}')
        if is_constant:
            self._ones[begin:self._at] = b'\xff' * size
        return self._data[begin:self._at]

    def _number(self) -> int:
        self._at += -(self._at - len(_HEADER)) % 4
        return int.from_bytes(self._take(4, is_constant=True), 'little')

    def _text(self) -> str:
        data = self._take(self._number(), is_constant=True)
        try:
            return data.rstrip(b'\x00').decode()
        except UnicodeDecodeError as error:
            raise MessageError(f'a string is no UTF-8: {error}') from error

    def fits(self, data: bytes) -> bool:
        """Return whether another message has the same frame, joints and lengths."""
        is_long = len(data) == self.size
        return is_long and int.from_bytes(data, 'little') & self._mask == self._fixed


def decode(message: Message) -> Any:
    """
    Read a message of any type; return its fields as a SimpleNamespace.

    MessageError is raised if the bytes are no such message, or the definition is none.
    """
    channel = message.channel
    try:
        return _decoder_of(channel.type, channel.schema)(message.data)
    except Exception as error:  # damaged bytes may cause any error in the library
        raise MessageError(f'not a message {channel.type}: {error}') from error


@lru_cache(maxsize=256)
def _decoder_of(type_name: str, schema: str) -> Callable[[bytes], Any]:
    """Return a function that decodes messages of a type; making it takes milliseconds."""
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
