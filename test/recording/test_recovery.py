# SPDX-License-Identifier: Apache-2.0
"""Bags that are cut off, damaged, foreign or hostile, and what is left of them."""

from __future__ import annotations

import functools
import hashlib
from io import BytesIO
from itertools import pairwise
import json
from pathlib import Path
import random
import resource
import shutil
import struct
import subprocess
import sys
import tempfile

from hypothesis import given, settings
from hypothesis import strategies as st
import lz4.frame
from mcap.data_stream import RecordBuilder
from mcap.reader import make_reader
from mcap.records import (
    AttachmentIndex,
    Chunk,
    ChunkIndex,
    DataEnd,
    Footer,
    Header,
    MetadataIndex,
    Schema,
    Statistics,
)
from mcap.records import (
    Channel as ChannelRecord,
)
from mcap.records import (
    Message as MessageRecord,
)
from mcap.writer import CompressionType, MCAP0_MAGIC, Writer
from mcap_ros2.decoder import DecoderFactory
import pytest
from rosbags.rosbag2 import Reader as RosbagsReader
from soft_throw_ros.recording.bag_reader import BagReader, read_stream
from soft_throw_ros.recording.bag_writer import BagWriter
from soft_throw_ros.recording.live_stream import StreamWriter
from soft_throw_ros.recording.message import BagError, Channel, Message
from soft_throw_ros.recording.recovery import recover
import zstandard

ROOT = Path(__file__).parents[2]
PLAIN = Channel(topic='/plain', type='std_msgs/msg/String', schema='string data')


def opened_by_others(folder):
    """Return the data of all messages as rosbags reads them, once mcap has read as many."""
    with RosbagsReader(folder) as bag:
        data = [bytes(data) for _, _, data in bag.messages()]
    count = 0
    for path in folder.glob('*.mcap'):
        with path.open('rb') as file:
            reader = make_reader(file, validate_crcs=True, decoder_factories=[DecoderFactory()])
            count += sum(1 for _ in reader.iter_decoded_messages())
    assert count == len(data)
    return data


def digest(folder):
    return {path.name: hashlib.sha256(path.read_bytes()).hexdigest() for path in folder.iterdir()}


def chunks_of(path):
    with path.open('rb') as file:
        return make_reader(file).get_summary().chunk_indexes


def is_subsequence(part, whole):
    rest = iter(whole)
    return all(item in rest for item in part)


# Cut off

KILLED = """
import mmap, os, random, signal, sys, time
from pathlib import Path
from soft_throw_ros.recording.bag_writer import BagWriter
from soft_throw_ros.recording.message import Channel, Message

folder, runs, seed = Path(sys.argv[1]), int(sys.argv[2]), int(sys.argv[3])
texts = Channel(topic='/text', type='std_msgs/msg/String', schema='string data')
numbers = Channel(topic='/number', type='std_msgs/msg/UInt64', schema='uint64 data')
flushed = mmap.mmap(-1, 8)  # shared with the process that is killed


def write_for_ever(path, number):
    compression = ('none', 'lz4', 'zstd')[number % 3]
    text = b'\\0\\1\\0\\0' + (1000).to_bytes(4, 'little') + b'x' * 999 + b'\\0'
    with BagWriter(path, distribution='jazzy', compression=compression, max_size=10**6) as writer:
        for step in range(10**9):
            data = b'\\0\\1\\0\\0' + step.to_bytes(8, 'little')
            writer.write(Message(numbers, data, step, step, step))
            writer.write(Message(texts, text, step, step, step))
            if step % 97 == 96:
                writer.flush()
                flushed[:] = (2 * (step + 1)).to_bytes(8, 'little')


random.seed(seed)
for number in range(runs):
    flushed[:] = bytes(8)
    child = os.fork()
    if not child:
        try:
            write_for_ever(folder / f'bag{number}', number)
        finally:
            os._exit(1)
    time.sleep(random.uniform(0.0, 0.06))
    os.kill(child, signal.SIGKILL)
    assert os.WIFSIGNALED(os.waitpid(child, 0)[1])
    print(int.from_bytes(flushed[:], 'little'))
"""


def test_process_that_is_killed_loses_only_what_came_since_it_flushed(tmp_path, rerun):
    runs = 40
    killed = subprocess.run(
        [sys.executable, '-c', KILLED, str(tmp_path), str(runs), '7'],
        capture_output=True,
        check=True,
        cwd=ROOT,
        text=True,
        timeout=100,
    )
    flushed = [int(line) for line in killed.stdout.split()]
    assert len(flushed) == runs
    assert sum(count > 0 for count in flushed) > runs // 2
    for number, count in enumerate(flushed):
        bag, target = tmp_path / f'bag{number}', tmp_path / f'whole{number}'
        if count:
            assert (bag / 'metadata.yaml').exists()
            report = recover(bag, target)
            assert report.message_count >= count
            data = opened_by_others(target)
            steps = [int.from_bytes(item[4:], 'little') for item in data if len(item) == 12]
            assert steps == list(range(len(steps)))
            assert len(data) == report.message_count in (2 * len(steps), 2 * len(steps) - 1)
    for path in sorted(target.glob('*.mcap')):
        rerun('mcap', 'check', path)


@pytest.mark.parametrize('compression', ['none', 'lz4', 'zstd'])
def test_bag_cut_off_anywhere_gives_what_came_before(recording, tmp_path, compression):
    recording.write(900, compression=compression, flush_every=202)
    (path,) = recording.files
    whole = path.read_bytes()
    expected = recording.content(recording.messages)
    borders = [chunk.chunk_start_offset + chunk.chunk_length for chunk in chunks_of(path)]
    assert len(borders) == 5
    cuts = {*random.Random(1).sample(range(8, len(whole)), 20)}
    cuts |= {border + shift for border in borders for shift in (-1, 0, 1, 9, 60)}
    cuts |= {len(whole) - size for size in (1, 8, 9, 37, 38, 100)}
    for size in sorted(cuts):
        path.write_bytes(whole[:size])
        with BagReader(path) as bag:
            found = recording.content(bag.messages())
            assert bag.damage
        assert found == expected[: len(found)]
        assert len(found) >= min(202 * sum(border <= size for border in borders), len(expected))
        if found and size % 4 == 0:
            target = tmp_path / f'whole{size}'
            assert recover(recording.folder, target).message_count == len(found)
            assert opened_by_others(target) == [message[1] for message in found]


def test_chunk_that_is_cut_off_gives_its_messages_before_the_cut(recording):
    recording.write(1000, compression='none', flush_every=10_000)
    (path,) = recording.files
    (chunk,) = chunks_of(path)
    path.write_bytes(path.read_bytes()[: chunk.chunk_start_offset + chunk.chunk_length // 2])
    with BagReader(recording.folder) as bag:
        assert 480 < bag.message_count < 520
        assert f'; {bag.message_count} messages before that are read' in bag.damage


# Damaged


@pytest.mark.parametrize('compression', ['none', 'lz4', 'zstd'])
def test_flipped_bits_cost_no_more_than_the_chunk_they_are_in(recording, tmp_path, compression):
    recording.write(600, compression=compression, flush_every=101)
    (path,) = recording.files
    whole = path.read_bytes()
    expected = recording.content(recording.messages)
    generator = random.Random(2)
    for number in range(100):
        damaged = bytearray(whole)
        place = generator.randrange(len(MCAP0_MAGIC), len(whole))
        damaged[place] ^= 1 << generator.randrange(8)
        path.write_bytes(damaged)
        with BagReader(path) as bag, BagReader(path, by_scan=True) as scan:
            for reader in (bag, scan):
                found = recording.content(reader.messages())
                assert is_subsequence(found, expected)
                assert len(found) >= len(expected) - 101
                assert reader.damage or found == expected
        if number % 20 == 0:
            report = recover(recording.folder, tmp_path / f'whole{number}')
            assert len(opened_by_others(tmp_path / f'whole{number}')) == report.message_count


def test_gap_says_where_and_how_many_messages(recording, tmp_path):
    recording.write(2000, flush_every=300)
    (path,) = recording.files
    chunk = chunks_of(path)[3]
    damaged = bytearray(path.read_bytes())
    damaged[chunk.chunk_start_offset + 100] ^= 4
    path.write_bytes(damaged)
    report = recover(recording.folder, tmp_path / 'whole')
    (gap,) = report.gaps
    assert (gap.path, gap.offset, gap.size) == (path, chunk.chunk_start_offset, chunk.chunk_length)
    assert gap.messages == 300
    assert report.message_count == len(recording.messages) - 300
    assert report.saved == {'/twin/joint_states': 1703, '/twin/journal': 17}
    assert report.skipped == report.gaps


def test_channels_survive_the_loss_of_the_chunk_that_defines_them(recording):
    recording.write(2000, flush_every=300)
    (path,) = recording.files
    first = chunks_of(path)[0]
    damaged = bytearray(path.read_bytes())
    damaged[first.chunk_start_offset + 100] ^= 4
    path.write_bytes(damaged[:-100])  # nor is there a summary
    with BagReader(recording.folder) as bag:
        assert bag.message_count == len(recording.messages) - 300
        assert [channel.schema for channel in bag.channels] == [
            recording.states.schema, recording.texts.schema,
        ]  # fmt: skip


def test_channel_with_a_checksum_wins_over_its_copy_without_one(recording):
    recording.write(100)
    (path,) = recording.files
    damaged = path.read_bytes().replace(b'/twin/journal', b'/twin/joUrnal', 1)
    path.write_bytes(damaged[:-100])
    with BagReader(recording.folder) as bag:
        assert [channel.topic for channel in bag.channels] == [
            '/twin/joint_states', '/twin/journal',
        ]  # fmt: skip


@pytest.mark.parametrize('size', [1, 8, 9, 5000, 300_000])
def test_reading_goes_on_after_bytes_that_do_not_belong_there(recording, size):
    recording.write(2000, flush_every=300)
    (path,) = recording.files
    whole = path.read_bytes()
    place = chunks_of(path)[2].chunk_start_offset
    for filling in (bytes(size), b'\xff' * size, random.Random(3).randbytes(size)):
        path.write_bytes(whole[:place] + filling + whole[place:])
        with BagReader(recording.folder, by_scan=True) as bag:
            found = recording.content(bag.messages())
        assert found == recording.content(recording.messages)
        assert [gap.size for gap in bag.gaps][:1] == [size]


def test_bag_whose_beginning_is_damaged_can_be_recovered(recording, tmp_path):
    recording.write(500)
    (path,) = recording.files
    path.write_bytes(b'\0' * 60 + path.read_bytes()[60:])
    with pytest.raises(BagError, match='is no MCAP file'):
        BagReader(recording.folder)
    report = recover(recording.folder, tmp_path / 'whole')
    assert report.message_count == len(recording.messages)


def test_all_that_a_bag_has_is_recovered(recording, tmp_path):
    recording.write(2000, max_duration=0.5, compression='lz4')
    before = digest(recording.folder)
    report = recover(recording.folder, tmp_path / 'whole')
    assert (report.skipped, report.gaps) == ((), ())
    assert digest(recording.folder) == before
    with BagReader(recording.folder) as old, BagReader(tmp_path / 'whole') as new:
        assert recording.content(old.messages()) == recording.content(new.messages())
        assert old.metadata == new.metadata
        assert list(old.attachments()) == list(new.attachments())
        assert [vars(channel) for channel in old.channels] == [
            vars(channel) for channel in new.channels
        ]
        assert new.distribution == 'jazzy'
        assert [file.path.name for file in new.files] == [f'whole_{n}.mcap' for n in range(4)]
        assert [file.counts for file in old.files] == [
            dict(zip(file.counts, new_file.counts.values(), strict=True))
            for file, new_file in zip(old.files, new.files, strict=True)
        ]


def test_messages_out_of_the_order_of_time_keep_their_places(tmp_path):
    times = [5, 3, 3, 9, 0, 7]
    with BagWriter(tmp_path / 'bag', distribution='') as writer:
        for number, time in enumerate(times):
            writer.write(Message(PLAIN, b'', time, 0, number))
    recover(tmp_path / 'bag', tmp_path / 'whole')
    with BagReader(tmp_path / 'whole') as bag:
        (file,) = bag.files
        assert [message.log_time for message in file.messages_as_written()] == times


def unchunked(count):
    writer = StreamWriter()
    stream = writer.start() + writer.define(PLAIN)
    borders = []
    for number in range(count):
        borders.append(len(stream))
        data = number.to_bytes(4, 'little') * 30
        stream += writer.block([Message(PLAIN, data, number, number, number)])
    return stream + writer.end(), borders


def test_messages_in_no_chunk_are_recovered_too(tmp_path):
    stream, borders = unchunked(500)
    path = tmp_path / 'stream.mcap'
    for place in (borders[100], borders[100] + 1, borders[100] + 9):  # opcode, length, contents
        damaged = bytearray(stream)
        damaged[place] ^= 0x40
        path.write_bytes(damaged[: borders[400] + 50])
        with BagReader(path) as bag:
            found = [message.sequence for message in bag.messages()]
            assert set(found) >= {*range(99), *range(102, 400)}
            assert 'the file ends within a record' in str(bag.gaps)


# Refused


def test_bag_that_is_being_written_is_not_touched(tmp_path):
    with BagWriter(tmp_path / 'bag', distribution='') as writer:
        writer.write(Message(PLAIN, b'', 0, 0))
        writer.flush()
        for source in ('bag', 'bag/bag_0.mcap'):
            with pytest.raises(BagError, match='is being written; stop the recorder'):
                recover(tmp_path / source, tmp_path / 'whole')
    assert recover(tmp_path / 'bag', tmp_path / 'whole').message_count == 1


def test_bag_is_not_overwritten_nor_changed(recording, tmp_path):
    recording.write(10)
    before = digest(recording.folder)
    (tmp_path / 'whole').mkdir()
    with pytest.raises(BagError, match='whole exists, and a bag is never overwritten'):
        recover(recording.folder, tmp_path / 'whole')
    for target in (recording.folder, recording.folder / 'whole'):
        with pytest.raises(BagError, match='is in the bag that is to be recovered'):
            recover(recording.folder, target)
    assert digest(recording.folder) == before
    assert list((tmp_path / 'whole').iterdir()) == []


def test_full_disk_leaves_no_half_of_a_bag(recording, tmp_path):
    recording.write(2000, compression='none')
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (5000, limits[1]))
    try:
        with pytest.raises(BagError, match=r'whole_0\.mcap: File too large'):
            recover(recording.folder, tmp_path / 'whole')
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)
    assert not (tmp_path / 'whole').exists()


# Anything at all


def small_bag(folder, **options):
    """Write a bag of three chunks, and return its file."""
    with BagWriter(folder, distribution='', **options) as writer:
        writer.add_metadata('name', {'key': 'value'})
        writer.attach('file', b'content', 'text/plain')
        for number in range(30):
            writer.write(Message(PLAIN, b'message %d ' % number * 5, number, number, number))
            if number % 10 == 9:
                writer.flush()
    return (folder / 'bag_0.mcap').read_bytes()


def without_checksums():
    """Write what rosbag2 does by default."""
    stream = BytesIO()
    writer = Writer(stream, 500, CompressionType.NONE, enable_crcs=False)
    writer.start('ros2')
    schema = writer.register_schema('std_msgs/msg/String', 'ros2msg', b'string data')
    channel = writer.register_channel('/plain', 'cdr', schema, {'topic_type_hash': ''})
    for number in range(30):
        writer.add_message(channel, number, b'message %d ' % number * 5, number, number)
    writer.finish()
    return stream.getvalue()


@functools.cache
def sound(kind):
    """Make a file in which nothing is wrong."""
    if kind == 'unchunked':
        return unchunked(30)[0]
    if kind == 'unchecked':
        return without_checksums()
    with tempfile.TemporaryDirectory() as folder:
        if kind == 'compressed':
            return zstandard.compress(small_bag(Path(folder) / 'bag'))
        return small_bag(Path(folder) / 'bag', compression=kind)


def try_everything(path, target):
    """Read a file in every way; return the data that each gives, if it takes the file."""
    found, reasons = [], []
    for by_scan in (False, True):
        try:
            with BagReader(path, by_scan=by_scan) as bag:
                found.append([message.data for message in bag.messages()])
                assert all(isinstance(record.metadata, dict) for record in bag.metadata)
                assert all(isinstance(record.data, bytes) for record in bag.attachments())
        except BagError as error:
            reasons.append(str(error))
    streamed = []
    with path.open('rb') as file:
        try:
            streamed += (
                item.data for item in read_stream(file, str(path)) if isinstance(item, Message)
            )
        except BagError as error:
            reasons.append(str(error))
    try:
        count = recover(path, target).message_count
    except BagError as error:
        reasons.append(str(error))
        assert not target.exists()
    else:
        assert count == len(found[-1])
        whole = [BytesIO(file.read_bytes()) for file in target.glob('*.mcap')]
        assert count == sum(
            len(list(make_reader(file, validate_crcs=True).iter_messages())) for file in whole
        )
        shutil.rmtree(target)
    assert all(str(path) in reason for reason in reasons)
    return [*found, streamed]


EDITS = st.lists(
    st.tuples(
        st.sampled_from(['flip', 'put', 'remove', 'insert', 'repeat', 'cut']),
        st.floats(0.0, 1.0, exclude_max=True),
        st.integers(0, 300),
        st.sampled_from([0, 1, 0xFF, 2**31, 2**32 - 1, 2**48, 2**63, 2**64 - 1]),
    ),
    min_size=1,
    max_size=4,
)


def edited(data, edits):
    data = bytearray(data)
    for kind, where, size, number in edits:
        place = int(where * len(data))
        if kind == 'flip':
            data[place : place + 1] = bytes([data[place] ^ (1 << size % 8)] if data else [])
        elif kind == 'put':
            data[place : place + 8] = number.to_bytes(8, 'little')
        elif kind == 'remove':
            del data[place : place + size]
        elif kind == 'insert':
            data[place:place] = bytes([number % 256]) * size
        elif kind == 'repeat':
            data[place:place] = data[place : place + size]
        else:
            del data[place:]
    return bytes(data)


@pytest.mark.parametrize('kind', ['lz4', 'zstd', 'none', 'unchunked', 'unchecked', 'compressed'])
@settings(max_examples=80)
@given(edits=EDITS)
def test_edited_file_gives_messages_or_a_reason(tmp_path_factory, kind, edits):
    folder = tmp_path_factory.mktemp('edited')
    path = folder / 'bag.mcap'
    path.write_bytes(edited(sound(kind), edits))
    found = try_everything(path, folder / 'whole')
    is_cut = any(edit[0] == 'cut' for edit in edits)
    if kind in ('lz4', 'zstd', 'compressed') and not is_cut:  # nothing is read without a checksum
        originals = {b'message %d ' % number * 5 for number in range(30)}
        assert all(originals.issuperset(data) for data in found)


@settings(max_examples=300)
@given(
    start=st.sampled_from([b'', MCAP0_MAGIC, zstandard.compress(MCAP0_MAGIC)]),
    pieces=st.lists(
        st.one_of(
            st.binary(max_size=60),
            st.builds(  # a record with any contents, and about the right length
                lambda opcode, body, more: struct.pack('<BQ', opcode, len(body) + more) + body,
                st.integers(0, 16),
                st.binary(max_size=60),
                st.sampled_from([0, 0, 0, 1, -1, 2**40]).filter(lambda more: more >= 0),
            ),
        ),
        max_size=8,
    ),
)
def test_file_of_anything_gives_messages_or_a_reason(tmp_path_factory, start, pieces):
    folder = tmp_path_factory.mktemp('anything')
    path = folder / 'bag.mcap'
    path.write_bytes(start + b''.join(pieces))
    try_everything(path, folder / 'whole')


def record(value):
    builder = RecordBuilder()
    value.write(builder)
    return builder.end()


def head(opcode, length):
    return struct.pack('<BQ', opcode, length)


def chunk(data, *, compression='', size=None, checksum=0):
    return record(
        Chunk(
            compression=compression,
            data=data,
            message_start_time=0,
            message_end_time=9,
            uncompressed_crc=checksum,
            uncompressed_size=len(data) if size is None else size,
        )
    )


DEFINED = record(Schema(id=1, name='t/msg/T', encoding='ros2msg', data=b'int8 x')) + record(
    ChannelRecord(id=1, topic='/a', message_encoding='cdr', metadata={}, schema_id=1)
)
MESSAGE = record(MessageRecord(channel_id=1, log_time=1, publish_time=1, sequence=1, data=b'x'))
ZEROS = bytes(300 * 2**20)
LARGE_FRAME = zstandard.compress(ZEROS)


def frame_claiming(size):
    """Make a frame of zstd whose head claims to hold so many bytes."""
    return b'\x28\xb5\x2f\xfd\xe0' + size.to_bytes(8, 'little') + b'\x01\0\0'


def summary(*records, start=None):
    """Put records where the index of a file is."""
    before = MCAP0_MAGIC + record(Header(profile='ros2', library='')) + chunk(DEFINED + MESSAGE)
    before += record(DataEnd(data_section_crc=0))
    start = len(before) if start is None else start
    footer = record(Footer(summary_start=start, summary_offset_start=0, summary_crc=0))
    return before + b''.join(map(record, records)) + footer + MCAP0_MAGIC


def chunk_index(**values):
    usual = {
        'chunk_length': 100,
        'chunk_start_offset': 8,
        'compression': '',
        'compressed_size': 1,
        'message_end_time': 9,
        'message_index_length': 0,
        'message_index_offsets': {},
        'message_start_time': 0,
        'uncompressed_size': 1,
    }
    return ChunkIndex(**usual | values)


def statistics(**values):
    usual = {
        'attachment_count': 0,
        'channel_count': 1,
        'channel_message_counts': {1: 1},
        'chunk_count': 1,
        'message_count': 1,
        'message_end_time': 9,
        'message_start_time': 0,
        'metadata_count': 0,
        'schema_count': 1,
    }
    return Statistics(**usual | values)


SCHEMA, CHANNEL = Schema(1, b'int8 x', 'ros2msg', 't/msg/T'), ChannelRecord(1, '/a', 'cdr', {}, 1)
HUGE = 2**63 - 1

HOSTILE = {
    **{
        f'record {opcode} of {length}': MCAP0_MAGIC + head(opcode, length) + bytes(50)
        for opcode in (*range(1, 16), 0x80)
        for length in (2**31, 2**40, 2**63, 2**64 - 1)
    },
    **{
        f'record {opcode} of nothing but {byte}': MCAP0_MAGIC + head(opcode, 200) + byte * 200
        for opcode in range(1, 16)
        for byte in (b'\0', b'\xff', b'\x7f')
    },
    'chunk of terabytes': MCAP0_MAGIC + chunk(b'', size=2**50),
    'zstd chunk of terabytes': MCAP0_MAGIC + chunk(LARGE_FRAME, compression='zstd', size=2**50),
    'zstd frame of terabytes': MCAP0_MAGIC
    + chunk(frame_claiming(2**50), compression='zstd', size=100),
    'zstd frame and chunk of terabytes': MCAP0_MAGIC
    + chunk(frame_claiming(2**50), compression='zstd', size=2**50),
    'zstd frame of what is not there': MCAP0_MAGIC
    + chunk(frame_claiming(2**28), compression='zstd', size=2**28),
    'zstd bomb': MCAP0_MAGIC + chunk(LARGE_FRAME, compression='zstd', size=len(ZEROS)),
    'small zstd bomb': MCAP0_MAGIC + chunk(LARGE_FRAME, compression='zstd', size=100),
    'cut zstd bomb': MCAP0_MAGIC + chunk(LARGE_FRAME, compression='zstd', size=2**26)[:-1],
    'lz4 bomb': MCAP0_MAGIC + chunk(lz4.frame.compress(ZEROS), compression='lz4', size=len(ZEROS)),
    'small lz4 bomb': MCAP0_MAGIC + chunk(lz4.frame.compress(ZEROS), compression='lz4', size=1),
    'cut lz4 bomb': MCAP0_MAGIC
    + chunk(lz4.frame.compress(ZEROS), compression='lz4', size=2**26)[:-1],
    'file bomb': LARGE_FRAME,
    'chunk in a chunk': MCAP0_MAGIC + chunk(chunk(chunk(DEFINED + MESSAGE))),
    'unknown compression': MCAP0_MAGIC + chunk(b'x', compression='brotli'),
    'channel without a schema': MCAP0_MAGIC
    + record(ChannelRecord(1, '/a', 'cdr', {}, 7))
    + MESSAGE * 3,
    'messages without a channel': MCAP0_MAGIC + MESSAGE * 3,
    'messages of all channels': MCAP0_MAGIC
    + DEFINED
    + b''.join(record(MessageRecord(number, 1, b'', 1, 1)) for number in range(0, 2**16, 100)),
}
"""Files without a message, by what they claim."""

HARMLESS = {
    'index of a chunk beyond the file': summary(
        SCHEMA, CHANNEL, statistics(), chunk_index(chunk_start_offset=HUGE, chunk_length=HUGE)
    ),
    'index of a chunk that is none': summary(SCHEMA, CHANNEL, statistics(), chunk_index()),
    'index of many channels': summary(
        SCHEMA,
        CHANNEL,
        statistics(),
        chunk_index(message_index_offsets=dict.fromkeys(range(2**16), HUGE)),
    ),
    'statistics of what is not there': summary(
        SCHEMA, CHANNEL, statistics(message_count=HUGE, chunk_count=0)
    ),
    'metadata and attachment that are none': summary(
        SCHEMA,
        CHANNEL,
        chunk_index(),
        statistics(metadata_count=1, attachment_count=2),
        MetadataIndex(offset=HUGE, length=1, name='x'),
        AttachmentIndex(8, 100, 0, 0, HUGE, 'x', 'y'),
        AttachmentIndex(HUGE, HUGE, 0, 0, HUGE, 'x', 'y'),
    ),
    'summary that is the footer': summary(start=0) + summary(start=1),
    'summary before the file': summary(SCHEMA, start=HUGE),
    'times beyond all times': MCAP0_MAGIC
    + DEFINED
    + record(MessageRecord(1, 2**64 - 1, b'', 1, 1))
    + chunk(DEFINED + record(MessageRecord(1, 1, b'', 2**64 - 1, 1)) + MESSAGE),
    'quality of service that is nested deep': MCAP0_MAGIC
    + record(SCHEMA)
    + record(ChannelRecord(1, '/a', 'cdr', {'offered_qos_profiles': '[' * 1000}, 1))
    + MESSAGE,
    'quality of service in aliases of aliases': MCAP0_MAGIC
    + record(SCHEMA)
    + record(
        ChannelRecord(
            1,
            '/a',
            'cdr',
            {
                'offered_qos_profiles': 'a: &a [x, x]\n'
                + ''.join(
                    f'{n}: &{n} [*{m}, *{m}, *{m}, *{m}]\n' for m, n in pairwise('abcdefghij')
                )
            },
            1,
        )
    )
    + MESSAGE,
}
"""Files with one message, and what they claim besides."""

LIMITED = """
import json, resource, sys
from pathlib import Path
from soft_throw_ros.recording.bag_reader import BagReader, read_stream
from soft_throw_ros.recording.message import BagError, Message
from soft_throw_ros.recording.recovery import recover

resource.setrlimit(resource.RLIMIT_AS, (1200 * 2**20, 1200 * 2**20))
resource.setrlimit(resource.RLIMIT_CPU, (90, 90))
folder = Path(sys.argv[1])
for path in sorted(folder.glob('*.mcap')):
    said = []
    for by_scan in (False, True):
        try:
            with BagReader(path, by_scan=by_scan) as bag:
                count = len(list(bag.messages()))
                [*bag.attachments(), *bag.metadata]
                said.append([count, bag.damage])
        except BagError as error:
            said.append([0, str(error)])
    try:
        with path.open('rb') as file:
            said.append([sum(isinstance(item, Message) for item in read_stream(file)), ''])
    except BagError as error:
        said.append([0, str(error)])
    try:
        said.append([recover(path, folder / path.stem).message_count, ''])
    except BagError as error:
        said.append([0, str(error)])
    print(json.dumps(said))
# getrusage would tell what the process had that this one was forked from
status = Path('/proc/self/status').read_text()
print(status.partition('VmHWM:')[2].split()[0])
"""


def test_hostile_files_cost_no_memory_and_give_what_they_have(tmp_path):
    for number, content in enumerate((HOSTILE | HARMLESS).values()):
        (tmp_path / f'{number:03}.mcap').write_bytes(content)
    read = subprocess.run(
        [sys.executable, '-c', LIMITED, str(tmp_path)],
        capture_output=True,
        check=False,
        cwd=ROOT,
        text=True,
        timeout=110,
    )
    assert read.returncode == 0, read.stderr
    *lines, memory = read.stdout.splitlines()
    assert int(memory) < 700 * 2**10  # [KiB]
    for name, line in zip(HOSTILE | HARMLESS, lines, strict=True):
        indexed, scanned, streamed, recovered = json.loads(line)
        expected = int(name in HARMLESS)
        assert [count for count, _ in (indexed, scanned, recovered)] == [expected] * 3, name
        assert streamed[0] == (expected and name != 'times beyond all times'), name
        if not expected:
            assert all(reason for _, reason in (indexed, scanned, recovered)), name
