# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
Messages as bytes (CDR), written and read without ROS.

Joint states of every tick are not built as message objects, but packed as one `struct`. Padding is
zero, so that equal messages have equal bytes. A library reads all other messages.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
import contextlib
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


def stamp_of(data: bytes) -> int:
    """Return the stamp of a message that begins with a header; 0 if it is shorter [ns]."""
    try:
        seconds, nanoseconds = _STAMP.unpack_from(data, len(_HEADER))
    except struct.error:
        return 0
    return int(seconds * SECOND + nanoseconds)


class JointStates(NamedTuple):
    """Messages sensor_msgs/JointState of the same joints, in SI units."""

    stamps: NDArray[np.int64]  # (n,) of the headers [ns]
    names: tuple[str, ...]
    position: Floats  # (n, joints), or (n, 0) where the messages have none, as the next two
    velocity: Floats
    effort: Floats


class _Layout:
    """The fields of a JointState as one `struct`, which ignores the padding that it reads."""

    def __init__(self, texts: Sequence[bytes], counts: Sequence[int]) -> None:
        """`texts` are frame and names with their zero bytes, `counts` the lengths of series."""
        frame, *names = texts
        self.names = tuple(name.rstrip(b'\x00').decode(errors='replace') for name in names)
        self._texts: list[int | bytes] = [len(frame), frame, len(names)]
        for name in names:
            self._texts += [len(name), name]
        fields = '<2s2xiI'
        for item in self._texts:
            if isinstance(item, bytes):
                fields += f'{len(item)}s'
            else:
                fields += f'{-struct.calcsize(fields) % 4}xI'
        for count in counts:
            fields += f'{-struct.calcsize(fields) % 4}xI'
            if count:  # doubles are aligned from the end of the header on
                fields += f'{(len(_HEADER) - struct.calcsize(fields)) % 8}x{count}d'
        self._struct = struct.Struct(fields)
        self._counts = counts

    def unpack(self, data: bytes) -> Any:
        """Read stamp [ns], names and series of a message; return None if it has another layout."""
        if len(data) < self._struct.size:  # some writers leave padding behind
            return None
        header, seconds, nanoseconds, *fields = self._struct.unpack_from(data)
        end = len(self._texts)
        if header != _HEADER[:2] or fields[:end] != self._texts:
            return None
        series = []
        for count in self._counts:
            if fields[end] != count:
                return None
            series.append(tuple(fields[end + 1:end + 1 + count]))
            end += 1 + count
        position, velocity, effort = series
        return seconds * SECOND + nanoseconds, self.names, position, velocity, effort


class JointStateEncoder(_Layout):
    """Write sensor_msgs/JointState of the same joints, with the first `series` of its series."""

    def __init__(self, frame: str, names: Sequence[str], *, series: int = 3) -> None:
        counts = [len(names) if number < series else 0 for number in range(3)]
        super().__init__([text.encode() + b'\x00' for text in (frame, *names)], counts)

    def encode(self, stamp_ns: int, values: Sequence[float]) -> bytes:
        """Return a message with the values of one series after another, as in a `State`."""
        first, second, third = self._counts
        both = first + second
        return self._struct.pack(
            _HEADER[:2], *divmod(stamp_ns, SECOND), *self._texts,
            first, *values[:first], second, *values[first:both], third, *values[both:],
        )

    def encode_arrays(self, stamp_ns: int, series: Sequence[Floats]) -> bytes:
        """Return a message made of an array per series."""
        return self.encode(stamp_ns, np.concatenate(series).tolist())


class JointStateReader:
    """Decoder of sensor_msgs/JointState; the layout of the last message costs two microseconds."""

    def __init__(self) -> None:
        self._last = _Layout([b''], [0, 0, 0])

    def read_all(self, datas: Sequence[bytes]) -> JointStates:
        """Read messages into arrays; MessageError if one is damaged, or unlike the first one."""
        rows = [self._read(data) for data in datas]
        names = rows[0][1]
        if len({(row[1], *map(len, row[2:])) for row in rows}) > 1:
            raise MessageError(
                f'messages JointState of one topic are not all of {", ".join(names)} alike'
            )
        stamps, _, *series = zip(*rows, strict=True)
        arrays = [np.array(values, float) for values in series]
        return JointStates(np.array(stamps, np.int64), names, *arrays)

    def _read(self, data: bytes) -> Any:
        if (values := self._last.unpack(data)) is None:
            self._last = _find_layout(data)
            values = self._last.unpack(data)
        return values


def _find_layout(data: bytes) -> _Layout:
    """Return the layout of a message; raise MessageError if the bytes are no JointState."""
    if data[:2] != _HEADER[:2]:
        raise MessageError(f'not little-endian CDR, which begins 00 01: {data[:8].hex(" ")!r}')
    at = len(_HEADER) + _STAMP.size

    def take(size: int, alignment: int = 1) -> bytes:
        nonlocal at
        at += (len(_HEADER) - at) % alignment + size
        if at > len(data):
            raise MessageError(f'{len(data)} bytes, which should be at least {at}')
        return data[at - size:at]

    def number() -> int:
        return int.from_bytes(take(4, 4), 'little')

    texts, counts = [take(number())], []
    texts += [take(number()) for _ in range(number())]
    for _ in range(3):
        counts.append(number())
        take(8 * counts[-1], 8 if counts[-1] else 1)
    return _Layout(texts, counts)


def decode(message: Message) -> Any:
    """Read a message of any type into a SimpleNamespace; MessageError if bytes are no such one."""
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
    with contextlib.redirect_stdout(None), contextlib.redirect_stderr(None):  # it would print
        decoder = DecoderFactory().decoder_for(MessageEncoding.CDR, definition)
    if decoder is None:
        raise MessageError(f'no definition of {type_name}: {schema[:60]!r}')
    return decoder
