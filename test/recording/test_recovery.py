# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Recovery of bags that are cut off or damaged: all whole chunks before the damage survive."""

from __future__ import annotations

import contextlib
from pathlib import Path
import random
import subprocess
import sys
from test.recording.conftest import largest_file, plain, read

from bags import attachments
from mcap.reader import make_reader
from mcap.writer import Writer
import pytest
from rosbags.rosbag2 import Reader as RosbagsReader
from soft_throw_ros.recording.bag_writer import BagWriter
from soft_throw_ros.recording.recovery import recover
from soft_throw_ros.storage.bag_reader import BagReader, UnfinishedError
from soft_throw_ros.storage.message import BagError

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


def flip(path, offset, bit=4):
    data = bytearray(path.read_bytes())
    data[offset] ^= bit
    path.write_bytes(data)


# Cut off

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
        assert len(data_as_read_by_others(target)) == recovered.message_count >= count
        with BagReader(target) as reader:
            steps = [message.sequence for message in reader.messages()]
        assert steps == list(range(len(steps)))
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
    cuts = {*random.Random(1).sample(range(8, len(whole)), 6)}
    cuts |= {border + shift for border in borders for shift in (-1, 0, 9)}
    cuts |= {len(whole) - size for size in (1, 9, 38)}
    for size in sorted(cuts):
        path.write_bytes(whole[:size])
        with pytest.raises(UnfinishedError, match='soft-throw recover'):
            BagReader(path)
        count = min(202 * sum(border <= size for border in borders), len(expected))
        if not count:
            continue
        target = tmp_path / f'whole{size}'
        recovered = recover(recording.folder, target)
        assert bool(recovered.omitted) == (size not in borders)
        assert recording.content(read(target).messages) == expected[:count]
        if size % 4 == 0:
            assert data_as_read_by_others(target) == [message[1] for message in expected[:count]]


# Damaged


@pytest.mark.parametrize('compression', ['none', 'lz4', 'zstd'])
def test_all_before_a_flipped_bit_is_recovered(recording, tmp_path, compression):
    recording.write(600, compression=compression, flush_every=101)
    (path,) = recording.files
    whole = path.read_bytes()
    expected = recording.content(recording.messages)
    borders = [chunk.chunk_start_offset + chunk.chunk_length for chunk in chunks_of(path)]
    generator = random.Random(2)
    for number in range(12):
        path.write_bytes(whole)
        offset = generator.randrange(borders[0], len(whole))
        flip(path, offset, 1 << generator.randrange(8))
        recovered = recover(recording.folder, tmp_path / f'whole{number}')
        result = recording.content(read(recovered.target).messages)
        before = min(101 * sum(border <= offset for border in borders), len(expected))
        assert result[:before] == expected[:before]
        assert recovered.omitted or result == expected
        remaining = iter(expected)
        assert all(message in remaining for message in result)
        with contextlib.suppress(BagError), BagReader(path) as bag:  # it never errs silently
            assert recording.content(bag.messages()) == expected
        assert len(data_as_read_by_others(recovered.target)) == len(result)


def test_all_contents_of_a_bag_are_recovered_in_order(recording, tmp_path):
    recording.write(2000, max_duration=0.5, compression='lz4')
    before = {path: path.read_bytes() for path in recording.folder.iterdir()}
    recovered = recover(recording.folder, tmp_path / 'whole')
    assert recovered.omitted == ()
    assert {path: path.read_bytes() for path in recording.folder.iterdir()} == before
    with BagReader(recording.folder) as old, BagReader(tmp_path / 'whole') as new:
        assert recording.content(old.messages(by_log_time=False)) == recording.content(
            new.messages(by_log_time=False)
        )
        assert old.metadata == new.metadata
        assert [vars(channel) for channel in old.channels] == [
            vars(channel) for channel in new.channels
        ]
        assert new.distribution == 'jazzy'
    assert attachments(recording.folder) == attachments(tmp_path / 'whole')


def test_messages_in_no_chunk_are_read_up_to_the_damage(tmp_path):
    path = tmp_path / 'stream.mcap'
    with path.open('wb') as file:
        writer = Writer(file, use_chunking=False)
        writer.start()
        file.write(b'\x80' + (3).to_bytes(8, 'little') + b'abc')  # a private record
        schema = writer.register_schema('std_msgs/msg/String', 'ros2msg', b'string data')
        channel = writer.register_channel('/plain', 'cdr', schema)
        for number in range(500):
            if number == 100:
                begin = file.tell()
            writer.add_message(channel, number, b'', number, number)
    flip(path, begin + 7, 0x40)  # the length
    recovered = recover(path, tmp_path / 'whole')
    assert [message.sequence for message in read(recovered.target).messages] == [*range(100)]
    (omitted,) = recovered.omitted
    assert f'{path.stat().st_size - begin} of' in omitted


def test_every_file_is_recovered_up_to_its_damage_and_missing_ones_are_named(recording, tmp_path):
    recording.write(900, max_duration=0.3)
    _, second, third = recording.files
    second.write_bytes(b'')
    flip(third, chunks_of(third)[0].chunk_start_offset + 1000)
    recovered = recover(recording.folder, tmp_path / 'whole')
    assert recovered.message_count == 303
    damaged, empty = recovered.omitted
    assert str(third) in damaged
    assert str(second) in empty
    assert attachments(tmp_path / 'whole') == {'twin.yaml': b'twin:\n'}


# Refused


def test_existing_or_open_bag_is_not_changed(recording, tmp_path):
    with BagWriter(tmp_path / 'other', distribution='') as writer:
        for source in ('other', 'other/other_0.mcap'):
            with pytest.raises(BagError, match='being written'):
                recover(tmp_path / source, tmp_path / 'whole')
        writer.write(plain(0))
    recording.write(10)
    for target in (tmp_path / 'other', recording.folder, recording.folder / 'whole'):
        with pytest.raises(BagError, match=str(target)):
            recover(recording.folder, target)
    assert len(list(recording.folder.iterdir())) == 2
    assert recover(tmp_path / 'other', tmp_path / 'whole').message_count == 1


def test_full_disk_leaves_no_partial_bag(recording, tmp_path):
    recording.write(2000, compression='none')
    with largest_file(5000), pytest.raises(BagError, match='File too large'):
        recover(recording.folder, tmp_path / 'whole')
    assert not (tmp_path / 'whole').exists()
