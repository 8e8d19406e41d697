# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Bags and messages that are cut off, damaged or inconsistent."""

from __future__ import annotations

from collections.abc import Collection
import functools
import io
from pathlib import Path
import shutil
import tempfile
from typing import Any

from bags import BEGIN, channel, write
from fuzzing import accepted, bounded, datas, fuzzed, run, texts, WORDS
from hypothesis import given
from hypothesis import strategies as st
from mcap.writer import CompressionType, IndexType, Writer
from rosbags.rosbag2 import Reader
from soft_throw_ros.commands import identify, recover
from soft_throw_ros.configuration.interface import FRAME, JOINTS
from soft_throw_ros.nodes import replay
from soft_throw_ros.storage.bag_reader import BagReader
from soft_throw_ros.storage.cdr import JointStateEncoder, JointStateReader, MessageError
from soft_throw_ros.storage.message import BagError
from twin_messages import TwinMessages

COMPRESSIONS = ('none', 'lz4', 'zstd')
STATE = JointStateEncoder(FRAME, JOINTS).encode(BEGIN, [0.1, 0.2] * 3)
OTHERS = JointStateEncoder('', ('a', 'plate', 'b'), series=1).encode(0, [0.0, 1.0, 2.0])
TOPICS = ['/twin/joint_states', '/twin/journal', '/measured_joint_states', *WORDS]


@functools.cache
def bag(compression: str) -> tuple[bytes, str, list[bytes]]:
    """Write a bag of a twin that has a journal; return file, metadata.yaml and messages."""
    topics = ('/twin/journal', '/twin/joint_states')
    made = TwinMessages(throw__period=0.05).go(60).messages
    messages = [message for message in made if message.channel.topic in topics]
    with tempfile.TemporaryDirectory() as name:
        folder = write(Path(name) / 'bag', messages, chunk=20, compression=compression)
        metadata = (folder / 'metadata.yaml').read_text('utf-8')
        data = (folder / 'bag_0.mcap').read_bytes()
    return data, metadata, [message.data for message in messages]


def assert_readable(path: Path, messages: Collection[bytes] = ()) -> None:
    """Assert that a bag is readable, with only the given messages if any, or is refused."""
    def read() -> None:
        with BagReader(path) as reader:
            contents = [message.data for message in reader.messages()]
            assert len(contents) <= 10_000
            assert not messages or set(contents) <= set(messages)
            assert '\n' not in reader.damage

    accepted(read, error=BagError)


@st.composite
def bags(draw: Any, folder: Path) -> Path:
    """Write a damaged bag into a new folder."""
    content, metadata, _ = bag(draw(st.sampled_from(COMPRESSIONS)))
    path = folder / 'bag'
    shutil.rmtree(path, ignore_errors=True)
    path.mkdir()
    (path / 'bag_0.mcap').write_bytes(draw(st.just(content) | datas(content)))
    if draw(st.booleans()):
        damaged = draw(texts(metadata, metadata.replace('bag_0.mcap', '../../etc/passwd')))
        (path / 'metadata.yaml').write_bytes(damaged.encode('utf-8', 'replace'))
    return path


@fuzzed(0.12)
@given(data=st.data())
def test_damaged_bag_gives_its_messages_or_is_refused(tmp_path: Path, data: Any) -> None:
    path, target = data.draw(bags(tmp_path)), tmp_path / 'new'
    shutil.rmtree(target, ignore_errors=True)
    with bounded(tmp_path):
        assert_readable(path, bag('none')[2])  # nothing without a checksum
        code, _, _ = run(recover.main, [str(path), '--to', str(target)])
    assert target.exists() == (code != 2)
    if target.exists():
        with Reader(target) as reader:  # of somebody else
            assert sum(1 for _ in reader.messages()) > 0


@fuzzed(0.004)
@given(data=st.data())
def test_damaged_bag_is_checked_and_identified_or_refused(tmp_path: Path, data: Any) -> None:
    path = str(data.draw(bags(tmp_path)))
    with bounded(tmp_path):
        run(replay.main, ['--check', path])
        run(identify.main, [path])


@st.composite
def foreign_bags(draw: Any) -> bytes:
    """Return a complete MCAP file with arbitrary schemas, topics, times and messages."""
    stream = io.BytesIO()
    writer = Writer(
        stream, chunk_size=2000, compression=CompressionType.NONE, index_types=IndexType.ALL
    )
    writer.start(draw(st.sampled_from(['ros2', '', 'x'])))
    states = channel('/twin/joint_states', 'sensor_msgs/msg/JointState')
    for _ in range(draw(st.integers(1, 3))):
        schema = writer.register_schema(
            draw(st.sampled_from([states.type, 'std_msgs/msg/String', 'x', *WORDS])),
            draw(st.sampled_from(['ros2msg', 'ros2msg', 'ros2idl', 'protobuf', ''])),
            draw(texts(states.schema, 'string data')).encode('utf-8', 'replace'),
        )
        topic = draw(st.sampled_from(TOPICS))
        number = writer.register_channel(
            topic, draw(st.sampled_from(['cdr', 'cdr', 'cdr', 'json', ''])), schema,
            {'offered_qos_profiles': draw(texts('- {history: 1, depth: 3, reliability: 2}'))},
        )
        for _ in range(draw(st.integers(0, 20))):
            time = draw(
                st.sampled_from([0, BEGIN, 2**63 - 1, 2**63, 2**64 - 1]) | st.integers(0, 9)
            )
            writer.add_message(number, time, draw(st.just(STATE) | datas(STATE)), time, 1)
    writer.finish()
    return stream.getvalue()


@fuzzed(0.06)
@given(content=foreign_bags())
def test_bag_of_others_is_read_or_refused(tmp_path: Path, content: bytes) -> None:
    path = tmp_path / 'other.mcap'
    path.write_bytes(content)
    with bounded(tmp_path):
        assert_readable(path)
        run(replay.main, ['--check', str(path)])
        run(identify.main, [str(path)])


@fuzzed(0.12)
@given(messages=st.lists(datas(STATE, OTHERS) | st.just(STATE), min_size=1, max_size=5))
def test_messages_are_read_or_refused(tmp_path: Path, messages: list[bytes]) -> None:
    reader = JointStateReader()
    with bounded(tmp_path):
        for message in messages:
            values = accepted(lambda data=message: reader.read(data), error=MessageError)
            assert 8 * sum(map(len, values[2:] if values else ())) <= len(message)
        states = accepted(lambda: reader.read_all(messages), error=MessageError)
        assert states is None or states.stamps.size == len(messages)
