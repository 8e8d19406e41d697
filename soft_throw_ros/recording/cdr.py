# SPDX-License-Identifier: Apache-2.0
"""
Messages as bytes (CDR), written and read without ROS.

What goes out at every tick is not built as a message object: its bytes (little endian) are made
once, and only stamp and numbers are written into them. Padding is zero, so that equal messages are
equal bytes; `rclpy.serialization` leaves in it what was in memory. What comes in by the thousand
is read in one go, since it is all of one layout. For everything else there is a library.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
import math
import struct
from typing import Any

import numpy as np
from numpy.typing import NDArray
from soft_throw_ros.twin.results import Floats, State

_SECOND = 1_000_000_000

_HEADER = b'\x00\x01\x00\x00'
"""CDR, little endian, no options."""


class MessageError(ValueError):
    """Bytes are no message of their type."""


class _Template:
    """Bytes of a message, written field by field; `offset` counts as CDR does, from the header."""

    def __init__(self) -> None:
        self.data = bytearray(_HEADER)

    def add(self, code: str, *values: Any) -> int:
        """Append numbers of one type, aligned, and return where they begin in `data`."""
        size = struct.calcsize(f'<{code}')
        self.data.extend(bytes(-(len(self.data) - 4) % size))
        begin = len(self.data)
        self.data.extend(struct.pack(f'<{len(values)}{code}', *values))
        return begin

    def add_string(self, text: str) -> None:
        """Append a string: its length with the final zero, its bytes, the zero."""
        encoded = text.encode() + b'\x00'
        self.add('I', len(encoded))
        self.data.extend(encoded)

    def add_doubles(self, count: int) -> int:
        """Append a sequence of doubles, zero for now, and return where they begin in `data`."""
        self.add('I', count)
        return self.add('d', *[0.0] * count)


class JointStateEncoder:
    """
    Write sensor_msgs/JointState of plate and projectile.

    Parameters
    ----------
    frame : str
        `header.frame_id`.
    names : sequence of str
        The two joints.

    """

    def __init__(self, frame: str, names: Sequence[str]) -> None:
        template = _Template()
        self._stamp = template.add('i', 0)
        template.add('I', 0)
        template.add_string(frame)
        template.add('I', len(names))
        for name in names:
            template.add_string(name)
        self._position, self._velocity, self._effort = (
            template.add_doubles(len(names)) for _ in range(3)
        )
        self._data = template.data
        self._pack_stamp = struct.Struct('<iI').pack_into
        self._pack_pair = struct.Struct('<2d').pack_into

    def encode(self, stamp_ns: int, state: State) -> bytes:
        """Return the message for a state at a time, as bytes to publish."""
        data = self._data
        self._pack_stamp(data, self._stamp, *divmod(stamp_ns, _SECOND))
        self._pack_pair(data, self._position, state[0], state[1])
        self._pack_pair(data, self._velocity, state[2], state[3])
        self._pack_pair(data, self._effort, state[4], state[5])
        return bytes(data)


class ArrayEncoder:
    """
    Write std_msgs/Float64MultiArray of always the same shape.

    Parameters
    ----------
    dimensions : mapping of str to int
        Labels and sizes, the slowest first.

    """

    def __init__(self, dimensions: Mapping[str, int]) -> None:
        template = _Template()
        template.add('I', len(dimensions))
        sizes = list(dimensions.values())
        for index, (label, size) in enumerate(dimensions.items()):
            template.add_string(label)
            template.add('I', size)
            template.add('I', math.prod(sizes[index:]))
        template.add('I', 0)  # data_offset
        count = math.prod(sizes)
        begin = template.add_doubles(count)
        self._data = template.data
        self._values = np.frombuffer(self._data, '<f8', count, begin)

    def encode(self, values: Floats) -> bytes:
        """Return the message as bytes to publish."""
        self._values[:] = values.reshape(-1)
        return bytes(self._data)


@dataclass(frozen=True, kw_only=True)
class JointStates:
    """
    Messages sensor_msgs/JointState of the same joints, one after another.

    Parameters
    ----------
    stamps : ndarray of int64, shape (n,)
        Of the headers. [ns]
    names : tuple of str
        Of the joints.
    position, velocity, effort : ndarray, shape (n, joints)
        In SI units; (n, 0) where the messages have none.

    """

    stamps: NDArray[np.int64]
    names: tuple[str, ...]
    position: Floats
    velocity: Floats
    effort: Floats


def decode_joint_states(datas: Sequence[bytes]) -> JointStates:
    """
    Read messages sensor_msgs/JointState of the same joints, at least one.

    Raises
    ------
    MessageError
        If one is none, or its frame, joints or lengths are not those of the first.

    """
    first = datas[0]
    cursor = _Cursor(first)
    stamp = cursor.numbers('iI')
    cursor.text()
    names = tuple(cursor.text() for _ in range(cursor.number('I')))
    begins, counts = zip(*(cursor.doubles() for _ in range(3)), strict=True)
    cursor.end()
    fields: list[tuple[str, Any, int]] = [('sec', '<i4', stamp), ('nanosec', '<u4', stamp + 4)]
    fields += [
        (name, ('<f8', (count,)), begin)
        for name, begin, count in zip(_SERIES, begins, counts, strict=True)
    ]
    layout = np.dtype(
        {
            'names': [name for name, _, _ in fields],
            'formats': [kind for _, kind, _ in fields],
            'offsets': [begin for _, _, begin in fields],
            'itemsize': len(first),
        }
    )
    if any(len(data) != len(first) for data in datas):
        raise MessageError('messages JointState of one topic are not all of one length')
    joined = b''.join(datas)
    rows = np.frombuffer(joined, np.uint8).reshape(len(datas), len(first))
    is_fixed = np.ones(len(first), bool)
    for begin, size in [(stamp, 8), *zip(begins, np.multiply(counts, 8), strict=True)]:
        is_fixed[begin : begin + size] = False
    if (rows[:, is_fixed] != rows[0, is_fixed]).any():
        raise MessageError(f'messages JointState of one topic are not all of {", ".join(names)}')
    values = np.frombuffer(joined, layout)
    stamps = values['sec'].astype(np.int64) * _SECOND + values['nanosec']
    return JointStates(
        stamps=stamps,
        names=names,
        **{name: np.array(values[name], np.float64) for name in _SERIES},
    )


_SERIES = ('position', 'velocity', 'effort')


def decode_array(data: bytes) -> tuple[list[str], Floats]:
    """
    Read std_msgs/Float64MultiArray: the labels of the dimensions, and the values in their shape.

    Raises
    ------
    MessageError
        If it is none, or has not as many values as its dimensions say.

    """
    cursor = _Cursor(data)
    labels, sizes = [], []
    for _ in range(cursor.number('I')):
        labels.append(cursor.text())
        sizes.append(cursor.number('I'))
        cursor.number('I')
    cursor.number('I')
    begin, count = cursor.doubles()
    cursor.end()
    if math.prod(sizes) != count:
        raise MessageError(f'an array of {sizes} cannot have {count} values')
    return labels, np.frombuffer(data, '<f8', count, begin).reshape(sizes)


def decode(type_name: str, schema: str, data: bytes) -> Any:
    """
    Read any message.

    Parameters
    ----------
    type_name : str
        Such as `std_msgs/msg/String`.
    schema : str
        Its definition and those it needs (`ros2msg`).
    data : bytes
        The message.

    Returns
    -------
    SimpleNamespace
        With the fields of the message.

    Raises
    ------
    MessageError
        If the bytes are no such message, or the definition is none.

    """
    try:
        return _decoder(type_name, schema)(data)
    except Exception as error:  # whatever damaged bytes lead the library to
        raise MessageError(f'not a message {type_name}: {error}') from error


@lru_cache(maxsize=256)
def _decoder(type_name: str, schema: str) -> Callable[[bytes], Any]:
    """Make what reads messages of a type, which takes the library milliseconds."""
    from mcap.records import Schema  # not needed by who only writes
    from mcap.well_known import MessageEncoding, SchemaEncoding
    from mcap_ros2.decoder import DecoderFactory

    definition = Schema(id=1, name=type_name, encoding=SchemaEncoding.ROS2, data=schema.encode())
    decoder = DecoderFactory().decoder_for(MessageEncoding.CDR, definition)
    if decoder is None:
        raise MessageError(f'no definition of {type_name}: {schema[:60]!r}')
    return decoder


class _Cursor:
    """Goes through a message; alignment counts from behind the header, as CDR has it."""

    def __init__(self, data: bytes) -> None:
        if data[:2] != _HEADER[:2]:
            raise MessageError(f'not little-endian CDR, which begins 00 01: {data[:8].hex(" ")!r}')
        self._data = data
        self._at = len(_HEADER)

    def numbers(self, codes: str) -> int:
        """Pass numbers of one size, and return where they begin."""
        size = struct.calcsize(codes[0])
        begin = self._at + -(self._at - len(_HEADER)) % size
        self._pass(begin + size * len(codes))
        return begin

    def number(self, code: str) -> int:
        """Return the next number."""
        (value,) = struct.unpack_from(f'<{code}', self._data, self.numbers(code))
        return int(value)

    def text(self) -> str:
        """Return the next string."""
        length = self.number('I')
        begin = self._at
        self._pass(begin + length)
        try:
            return self._data[begin : self._at].rstrip(b'\x00').decode()
        except UnicodeDecodeError as error:
            raise MessageError(f'a string is no UTF-8: {error}') from error

    def doubles(self) -> tuple[int, int]:
        """Pass a sequence of doubles, and return where it begins and how many there are."""
        count = self.number('I')
        if not count:
            return self._at, 0
        begin = self.numbers('d')
        self._pass(begin + 8 * count)
        return begin, count

    def end(self) -> None:
        """See that nothing follows but padding."""
        if len(self._data) - self._at > 7:  # some leave as much behind
            raise MessageError(f'{len(self._data) - self._at} bytes follow the message')

    def _pass(self, end: int) -> None:
        if end > len(self._data):
            raise MessageError(f'{len(self._data)} bytes, which should be at least {end}')
        self._at = end
