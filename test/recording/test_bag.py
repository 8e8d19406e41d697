# SPDX-License-Identifier: Apache-2.0
"""Bags: ours as others read them, those of others as we read them, and streams through pipes."""

from __future__ import annotations

from contextlib import contextmanager
from io import BytesIO
import itertools
import os
import resource
import shutil
import tracemalloc
from types import SimpleNamespace

from hypothesis import given
from hypothesis import strategies as st
from mcap.reader import make_reader
from mcap.records import Metadata
from mcap.stream_reader import StreamReader
from mcap.writer import CompressionType, IndexType, Writer
from mcap_ros2.decoder import DecoderFactory
import pytest
from rosbags.interfaces import QosDurability
from rosbags.rosbag2 import (
    CompressionFormat,
    CompressionMode,
    StoragePlugin,
)
from rosbags.rosbag2 import (
    Reader as RosbagsReader,
)
from rosbags.rosbag2 import (
    Writer as RosbagsWriter,
)
from rosbags.rosbag2.metadata import parse_qos
from rosbags.typesys import get_typestore, Stores
from soft_throw_ros.recording.bag_reader import BagReader, read_stream
from soft_throw_ros.recording.bag_writer import BagWriter, CHUNK_SIZE, is_being_written
from soft_throw_ros.recording.live_stream import StreamWriter
from soft_throw_ros.recording.message import BagError, Channel, Message
from soft_throw_ros.recording.qos import Qos, to_yaml
import yaml

TYPES = get_typestore(Stores.ROS2_JAZZY)
PLAIN = Channel(topic='/plain', type='std_msgs/msg/String', schema='string data')
COMPRESSIONS = ('none', 'lz4', 'zstd')


def plain(number, *, time=None, size=100):
    time = number if time is None else time
    return Message(PLAIN, number.to_bytes(8, 'little') + bytes(size - 8), time, time, number)


def noise(number):
    """Make a message that cannot be compressed."""
    return Message(PLAIN, os.urandom(1000), number, number, number)


def write_all(writer, messages):
    for message in messages:
        writer.write(message)


def numbers(messages):
    return [message.sequence for message in messages]


def information(folder):
    return yaml.safe_load((folder / 'metadata.yaml').read_text())['rosbag2_bagfile_information']


def read(path, **options):
    """Read all of a bag that is whole."""
    with BagReader(path, **options) as bag:
        contents = SimpleNamespace(
            messages=list(bag.messages()),
            metadata=bag.metadata,
            attachments=list(bag.attachments()),
            channels=bag.channels,
            counts=list(bag.counts.values()),
            span=(bag.start_time, bag.end_time),
        )
        assert bag.message_count == len(contents.messages)
        assert bag.damage == ''
        return contents


@contextmanager
def largest_file(size):
    """Have the system refuse to write files beyond a size, as if the disk were full."""
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, limits[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)


# What we write, others read


@pytest.mark.parametrize('compression', COMPRESSIONS)
def test_rosbags_reads_what_was_written(recording, compression):
    recording.write(compression=compression)
    with RosbagsReader(recording.folder) as bag:
        found = [
            (connection.topic, time, bytes(data), TYPES.deserialize_cdr(data, connection.msgtype))
            for connection, time, data in bag.messages()
        ]
        states, texts = bag.connections
        assert (bag.message_count, bag.ros_distro) == (len(recording.messages), 'jazzy')
        first, last = recording.messages[0].log_time, recording.messages[-1].log_time
        assert (bag.start_time, bag.end_time) == (first, last + 1)
    assert [item[:3] for item in found] == [
        (message.channel.topic, message.log_time, message.data) for message in recording.messages
    ]
    assert [item[3].position[0] for item in found if item[0] == states.topic] == list(range(3000))
    assert [item[3].data for item in found if item[0] == texts.topic][7] == 'step 700 äöü'
    assert states.digest == TYPES.hash_rihs01('sensor_msgs/msg/JointState')
    assert states.ext.offered_qos_profiles == parse_qos(to_yaml(recording.states.qos))
    (qos,) = texts.ext.offered_qos_profiles
    assert qos.durability is QosDurability.TRANSIENT_LOCAL


@pytest.mark.parametrize('compression', COMPRESSIONS)
def test_mcap_reads_what_was_written(recording, compression):
    recording.write(compression=compression)
    with recording.files[0].open('rb') as file:
        reader = make_reader(file, validate_crcs=True, decoder_factories=[DecoderFactory()])
        assert reader.get_header().profile == 'ros2'
        found = list(reader.iter_decoded_messages())
        metadata = {record.name: record.metadata for record in reader.iter_metadata()}
        (attachment,) = reader.iter_attachments()
        chunks = reader.get_summary().chunk_indexes
        schemas = reader.get_summary().schemas.values()
    assert [
        (channel.topic, raw.data, raw.log_time, raw.publish_time, raw.sequence)
        for _, channel, raw, _ in found
    ] == recording.content(recording.messages)
    positions = [decoded.position for _, channel, _, decoded in found if 'joint' in channel.topic]
    assert positions == [[number, number] for number in range(3000)]
    assert {(schema.name, schema.encoding) for schema in schemas} == {
        ('sensor_msgs/msg/JointState', 'ros2msg'),
        ('std_msgs/msg/String', 'ros2msg'),
    }
    assert metadata['parameters of /twin'] == {'gravity': '9.81', 'model': 'exact'}
    assert (attachment.name, attachment.data) == ('twin.yaml', b'twin:\n')
    assert all(chunk.uncompressed_size <= CHUNK_SIZE for chunk in chunks)
    assert {chunk.compression for chunk in chunks} == {compression.replace('none', '')}


@pytest.mark.parametrize('compression', COMPRESSIONS)
def test_rerun_reads_what_was_written(recording, rerun, compression, tmp_path):
    recording.write(300, compression=compression)
    checked = rerun('mcap', 'check', recording.files[0])
    assert [line.split()[0] for line in checked.splitlines() if '/twin' in line] == ['ok', 'ok']
    said = rerun('mcap', 'convert', recording.files[0], '--output', tmp_path / 'bag.rrd')
    assert 're_mcap' not in said  # which warns of what it finds odd
    assert '/twin/joint_states' in rerun('rrd', 'print', tmp_path / 'bag.rrd')


def test_metadata_file_has_the_keys_and_types_that_rosbags_writes(recording, tmp_path):
    recording.write(100, max_duration=0.05)
    with RosbagsWriter(tmp_path / 'theirs', version=9, storage_plugin=StoragePlugin.MCAP) as bag:
        connection = bag.add_connection('/a', 'std_msgs/msg/String', typestore=TYPES)
        bag.write(connection, 7, b'')

    def shape(value):
        if isinstance(value, dict):
            return {key: shape(item) for key, item in value.items()}
        return [shape(value[0])] if isinstance(value, list) and value else type(value)

    ours, theirs = shape(information(recording.folder)), shape(information(tmp_path / 'theirs'))
    topic = ours['topics_with_message_count'][0]['topic_metadata']
    assert topic.pop('offered_qos_profiles') == [shape(Qos().to_dict())]
    assert theirs['topics_with_message_count'][0]['topic_metadata'].pop('offered_qos_profiles')
    assert ours.pop('custom_data') == {}  # as rosbag2 has it; rosbags writes null
    theirs.pop('custom_data')
    assert ours == theirs


def test_metadata_are_in_the_files_too(recording):
    recording.write()
    with recording.files[0].open('rb') as file:
        (text,) = [  # of several, Rerun would complain
            record.metadata['serialized_metadata']
            for record in make_reader(file).iter_metadata()
            if record.name == 'rosbag2'
        ]
    assert yaml.safe_load(text) == information(recording.folder)
    assert information(recording.folder)['version'] == 9


# Files


def test_every_file_of_a_bag_can_be_read_alone(recording):
    recording.write(max_duration=0.5)
    first_state = recording.messages[0].log_time
    assert len(recording.files) == 6
    for number, path in enumerate(recording.files):
        assert path.name == f'bag_{number}.mcap'
        part = read(path)
        begin = first_state + number * 500_000_000
        assert [message[1:] for message in part.messages] == [
            message[1:]
            for message in recording.messages
            if begin <= message.log_time < begin + 500_000_000
        ]
        assert [record.name for record in part.metadata] == ['parameters of /twin']
        assert part.channels[0].qos == recording.states.qos
        with RosbagsReader(path) as theirs:
            assert theirs.message_count == len(part.messages)
    whole = read(recording.folder)
    assert recording.content(whole.messages) == recording.content(recording.messages)
    assert len(whole.channels) == 2
    assert len(whole.metadata) == len(whole.attachments) == 1


def test_file_that_has_grown_beyond_the_size_is_followed_by_another(recording):
    recording.write(20_000, compression='none', max_size=10**6)
    sizes = [path.stat().st_size for path in recording.files]
    assert len(sizes) > 2
    assert max(sizes) < 10**6 + 2 * CHUNK_SIZE
    assert min(sizes[:-1]) > 10**6
    assert recording.content(read(recording.folder).messages) == recording.content(
        recording.messages
    )
    described = information(recording.folder)
    assert described['relative_file_paths'] == [path.name for path in recording.files]
    assert sum(file['message_count'] for file in described['files']) == len(recording.messages)
    with RosbagsReader(recording.folder) as theirs:
        assert sum(1 for _ in theirs.messages()) == len(recording.messages)


def test_split_begins_a_file_only_if_there_are_messages_in_this_one(tmp_path):
    with BagWriter(tmp_path / 'bag', distribution='') as writer:
        for number in range(3):
            writer.split()
            writer.split()
            writer.write(plain(number))
    assert len(list(tmp_path.glob('bag/*.mcap'))) == 3
    assert numbers(read(tmp_path / 'bag').messages) == [0, 1, 2]


def test_metadata_that_change_are_kept_and_the_last_are_repeated(tmp_path):
    with BagWriter(tmp_path / 'bag', distribution='') as writer:
        for number in range(3):
            writer.add_metadata('parameters', {'gravity': str(number)})
            writer.write(plain(number))
        writer.split()
        writer.write(plain(3))
        writer.add_metadata('losses', {'/plain': '0'})
    bag = read(tmp_path / 'bag')
    assert [record.metadata for record in bag.metadata] == [
        {'gravity': '0'}, {'gravity': '1'}, {'gravity': '2'}, {'/plain': '0'},
    ]  # fmt: skip
    part = read(tmp_path / 'bag/bag_1.mcap')
    assert [record.metadata for record in part.metadata] == [{'gravity': '2'}, {'/plain': '0'}]


def test_folder_that_exists_is_never_written_into(tmp_path):
    (tmp_path / 'bag').mkdir()
    (tmp_path / 'file').touch()
    for name in ('bag', 'file'):
        with pytest.raises(BagError, match=f'{name} exists, and a bag is never overwritten'):
            BagWriter(tmp_path / name, distribution='')
    assert sorted(path.name for path in tmp_path.rglob('*')) == ['bag', 'file']


def test_second_writer_into_a_folder_is_refused(tmp_path):
    with BagWriter(tmp_path / 'bag', distribution='') as writer:
        writer.write(plain(0))
        with pytest.raises(BagError, match='bag exists'):
            BagWriter(tmp_path / 'bag', distribution='')
        writer.write(plain(1))
        assert is_being_written(tmp_path / 'bag')
        assert is_being_written(tmp_path / 'bag/bag_0.mcap')
    assert not is_being_written(tmp_path / 'bag')
    assert not is_being_written(tmp_path / 'missing')
    assert numbers(read(tmp_path / 'bag').messages) == [0, 1]


def test_folder_that_cannot_be_made_is_named(tmp_path):
    (tmp_path / 'file').touch()
    with pytest.raises(BagError, match='file/bag: Not a directory'):
        BagWriter(tmp_path / 'file/bag', distribution='')


@pytest.mark.parametrize(
    ('options', 'message'),
    [
        ({'compression': 'zip'}, "must be one of none, lz4, zstd, got 'zip'"),
        ({'max_size': -1}, 'max_size must be .* not negative, got -1'),
        ({'max_duration': -0.5}, r'max_duration must be .* got -0\.5'),
        ({'max_duration': float('nan')}, 'max_duration must be .* got nan'),
    ],
)
def test_wrong_option_is_quoted(tmp_path, options, message):
    with pytest.raises(BagError, match=message):
        BagWriter(tmp_path / 'bag', distribution='', **options)
    assert not (tmp_path / 'bag').exists()


# What is kept when


@pytest.mark.parametrize('sync', [False, True])
def test_all_before_a_flush_can_be_read_by_others_at_once(recording, sync):
    messages = recording.make(500)
    with BagWriter(recording.folder, distribution='jazzy', sync=sync) as writer:
        for number, message in enumerate(messages):
            writer.write(message)
            if number % 50 == 49:
                writer.flush()
                with BagReader(recording.folder) as bag:
                    found = recording.content(bag.messages())
                    assert found == recording.content(messages[: number + 1])
                    assert bag.distribution == 'jazzy'
                    assert 'bag: the bag is being written' in bag.damage
                    assert 'bag_0.mcap: the file has no end' in str(bag.gaps[1])
                assert sum(writer.counts.values()) == number + 1
    assert recording.content(read(recording.folder).messages) == recording.content(messages)


def test_sync_waits_for_the_disk(tmp_path, monkeypatch):
    synced = []
    monkeypatch.setattr(os, 'fsync', lambda descriptor: synced.append(os.fstat(descriptor).st_ino))
    with BagWriter(tmp_path / 'bag', distribution='', sync=True) as writer:
        writer.write(plain(0))
        writer.flush()
        assert synced[-1] == (tmp_path / 'bag/bag_0.mcap').stat().st_ino
    assert synced[-1] == (tmp_path / 'bag/metadata.yaml').stat().st_ino
    assert (tmp_path / 'bag').stat().st_ino in synced


def test_full_disk_is_named_once_and_what_came_before_is_kept(tmp_path):
    writer = BagWriter(tmp_path / 'bag', distribution='', compression='none')
    writer.write(plain(0))
    writer.flush()
    messages = map(plain, itertools.count(1))
    with largest_file(10**6), pytest.raises(BagError, match=r'bag_0\.mcap: File too large'):
        write_all(writer, messages)
    kept = sum(writer.counts.values())
    number = next(messages).sequence
    assert 6000 < kept < number
    # The one that could not be written is lost, and so are those that waited with it
    assert writer.lost == {PLAIN: number - kept}
    with pytest.raises(BagError, match='File too large'):
        writer.write(plain(number))
    with pytest.raises(BagError, match='File too large'):
        writer.add_metadata('losses', {})
    assert writer.lost == {PLAIN: number - kept + 1}
    writer.close()
    writer.close()
    with BagReader(tmp_path / 'bag') as bag:
        assert numbers(bag.messages()) == list(range(kept))
        assert bag.gaps[0][2:4] == (0, 'the file has no end')  # it ends after a whole record
    assert information(tmp_path / 'bag')['message_count'] == kept


def test_writing_goes_on_in_a_next_file_when_there_is_room_again(tmp_path):
    writer = BagWriter(tmp_path / 'bag', distribution='')
    writer.attach('file', b'content', 'text/plain')
    with largest_file(10**4):
        with pytest.raises(BagError, match='File too large'):
            write_all(writer, map(noise, itertools.count()))
        with pytest.raises(BagError, match='File too large'):
            writer.add_metadata('while it was full', {'key': 'value'})
    writer.flush()
    writer.write(plain(10**6))
    writer.close()
    with BagReader(tmp_path / 'bag') as bag:
        assert numbers(bag.messages())[-1] == 10**6
    part = read(tmp_path / 'bag/bag_1.mcap')
    assert numbers(part.messages) == [10**6]
    assert [record.name for record in part.metadata] == ['while it was full']
    assert [record.data for record in part.attachments] == [b'content']


@pytest.mark.parametrize('size', [10, 60, 300])
def test_disk_that_is_full_at_once_leaves_nothing_behind(tmp_path, size):
    with largest_file(size), pytest.raises(BagError, match='File too large'):
        BagWriter(tmp_path / 'bag', distribution='')
    assert list(tmp_path.iterdir()) == []


def test_disk_that_is_full_at_the_end_is_named_by_close(tmp_path):
    writer = BagWriter(tmp_path / 'bag', distribution='')
    writer.write(Message(PLAIN, os.urandom(10**5), 0, 0))
    with largest_file(10**4), pytest.raises(BagError, match='File too large'):
        writer.close()
    writer.close()
    assert not is_being_written(tmp_path / 'bag')
    for call in (writer.flush, writer.split, lambda: writer.write(plain(1))):
        with pytest.raises(BagError, match='bag is closed'):
            call()
    assert writer.lost == {PLAIN: 2}


# Messages


def test_messages_of_every_size_are_kept(tmp_path):
    sizes = [8, 9, 10**3, CHUNK_SIZE - 31, CHUNK_SIZE, CHUNK_SIZE + 1, 3 * 10**6, 100]
    messages = [plain(number, size=size) for number, size in enumerate(sizes)]
    messages.append(Message(PLAIN, b'', 99, 99, 99))
    with BagWriter(tmp_path / 'bag', distribution='') as writer:
        for message in messages:
            writer.write(message)
    assert [message[1:] for message in read(tmp_path / 'bag').messages] == [
        message[1:] for message in messages
    ]


def test_times_and_numbers_are_kept_up_to_the_largest(tmp_path):
    latest = 2**63 - 1
    messages = [
        Message(PLAIN, b'', 0, latest, 2**32 - 1),
        Message(PLAIN, b'', latest, 0, 2**32 + 5),
    ]
    with BagWriter(tmp_path / 'bag', distribution='', max_duration=1e9) as writer:
        for message in messages:
            writer.write(message)
    bag = read(tmp_path / 'bag')
    assert [message[2:] for message in bag.messages] == [(0, latest, 2**32 - 1), (latest, 0, 5)]
    assert bag.span == (0, latest)
    with RosbagsReader(tmp_path / 'bag') as theirs:
        assert (theirs.message_count, theirs.start_time) == (2, 0)


@pytest.mark.parametrize('times', [(-1, 0), (0, -1), (2**63, 0), (0, 2**64)])
def test_time_that_is_none_is_quoted_and_nothing_is_written(tmp_path, times):
    with BagWriter(tmp_path / 'bag', distribution='') as writer:
        writer.write(plain(0))
        with pytest.raises(BagError, match=f'/plain: times .*, got {times[0]} and {times[1]}'):
            writer.write(Message(PLAIN, b'', *times))
        writer.write(plain(1))
    assert numbers(read(tmp_path / 'bag').messages) == [0, 1]


def test_bag_without_messages_is_one(tmp_path, rerun):
    with BagWriter(tmp_path / 'bag', distribution='kilted') as writer:
        writer.add_channel(PLAIN)
    bag = read(tmp_path / 'bag')
    assert (bag.messages, bag.counts, bag.span) == ([], [0], (0, 0))
    assert [channel.topic for channel in bag.channels] == ['/plain']
    with RosbagsReader(tmp_path / 'bag') as theirs:
        assert (theirs.message_count, theirs.duration) == (0, 0)
        assert [connection.msgcount for connection in theirs.connections] == [0]
    rerun('mcap', 'check', tmp_path / 'bag/bag_0.mcap')


def test_channels_that_are_alike_are_one_when_read_and_others_are_not(tmp_path):
    def channel(**qos):
        return Channel(topic='/a', type='t/msg/T', schema='int8 x', qos=(Qos(**qos),))

    # As if publishers went, came back, and one of them were another
    given_channels = [channel(), channel(), channel(depth=1)]
    with BagWriter(tmp_path / 'bag', distribution='') as writer:
        for number, item in enumerate(given_channels):
            writer.write(Message(item, b'', number, number, number))
    bag = read(tmp_path / 'bag')
    assert [channel.qos for channel in bag.channels] == [(Qos(),), (Qos(depth=1),)]
    assert [bag.channels.index(message.channel) for message in bag.messages] == [0, 0, 1]
    assert bag.counts == [2, 1]


def test_schema_encoding_of_others_is_kept(tmp_path):
    channel = Channel(topic='/a', type='t/msg/T', schema='IDL: ä', schema_encoding='ros2idl')
    with BagWriter(tmp_path / 'bag', distribution='') as writer:
        writer.write(Message(channel, b'', 0, 0))
    (found,) = read(tmp_path / 'bag').channels
    assert (found.schema, found.schema_encoding) == ('IDL: ä', 'ros2idl')


# Reading in order


@given(
    times=st.lists(st.integers(0, 30), max_size=60),
    cuts=st.sets(st.integers(0, 60)),
    span=st.tuples(st.integers(-5, 35), st.integers(-5, 35)),
    topics=st.sampled_from([None, '/even', ['/odd'], ('/even', '/odd'), [], ['/missing']]),
)
def test_messages_come_by_time_and_equal_ones_as_written(
    tmp_path_factory, times, cuts, span, topics
):
    channels = [
        Channel(topic=topic, type='t/msg/T', schema='int8 x') for topic in ('/even', '/odd')
    ]
    messages = [
        Message(channels[number % 2], b'', time, 0, number) for number, time in enumerate(times)
    ]
    folder = tmp_path_factory.mktemp('order') / 'bag'
    with BagWriter(folder, distribution='') as writer:
        for message in messages:
            if message.sequence in cuts:  # a chunk, or a file, ends
                writer.flush() if message.sequence % 2 else writer.split()
            writer.write(message)
    expected = [message[2:] for message in sorted(messages, key=lambda message: message.log_time)]
    start, end = span
    wanted = [topics] if isinstance(topics, str) else topics
    with BagReader(folder) as bag, BagReader(folder, by_scan=True) as scanned:
        for reader in (bag, scanned):
            assert [message[2:] for message in reader.messages()] == expected
            assert [message[2:] for message in reader.messages(topics, start, end)] == [
                message[2:]
                for message in sorted(messages, key=lambda message: message.log_time)
                if (wanted is None or message.channel.topic in wanted)
                and start <= message.log_time < end
            ]
            assert reader.damage == ''


@pytest.mark.parametrize('by_scan', [False, True])
def test_large_bag_is_read_in_little_memory(tmp_path, by_scan):
    with BagWriter(tmp_path / 'bag', distribution='') as writer:
        for number in range(4000):
            writer.write(plain(number, size=20_000))
    tracemalloc.start()
    try:
        with BagReader(tmp_path / 'bag', by_scan=by_scan) as bag:
            assert sum(len(message.data) for message in bag.messages()) == 80_000_000
        _, peak = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert peak < 10 * CHUNK_SIZE


# Bags of others


THEIR_BAGS = [
    *itertools.product([8, 9], [None]),
    *itertools.product([9], [CompressionMode.FILE, CompressionMode.MESSAGE]),
    (9, CompressionMode.STORAGE),
]


@pytest.mark.parametrize(('version', 'mode'), THEIR_BAGS)
def test_bag_of_rosbags_is_read(recording, tmp_path, version, mode):
    messages = recording.make(300)
    profiles = parse_qos(to_yaml([Qos(depth=7, reliability='best_effort')]))
    bag = RosbagsWriter(tmp_path / 'theirs', version=version, storage_plugin=StoragePlugin.MCAP)
    if mode is not None:
        bag.set_compression(mode, CompressionFormat.ZSTD)
    with bag:
        connections = {
            channel: bag.add_connection(
                channel.topic, channel.type, typestore=TYPES, offered_qos_profiles=profiles
            )
            for channel in (recording.states, recording.texts)
        }
        for message in messages:
            bag.write(connections[message.channel], message.log_time, message.data)
    for options in ({}, {'by_scan': True}):
        ours = read(tmp_path / 'theirs', **options)
        assert [
            (message.channel.topic, message.data, message.log_time) for message in ours.messages
        ] == [(message.channel.topic, message.data, message.log_time) for message in messages]
        assert [channel.type for channel in ours.channels] == [
            'sensor_msgs/msg/JointState', 'std_msgs/msg/String',
        ]  # fmt: skip
        assert {channel.qos for channel in ours.channels} == {
            (Qos(depth=7, reliability='best_effort'),)
        }
        assert ours.counts == [300, 3]
    if mode is CompressionMode.FILE:
        (path,) = (tmp_path / 'theirs').glob('*.mcap.zstd')
        assert len(read(path).messages) == len(messages)


@pytest.mark.parametrize('chunked', [True, False])
@pytest.mark.parametrize('index_types', [IndexType.ALL, IndexType.NONE, IndexType.CHUNK])
@pytest.mark.parametrize('statistics', [True, False])
@pytest.mark.parametrize('repeated', [True, False])
def test_mcap_with_any_index_is_read(tmp_path, chunked, index_types, statistics, repeated):
    times = [3, 1, 2, 2, 5, 4, 0, 9, 8, 7] * 40
    with (tmp_path / 'theirs.mcap').open('wb') as file:
        writer = Writer(
            file,
            chunk_size=1000,
            compression=CompressionType.LZ4,
            index_types=index_types,
            use_chunking=chunked,
            use_statistics=statistics,
            repeat_channels=repeated,
            repeat_schemas=repeated,
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
    bag = read(tmp_path / 'theirs.mcap')
    assert [(message.log_time, message.sequence) for message in bag.messages] == sorted(
        (time, number) for number, time in enumerate(times)
    )
    assert bag.span == (0, 9)
    assert bag.metadata == [Metadata(name='name', metadata={'key': 'value'})]
    assert [record.data for record in bag.attachments] == [b'content']


def cut(text):
    return text[:300]


def rename(text):
    return text.replace('bag_3.mcap', 'bag_x.mcap')


@pytest.mark.parametrize(
    ('damaged', 'reason'),
    [
        (None, 'metadata.yaml: the file is missing'),
        (cut, 'metadata.yaml: the file does not describe a bag'),
        ('rosbag2_bagfile_information: [', 'metadata.yaml: the file cannot be read, '),
        ('rosbag2_bagfile_information: 7', 'metadata.yaml: the file does not describe a bag'),
        ('- 1', 'metadata.yaml: the file cannot be read, '),
        ('[' * 1000, 'metadata.yaml: the file cannot be read, '),
        ('#' * 2**21, 'metadata.yaml: the file cannot be read, '),
        ('\0', 'metadata.yaml: the file cannot be read, '),
        (rename, 'bag_x.mcap: the file is missing'),
    ],
)
def test_folder_without_its_metadata_is_read_and_says_so(recording, damaged, reason):
    recording.write(2000, max_duration=0.15)
    assert len(recording.files) > 10  # so that names are not in the order of the alphabet
    path = recording.folder / 'metadata.yaml'
    text = path.read_text()
    path.unlink()
    if damaged is not None:
        path.write_text(damaged(text) if callable(damaged) else damaged)
    with BagReader(recording.folder) as bag:
        assert recording.content(bag.messages()) == recording.content(recording.messages)
        assert reason in bag.damage


def test_file_that_a_folder_does_not_list_is_left_out(recording):
    recording.write(300)
    (recording.folder / 'bag_1.mcap').write_bytes(b'something else')
    assert len(read(recording.folder).messages) == len(recording.messages)


def test_bag_in_sqlite_is_named_with_what_converts_it(tmp_path):
    with RosbagsWriter(tmp_path / 'bag', version=9) as bag:
        connection = bag.add_connection('/a', 'std_msgs/msg/String', typestore=TYPES)
        bag.write(connection, 7, b'')
    for path in (tmp_path / 'bag', tmp_path / 'bag/bag.db3'):
        with pytest.raises(BagError, match='is a bag in sqlite3, not in MCAP; convert it'):
            BagReader(path)
    (tmp_path / 'bag/metadata.yaml').unlink()
    with pytest.raises(BagError, match='is a bag in sqlite3'):
        BagReader(tmp_path / 'bag')


@pytest.mark.parametrize(
    ('content', 'reason'),
    [
        (b'', 'is empty'),
        (b'#ROSBAG V2.0\n', 'is a bag in ROS 1, not in MCAP; .* rosbags-convert'),
        (b'time,position\n0,1\n', 'is no MCAP file'),
        (b'\x89MCAP1\r\n', 'is no MCAP file'),
        (b'\x28\xb5\x2f\xfd', 'is empty'),  # as far as it can be decompressed
        (b'\x28\xb5\x2f\xfd' + b'\xff' * 100, 'cannot be decompressed'),
    ],
)
@pytest.mark.parametrize('in_folder', [False, True])
def test_file_that_is_no_bag_is_named_with_the_reason(tmp_path, content, reason, in_folder):
    path = tmp_path / 'bag.mcap'
    path.write_bytes(content)
    with pytest.raises(BagError, match=rf'bag\.mcap.* {reason}'):
        BagReader(tmp_path if in_folder else path)


def test_path_that_is_no_bag_is_named(tmp_path):
    os.mkfifo(tmp_path / 'pipe')
    with pytest.raises(BagError, match='pipe is no file'):
        BagReader(tmp_path / 'pipe')
    with pytest.raises(BagError, match='missing: No such file or directory'):
        BagReader(tmp_path / 'missing')
    with pytest.raises(BagError, match='is no bag, there is no MCAP file in it'):
        BagReader(tmp_path)


@pytest.mark.parametrize('encoding', ['json', 'ros1', 'protobuf', ''])
def test_messages_that_are_not_those_of_ros_are_refused(tmp_path, encoding):
    with (tmp_path / 'theirs.mcap').open('wb') as file:
        writer = Writer(file)
        writer.start()
        schema = writer.register_schema('t/T', 'jsonschema', b'{}')
        channel = writer.register_channel('/a', encoding, schema)
        writer.add_message(channel, 0, b'{}', 0)
        writer.finish()
    with pytest.raises(BagError, match=f"theirs.mcap: /a has messages in '{encoding}', not in"):
        BagReader(tmp_path / 'theirs.mcap')


# Streams


@pytest.fixture
def stream_parts(recording):
    """Make a stream: its beginning, definitions, blocks of messages, and its end."""
    messages = recording.make(1000)
    writer = StreamWriter()
    parts = [writer.start()]
    for number in range(0, len(messages), 100):
        block = messages[number : number + 100]
        parts += [writer.define(message.channel) for message in block]
        parts.append(writer.block(block))
    return [*filter(None, parts), writer.metadata('name', {'key': 'value'}), writer.end()]


def split_items(stream):
    items = list(read_stream(stream))
    messages = [item for item in items if isinstance(item, Message)]
    return messages, [item for item in items if not isinstance(item, Message)]


def test_stream_comes_out_as_it_went_in(recording, stream_parts):
    messages, others = split_items(BytesIO(b''.join(stream_parts)))
    assert recording.content(messages) == recording.content(recording.messages)
    assert others == [Metadata(name='name', metadata={'key': 'value'})]
    assert {message.channel.topic: message.channel.schema for message in messages} == {
        channel.topic: channel.schema for channel in (recording.states, recording.texts)
    }


def test_stream_is_what_mcap_reads(recording, stream_parts):
    reader = make_reader(BytesIO(b''.join(stream_parts)), decoder_factories=[DecoderFactory()])
    found = [decoded for *_, decoded in reader.iter_decoded_messages()]
    assert len(found) == len(recording.messages)


def test_parts_of_a_stream_are_whole_records(stream_parts):
    for part in stream_parts[1:-1]:
        reader = StreamReader(BytesIO(part + stream_parts[-1]), skip_magic=True)
        *records, _, _ = (type(record).__name__ for record in reader.records)
        assert set(records) <= {'Message'} or set(records) <= {'Schema', 'Channel', 'Metadata'}


@given(st.sets(st.integers(2, 13)))
def test_blocks_of_messages_may_be_left_out(dropped):
    writer = StreamWriter()
    channels = [
        Channel(topic=f'/{name}', type='t/msg/T', schema='int8 x') for name in ('a', 'b', 'c')
    ]
    stream = writer.start()
    for number in range(14):
        channel = channels[min(number // 4, 2)]
        stream += writer.define(channel)
        block = writer.block([Message(channel, b'x', number, number)] * 3)
        stream += b'' if number in dropped else block
    messages, _ = split_items(BytesIO(stream))
    assert [message.log_time for message in messages] == [
        number for number in range(14) if number not in dropped for _ in range(3)
    ]


def test_next_reader_of_a_stream_gets_all_channels(recording):
    writer = StreamWriter()
    messages = recording.make(10)
    for message in messages:
        writer.start(), writer.define(message.channel), writer.block([message])
    late, _ = split_items(BytesIO(writer.start() + writer.block(messages)))
    assert recording.content(late) == recording.content(messages)


def test_items_of_a_pipe_come_as_they_are_written(stream_parts):
    """Nothing is written before what is there already has been read."""
    source, target = os.pipe()
    blocks = iter(stream_parts)
    with os.fdopen(source, 'rb') as pipe, os.fdopen(target, 'wb', buffering=0) as out:
        out.writelines(itertools.islice(blocks, 3))  # beginning, and the two channels
        items = read_stream(pipe)
        for block in itertools.islice(blocks, 5):
            out.write(block)
            assert len(list(itertools.islice(items, 100))) == 100


def test_bag_can_be_read_as_a_stream(recording):
    recording.write(compression='lz4')
    messages, metadata = split_items(BytesIO(recording.files[0].read_bytes()))
    assert recording.content(messages) == recording.content(recording.messages)
    assert [record.name for record in metadata] == ['parameters of /twin', 'rosbag2']


def test_stream_may_end_after_any_record(recording, stream_parts):
    for number in range(1, len(stream_parts)):
        messages, _ = split_items(BytesIO(b''.join(stream_parts[:number])))
        assert (
            recording.content(messages) == recording.content(recording.messages)[: len(messages)]
        )


@pytest.mark.parametrize(
    ('damage', 'reason'),
    [
        (lambda parts: b'', 'it does not begin as MCAP does'),
        (lambda parts: b'hello', 'it does not begin as MCAP does'),
        (lambda parts: b''.join(parts)[:50_000], 'it ends within a record'),
        (lambda parts: b''.join(parts[:-1])[:-1], 'it ends within a record'),
        (lambda parts: b''.join([*parts[:5], bytes(9), *parts[5:]]), 'no record .* with 0x00'),
        (lambda parts: parts[0] + b''.join(parts[4:]), 'nothing defines channel 1'),
        (lambda parts: parts[0] + b'\5' + b'\xff' * 8, 'claims to have 18446744073709551615'),
    ],
)
def test_stream_that_breaks_off_says_so_after_what_it_gave(
    recording, stream_parts, damage, reason
):
    stream = BytesIO(damage(stream_parts))
    before = []
    with pytest.raises(BagError, match=f'standard input: .*{reason}'):
        before.extend(read_stream(stream, 'standard input'))
    assert recording.content(before) == recording.content(recording.messages[: len(before)])
