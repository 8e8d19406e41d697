# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""The command `recover`."""

from pathlib import Path

import pytest
from soft_throw_ros.commands import recover
from soft_throw_ros.recording.bag_writer import BagWriter
from soft_throw_ros.storage.message import Channel, Message

COMMAND = (recover.main,)
CHANNEL = Channel(topic='/a', type='std_msgs/msg/String', schema='string data')


@pytest.fixture
def bag(tmp_path):
    """Write a bag of three chunks."""
    with BagWriter(tmp_path / 'run', distribution='jazzy', compression='none') as writer:
        for number in range(300):
            writer.write(Message(CHANNEL, b'x' * 50, number, number, number))
            if number % 100 == 99:
                writer.flush()
    return tmp_path / 'run'


def damage(bag, share):
    """Damage a byte of a bag; return the file."""
    path = bag / 'run_0.mcap'
    data = bytearray(path.read_bytes())
    data[round(share * len(data))] ^= 1
    path.write_bytes(data)
    return path


def test_loss_is_reported_with_its_file_size_and_exit_code(command, bag, tmp_path):
    path, target = damage(bag, 0.5), tmp_path / 'out/whole'
    first, *_, last = command.run(bag, '--to', target, code=1).splitlines()
    assert first.startswith(f'{target}: 100 messages')
    assert last.startswith(f'omitted: {path}: ')
    assert str(path.stat().st_size) in last


def test_file_that_is_cut_off_is_called_so(command, bag):
    path = bag / 'run_0.mcap'
    path.write_bytes(path.read_bytes()[:path.stat().st_size // 2])
    assert command.run(bag, code=1).rstrip().endswith('cut off')


def test_recovered_bag_is_beside_the_other(command, bag, tmp_path, monkeypatch):
    monkeypatch.chdir(bag)
    assert command.run('.').startswith(f'{bag}_recovered: 300 messages')
    path = (bag / 'run_0.mcap').rename(tmp_path / 'alone.mcap')
    assert command.run(path).startswith(f'{tmp_path}/alone_recovered: 300 messages')


def test_error_is_one_line(command, bag, tmp_path):
    assert str(tmp_path) in command.refused(bag, '--to', tmp_path)
    damage(bag, 0.1)
    assert 'run_0.mcap' in command.refused(bag)
    assert not Path(f'{bag}_recovered').exists()
