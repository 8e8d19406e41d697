# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Writing of bags: compatibility, complete files and full disks."""

from __future__ import annotations

from collections import Counter
import os
import resource
import shutil
from test.recording.conftest import largest_file, PLAIN, plain, read, TYPES

from bags import channel, profiles, saved, write
from mcap.reader import make_reader
import pytest
from rosbags.interfaces import QosDurability
from rosbags.rosbag2 import Reader as RosbagsReader
from rosbags.rosbag2.metadata import parse_qos
from soft_throw_ros.recording.bag_writer import BagWriter, CHUNK_SIZE
from soft_throw_ros.recording.recovery import recover
from soft_throw_ros.storage.bag_lock import is_being_written
from soft_throw_ros.storage.bag_reader import BagReader
from soft_throw_ros.storage.message import BagError, Channel, LATEST, Message
import yaml


def numbers(messages):
    return [message.sequence for message in messages]


def information(folder):
    return yaml.safe_load((folder / 'metadata.yaml').read_text())['rosbag2_bagfile_information']


# Compatibility with other readers


@pytest.mark.parametrize('compression', ['none', 'lz4', 'zstd'])
def test_rosbags_and_mcap_read_the_written_bag(recording, compression):
    recording.write(compression=compression)
    with RosbagsReader(recording.folder) as bag:
        result = [
            (connection.topic, time, bytes(data), TYPES.deserialize_cdr(data, connection.msgtype))
            for connection, time, data in bag.messages()
        ]
        states, texts = bag.connections
        assert (bag.message_count, bag.ros_distro) == (len(recording.messages), 'jazzy')
        first, last = recording.messages[0].log_time, recording.messages[-1].log_time
        assert (bag.start_time, bag.end_time) == (first, last + 1)
    assert [item[:3] for item in result] == [
        (message.channel.topic, message.log_time, message.data) for message in recording.messages
    ]
    assert [item[3].position[0] for item in result if item[0] == states.topic] == list(range(3000))
    assert states.digest == TYPES.hash_rihs01('sensor_msgs/msg/JointState')
    assert states.ext.offered_qos_profiles == parse_qos(recording.states.qos)
    (qos,) = texts.ext.offered_qos_profiles
    assert qos.durability is QosDurability.TRANSIENT_LOCAL
    with recording.files[0].open('rb') as file:
        reader = make_reader(file, validate_crcs=True)
        assert reader.get_header().profile == 'ros2'
        result = list(reader.iter_messages())
        metadata = {record.name: record.metadata for record in reader.iter_metadata()}
        (attachment,) = reader.iter_attachments()
        chunks = reader.get_summary().chunk_indexes
    assert [
        (channel.topic, raw.data, raw.log_time, raw.publish_time, raw.sequence)
        for _, channel, raw in result
    ] == recording.content(recording.messages)
    assert {schema.encoding for schema, *_ in result} == {'ros2msg'}
    assert metadata['parameters of /twin'] == {'gravity': '9.81', 'model': 'exact'}
    assert yaml.safe_load(metadata['rosbag2']['serialized_metadata']) == information(
        recording.folder
    )
    assert (attachment.name, attachment.data) == ('twin.yaml', b'twin:\n')
    assert all(chunk.uncompressed_size < 1.1 * CHUNK_SIZE for chunk in chunks)
    assert {chunk.compression for chunk in chunks} == {compression.replace('none', '')}


# Files


def test_every_file_of_a_bag_can_be_read_alone(recording):
    recording.write(max_duration=0.5)
    first_state = recording.messages[0].log_time
    assert [path.name for path in recording.files] == [f'bag_{number}.mcap' for number in range(6)]
    for number, path in enumerate(recording.files):
        bag = read(path)
        begin = first_state + number * 500_000_000
        assert recording.content(bag.messages) == recording.content(
            message
            for message in recording.messages
            if begin <= message.log_time < begin + 500_000_000
        )
        assert [record.name for record in bag.metadata] == ['parameters of /twin']
        assert bag.channels[0].qos == recording.states.qos
        with RosbagsReader(path) as theirs:
            assert theirs.message_count == len(bag.messages)
    whole = read(recording.folder)
    assert recording.content(whole.messages) == recording.content(recording.messages)
    assert (len(whole.channels), len(whole.metadata), len(whole.attachments)) == (2, 1, 1)


def test_file_beyond_the_size_limit_is_followed_by_another(tmp_path):
    options = {'compression': 'none', 'max_size': 10**6}
    with BagWriter(tmp_path / 'bag', distribution='', **options) as writer:
        for number in range(3000):
            writer.write(plain(number, size=1000))
    sizes = [path.stat().st_size for path in sorted(tmp_path.glob('bag/*.mcap'))]
    assert len(sizes) == 3
    assert max(sizes) < 10**6 + 2 * CHUNK_SIZE
    assert min(sizes[:-1]) > 10**6
    with RosbagsReader(tmp_path / 'bag') as theirs:
        assert sum(1 for _ in theirs.messages()) == 3000


def test_changed_metadata_are_kept_and_the_last_are_repeated(tmp_path):
    with BagWriter(tmp_path / 'bag', distribution='') as writer:
        for number in range(3):
            writer.add_metadata('parameters', {'gravity': str(number)})
            writer.write(plain(number))
        for _ in range(2):  # the second time there is nothing to split
            writer.split()
        writer.write(plain(3))
        writer.add_metadata('losses', {'/plain': '0'})
    assert len(list(tmp_path.glob('bag/*.mcap'))) == 2
    bag = read(tmp_path / 'bag')
    assert [record.metadata for record in bag.metadata] == [
        {'gravity': '0'}, {'gravity': '1'}, {'gravity': '2'}, {'/plain': '0'},
    ]
    bag = read(tmp_path / 'bag/bag_1.mcap')
    assert [record.metadata for record in bag.metadata] == [{'gravity': '2'}, {'/plain': '0'}]


def test_equal_profiles_are_written_without_aliases(tmp_path):
    assert '*' not in profiles({'depth': 3}, {'depth': 3})
    topics = [channel(f'/talk{number}', depth=7) for number in range(3)]
    path = write(tmp_path / 'bag', [Message(topic, b'', 1, 1) for topic in topics])
    assert '*' not in (path / 'metadata.yaml').read_text()


def test_bag_is_locked_and_never_overwritten(tmp_path):
    (tmp_path / 'file').touch()
    with BagWriter(tmp_path / 'bag', distribution='') as writer:
        writer.write(plain(0))
        for name in ('bag', 'file'):
            with pytest.raises(BagError, match=f'{name} exists'):
                BagWriter(tmp_path / name, distribution='')
        assert is_being_written(tmp_path / 'bag')
        assert is_being_written(tmp_path / 'bag/bag_0.mcap')
    assert not is_being_written(tmp_path / 'bag')
    assert not is_being_written(tmp_path / 'missing')
    assert numbers(read(tmp_path / 'bag').messages) == [0]
    with pytest.raises(BagError, match='file/bag: Not a directory'):
        BagWriter(tmp_path / 'file/bag', distribution='')


# Flushes and faults


@pytest.mark.parametrize('sync', [False, True])
def test_messages_before_a_flush_are_readable_at_once(recording, sync):
    messages = recording.make(500)
    with BagWriter(recording.folder, distribution='jazzy', sync=sync) as writer:
        for number, message in enumerate(messages):
            writer.write(message)
            if number % 50 == 49:
                writer.flush()
                assert saved(recording.folder) == recording.content(messages[: number + 1])
                with pytest.raises(BagError, match='being written'):
                    BagReader(recording.folder)
                assert sum(writer.counts.values()) == number + 1
    assert recording.content(read(recording.folder).messages) == recording.content(messages)


@pytest.mark.parametrize('max_size', [0, 300_000])
def test_full_disk_is_named_and_loses_nothing_if_space_is_freed(tmp_path, max_size):
    reasons = []

    def wait(reason):
        reasons.append(reason)
        if len(reasons) == 3:
            resource.setrlimit(resource.RLIMIT_FSIZE, [resource.RLIM_INFINITY] * 2)
        return True

    writer = BagWriter(tmp_path / 'bag', distribution='', compression='none', max_size=max_size)
    writer.wait_for_disk = wait
    writer.attach('file', b'content', 'text/plain')
    with largest_file(200_000):
        for number in range(5000):
            writer.write(plain(number, size=1000))
        writer.add_metadata('name', {'key': 'value'})
        writer.close()
    assert len(reasons) == 3
    assert all('bag_0.mcap: File too large' in reason for reason in reasons)
    assert (writer.counts, writer.lost) == (Counter({PLAIN: 5000}), Counter())
    bag = read(tmp_path / 'bag')
    assert numbers(bag.messages) == list(range(5000))
    assert [record.name for record in bag.metadata] == ['name']
    assert (len(list(tmp_path.glob('bag/*.mcap'))) > 5) == (max_size > 0)
    with RosbagsReader(tmp_path / 'bag') as theirs:
        assert theirs.message_count == 5000


def test_disk_full_at_the_end_is_named_by_close_and_keeps_flushed_messages(tmp_path):
    writer = BagWriter(tmp_path / 'bag', distribution='')
    for number in range(3):
        writer.write(plain(number))
    writer.flush()
    writer.write(Message(PLAIN, os.urandom(10**5), 3, 3))
    with largest_file(10**4), pytest.raises(BagError, match='File too large'):
        writer.close()
    writer.close()
    assert not is_being_written(tmp_path / 'bag')
    assert (writer.counts, writer.lost) == (Counter({PLAIN: 3}), Counter({PLAIN: 1}))
    recovery = recover(tmp_path / 'bag', tmp_path / 'recovered')
    assert numbers(read(recovery.target).messages) == [0, 1, 2]
    assert len(recovery.omitted) == 1  # a part of a record
    for call in (writer.flush, writer.split, lambda: writer.write(plain(1))):
        with pytest.raises(BagError, match='bag is closed'):
            call()


@pytest.mark.parametrize('size', [10, 300])
def test_disk_that_is_full_at_once_leaves_nothing_behind(tmp_path, size):
    with largest_file(size), pytest.raises(BagError, match='File too large'):
        BagWriter(tmp_path / 'bag', distribution='')
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize('files', [1, 3])
def test_bag_deleted_during_recording_is_named_and_counted_as_lost(tmp_path, files):
    writer = BagWriter(tmp_path / 'bag', distribution='')
    for number in range(45):
        writer.write(plain(number))
        if number < 10 * (files - 1) and number % 10 == 4:
            writer.split()
    writer.flush()
    shutil.rmtree(tmp_path / 'bag')
    for call in (writer.flush, writer.flush, writer.close):
        with pytest.raises(BagError, match=r'bag_\d\.mcap: .*deleted'):
            call()
        assert (writer.counts, writer.lost) == (Counter(), Counter({PLAIN: 45}))
    assert list(tmp_path.iterdir()) == []


# Messages


def test_messages_of_every_size_time_and_number_are_kept(tmp_path):
    sizes = [8, 9, CHUNK_SIZE - 31, CHUNK_SIZE, CHUNK_SIZE + 1, 3 * 10**6]
    messages = [plain(number, size=size) for number, size in enumerate(sizes)]
    messages += [Message(PLAIN, b'', 99, LATEST, 2**32 - 1), Message(PLAIN, b'', LATEST, 0, 5)]
    with BagWriter(tmp_path / 'bag', distribution='', max_duration=1e10) as writer:
        for message in messages:
            writer.write(message)
        for times in ((-1, 0), (0, -1), (2**63, 0), (0, 2**64)):
            with pytest.raises(ValueError, match=f'/plain: .* got {times[0]} and {times[1]}'):
                writer.write(Message(PLAIN, b'', *times))
    bag = read(tmp_path / 'bag')
    assert [message[1:] for message in bag.messages] == [message[1:] for message in messages]
    assert bag.span == (0, LATEST)
    with RosbagsReader(tmp_path / 'bag') as theirs:
        assert (theirs.message_count, theirs.start_time) == (len(messages), 0)


def test_bag_without_messages_is_valid(tmp_path):
    BagWriter(tmp_path / 'bag', distribution='kilted').close()
    bag = read(tmp_path / 'bag')
    assert (bag.messages, bag.counts, bag.span) == ([], [], (0, 0))
    with RosbagsReader(tmp_path / 'bag') as theirs:
        assert theirs.message_count == 0


def test_equal_channels_are_merged_when_read(tmp_path):
    def channel(**qos):
        return Channel(topic='/a', type='t/msg/T', schema='IDL: ä', schema_encoding='ros2idl',
                       qos=profiles(qos))

    # Publishers that restart, the last with another quality of service
    given_channels = [channel(), channel(), channel(depth=1)]
    with BagWriter(tmp_path / 'bag', distribution='') as writer:
        for number, item in enumerate(given_channels):
            writer.write(Message(item, b'', number, number, number))
    bag = read(tmp_path / 'bag')
    assert [channel.qos for channel in bag.channels] == [profiles({}), profiles({'depth': 1})]
    assert {(item.schema, item.schema_encoding) for item in bag.channels} == {
        ('IDL: ä', 'ros2idl')
    }
    assert [bag.channels.index(message.channel) for message in bag.messages] == [0, 0, 1]
    assert bag.counts == [2, 1]
