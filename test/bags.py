# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Channels, messages and bags for tests, and valid input that is damaged."""

from __future__ import annotations

from collections.abc import Callable, Iterable
import contextlib
import math
from pathlib import Path
import re
import struct
import time
from typing import Any, TypeVar

from hypothesis import HealthCheck, Phase, settings
from hypothesis import strategies as st
from mcap.exceptions import EndOfFile
from mcap.reader import make_reader, NonSeekingReader
from soft_throw_ros.recording.bag_writer import BagWriter
from soft_throw_ros.recording.schemas import find_schema, installed_prefixes
from soft_throw_ros.storage.bag_folder import dump_yaml
from soft_throw_ros.storage.bag_reader import BagReader
from soft_throw_ros.storage.message import Channel, Message

BEGIN = 1_700_000_000_000_000_000
"""Time of the first message. [ns]"""


def profiles(*changes: dict[str, Any]) -> str:
    """Return YAML with a quality-of-service profile for each set of changes."""
    infinite = {'sec': 9223372036, 'nsec': 854775807}
    default = {
        'history': 'keep_last', 'depth': 10, 'reliability': 'reliable', 'durability': 'volatile',
        'deadline': infinite, 'lifespan': infinite, 'liveliness': 'automatic',
        'liveliness_lease_duration': infinite, 'avoid_ros_namespace_conventions': False,
    }
    return dump_yaml([{**default, **profile} for profile in changes])


def channel(topic: str, kind: str = 'std_msgs/msg/String', **qos: Any) -> Channel:
    """Return the channel of a topic whose publisher offers `qos`."""
    schema, type_hash = find_schema(kind, installed_prefixes())
    return Channel(topic=topic, type=kind, schema=schema, type_hash=type_hash, qos=profiles(qos))


def text(content: str) -> bytes:
    """Return a serialized message of std_msgs/String."""
    data = content.encode() + b'\0'
    return b'\0\1\0\0' + struct.pack('<I', len(data)) + data


def saved(folder: Path) -> list[tuple[str, bytes, int, int, int]]:
    """Return topic, data, times [ns] and number of each message, as mcap reads an open bag."""
    rows = []
    for path in sorted(folder.glob('*.mcap')):
        with path.open('rb') as file, contextlib.suppress(EndOfFile, struct.error):
            reader = NonSeekingReader(file, validate_crcs=True)
            for _, channel, message in reader.iter_messages(log_time_order=False):
                times = message.log_time, message.publish_time
                rows.append((channel.topic, message.data, *times, message.sequence))
    return rows


def write(path: Path, messages: Iterable[Message], chunk: int = 1000, **kwargs: Any) -> Path:
    """Write a bag with a fixed number of messages per chunk."""
    with BagWriter(path, distribution='jazzy', **kwargs) as writer:
        for number, message in enumerate(messages):
            writer.write(message)
            if number % chunk == chunk - 1:
                writer.flush()
    return path


def notes(folder: Path) -> dict[str, dict[str, str]]:
    """Return the named texts in the last file of a bag, as mcap reads them."""
    with max(folder.glob('*.mcap')).open('rb') as file:
        return {item.name: item.metadata for item in make_reader(file).iter_metadata()}


PLAIN = Channel(topic='/plain', type='std_msgs/msg/String', schema='string data')


def plain(number: int, size: int = 100) -> Message:
    """Make a message that contains only its number, which is also its time."""
    return Message(PLAIN, number.to_bytes(8, 'little') + bytes(size - 8), *3 * [number])


def read(path: Path, *topics: str) -> list[tuple[str, bytes, int, int, int]]:
    """Return such rows of the messages of a finished bag, by time, as our reader has them."""
    with BagReader(path) as bag:
        return [(message.channel.topic, *message[1:]) for message in bag.messages(topics or None)]


def wait_until(done: Callable[[], bool], timeout: float = 60.0) -> None:
    """Wait for an effect of another thread or process."""
    deadline = time.monotonic() + timeout
    while not done():
        assert time.monotonic() < deadline
        time.sleep(0.01)


NUMBERS = [
    'nan', '.nan', 'inf', '-.inf', '1e400', '1e308', '5e-324', '-0.0', '0', '1e-3', '1', '-1',
    '0x1F', '1_000', '١', '1,5', '9' * 400, '18446744073709551616',
]
WORDS = [
    *NUMBERS, '', ' ', '\t', '\n', '\r', '\0', '\ufeff', ':', '- ', '? ', '#', ',', ';', '[' * 300,
    '{a: ' * 300, '&a ', '*a', '<<: *a', '!!python/object/apply:os.system [exit 1]', '---\n', '"',
    '%', 'null', 'true', '2026-11-22', '../', '**', '\u2028', 'a' * 3000, ':=', '+-',
]
_RAW_NUMBERS = [
    *(struct.pack('<I', number) for number in (0, 1, 2**28, 2**32 - 1)),
    *(struct.pack('<Q', number) for number in (0, 2**32, 2**63, 2**64 - 1)),
    *(struct.pack('<d', number) for number in (math.nan, math.inf, 1e308)),
]

few = settings(
    max_examples=50,
    phases=(Phase.explicit, Phase.generate),  # shrinking a bag takes minutes
    suppress_health_check=[HealthCheck.function_scoped_fixture],
)
"""Decorator of a property test whose examples overwrite the same files."""

Result = TypeVar('Result')


def accepted(read: Callable[[], Result], *words: str) -> Result | None:
    """Return the result of a parser, or None after a ValueError of one line with the words."""
    try:
        return read()
    except ValueError as error:
        line = str(error)
    assert line.strip()
    assert '\n' not in line
    assert all(word in line for word in words), line
    return None


@st.composite
def texts(draw: Callable[..., Any], *valid: str) -> str:
    """Return a valid text with other numbers, and parts replaced by words or doubled."""
    text: str = draw(st.sampled_from(valid))
    for _ in range(draw(st.integers(0, 3))):
        numbers = list(re.finditer(r'-?\d[\d.]*(?:e-?\d+)?', text))
        if numbers and draw(st.booleans()):
            begin, end = draw(st.sampled_from(numbers)).span()
            put = draw(st.sampled_from(NUMBERS) | st.floats().map(repr))
        else:
            begin = draw(st.integers(0, len(text)))
            end = min(len(text), begin + draw(st.sampled_from([0, 1, 4, 12, 200])))
            put = draw(st.sampled_from([*WORDS, text[begin:end] * 2]) | st.text(max_size=5))
        text = text[:begin] + put + text[end:]
    return text


@st.composite
def datas(draw: Callable[..., Any], *valid: bytes) -> bytes:
    """Return valid data with flipped bits, other numbers, and parts cut off or doubled."""
    data = bytearray(draw(st.sampled_from(valid)))
    for _ in range(draw(st.integers(1, 3))):
        begin = draw(st.integers(0, len(data)))
        if begin < len(data) and draw(st.booleans()):
            data[begin] ^= 1 << draw(st.integers(0, 7))
        else:
            end = begin + draw(st.sampled_from([1, 4, 8, 64, len(data)]))
            put = draw(st.sampled_from([b'', bytes(data[begin:end]) * 2, *_RAW_NUMBERS]))
            data[begin:end] = put
    return bytes(data)
