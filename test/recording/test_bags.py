# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Bags written by us and by others, whole, cut off and damaged; other programs read ours."""

from __future__ import annotations

import contextlib
import os
from pathlib import Path
import shutil
import subprocess
import sys
from test.recording.conftest import content, information, largest_file, PLAIN, plain, read, TYPES
import tracemalloc

from bags import profiles, saved, write
from damage import accepted, datas, few
from hypothesis import given, settings
from hypothesis import strategies as st
from mcap.reader import make_reader
from mcap.writer import CompressionType, IndexType, Writer
import pytest
from rosbags.interfaces import QosDurability
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin
from rosbags.rosbag2 import Reader as RosbagsReader
from rosbags.rosbag2 import Writer as RosbagsWriter
from rosbags.rosbag2.metadata import parse_qos
from soft_throw_ros.commands.recover import main as recover_bag
from soft_throw_ros.recording.bag_writer import BagWriter, CHUNK_SIZE
from soft_throw_ros.recording.recovery import recover
from soft_throw_ros.storage import mcap_records
from soft_throw_ros.storage.bag_lock import is_being_written
from soft_throw_ros.storage.bag_reader import BagReader, UnfinishedError
from soft_throw_ros.storage.message import BagError, Channel, LATEST, Message
import yaml

ROOT = Path(__file__).parents[2]
CHANNELS = [
    Channel(topic='/even', type='t/msg/T', schema='int8 x'),
    Channel(topic='/odd', type='t/msg/T', schema='int8 x', qos=profiles({'depth': 1})),
]


def read_by_others(folder):
    """Return topics, times and data of a bag as rosbags reads them, and mcap as well."""
    with RosbagsReader(folder) as bag:
        rows = [(item.topic, time, bytes(data)) for item, time, data in bag.messages()]
        assert bag.message_count == len(rows)
    theirs = []
    for path in sorted(folder.glob('*.mcap'), key=lambda path: (len(path.name), path.name)):
        with path.open('rb') as file:
            for _, topic, message in make_reader(file, validate_crcs=True).iter_messages():
                theirs.append((topic.topic, message.log_time, message.data))
    assert sorted(theirs) == sorted(rows)
    return sorted(rows, key=lambda row: row[1])


def chunk_ends(path):
    with path.open('rb') as file:
        index = make_reader(file).get_summary().chunk_indexes
    return [chunk.chunk_start_offset + chunk.chunk_length for chunk in index]


def flip(path, offset, bit=4):
    data = bytearray(path.read_bytes())
    data[offset] ^= bit
    path.write_bytes(data)


# The format


@settings(few, max_examples=25)
@given(
    times=st.lists(st.integers(0, 30) | st.just(LATEST), max_size=50),
    breaks=st.sets(st.integers(0, 50)),
    compression=st.sampled_from(['none', 'lz4', 'zstd']),
    sizes=st.sampled_from([(0, 20), (9, CHUNK_SIZE + 1)]),
    cut=st.floats(0.0, 1.0, exclude_max=True),
    bit=st.integers(0, 7),
)
def test_written_bag_is_read_by_all_and_recovered_up_to_its_damage(
    tmp_path_factory, times, breaks, compression, sizes, cut, bit
):
    folder = tmp_path_factory.mktemp('bag')
    messages = [
        Message(CHANNELS[number % 2], bytes([number]) * sizes[number % 2], time, time // 2, number)
        for number, time in enumerate(times)
    ]
    with BagWriter(folder / 'bag', distribution='jazzy', compression=compression) as writer:
        for message in messages:
            if message.sequence in breaks:  # a chunk, or a file, ends
                writer.split() if message.sequence % 16 == 0 else writer.flush()
            writer.write(message)
        writer.add_metadata('name', {'key': 'value'})
    by_time = sorted(messages, key=lambda message: message.log_time)
    assert read_by_others(folder / 'bag') == [
        (message.channel.topic, message.log_time, message.data) for message in by_time
    ]
    with BagReader(folder / 'bag') as reader:
        assert content(reader.messages()) == content(by_time)
        assert content(reader.messages(['/odd'])) == content(by_time, '/odd')
        assert content(reader.messages(by_log_time=False)) == content(messages)
        assert [item.metadata for item in reader.metadata] == [{'key': 'value'}]
    newest = max((folder / 'bag').glob('*.mcap'), key=lambda path: path.stat().st_mtime_ns)
    part, whole = content(read(newest).messages), newest.read_bytes()
    path = folder / 'part/part_0.mcap'
    path.parent.mkdir()
    offset = 8 + int(cut * (len(whole) - 8))
    for name in ('cut', 'flipped'):
        path.write_bytes(whole[:offset] if name == 'cut' else whole)
        if name == 'flipped':
            flip(path, offset, 1 << bit)
        with contextlib.suppress(BagError), BagReader(path) as reader:
            assert content(reader.messages()) == part  # it never errs silently
            assert name == 'flipped'
        result = []
        with contextlib.suppress(BagError):  # nothing can be recovered
            result = content(read(recover(path, folder / name).target).messages)
        if name == 'cut':  # all that mcap reads
            assert sorted(result) == sorted(saved(path.parent))
        assert set(result) <= set(part)


def test_cut_bag_gives_all_whole_chunks(recording, tmp_path):
    recording.write(900, flush_every=202)
    (path,) = recording.files
    whole, expected, ends = path.read_bytes(), content(recording.messages), chunk_ends(path)
    assert len(ends) == 5
    cuts = {end + shift for end in ends for shift in (-1, 0, 9)}
    for size in sorted(cuts | {len(whole) - size for size in (1, 9, 38)}):
        path.write_bytes(whole[:size])
        with pytest.raises(UnfinishedError, match='soft-throw recover'):
            BagReader(path)
        if count := min(202 * sum(end <= size for end in ends), len(expected)):
            recovered = recover(recording.folder, tmp_path / f'whole{size}')
            assert bool(recovered.omitted) == (size not in ends)
            assert content(read(recovered.target).messages) == expected[:count]


def test_bag_has_the_metadata_of_rosbag2(recording):
    recording.write()
    with RosbagsReader(recording.folder) as bag:
        states, texts = bag.connections
        assert bag.ros_distro == 'jazzy'
        first, last = recording.messages[0].log_time, recording.messages[-1].log_time
        assert (bag.start_time, bag.end_time) == (first, last + 1)
        decoded = [TYPES.deserialize_cdr(data, item.msgtype) for item, _, data in bag.messages()]
    assert decoded[-1].position[0] == 2999
    assert states.digest == TYPES.hash_rihs01('sensor_msgs/msg/JointState')
    assert states.ext.offered_qos_profiles == parse_qos(recording.states.qos)
    (qos,) = texts.ext.offered_qos_profiles
    assert qos.durability is QosDurability.TRANSIENT_LOCAL
    with recording.files[0].open('rb') as file:
        reader = make_reader(file)
        assert reader.get_header().profile == 'ros2'
        metadata = {record.name: record.metadata for record in reader.iter_metadata()}
        chunks = reader.get_summary().chunk_indexes
    assert yaml.safe_load(metadata['rosbag2']['serialized_metadata']) == information(
        recording.folder
    )
    assert all(chunk.uncompressed_size < 1.1 * CHUNK_SIZE for chunk in chunks)


def test_file_beyond_the_size_limit_is_followed_by_another(tmp_path):
    options = {'compression': 'none', 'max_size': 10**6}
    with BagWriter(tmp_path / 'bag', distribution='', **options) as writer:
        for number in range(3000):
            writer.write(plain(number, size=1000))
    sizes = [path.stat().st_size for path in sorted(tmp_path.glob('bag/*.mcap'))]
    assert len(sizes) == 3
    assert max(sizes) < 10**6 + 2 * CHUNK_SIZE
    assert min(sizes[:-1]) > 10**6
    assert len(read_by_others(tmp_path / 'bag')) == 3000


def test_equal_channels_are_merged_when_read(tmp_path):
    def make(**qos):
        return Channel(topic='/a', type='t/msg/T', schema='IDL: ä', schema_encoding='ros2idl',
                       qos=profiles(qos))

    # Publishers that restart, the last with another quality of service
    messages = [Message(item, b'', 1, 1) for item in (make(), make(), make(depth=1))]
    bag = read(write(tmp_path / 'bag', messages))
    assert [item.qos for item in bag.channels] == [profiles({}), profiles({'depth': 1})]
    assert {(item.schema, item.schema_encoding) for item in bag.channels} == {
        ('IDL: ä', 'ros2idl')
    }
    assert [bag.channels.index(message.channel) for message in bag.messages] == [0, 0, 1]
    assert bag.counts == [2, 1]


# Writing


@pytest.mark.parametrize('times', [(-1, 0), (0, -1), (2**63, 0), (0, 2**64)])
def test_invalid_time_is_refused_with_its_value(tmp_path, times):
    with (
        BagWriter(tmp_path / 'bag', distribution='') as writer,
        pytest.raises(ValueError, match=f'/plain: .* got {times[0]} and {times[1]}'),
    ):
        writer.write(Message(PLAIN, b'', *times))


def test_bag_is_locked_and_never_overwritten(tmp_path):
    (tmp_path / 'file').touch()
    with BagWriter(tmp_path / 'bag', distribution='') as writer:
        writer.write(plain(0))
        for name in ('bag', 'file'):
            with pytest.raises(BagError, match=f'{name} exists'):
                BagWriter(tmp_path / name, distribution='')
        for path in (tmp_path / 'bag', tmp_path / 'bag/bag_0.mcap'):
            assert is_being_written(path)
            with pytest.raises(BagError, match='being written'):
                recover(path, tmp_path / 'whole')
    assert not is_being_written(tmp_path / 'bag')
    assert not is_being_written(tmp_path / 'missing')
    assert len(read(tmp_path / 'bag').messages) == 1
    with pytest.raises(BagError, match='file/bag: Not a directory'):
        BagWriter(tmp_path / 'file/bag', distribution='')


@pytest.mark.parametrize('sync', [False, True])
def test_messages_before_a_flush_are_readable_at_once(recording, sync):
    messages = recording.make(500)
    with BagWriter(recording.folder, distribution='jazzy', sync=sync) as writer:
        for number, message in enumerate(messages):
            writer.write(message)
            if number % 50 == 49:
                writer.flush()
                assert saved(recording.folder) == content(messages[: number + 1])
                with pytest.raises(BagError, match='being written'):
                    BagReader(recording.folder)
                assert sum(writer.counts.values()) == number + 1


@pytest.mark.parametrize('max_size', [0, 300_000])
def test_full_disk_is_named_and_loses_nothing_if_space_is_freed(tmp_path, max_size):
    reasons = []
    writer = BagWriter(tmp_path / 'bag', distribution='', compression='none', max_size=max_size)
    with contextlib.ExitStack() as stack:
        stack.enter_context(largest_file(200_000))

        def wait(reason):
            reasons.append(reason)
            if len(reasons) == 3:
                stack.close()
            return True

        writer.wait_for_disk = wait
        for number in range(5000):
            writer.write(plain(number, size=1000))
        writer.add_metadata('name', {'key': 'value'})
        writer.close()
    assert len(reasons) == 3
    assert all('bag_0.mcap: File too large' in reason for reason in reasons)
    assert (writer.counts, writer.lost) == ({PLAIN: 5000}, {})
    bag = read(tmp_path / 'bag')
    assert [message.sequence for message in bag.messages] == list(range(5000))
    assert (len(list(tmp_path.glob('bag/*.mcap'))) > 5) == (max_size > 0)
    assert len(read_by_others(tmp_path / 'bag')) == 5000


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
    assert (writer.counts, writer.lost) == ({PLAIN: 3}, {PLAIN: 1})
    recovery = recover(tmp_path / 'bag', tmp_path / 'recovered')
    assert len(read(recovery.target).messages) == 3
    assert len(recovery.omitted) == 1  # a part of a record
    for call in (writer.flush, writer.split, lambda: writer.write(plain(1))):
        with pytest.raises(BagError, match='bag is closed'):
            call()


def test_disk_that_is_full_at_once_leaves_nothing_behind(recording, tmp_path):
    for size in (10, 300):
        with largest_file(size), pytest.raises(BagError, match='File too large'):
            BagWriter(tmp_path / 'full', distribution='')
    recording.write(2000, compression='none')
    with largest_file(5000), pytest.raises(BagError, match='File too large'):
        recover(recording.folder, tmp_path / 'full')
    assert not (tmp_path / 'full').exists()


def test_deleted_bag_is_named_at_the_end(tmp_path):
    writer = BagWriter(tmp_path / 'bag', distribution='')
    writer.write(plain(0))
    shutil.rmtree(tmp_path / 'bag')
    with pytest.raises(BagError, match=r'metadata\.yaml: No such file'):
        writer.close()
    assert list(tmp_path.iterdir()) == []


KILLED = """
import mmap, os, random, signal, sys, time
from pathlib import Path
from soft_throw_ros.recording.bag_writer import BagWriter
from soft_throw_ros.storage.message import Channel, Message

texts = Channel(topic='/text', type='std_msgs/msg/String', schema='string data')
text = b'\\0\\1\\0\\0' + (1000).to_bytes(4, 'little') + b'x' * 999 + b'\\0'
flushed = mmap.mmap(-1, 8)  # shared with the process that is killed


def write_for_ever(path, compression):
    with BagWriter(path, distribution='jazzy', compression=compression, max_size=10**6) as writer:
        for step in range(10**9):
            writer.write(Message(texts, text, step, step, step))
            if step % 97 == 96:
                writer.flush()
                flushed[:] = (step + 1).to_bytes(8, 'little')


random.seed(7)
for number in range(15):
    flushed[:] = bytes(8)
    child = os.fork()
    if not child:
        try:
            write_for_ever(Path(sys.argv[1]) / f'bag{number}', ('none', 'lz4', 'zstd')[number % 3])
        finally:
            os._exit(1)
    while not any(flushed[:]):
        time.sleep(0.001)
    time.sleep(random.uniform(0.0, 0.06))
    os.kill(child, signal.SIGKILL)
    assert os.WIFSIGNALED(os.waitpid(child, 0)[1])
    print(int.from_bytes(flushed[:], 'little'))
"""


def test_killed_process_loses_only_messages_after_its_last_flush(tmp_path, rerun):
    killed = subprocess.run(
        [sys.executable, '-c', KILLED, str(tmp_path)],
        stdout=subprocess.PIPE,
        check=True,
        cwd=ROOT,
        timeout=100,
    )
    for number, count in enumerate(map(int, killed.stdout.split())):
        bag, target = tmp_path / f'bag{number}', tmp_path / f'whole{number}'
        assert (bag / 'metadata.yaml').exists()
        recovered = recover(bag, target)
        steps = [time for _, time, _ in read_by_others(target)]
        assert steps == list(range(recovered.message_count))
        assert len(steps) >= count
    for path in sorted(target.glob('*.mcap')):
        rerun('mcap', 'check', path)


# Bags of others


@pytest.mark.parametrize(
    ('version', 'mode'),
    [(8, None), (9, None), (9, CompressionMode.STORAGE)],
)
def test_bag_of_rosbags_is_read(recording, tmp_path, version, mode):
    messages = recording.make(300)
    offered = parse_qos(profiles({'depth': 7, 'reliability': 'best_effort'}))
    bag = RosbagsWriter(tmp_path / 'theirs', version=version, storage_plugin=StoragePlugin.MCAP)
    if mode is not None:
        bag.set_compression(mode, CompressionFormat.ZSTD)
    with bag:
        connections = {
            item: bag.add_connection(
                item.topic, item.type, typestore=TYPES, offered_qos_profiles=offered
            )
            for item in (recording.states, recording.texts)
        }
        for message in messages:
            bag.write(connections[message.channel], message.log_time, message.data)
    recover(tmp_path / 'theirs', tmp_path / 'recovered')
    for name in ('theirs', 'recovered'):
        ours = read(tmp_path / name)
        assert [(item.channel.topic, item.data, item.log_time) for item in ours.messages] == [
            (item.channel.topic, item.data, item.log_time) for item in messages
        ]
        assert [item.type for item in ours.channels] == [item.type for item in connections]
        assert all(parse_qos(item.qos) == offered for item in ours.channels)
        assert ours.counts == [300, 3]


@pytest.mark.parametrize('chunked', [True, False])
@pytest.mark.parametrize('index_types', [IndexType.ALL, IndexType.NONE, IndexType.CHUNK])
@pytest.mark.parametrize('has_statistics', [True, False])
def test_mcap_with_any_index_or_none_is_read_and_recovered(
    tmp_path, chunked, index_types, has_statistics
):
    times = [3, 1, 2, 2, 5, 4, 0, 9, 8, 7] * 40
    path = tmp_path / 'theirs.mcap'
    with path.open('wb') as file:
        writer = Writer(
            file,
            chunk_size=1000,
            compression=CompressionType.LZ4,
            index_types=index_types,
            use_chunking=chunked,
            use_statistics=has_statistics,
        )
        writer.start()
        file.write(b'\x80' + (3).to_bytes(8, 'little') + b'abc')  # a private record
        number = writer.register_channel(
            '/a', 'cdr', writer.register_schema('t/msg/T', 'ros2msg', b'int8 x')
        )
        for sequence, time in enumerate(times):
            writer.add_message(number, time, bytes([sequence % 256]), time, sequence)
        writer.add_metadata('name', {'key': 'value'})
        writer.finish()
    rows = sorted((time, sequence) for sequence, time in enumerate(times))
    for bag in (read(path), read(recover(path, tmp_path / 'recovered').target)):
        assert [(item.log_time, item.sequence) for item in bag.messages] == rows
        assert bag.span == (0, 9)
    assert [item.metadata for item in bag.metadata] == [{'key': 'value'}]


@pytest.mark.parametrize(
    'damage',
    [None, lambda text: text[:300], lambda _: 'rosbag2_bagfile_information: [',
     lambda _: '[' * 1000, lambda text: f'{text}# {"x" * 2**20}'],
)
def test_bag_is_read_without_its_metadata_but_not_without_a_file(recording, tmp_path, damage):
    recording.write(2000, max_duration=0.15)
    assert len(recording.files) > 10  # so that names are not in the order of the alphabet
    path = recording.folder / 'metadata.yaml'
    text = path.read_text()
    path.unlink()
    if damage is not None:
        path.write_text(damage(text))
    assert content(read(recording.folder).messages) == content(recording.messages)
    path.write_text(text)
    (recording.folder / 'bag_3.mcap').write_bytes(b'')
    (recording.folder / 'bag_5.mcap').unlink()
    with pytest.raises(UnfinishedError, match=r'bag_5\.mcap.*soft-throw recover'):
        BagReader(recording.folder)
    recovered = recover(recording.folder, tmp_path / 'whole')
    assert ['bag_5' in recovered.omitted[0], 'bag_3' in recovered.omitted[1]] == [True] * 2
    assert recovered.message_count == len(recording.messages) - 2 * 151


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
    ('data', 'reason'),
    [
        (b'', 'empty'),
        (b'#ROSBAG V2.0\n', 'ROS 1.*rosbags-convert'),
        (b'time,position\n0,1\n', 'no MCAP file'),
        (b'\x28\xb5\x2f\xfd' + b'\xff' * 100, 'compressed.*rosbags-convert'),
    ],
)
@pytest.mark.parametrize('in_folder', [False, True])
def test_file_that_is_no_bag_is_refused_with_a_reason(tmp_path, data, reason, in_folder):
    path = tmp_path / 'bag.mcap'
    path.write_bytes(data)
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


# Damage


def test_damaged_index_is_refused(recording):
    recording.write(10)
    (path,) = recording.files
    flip(path, path.read_bytes().rindex(b'/twin/journal') + 1)
    with pytest.raises(UnfinishedError, match='checksum of its index'):
        BagReader(path)


def test_bag_is_read_up_to_the_first_damaged_chunk_and_recovered_file_by_file(
    recording, tmp_path
):
    recording.write(900, max_duration=0.3)
    before = {path: path.read_bytes() for path in recording.folder.iterdir()}
    flip(recording.files[1], before[recording.files[1]].index(b'zstd') + 100)
    messages = []
    with BagReader(recording.folder) as bag, pytest.raises(UnfinishedError, match='chunk'):
        messages.extend(bag.messages())  # up to the error
    assert content(messages) == content(recording.messages[:303])
    recovered = recover(recording.folder, tmp_path / 'whole')
    assert recovered.message_count == 606
    (omitted,) = recovered.omitted
    assert str(recording.files[1]) in omitted
    changed = {path for path in recording.folder.iterdir() if path.read_bytes() != before[path]}
    assert changed == {recording.files[1]}
    for target in (tmp_path / 'whole', recording.folder, recording.folder / 'whole'):
        with pytest.raises(BagError, match=str(target)):
            recover(recording.folder, target)


def claiming(folder, kind):
    """Write a bag with one message, and a record or chunk that claims far more than there is."""
    path = folder / f'{kind}.mcap'
    with path.open('wb') as file:
        writer = Writer(file, use_chunking=kind != 'message', compression=CompressionType.NONE)
        writer.start('ros2')
        schema = writer.register_schema('t/msg/T', 'ros2msg', b'int8 x')
        number = writer.register_channel('/a', 'cdr', schema)
        writer.add_message(number, 1, b'', 1)
        writer.flush()
        begin = file.tell()
        writer.add_message(number, 2, b'abc', 2)
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
        monkeypatch.setattr(mcap_records, 'MAX_RECORD', limit)
        with pytest.raises(UnfinishedError, match=f'more than {limit}'):
            BagReader(path)
        monkeypatch.undo()


@few
@given(data=st.data())
def test_damaged_bag_gives_messages_as_they_were_written_or_is_refused(tmp_path, data):
    messages = [Message(CHANNELS[1], bytes([n] * 20), n, 0, n) for n in range(40)]
    contents = []
    for name in ('none', 'lz4', 'zstd'):
        if not (tmp_path / name).exists():
            write(tmp_path / name, messages, chunk=10, compression=name)
        contents.append((tmp_path / f'{name}/{name}_0.mcap').read_bytes())
    path, target = tmp_path / 'bag.mcap', tmp_path / 'new'
    path.write_bytes(data.draw(datas(*contents)))
    shutil.rmtree(target, ignore_errors=True)
    written = {message.data for message in messages}

    def read_data():
        with BagReader(path) as reader:
            return {message.data for message in reader.messages()}

    assert (accepted(read_data, str(path)) or set()) <= written
    with contextlib.suppress(SystemExit):  # with code 2, if nothing can be recovered
        recover_bag([str(path), '--to', str(target)])
    if target.exists():
        assert {item for *_, item in read_by_others(target)} <= written
