# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Bags written by us and by others, whole, cut off and damaged; other programs read ours."""

from __future__ import annotations

import contextlib
import os
from pathlib import Path
import resource
import shutil
import subprocess
import sys
import tracemalloc

from bags import accepted, channel, datas, few, notes, plain, profiles, read, saved, text, write
from hypothesis import given, settings
from hypothesis import strategies as st
from mcap.reader import make_reader
from mcap.writer import CompressionType, IndexType, Writer
import pytest
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin
from rosbags.rosbag2 import Reader as RosbagsReader
from rosbags.rosbag2 import Writer as RosbagsWriter
from rosbags.rosbag2.metadata import parse_qos
from rosbags.typesys import get_typestore, Stores
from soft_throw_ros.recording.bag_writer import BagWriter, CHUNK_SIZE
from soft_throw_ros.recording.recovery import recover
from soft_throw_ros.storage import bag_reader
from soft_throw_ros.storage.bag_reader import BagReader, UnfinishedError
from soft_throw_ros.storage.message import BagError, Channel, LATEST, Message
import yaml

ROOT = Path(__file__).parents[2]
TYPES = get_typestore(Stores.ROS2_JAZZY)
CHANNELS = [
    Channel(topic='/even', type='t/msg/T', schema='int8 x'),
    Channel(topic='/odd', type='t/msg/T', schema='int8 x', qos=profiles({'depth': 1})),
]


def read_by_others(folder):
    """Return topics, times and data of a bag as rosbags reads them, and mcap as well."""
    with RosbagsReader(folder) as bag:
        rows = [(item.topic, time, bytes(data)) for item, time, data in bag.messages()]
        assert bag.message_count == len(rows)
    assert sorted((topic, time, data) for topic, data, time, *_ in saved(folder)) == sorted(rows)
    return sorted(rows, key=lambda row: row[1])


@contextlib.contextmanager
def largest_file(size):
    """Limit the size of files that this process may write, like a full disk."""
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, limits[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)


@settings(few, max_examples=40)
@given(
    times=st.lists(st.integers(0, 30) | st.just(LATEST), max_size=50),
    breaks=st.sets(st.integers(0, 50)),
    compression=st.sampled_from(['none', 'lz4', 'zstd']),
    sizes=st.sampled_from([(0, 20), (9, CHUNK_SIZE + 1)]),
    cut=st.floats(0.0, 1.0, exclude_max=True),
    data=st.data(),
)
def test_bag_is_read_by_all_and_recovered_up_to_its_damage(
    tmp_path_factory, times, breaks, compression, sizes, cut, data
):
    folder = tmp_path_factory.mktemp('bag')
    messages = [
        Message(CHANNELS[number % 2], bytes([number]) * sizes[number % 2], time, time // 2, number)
        for number, time in enumerate(times)
    ]
    with BagWriter(folder / 'bag', distribution='jazzy', compression=compression) as writer:
        for message in messages:
            if message.sequence in breaks:  # a chunk, or a file, ends
                writer.split() if message.sequence % 3 == 0 else writer.flush()
            writer.write(message)
    rows = sorted(((m.channel.topic, *m[1:]) for m in messages), key=lambda row: row[2])
    assert read_by_others(folder / 'bag') == [(row[0], row[2], row[1]) for row in rows]
    assert read(folder / 'bag') == rows
    assert read(folder / 'bag', '/odd') == [row for row in rows if row[0] == '/odd']
    with BagReader(folder / 'bag') as reader:
        assert [m.sequence for m in reader.messages(by_log_time=False)] == list(range(len(times)))
        assert reader.start_time == min(times, default=0)
        assert reader.end_time == max(times, default=0)
    newest = max((folder / 'bag').glob('*.mcap'), key=lambda path: path.stat().st_mtime_ns)
    part, whole = read(newest), newest.read_bytes()
    path = folder / 'part/part_0.mcap'
    path.parent.mkdir()
    for name in ('cut', 'damaged'):
        is_cut = name == 'cut'
        end = 8 + int(cut * (len(whole) - 8))
        path.write_bytes(whole[:end] if is_cut else data.draw(datas(whole)))
        known = accepted(lambda: read(path), str(path))
        assert known is None if is_cut else set(known or ()) <= set(part)  # it never errs silently
        result = []
        with contextlib.suppress(BagError):  # nothing can be recovered
            result = read(recover(path, folder / name).target)
        assert set(result) <= set(part)
        if is_cut:  # all that mcap reads
            assert sorted(result) == sorted(saved(path.parent))


def test_bag_has_the_metadata_of_rosbag2(tmp_path):
    states = channel('/twin/joint_states', 'sensor_msgs/msg/JointState', depth=1000)
    texts = channel('/twin/journal', durability='transient_local')
    messages = [Message((states, texts)[n % 2], text(f'{n} äöü'), n, n, n) for n in range(5000)]
    folder = write(tmp_path / 'bag', messages, chunk=10**6)
    with RosbagsReader(folder) as bag:
        first, second = bag.connections
        assert (bag.ros_distro, bag.start_time, bag.end_time) == ('jazzy', 0, 5000)
        *_, (_, _, data) = bag.messages()
    assert TYPES.deserialize_cdr(data, second.msgtype).data == '4999 äöü'
    assert first.digest == TYPES.hash_rihs01('sensor_msgs/msg/JointState')
    for connection, ours in ((first, states), (second, texts)):
        assert connection.ext.offered_qos_profiles == parse_qos(ours.qos)
    with (folder / 'bag_0.mcap').open('rb') as file:
        reader = make_reader(file)
        assert reader.get_header().profile == 'ros2'
        chunks = reader.get_summary().chunk_indexes
    assert all(chunk.uncompressed_size < 1.1 * CHUNK_SIZE for chunk in chunks)
    information = yaml.safe_load((folder / 'metadata.yaml').read_text())
    inside = yaml.safe_load(notes(folder)['rosbag2']['serialized_metadata'])
    assert inside == information['rosbag2_bagfile_information']


def test_equal_channels_are_merged_when_read(tmp_path):
    one = {'topic': '/a', 'type': 't/msg/T', 'schema': 'IDL: ä', 'schema_encoding': 'ros2idl'}
    # Publishers that restart, the last with another quality of service
    channels = [Channel(**one), Channel(**one), Channel(**one, qos=profiles({'depth': 1}))]
    with BagReader(write(tmp_path / 'bag', [Message(c, b'', 1, 1) for c in channels])) as bag:
        assert [vars(item) for item in bag.channels] == [vars(item) for item in channels[1:]]
        assert len(list(bag.messages())) == 3


def test_bag_is_locked_and_never_overwritten(tmp_path):
    (tmp_path / 'file').touch()
    bag = tmp_path / 'bag'
    with BagWriter(bag, distribution='') as writer:
        writer.write(plain(0))
        with pytest.raises(ValueError, match=r'/plain: .* got -1 and 0'):
            writer.write(plain(0)._replace(log_time=-1))
        for name, reason in (
            ('bag', 'bag: File exists'), ('file', 'file: File exists'),
            ('file/bag', 'bag: Not a directory'),
        ):
            with pytest.raises(BagError, match=reason):
                BagWriter(tmp_path / name, distribution='')
        for path in (bag, bag / 'bag_0.mcap'):
            for use in (BagReader, lambda path: recover(path, tmp_path / 'whole')):
                with pytest.raises(BagError, match='being written'):
                    use(path)
    assert len(read(bag)) == 1
    recover(bag, tmp_path / 'whole')
    for target in (tmp_path / 'whole', bag, bag / 'whole'):
        with pytest.raises(BagError, match=str(target)):
            recover(bag, target)
    writer = BagWriter(tmp_path / 'deleted', distribution='')
    shutil.rmtree(tmp_path / 'deleted')
    with pytest.raises(BagError, match=r'metadata\.yaml: No such file'):
        writer.close()


@pytest.mark.parametrize('options', [{}, {'max_size': 300_000, 'sync': True}])
def test_full_disk_is_named_and_loses_nothing_if_space_is_freed(tmp_path, options):
    reasons = []
    writer = BagWriter(tmp_path / 'bag', distribution='', compression='none', **options)
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
        writer.close()
    assert len(reasons) == 3
    assert all('bag_0.mcap: File too large' in reason for reason in reasons)
    assert writer.counts.total() == 5000
    assert [time for _, time, _ in read_by_others(tmp_path / 'bag')] == list(range(5000))
    sizes = [path.stat().st_size for path in tmp_path.glob('bag/*.mcap')]
    assert (len(sizes) > 5 and max(sizes) < 3 * CHUNK_SIZE) == bool(options)


@pytest.mark.parametrize('room', range(1000, 1200, 20))  # some end between a chunk and its index
def test_whole_chunk_counts_as_saved_if_the_disk_is_full_before_its_index(tmp_path, room):
    path = tmp_path / 'bag'
    writer = BagWriter(path, distribution='', compression='none')

    def fill():
        for number in range(1000):
            writer.write(plain(number))
            writer.flush()

    begin = (path / 'bag_0.mcap').stat().st_size
    with largest_file(begin + room), pytest.raises(BagError, match='too large'):
        fill()
    with pytest.raises(BagError, match='too large'):
        writer.close()
    assert recover(path, tmp_path / 'recovered').saved.total() == writer.counts.total()
    for size in (10, 300):
        with largest_file(size), pytest.raises(BagError, match='File too large'):
            BagWriter(tmp_path / 'other', distribution='')  # which leaves nothing behind


KILLED = """
import os, random, signal, sys, time
from soft_throw_ros.recording.bag_writer import BagWriter
from soft_throw_ros.storage.message import Channel, Message

texts = Channel(topic='/text', type='std_msgs/msg/String', schema='string data')
text = b'\\0\\1\\0\\0' + (1000).to_bytes(4, 'little') + b'x' * 999 + b'\\0'
random.seed(7)
for number in range(15):
    counts, flushed = os.pipe()
    child = os.fork()
    if not child:
        path, compression = f'{sys.argv[1]}/bag{number}', ('none', 'lz4', 'zstd')[number % 3]
        bag = BagWriter(path, distribution='jazzy', compression=compression, max_size=10**6)
        for step in range(10**9):
            bag.write(Message(texts, text, step, step, step))
            if step % 97 == 96:
                bag.flush()
                os.write(flushed, (step + 1).to_bytes(8, 'little'))
    os.close(flushed)
    first = os.read(counts, 8)
    time.sleep(random.uniform(0.0, 0.06))
    os.kill(child, signal.SIGKILL)
    assert os.WIFSIGNALED(os.waitpid(child, 0)[1])
    print(int.from_bytes((first + os.read(counts, 2**16))[-8:], 'little'))
"""


def test_flush_with_sync_reaches_the_disk(tmp_path, monkeypatch):
    synced, path = [], tmp_path / 'bag/bag_0.mcap'
    monkeypatch.setattr(os, 'fsync', lambda file: synced.append(
        os.fstat(file if isinstance(file, int) else file.fileno())
    ))
    with BagWriter(path.parent, distribution='', sync=True) as writer:
        writer.write(Message(CHANNELS[0], b'1', 1, 1, 1))
        writer.flush()
        now = path.stat()
        assert (synced[-1].st_ino, synced[-1].st_size) == (now.st_ino, now.st_size)


def test_killed_process_loses_only_messages_after_its_last_flush(tmp_path):
    command = sys.executable, '-c', KILLED, str(tmp_path)
    killed = subprocess.check_output(command, cwd=ROOT, timeout=100)
    for number, count in enumerate(map(int, killed.split())):
        bag = tmp_path / f'bag{number}'
        assert (bag / 'metadata.yaml').exists()
        recovered = recover(bag, tmp_path / f'whole{number}')
        steps = [time for _, time, _ in read_by_others(recovered.target)]
        assert steps == list(range(recovered.saved.total()))
        assert len(steps) >= count


@pytest.mark.parametrize(('version', 'plugin', 'mode', 'is_refused'), [
    (8, StoragePlugin.MCAP, None, False), (9, StoragePlugin.MCAP, None, False),
    (9, StoragePlugin.MCAP, CompressionMode.STORAGE, False),
    (9, StoragePlugin.MCAP, CompressionMode.FILE, True),
    (9, StoragePlugin.MCAP, CompressionMode.MESSAGE, True),
    (9, StoragePlugin.SQLITE3, None, True),
])
def test_bag_of_rosbags_is_read_or_refused_with_its_converter(
    tmp_path, version, plugin, mode, is_refused
):
    offered = parse_qos(profiles({'depth': 7, 'reliability': 'best_effort'}))
    bag = RosbagsWriter(tmp_path / 'theirs', version=version, storage_plugin=plugin)
    if mode is not None:
        bag.set_compression(mode, CompressionFormat.ZSTD)
    with bag:
        connection = bag.add_connection(
            '/a', 'std_msgs/msg/String', typestore=TYPES, offered_qos_profiles=offered
        )
        for number in range(300):
            bag.write(connection, number, text(str(number)))
    if is_refused:
        for path in (tmp_path / 'theirs', *tmp_path.glob('theirs/*.db3')):
            with pytest.raises(BagError, match=r'theirs.*rosbags-convert'):
                BagReader(path)
        return
    for path in (tmp_path / 'theirs', recover(tmp_path / 'theirs', tmp_path / 'new').target):
        rows = [('/a', text(str(number)), number) for number in range(300)]
        assert [row[:3] for row in read(path)] == rows
        with BagReader(path) as ours:
            (only,) = ours.channels
        assert (only.type, parse_qos(only.qos)) == ('std_msgs/msg/String', offered)


def write_by_mcap(path, times, topic='/a', encoding='cdr', schema=1, **options):
    """Write messages with the library alone; return the offset of each in the file."""
    offsets = []
    with path.open('wb') as file:
        writer = Writer(file, **options)
        writer.start()
        file.write(b'\x80' + (3).to_bytes(8, 'little') + b'abc')  # a private record
        writer.register_schema('t/msg/T', 'ros2msg', b'int8 x')
        number = writer.register_channel(topic, encoding, schema)
        for sequence, time in enumerate(times):
            offsets.append(file.tell())
            writer.add_message(number, time, bytes([sequence % 256]), time, sequence)
        writer.add_metadata('name', {'key': 'value'})
        writer.finish()
    return offsets


@pytest.mark.parametrize('chunked', [True, False])
@pytest.mark.parametrize('index_types', [IndexType.ALL, IndexType.NONE, IndexType.CHUNK])
@pytest.mark.parametrize('has_statistics', [True, False])
def test_mcap_with_any_index_or_none_is_read_and_recovered(
    tmp_path, chunked, index_types, has_statistics
):
    times, path = [3, 1, 2, 2, 5, 4, 0, 9, 8, 7] * 40, tmp_path / 'theirs.mcap'
    write_by_mcap(
        path, times, chunk_size=1000, compression=CompressionType.LZ4, index_types=index_types,
        use_chunking=chunked, use_statistics=has_statistics,
    )
    rows = sorted((time, sequence) for sequence, time in enumerate(times))
    for bag in (path, recover(path, tmp_path / 'recovered').target):
        assert [(time, sequence) for _, _, time, _, sequence in read(bag)] == rows
    assert notes(bag)['name'] == {'key': 'value'}


@pytest.mark.parametrize('damage', [
    None, lambda text: text[:300], lambda _: '[' * 1000, lambda text: f'{text}# {"x" * 2**20}',
])
def test_bag_is_read_without_its_metadata_but_not_without_a_file(tmp_path, damage):
    folder = write(tmp_path / 'bag', map(plain, range(2000)), max_duration=1.5e-7)
    path = folder / 'metadata.yaml'
    whole = path.read_text()
    path.write_text(damage(whole)) if damage else path.unlink()
    assert [row[2] for row in read(folder)] == list(range(2000))  # 2 before 10
    path.write_text(whole)
    (folder / 'bag_3.mcap').write_bytes(b'')
    (folder / 'bag_5.mcap').unlink()
    with pytest.raises(UnfinishedError, match=r'bag_3\.mcap.*soft-throw recover'):
        BagReader(folder)
    recovered = recover(folder, tmp_path / 'whole')
    assert ['bag_3' in recovered.omitted[0], 'bag_5' in recovered.omitted[1]] == [True] * 2
    assert recovered.saved.total() == 2000 - 2 * 150


def test_file_or_path_that_is_no_bag_is_refused_with_a_reason(tmp_path):
    path = tmp_path / 'bag.mcap'
    for data, reason in ((b'', 'empty'), (b'#ROSBAG V2.0\n', 'is compressed.*rosbags-convert')):
        path.write_bytes(data)
        for bag in (tmp_path, path):
            with pytest.raises(BagError, match=rf'bag\.mcap.*{reason}'):
                BagReader(bag)
    os.mkfifo(tmp_path / 'pipe')
    (tmp_path / 'nothing').mkdir()
    for name in ('pipe', 'missing', 'nothing'):
        with pytest.raises(BagError, match=name):
            BagReader(tmp_path / name)


@pytest.mark.parametrize(('encoding', 'schema', 'time', 'reason'), [
    ('json', 1, 0, r"/a /b [^\n]*'json'"), ('cdr', 0, 0, 'nothing defines channel 1'),
    ('cdr', 1, 2**63, f'{2**63}'),
])
def test_messages_that_are_not_of_ros_are_refused_in_one_line(
    tmp_path, encoding, schema, time, reason
):
    write_by_mcap(tmp_path / 'theirs.mcap', [time], '/a\n/b', encoding, schema)
    with pytest.raises(BagError, match=rf'^[^\n]*theirs\.mcap: [^\n]*{reason}[^\n]*$'):
        read(tmp_path / 'theirs.mcap')


@pytest.mark.parametrize('size', [10**9, 10**12])
@pytest.mark.parametrize('kind', ['message', 'chunk', 'unpacked', 'data'])
def test_record_that_claims_more_than_there_is_is_refused_in_little_memory(tmp_path, kind, size):
    path = tmp_path / 'claiming.mcap'
    _, begin = write_by_mcap(
        path, [1, 2], chunk_size=1, use_chunking=kind != 'message',
        compression=CompressionType.NONE,
    )
    with path.open('r+b') as file:
        file.seek(begin + {'message': 1, 'chunk': 1, 'unpacked': 9 + 16, 'data': 9 + 32}[kind])
        file.write(size.to_bytes(8, 'little'))
    tracemalloc.start()
    try:
        with contextlib.suppress(BagError):
            assert len(read(path)) == 2
            assert kind in ('chunk', 'unpacked')  # the index has the right sizes
        recovered = recover(path, tmp_path / 'new')
        _, peak = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert peak < 10**7
    assert len(recovered.omitted) == 1
    assert [data for _, data, *_ in read(recovered.target)] == [b'\0']


def test_chunk_and_index_beyond_the_limit_are_refused(tmp_path, monkeypatch):
    for name, size, limit in (('chunk', 200_000, 100_000), ('index', 100, 3_000)):
        messages = [plain(number, size=size) for number in range(50)]
        path = write(tmp_path / name, messages, chunk=1, compression='none')
        monkeypatch.setattr(bag_reader, 'MAX_RECORD', limit)
        with pytest.raises(UnfinishedError, match=f'more than {limit}'):
            BagReader(path)
        monkeypatch.undo()
