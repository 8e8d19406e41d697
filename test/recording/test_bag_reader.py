# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Reading of our own and foreign bags in order, and of streams through pipes."""

from __future__ import annotations

import contextlib
import os
import shutil
from test.recording.conftest import plain, read, TYPES
import tracemalloc

from bags import profiles, write
from damage import accepted, datas, few
from hypothesis import given, settings
from hypothesis import strategies as st
from mcap.records import Metadata
from mcap.writer import CompressionType, IndexType, Writer
import pytest
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin
from rosbags.rosbag2 import Reader as RosbagsReader
from rosbags.rosbag2 import Writer as RosbagsWriter
from rosbags.rosbag2.metadata import parse_qos
from soft_throw_ros.commands.recover import main as recover_bag
from soft_throw_ros.recording.bag_writer import BagWriter, CHUNK_SIZE
from soft_throw_ros.recording.recovery import recover
from soft_throw_ros.storage import bag_reader, mcap_stream
from soft_throw_ros.storage.bag_metadata import MAX_FILE_SIZE
from soft_throw_ros.storage.bag_reader import BagReader, UnfinishedError
from soft_throw_ros.storage.message import BagError, Channel, Message


@settings(max_examples=50)
@given(
    times=st.lists(st.integers(0, 30), max_size=60),
    cuts=st.sets(st.integers(0, 60)),
    span=st.tuples(st.integers(-5, 35), st.integers(-5, 35)),
    topics=st.sampled_from([None, ['/odd'], ('/even', '/odd'), [], ['/missing']]),
)
def test_messages_are_sorted_by_time_and_then_as_written(
    tmp_path_factory, times, cuts, span, topics
):
    channels = [Channel(topic=name, type='t/msg/T', schema='int8 x') for name in ('/even', '/odd')]
    messages = [
        Message(channels[number % 2], b'', time, 0, number) for number, time in enumerate(times)
    ]
    folder = tmp_path_factory.mktemp('order') / 'bag'
    with BagWriter(folder, distribution='') as writer:
        for message in messages:
            if message.sequence in cuts:  # a chunk, or a file, ends
                writer.flush() if message.sequence % 2 else writer.split()
            writer.write(message)
    start, end = span
    selected = [
        message
        for message in messages
        if (topics is None or message.channel.topic in topics) and start <= message.log_time < end
    ]
    by_time = sorted(selected, key=lambda message: message.log_time)
    with BagReader(folder) as reader:
        result = reader.messages(topics, start, end)
        assert [message[2:] for message in result] == [message[2:] for message in by_time]
        result = reader.messages(topics, start, end, by_log_time=False)
        assert [message[2:] for message in result] == [message[2:] for message in selected]
        assert reader.damage == ''


def test_large_bag_is_read_in_little_memory(tmp_path):
    with BagWriter(tmp_path / 'bag', distribution='') as writer:
        for number in range(4000):
            writer.write(plain(number, size=20_000))
    tracemalloc.start()
    try:
        with BagReader(tmp_path / 'bag') as bag:
            assert sum(len(message.data) for message in bag.messages()) == 80_000_000
        _, peak = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert peak < 10 * CHUNK_SIZE


# Bags of others


@pytest.mark.parametrize(
    ('version', 'mode'),
    [(8, None), (9, None), (9, CompressionMode.STORAGE)],
)
def test_bag_of_rosbags_is_read(recording, tmp_path, version, mode):
    messages = recording.make(300)
    offered = profiles({'depth': 7, 'reliability': 'best_effort'})
    bag = RosbagsWriter(tmp_path / 'theirs', version=version, storage_plugin=StoragePlugin.MCAP)
    if mode is not None:
        bag.set_compression(mode, CompressionFormat.ZSTD)
    with bag:
        connections = {
            channel: bag.add_connection(
                channel.topic,
                channel.type,
                typestore=TYPES,
                offered_qos_profiles=parse_qos(offered),
            )
            for channel in (recording.states, recording.texts)
        }
        for message in messages:
            bag.write(connections[message.channel], message.log_time, message.data)
    recover(tmp_path / 'theirs', tmp_path / 'recovered')
    for name in ('theirs', 'recovered'):
        ours = read(tmp_path / name)
        assert [
            (message.channel.topic, message.data, message.log_time) for message in ours.messages
        ] == [(message.channel.topic, message.data, message.log_time) for message in messages]
        assert {channel.type for channel in ours.channels} == {
            'sensor_msgs/msg/JointState', 'std_msgs/msg/String',
        }
        for channel in ours.channels:
            assert parse_qos(channel.qos) == parse_qos(offered)
        assert ours.counts == [300, 3]


@pytest.mark.parametrize('chunked', [True, False])
@pytest.mark.parametrize('index_types', [IndexType.ALL, IndexType.NONE, IndexType.CHUNK])
@pytest.mark.parametrize('has_statistics', [True, False])
def test_mcap_with_any_index_or_none_is_read(tmp_path, chunked, index_types, has_statistics):
    times = [3, 1, 2, 2, 5, 4, 0, 9, 8, 7] * 40
    with (tmp_path / 'theirs.mcap').open('wb') as file:
        writer = Writer(
            file,
            chunk_size=1000,
            compression=CompressionType.LZ4,
            index_types=index_types,
            use_chunking=chunked,
            use_statistics=has_statistics,
            repeat_channels=has_statistics,
            repeat_schemas=has_statistics,
            enable_data_crcs=True,
        )
        writer.start()
        channel = writer.register_channel(
            '/a', 'cdr', writer.register_schema('t/msg/T', 'ros2msg', b'int8 x')
        )
        for number, time in enumerate(times):
            writer.add_message(channel, time, bytes([number % 256]), time, number)
            if number == 100:
                writer.add_metadata('name', {'key': 'value'})
        writer.add_attachment(0, 0, 'file', 'text/plain', b'content')
        writer.finish()
    recover(tmp_path / 'theirs.mcap', tmp_path / 'recovered')
    for name in ('theirs.mcap', 'recovered'):
        bag = read(tmp_path / name)
        assert [(message.log_time, message.sequence) for message in bag.messages] == sorted(
            (time, number) for number, time in enumerate(times)
        )
        assert bag.span == (0, 9)
        assert bag.metadata == [Metadata(name='name', metadata={'key': 'value'})]
    assert bag.attachments == {'file': b'content'}


@pytest.mark.parametrize(
    ('damage', 'name'),
    [
        (lambda _: None, 'metadata.yaml'),
        (lambda text: text[:300], 'metadata.yaml'),
        (lambda _: 'rosbag2_bagfile_information: [', 'metadata.yaml'),
        (lambda _: '[' * 1000, 'metadata.yaml'),
        (lambda text: f'{text}# {"x" * MAX_FILE_SIZE}', 'metadata.yaml'),
        (lambda text: text.replace('bag_3.mcap', 'bag_x.mcap'), 'bag_x.mcap'),
    ],
)
def test_folder_without_metadata_is_read_with_a_note(recording, damage, name):
    recording.write(2000, max_duration=0.15)
    assert len(recording.files) > 10  # so that names are not in the order of the alphabet
    path = recording.folder / 'metadata.yaml'
    text = damage(path.read_text())
    path.unlink()
    if text is not None:
        path.write_text(text)
    with BagReader(recording.folder) as bag:
        assert recording.content(bag.messages()) == recording.content(recording.messages)
        assert name in bag.damage


@pytest.mark.parametrize(
    ('plugin', 'mode', 'reason'),
    [
        (StoragePlugin.MCAP, CompressionMode.FILE, 'compressed'),
        (StoragePlugin.MCAP, CompressionMode.MESSAGE, 'compressed'),
        (StoragePlugin.SQLITE3, None, 'sqlite3'),
    ],
)
def test_bag_of_another_format_is_refused_with_its_converter(tmp_path, plugin, mode, reason):
    bag = RosbagsWriter(tmp_path / 'theirs', version=9, storage_plugin=plugin)
    if mode is not None:
        bag.set_compression(mode, CompressionFormat.ZSTD)
    with bag:
        bag.write(bag.add_connection('/a', 'std_msgs/msg/String', typestore=TYPES), 7, b'')
    for path in (tmp_path / 'theirs', *tmp_path.glob('theirs/*.db3')):
        with pytest.raises(BagError, match=rf'theirs.*{reason}.*rosbags-convert'):
            BagReader(path)


@pytest.mark.parametrize(
    ('content', 'reason'),
    [
        (b'', 'empty'),
        (b'#ROSBAG V2.0\n', 'ROS 1.*rosbags-convert'),
        (b'time,position\n0,1\n', 'no MCAP file'),
        (b'\x28\xb5\x2f\xfd' + b'\xff' * 100, 'compressed.*rosbags-convert'),
    ],
)
@pytest.mark.parametrize('in_folder', [False, True])
def test_file_that_is_no_bag_is_refused_with_a_reason(tmp_path, content, reason, in_folder):
    path = tmp_path / 'bag.mcap'
    path.write_bytes(content)
    with pytest.raises(BagError, match=rf'bag\.mcap.* {reason}'):
        BagReader(tmp_path if in_folder else path)


def test_path_that_is_no_bag_is_named(tmp_path):
    os.mkfifo(tmp_path / 'pipe')
    (tmp_path / 'empty').mkdir()
    for name in ('pipe', 'missing', 'empty'):
        with pytest.raises(BagError, match=name):
            BagReader(tmp_path / name)


@pytest.mark.parametrize(
    ('encoding', 'schema', 'time', 'reason'),
    [
        ('json', 1, 0, r"/a /b [^\n]*'json'"),
        ('cdr', 0, 0, 'nothing defines channel 1'),
        ('cdr', 1, 2**63, f'{2**63}'),
    ],
)
def test_messages_that_are_not_of_ros_are_refused_in_one_line(
    tmp_path, encoding, schema, time, reason
):
    with (tmp_path / 'theirs.mcap').open('wb') as file:
        writer = Writer(file)
        writer.start()
        writer.register_schema('t/T', 'jsonschema', b'{}')
        writer.add_message(writer.register_channel('/a\n/b', encoding, schema), time, b'{}', time)
        writer.finish()
    with pytest.raises(BagError, match=rf'^[^\n]*theirs\.mcap: [^\n]*{reason}[^\n]*$'):
        read(tmp_path / 'theirs.mcap')


def test_damaged_index_is_refused(recording):
    recording.write(10)
    (path,) = recording.files
    data, offset = bytearray(path.read_bytes()), path.read_bytes().rindex(b'/twin/journal')
    data[offset + 1] ^= 1
    path.write_bytes(data)
    with pytest.raises(UnfinishedError, match='checksum of its index'):
        BagReader(path)


def test_bag_is_read_up_to_the_first_damaged_chunk(recording):
    recording.write(900, max_duration=0.3)
    path = recording.files[1]
    data = bytearray(path.read_bytes())
    data[data.index(b'zstd') + 100] ^= 1
    path.write_bytes(data)
    messages = []
    with BagReader(recording.folder) as bag, pytest.raises(UnfinishedError, match='chunk'):
        messages.extend(bag.messages())  # up to the error
    assert recording.content(messages) == recording.content(recording.messages[:len(messages)])
    assert len(messages) == 303


# Large claims


def claiming(folder, kind):
    """Write a bag with one message, and a record or chunk that claims far more than there is."""
    path = folder / f'{kind}.mcap'
    with path.open('wb') as file:
        writer = Writer(file, use_chunking=kind != 'message', compression=CompressionType.NONE)
        writer.start('ros2')
        schema = writer.register_schema('t/msg/T', 'ros2msg', b'int8 x')
        channel = writer.register_channel('/a', 'cdr', schema)
        writer.add_message(channel, 1, b'', 1)
        writer.flush()
        begin = file.tell()
        writer.add_message(channel, 2, b'abc', 2)
        writer.flush()
        writer.finish()
    with path.open('r+b') as file:
        file.seek(begin + {'message': 1, 'chunk': 1, 'unpacked': 9 + 16, 'data': 9 + 32}[kind])
        file.write((10**12).to_bytes(8, 'little'))
    return path


@pytest.mark.parametrize('kind', ['message', 'chunk', 'unpacked', 'data'])
def test_record_that_claims_more_than_there_is_is_refused_in_little_memory(tmp_path, kind):
    path = claiming(tmp_path, kind)
    tracemalloc.start()
    try:
        with contextlib.suppress(BagError), BagReader(path) as reader:
            messages = list(reader.messages())
            assert kind in ('chunk', 'unpacked')  # the index has the right sizes
            assert [message.data for message in messages] == [b'', b'abc']
        recovered = recover(path, tmp_path / 'new')
        _, peak = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert peak < 10**7
    assert len(recovered.omitted) == 1
    assert [message.data for message in read(recovered.target).messages] == [b'']


def test_chunk_and_index_beyond_the_limit_are_refused(tmp_path, monkeypatch):
    for name, size, limit in (('chunk', 200_000, 100_000), ('index', 100, 3_000)):
        messages = [plain(number, size=size) for number in range(50)]
        path = write(tmp_path / name, messages, chunk=1, compression='none')
        monkeypatch.setattr(mcap_stream, 'MAX_RECORD', limit)
        with pytest.raises(UnfinishedError, match=f'more than {limit}'):
            BagReader(path)
        monkeypatch.undo()


def test_large_file_without_an_index_is_refused_and_recovered(tmp_path, monkeypatch):
    path = tmp_path / 'plain.mcap'
    with path.open('wb') as file:
        writer = Writer(file, use_chunking=False)
        writer.start()
        schema = writer.register_schema('t/msg/T', 'ros2msg', b'int8 x')
        writer.add_message(writer.register_channel('/a', 'cdr', schema), 1, bytes(1000), 1)
        writer.finish()
    monkeypatch.setattr(bag_reader, 'MAX_UNINDEXED', 1000)
    with pytest.raises(UnfinishedError, match=r'no index.*soft-throw recover'):
        BagReader(path)
    assert recover(path, tmp_path / 'new').message_count == 1


@pytest.fixture(scope='module')
def small_bags(tmp_path_factory):
    """Return the bytes of small bags, and their messages."""
    channel = Channel(topic='/odd', type='t/msg/T', schema='int8 x')
    messages = [Message(channel, bytes([number] * 20), number, 0, number) for number in range(40)]
    folder = tmp_path_factory.mktemp('small')
    contents = []
    for name in ('none', 'lz4', 'zstd'):
        write(folder / name, messages, chunk=10, compression=name)
        contents.append((folder / f'{name}/{name}_0.mcap').read_bytes())
    return contents, {message.data for message in messages}


@few
@given(data=st.data())
def test_damaged_bag_gives_messages_as_they_were_written_or_is_refused(
    tmp_path, small_bags, data
):
    contents, written = small_bags
    path, target = tmp_path / 'bag.mcap', tmp_path / 'new'
    path.write_bytes(data.draw(datas(*contents)))
    shutil.rmtree(target, ignore_errors=True)

    def read():
        with BagReader(path) as reader:
            return {message.data for message in reader.messages()}

    assert (accepted(read, str(path)) or set()) <= written
    with contextlib.suppress(SystemExit):  # with code 2, if nothing can be recovered
        recover_bag([str(path), '--to', str(target)])
    if target.exists():
        with RosbagsReader(target) as reader:
            assert {bytes(message) for *_, message in reader.messages()} <= written
