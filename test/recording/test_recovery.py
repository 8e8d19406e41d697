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
"""Bags that are cut off or damaged, and what is left of them: whole chunks, and nothing else."""

from __future__ import annotations

import functools
from io import BytesIO
from pathlib import Path
import random
import resource
import subprocess
import sys
import tempfile
from test.recording.conftest import PLAIN, plain

from hypothesis import given, settings
from hypothesis import strategies as st
from mcap.reader import make_reader
from mcap.writer import MCAP0_MAGIC
import pytest
from rosbags.rosbag2 import Reader as RosbagsReader
from soft_throw_ros.recording.bag_reader import BagReader, read_stream
from soft_throw_ros.recording.bag_writer import BagWriter
from soft_throw_ros.recording.live_stream import StreamWriter
from soft_throw_ros.recording.message import BagError, Message
from soft_throw_ros.recording.recovery import recover

ROOT = Path(__file__).parents[2]


def data_as_read_by_others(folder):
    """Return the data of all messages as rosbags reads them, once mcap has read as many."""
    with RosbagsReader(folder) as bag:
        data = [bytes(data) for _, _, data in bag.messages()]
    count = 0
    for path in folder.glob('*.mcap'):
        with path.open('rb') as file:
            count += sum(1 for _ in make_reader(file, validate_crcs=True).iter_messages())
    assert count == len(data)
    return data


def chunks_of(path):
    with path.open('rb') as file:
        return make_reader(file).get_summary().chunk_indexes


def flip(path, place, bit=4):
    data = bytearray(path.read_bytes())
    data[place] ^= bit
    path.write_bytes(data)


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
    while number % 3 and not any(flushed[:]):
        time.sleep(0.001)
    time.sleep(random.uniform(0.0, 0.06))
    os.kill(child, signal.SIGKILL)
    assert os.WIFSIGNALED(os.waitpid(child, 0)[1])
    print(int.from_bytes(flushed[:], 'little'))
"""


def test_process_that_is_killed_loses_only_what_came_since_it_flushed(tmp_path, rerun):
    runs = 30
    killed = subprocess.run(
        [sys.executable, '-c', KILLED, str(tmp_path), str(runs), '7'],
        capture_output=True,
        check=True,
        cwd=ROOT,
        text=True,
        timeout=100,
    )
    flushed = [int(line) for line in killed.stdout.split()]
    assert sum(count > 0 for count in flushed) > runs // 2
    for number, count in enumerate(flushed):
        bag, target = tmp_path / f'bag{number}', tmp_path / f'whole{number}'
        if count:
            assert (bag / 'metadata.yaml').exists()
            recovered = recover(bag, target)
            assert recovered.message_count >= count
            data = data_as_read_by_others(target)
            steps = [int.from_bytes(item[4:], 'little') for item in data if len(item) == 12]
            assert steps == list(range(len(steps)))
            assert len(data) == recovered.message_count in (2 * len(steps), 2 * len(steps) - 1)
    for path in sorted(target.glob('*.mcap')):
        rerun('mcap', 'check', path)


@pytest.mark.parametrize('compression', ['none', 'lz4', 'zstd'])
def test_bag_cut_off_anywhere_gives_all_whole_chunks(recording, tmp_path, compression):
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
        count = min(202 * sum(border <= size for border in borders), len(expected))
        assert found == expected[:count]
        if found and size % 4 == 0:
            target = tmp_path / f'whole{size}'
            assert recover(recording.folder, target).message_count == count
            assert data_as_read_by_others(target) == [message[1] for message in found]


# Damaged


@pytest.mark.parametrize('compression', ['none', 'lz4', 'zstd'])
def test_flipped_bit_costs_no_more_than_the_chunk_it_is_in(recording, tmp_path, compression):
    recording.write(600, compression=compression, flush_every=101)
    (path,) = recording.files
    whole = path.read_bytes()
    expected = recording.content(recording.messages)
    generator = random.Random(2)
    for number in range(100):
        path.write_bytes(whole)
        flip(path, generator.randrange(len(MCAP0_MAGIC), len(whole)), 1 << generator.randrange(8))
        with BagReader(path) as bag, BagReader(path, by_scan=True) as scan:
            for reader in (bag, scan):
                found = recording.content(reader.messages())
                rest = iter(expected)
                assert all(message in rest for message in found)
                assert len(found) >= len(expected) - 101
                assert reader.damage or found == expected
        if number % 20 == 0:
            recovered = recover(recording.folder, tmp_path / f'whole{number}')
            data = data_as_read_by_others(tmp_path / f'whole{number}')
            assert len(data) == recovered.message_count


def test_gap_says_where_it_is_and_channels_survive_it(recording, tmp_path):
    recording.write(2000, flush_every=300)
    (path,) = recording.files
    chunk, following = chunks_of(path)[:2]  # the first one defines the channels
    flip(path, chunk.chunk_start_offset + 100)
    path.write_bytes(path.read_bytes()[:-37])  # nor is there an end that would repeat them
    recovered = recover(recording.folder, tmp_path / 'whole')
    gap, _ = recovered.gaps
    size = following.chunk_start_offset - chunk.chunk_start_offset
    assert (gap.path, gap.offset, gap.size) == (path, chunk.chunk_start_offset, size)
    assert recovered.saved == {'/twin/joint_states': 1703, '/twin/journal': 17}
    assert recovered.skipped == (gap,)
    with BagReader(tmp_path / 'whole') as bag:
        assert [channel.schema for channel in bag.channels] == [
            recording.states.schema, recording.texts.schema,
        ]  # fmt: skip


@pytest.mark.parametrize(
    ('found', 'damaged'), [(b'/twin/journal', b'/twin/joUrnal'), (b'RIHS01_', b'RIHS01x')]
)
def test_definition_with_a_checksum_wins_over_its_copy_without_one(
    recording, tmp_path, found, damaged
):
    recording.write(100, compression='lz4')
    (path,) = recording.files
    path.write_bytes(path.read_bytes().replace(found, damaged, 1)[:-100])
    recover(path, tmp_path / 'whole')
    with BagReader(tmp_path / 'whole') as bag:
        assert {channel.topic: channel.type_hash for channel in bag.channels} == {
            channel.topic: channel.type_hash for channel in (recording.states, recording.texts)
        }


@pytest.mark.parametrize('size', [1, 9, 5000, 300_000])
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
        assert bag.gaps[0].size == size


def test_bag_whose_beginning_is_damaged_can_be_recovered(recording, tmp_path):
    recording.write(500)
    (path,) = recording.files
    path.write_bytes(b'\0' * 60 + path.read_bytes()[60:])
    with pytest.raises(BagError, match='no MCAP file'):
        BagReader(recording.folder)
    assert recover(recording.folder, tmp_path / 'whole').message_count == len(recording.messages)


def test_all_that_a_bag_has_is_recovered_in_its_order(recording, tmp_path):
    recording.write(2000, max_duration=0.5, compression='lz4')
    before = {path: path.read_bytes() for path in recording.folder.iterdir()}
    recovered = recover(recording.folder, tmp_path / 'whole')
    assert recovered.gaps == ()
    assert {path: path.read_bytes() for path in recording.folder.iterdir()} == before
    with BagReader(recording.folder) as old, BagReader(tmp_path / 'whole') as new:
        assert recording.content(old.messages(by_log_time=False)) == recording.content(
            new.messages(by_log_time=False)
        )
        assert old.metadata == new.metadata
        assert list(old.attachments()) == list(new.attachments())
        assert [vars(channel) for channel in old.channels] == [
            vars(channel) for channel in new.channels
        ]
        assert new.distribution == 'jazzy'


def unchunked(count):
    """Write messages in no chunk; return the file, and where each begins."""
    writer = StreamWriter()
    stream = writer.start() + writer.define(PLAIN)
    begins = []
    for number in range(count):
        begins.append(len(stream))
        stream += writer.block(
            [Message(PLAIN, b'message %d ' % number * 5, number, number, number)]
        )
    return stream, begins


def test_messages_in_no_chunk_are_read_up_to_the_damage(tmp_path):
    data, begins = unchunked(500)
    path = tmp_path / 'stream.mcap'
    for place in (begins[100], begins[100] + 7):  # opcode, length
        path.write_bytes(data)
        flip(path, place, 0x40)
        with BagReader(path) as bag:
            assert [message.sequence for message in bag.messages()] == list(range(100))
            assert bag.gaps[0].offset == begins[100]


def test_empty_file_of_a_bag_is_named_and_the_others_are_read(recording, tmp_path):
    recording.write(900, max_duration=0.3)
    recording.files[1].write_bytes(b'')
    recovered = recover(recording.folder, tmp_path / 'whole')
    assert recovered.message_count == len(recording.messages) - 303
    assert str(recording.files[1]) in str(recovered.gaps[0])


def test_attachment_with_a_wrong_checksum_is_left_out_and_named(recording, tmp_path):
    recording.write(100)
    (path,) = recording.files
    flip(path, path.read_bytes().index(b'twin:'))
    recovered = recover(recording.folder, tmp_path / 'whole')
    assert 'attachment' in recovered.gaps[0].reason
    with BagReader(tmp_path / 'whole') as bag:
        assert list(bag.attachments()) == []


def test_messages_whose_definition_is_damaged_are_left_out_and_counted(recording, tmp_path):
    recording.write(2000, flush_every=300)
    (path,) = recording.files
    data = bytearray(path.read_bytes())
    first, last = chunks_of(path)[0], data.rindex(b'rosbag2')
    for begin, size in ((first.chunk_start_offset, 40), (last, len(data) - last)):
        data[begin:begin + size] = bytes(size)
    path.write_bytes(data.replace(b'/twin/joint_states', b'/twin/joint_Xtates', 1))
    recovered = recover(recording.folder, tmp_path / 'whole')
    assert recovered.saved == {'/twin/journal': 17}
    assert len(data_as_read_by_others(tmp_path / 'whole')) == 17
    assert any(gap.messages == 1703 and 'channel 1' in gap.reason for gap in recovered.skipped)


@pytest.mark.parametrize(
    ('found', 'damaged', 'count'),
    [
        (b'RIHS01_', b'RIHS01x', 50),
        (b'string data', b'string dataX', 50),
        (b'string data', b'str\xf1ng data', 0),
        (b'/twin/journal', b'/twin/\0ournal', 0),
        (b'std_msgs/msg/String', b'std_msgs/mzg/String', 0),
    ],
)
def test_definition_without_a_checksum_is_left_out_where_it_cannot_be_trusted(
    recording, tmp_path, found, damaged, count
):
    writer = StreamWriter()
    messages = [recording.text(number, 'hello') for number in range(50)]
    data = writer.start() + writer.define(recording.texts) + writer.block(messages)
    path = tmp_path / 'stream.mcap'
    path.write_bytes(data.replace(found, damaged[: len(found)]))
    if not count:
        with pytest.raises(BagError, match='no message to recover'):
            recover(path, tmp_path / 'whole')
        return
    recovered = recover(path, tmp_path / 'whole')
    assert len(data_as_read_by_others(tmp_path / 'whole')) == count == recovered.message_count
    assert '/twin/journal' in recovered.doubts[0]
    with BagReader(tmp_path / 'whole') as bag:
        assert [(channel.type_hash, channel.qos) for channel in bag.channels] == [('', '')]


# Anything at all


@functools.cache
def sound_file(kind):
    """Make a small file in which nothing is wrong."""
    if kind == 'unchunked':
        return unchunked(30)[0]
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / 'bag'
        with BagWriter(path, distribution='', compression=kind) as writer:
            writer.add_metadata('name', {'key': 'value'})
            writer.attach('file', b'content', 'text/plain')
            for number in range(30):
                data = b'message %d ' % number * 5
                writer.write(Message(PLAIN, data, number, number, number))
                if number % 10 == 9:
                    writer.flush()
        return (path / 'bag_0.mcap').read_bytes()


def edited(data, edits):
    data = bytearray(data)
    for kind, where, size, number in edits:
        place = int(where * len(data))
        if kind == 'flip':
            data[place:place + 1] = bytes([data[place] ^ (1 << size % 8)] if data else [])
        elif kind == 'put':
            data[place:place + 8] = number.to_bytes(8, 'little')
        elif kind == 'remove':
            del data[place:place + size]
        elif kind == 'repeat':
            data[place:place] = data[place:place + size]
        else:
            del data[place:]
    return bytes(data)


@pytest.mark.parametrize('kind', ['lz4', 'zstd', 'none', 'unchunked'])
@settings(max_examples=60)
@given(
    edits=st.lists(
        st.tuples(
            st.sampled_from(['flip', 'put', 'remove', 'repeat', 'cut']),
            st.floats(0.0, 1.0, exclude_max=True),
            st.integers(0, 300),
            st.sampled_from([0, 1, 0xFF, 2**31, 2**32 - 1, 2**48, 2**63, 2**64 - 1]),
        ),
        min_size=1,
        max_size=4,
    )
)
def test_edited_file_gives_messages_or_a_reason(tmp_path_factory, kind, edits):
    path = tmp_path_factory.mktemp('edited') / 'bag.mcap'
    path.write_bytes(edited(sound_file(kind), edits))
    found, reasons = [], []
    for by_scan in (False, True):
        try:
            with BagReader(path, by_scan=by_scan) as bag:
                found.append([message.data for message in bag.messages()])
                assert all(isinstance(record.metadata, dict) for record in bag.metadata)
                assert all(record.data == b'content' for record in bag.attachments())
        except BagError as error:
            reasons.append(str(error))
    try:
        items = read_stream(BytesIO(path.read_bytes()), str(path))
        found.append([item.data for item in items if isinstance(item, Message)])
    except BagError as error:
        reasons.append(str(error))
    try:
        count = recover(path, path.with_name('whole')).message_count
        assert count == len(data_as_read_by_others(path.with_name('whole')))
    except BagError as error:
        reasons.append(str(error))
    assert all(str(path) in reason for reason in reasons)
    if kind in ('lz4', 'zstd', 'none'):  # nothing is read without a checksum
        originals = {b'message %d ' % number * 5 for number in range(30)}
        assert all(originals.issuperset(data) for data in found)


# Refused


def test_bag_that_is_being_written_is_not_touched(tmp_path):
    with BagWriter(tmp_path / 'bag', distribution='') as writer:
        writer.write(plain(0))
        writer.flush()
        for source in ('bag', 'bag/bag_0.mcap'):
            with pytest.raises(BagError, match='being written'):
                recover(tmp_path / source, tmp_path / 'whole')
    assert recover(tmp_path / 'bag', tmp_path / 'whole').message_count == 1


def test_bag_is_not_overwritten_nor_changed(recording, tmp_path):
    recording.write(10)
    (tmp_path / 'other').mkdir()
    for target in (tmp_path / 'other', recording.folder, recording.folder / 'whole'):
        with pytest.raises(BagError, match=str(target)):
            recover(recording.folder, target)
    assert len(list(recording.folder.iterdir())) == 2
    assert list((tmp_path / 'other').iterdir()) == []


def test_full_disk_leaves_no_half_of_a_bag(recording, tmp_path):
    recording.write(2000, compression='none')
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (5000, limits[1]))
    try:
        with pytest.raises(BagError, match='File too large'):
            recover(recording.folder, tmp_path / 'whole')
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)
    assert not (tmp_path / 'whole').exists()
