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
"""Small bags that would need much memory or time are refused in one line."""

from __future__ import annotations

from collections.abc import Callable
import itertools
import os
from pathlib import Path
import struct
import tracemalloc
from typing import Any
import zlib

from bags import attachments, channel, profiles, text, write
import lz4.frame
from mcap.data_stream import RecordBuilder
from mcap.records import Channel, Chunk, ChunkIndex, Footer, Schema, Statistics
from mcap.stream_reader import StreamReader
from mcap.writer import MCAP0_MAGIC, Writer
import pytest
from soft_throw_ros.nodes.conversions import text_to_profiles
from soft_throw_ros.recording.recovery import recover
from soft_throw_ros.storage import mcap_records
from soft_throw_ros.storage.bag_metadata import (
    load_profiles,
    MAX_FILE_SIZE,
    MAX_PROFILES_SIZE,
    profiles_of,
)
from soft_throw_ros.storage.bag_reader import BagReader, UnfinishedError
from soft_throw_ros.storage.cdr import decode, MAX_SCHEMA, MessageError
from soft_throw_ros.storage.mcap_records import MAX_RECORD
from soft_throw_ros.storage.message import BagError, Message
from soft_throw_ros.storage.message import Channel as Topic
import zstandard

PEAK = 200_000_000
"""Memory that a refusal may take. [bytes]"""

EMPTY = struct.pack('<BQHIQQ', 5, 22, 1, 0, 0, 0)
"""A message without data."""

TOPICS = [
    Schema(id=1, name='std_msgs/msg/String', encoding='ros2msg', data=b'string data'),
    Channel(id=1, topic='/talk', message_encoding='cdr', metadata={}, schema_id=1),
]


def chunk(data: bytes, compression: str, size: int, checksum: int = 0) -> Chunk:
    return Chunk(compression=compression, data=data, message_start_time=0, message_end_time=0,
                 uncompressed_crc=checksum, uncompressed_size=size)


def mcap(path: Path, *records: Any) -> Path:
    """Write a file of some records, without an end."""
    builder = RecordBuilder()
    for record in (*TOPICS, *records):
        record.write(builder)
    path.write_bytes(MCAP0_MAGIC + struct.pack('<BQII', 1, 8, 0, 0) + builder.end())
    return path


def finish(path: Path) -> Path:
    """Append an index that repeats the claims of the chunk about itself; return the new file."""
    begin = len(mcap(path.with_name('empty.mcap')).read_bytes())
    size = path.stat().st_size - begin
    with path.open('rb') as file:
        file.seek(begin)
        (record,) = itertools.islice(
            StreamReader(file, skip_magic=True, emit_chunks=True).records, 1
        )
    assert isinstance(record, Chunk)
    claimed = min(record.uncompressed_size, MAX_RECORD)
    end = [
        *TOPICS,
        Statistics(0, 1, {1: 1}, 1, 1, 0, 0, 0, 1),
        ChunkIndex(size, begin, record.compression, len(record.data), 0, 0, {}, 0, claimed),
        Footer(path.stat().st_size, 0, 0),
    ]
    builder = RecordBuilder()
    for item in end:
        item.write(builder)
    finished = path.with_name('finished.mcap')
    finished.write_bytes(path.read_bytes() + builder.end() + MCAP0_MAGIC)
    return finished


def messages_of(path: Path) -> list[Message]:
    with BagReader(path) as reader:
        return list(reader.messages())


def bounded(read: Callable[[], object]) -> object:
    tracemalloc.start()
    try:
        return read()
    finally:
        _, peak = tracemalloc.get_traced_memory()
        tracemalloc.stop()
        assert peak < PEAK


def zstd_claim(size: int, payload: bytes) -> bytes:
    """Compress a payload into a frame whose head claims another size."""
    body = zstandard.ZstdCompressor(write_content_size=False).compress(payload)
    frame = bytearray(body)
    frame[4] = 0xC0 | (frame[4] & 0x07)  # eight bytes of content size, and a window
    return bytes(frame[:6]) + struct.pack('<Q', size) + bytes(frame[6:])


def zeros(size: int, compression: str) -> bytes:
    """Compress zeros without having them in memory."""
    if compression == 'zstd':
        context: Any = zstandard.ZstdCompressor(level=3).compressobj(size=size)
        pieces = []
    else:
        context = lz4.frame.LZ4FrameCompressor()
        pieces = [context.begin()]
    pieces += [context.compress(bytes(2**20)) for _ in range(size // 2**20)]
    return b''.join([*pieces, context.flush()])


@pytest.mark.parametrize('make', [
    lambda: chunk(zstd_claim(2**32, b'x' * 1000), 'zstd', 2**32),
    lambda: chunk(zeros(2**28, 'zstd'), 'zstd', 1000),
    lambda: chunk(zstd_claim(2**32, b'x' * 1000), 'zstd', 1000),
    lambda: chunk(zeros(2**28, 'lz4'), 'lz4', 1000),
    lambda: chunk(zeros(2**28, 'lz4'), 'lz4', 2**28),
    lambda: chunk(b'', 'zstd', 2**63),
    lambda: chunk(b'', 'deflate', 10),
])
def test_too_large_chunk_is_damage(tmp_path, make) -> None:
    path = mcap(tmp_path / 'bag.mcap', make())
    assert path.stat().st_size < 5_000_000

    with pytest.raises(BagError, match=r'chunk .*no message'):
        bounded(lambda: recover(path, tmp_path / 'new'))
    with pytest.raises(UnfinishedError, match='chunk'):
        bounded(lambda: messages_of(finish(path)))


@pytest.mark.parametrize('compression', ['zstd', ''])
def test_very_many_messages_in_a_chunk_are_damage(tmp_path, monkeypatch, compression) -> None:
    monkeypatch.setattr(mcap_records, 'MAX_RECORDS', 1000)
    data = EMPTY * 1001
    packed = zstandard.compress(data) if compression else data
    path = mcap(tmp_path / 'bag.mcap', chunk(packed, compression, len(data), zlib.crc32(data)))
    del data, packed

    for read in (lambda: recover(path, tmp_path / 'new'), lambda: messages_of(finish(path))):
        with pytest.raises(BagError, match='1000'):
            bounded(read)


def test_bag_needs_no_more_memory_than_the_limit(tmp_path, monkeypatch) -> None:
    monkeypatch.setattr(mcap_records, 'MAX_KEPT', 100_000)
    path = tmp_path / 'bag.mcap'
    with path.open('wb') as file:
        writer = Writer(file)
        writer.start('ros2')
        for number in range(300):
            writer.add_metadata(str(number), {'key': 'x' * 1000})
        writer.finish()
    for read in (BagReader, lambda path: recover(path, tmp_path / 'new')):
        with pytest.raises(BagError, match=r'bag\.mcap: .*100000'):
            read(path)


def test_chunks_of_equal_time_need_no_more_memory_than_the_limit(tmp_path, monkeypatch) -> None:
    monkeypatch.setattr('soft_throw_ros.storage.bag_reader.MAX_KEPT', 100_000)
    talk = channel('/talk')
    messages = [Message(talk, text('x' * 1000), time % 2, 0) for time in range(400)]
    path = write(tmp_path / 'bag', messages, chunk=10)
    with BagReader(path) as reader, pytest.raises(BagError, match='about the same time'):
        list(reader.messages())


def test_chunk_listed_repeatedly_is_read_once(tmp_path) -> None:
    path = tmp_path / 'bag.mcap'
    with path.open('wb') as file:
        writer = Writer(file)
        writer.start('ros2')
        schema = writer.register_schema('std_msgs/msg/String', 'ros2msg', b'string data')
        number = writer.register_channel('/talk', 'cdr', schema)
        writer.add_message(number, 1, text('x'), 1)
        writer.flush()
        indices = writer._Writer__chunk_indices  # type: ignore[attr-defined]
        indices += indices * 999
        writer._Writer__statistics.chunk_count = 1000  # type: ignore[attr-defined]
        writer.finish()
    with pytest.raises(UnfinishedError, match='out of bounds'):
        BagReader(path)
    assert recover(path, tmp_path / 'new').message_count == 1


def test_large_attachments_are_skipped(tmp_path, monkeypatch) -> None:
    monkeypatch.setattr(mcap_records, 'MAX_ATTACHED', 13 * 2**20)
    path, size = tmp_path / 'bag.mcap', 6 * 2**20
    mcap(path, chunk(EMPTY, '', len(EMPTY), zlib.crc32(EMPTY)))
    with path.open('ab') as file:
        for number in range(20):
            name = f'{number:08}'.encode()
            head = struct.pack('<QQI8sIQ', 0, 0, 8, name, 0, size)
            file.write(struct.pack('<BQ', 9, len(head) + size + 4) + head)
            file.truncate(file.tell() + size + 4)  # a hole
            file.seek(0, os.SEEK_END)
        file.write(struct.pack('<BQQQQQI', 9, 200 * 2**20, 0, 0, 0, 0, 0))
    recovery = bounded(lambda: recover(path, tmp_path / 'new'))
    reasons = [item.reason for item in recovery.unreadable]  # type: ignore[attr-defined]
    assert sum(str(13 * 2**20) in reason for reason in reasons) == 18
    assert any(str(MAX_RECORD) in reason for reason in reasons)
    assert len(messages_of(tmp_path / 'new')) == 1
    assert len(attachments(tmp_path / 'new')) == 2


def test_end_that_claims_the_whole_file_takes_little_memory(tmp_path) -> None:
    path = mcap(tmp_path / 'bag.mcap', chunk(EMPTY, '', len(EMPTY), zlib.crc32(EMPTY)))
    with path.open('ab') as file:
        for _ in range(5):
            file.write(struct.pack('<BQ', 0x80, 50 * 2**20))
            file.truncate(file.tell() + 50 * 2**20)  # a hole
            file.seek(0, os.SEEK_END)
        file.write(struct.pack('<BQQQI', 2, 20, len(MCAP0_MAGIC), 0, 1) + MCAP0_MAGIC)
    recovery = bounded(lambda: recover(path, tmp_path / 'new'))
    (unreadable,) = recovery.unreadable  # type: ignore[attr-defined]
    assert 'checksum of the end' in unreadable.reason
    assert len(messages_of(tmp_path / 'new')) == 1


# metadata.yaml and the quality of service


def bomb(levels: int, merge: str = '') -> str:
    """Return YAML whose expansion grows tenfold with every line."""
    lines = ['a0: &a0 {x: y}' if merge else 'a0: &a0 [x, x, x, x, x, x, x, x, x, x]']
    for level in range(1, levels):
        names = ', '.join([f'*a{level - 1}'] * 10)
        value = f'{{<<: [{names}]}}' if merge else f'[{names}]'
        lines.append(f'a{level}: &a{level} {value}')
    return '\n'.join(lines) + '\n'


@pytest.mark.parametrize('metadata', [
    bomb(12) + 'rosbag2_bagfile_information: {relative_file_paths: [*a11]}',
    bomb(12) + 'rosbag2_bagfile_information: {relative_file_paths: [], ros_distro: *a11}',
    bomb(9, '<<') + 'rosbag2_bagfile_information: {relative_file_paths: [], <<: *a8}',
    '[' * 3000,
    '# ' + 'x' * MAX_FILE_SIZE,
])
def test_exploding_metadata_is_skipped_and_messages_are_read(tmp_path, metadata) -> None:
    talk = channel('/talk')
    path = write(tmp_path / 'bag', [Message(talk, text('x'), 1, 1)])
    (path / 'metadata.yaml').write_text(metadata)

    def read() -> tuple[int, str]:
        with BagReader(path) as reader:
            return len(list(reader.messages())), reader.damage

    count, damage = bounded(read)  # type: ignore[misc]
    assert count == 1
    assert '<<' in metadata or 'metadata.yaml: the file ' in damage
    assert '\n' not in damage
    assert len(damage) < 1000


def test_metadata_fifo_does_not_block(tmp_path) -> None:
    path = write(tmp_path / 'bag', [Message(channel('/talk'), text('x'), 1, 1)])
    (path / 'metadata.yaml').unlink()
    os.mkfifo(path / 'metadata.yaml')
    with BagReader(path) as reader:
        assert len(list(reader.messages())) == 1
        assert 'not a regular file' in reader.damage


@pytest.mark.parametrize('qos', [
    '- &a {reliability: reliable}\n- *a\n',
    bomb(9, '<<'),
    '- {reliability: reliable}\n' * (MAX_PROFILES_SIZE // 20),
    '[' * 3000,
])
def test_exploding_quality_of_service_is_skipped(qos) -> None:
    def read() -> tuple[object, ...]:
        return load_profiles(qos), profiles_of(qos), text_to_profiles(qos)

    assert bounded(read) == ([], [], [])


def test_equal_profiles_are_written_without_aliases(tmp_path) -> None:
    qos = profiles({'depth': 3}, {'depth': 3})
    assert '*' not in qos
    assert len(text_to_profiles(qos)) == 2
    topics = [channel(f'/talk{number}', depth=7) for number in range(3)]
    path = write(tmp_path / 'bag', [Message(topic, text('x'), 1, 1) for topic in topics])
    assert '*' not in (path / 'metadata.yaml').read_text()
    with BagReader(path) as reader:
        assert (reader.damage, reader.distribution) == ('', 'jazzy')


# messages


@pytest.mark.parametrize('schema', [
    f'Nothing[] many\n{"=" * 80}\nMSG: a/Nothing\nuint8 X=1\n',
    f'Nothing[400000000] many\n{"=" * 80}\nMSG: a/Nothing\nuint8[0] nothing\n',
    'uint8 data\n' * MAX_SCHEMA,
])
def test_definition_of_unbounded_size_is_refused(schema) -> None:
    topic = Topic(topic='/a', type='a/msg/Many', schema=schema)
    message = Message(topic, b'\0\1\0\0\xff\xff\xff\xff', 0, 0)
    with pytest.raises(MessageError, match='a/msg/Many'):
        bounded(lambda: decode(message))
