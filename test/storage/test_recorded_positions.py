# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Positions of joints in the messages of a bag."""

import math

from bags import BEGIN, text
import pytest
from soft_throw_ros.configuration.interface import JOINT_STATE, TEXT
from soft_throw_ros.recording.bag_writer import BagWriter
from soft_throw_ros.storage.bag_reader import BagReader
from soft_throw_ros.storage.cdr import JointStateEncoder
from soft_throw_ros.storage.message import Channel, Message
from soft_throw_ros.storage.recorded_positions import read_positions

TOPIC, OTHER = '/rig/states', '/other'
JOINTS = ('plate', 'projectile')


@pytest.fixture
def read(tmp_path):
    """Return a function that records messages as joint states, and reads the positions."""

    def read(messages):
        with BagWriter(tmp_path / 'bag', distribution='jazzy') as writer:
            for topic, data in messages:
                is_text = topic.endswith('journal')
                channel = Channel(
                    topic=topic, type=TEXT if is_text else JOINT_STATE,
                    schema='string data' if is_text else 'string name',
                )
                writer.write(Message(channel, data, BEGIN, BEGIN))
        with BagReader(tmp_path / 'bag') as reader:
            return read_positions(reader, [TOPIC, OTHER], JOINTS)

    return read


def encode(stamp, joints, positions):
    return JointStateEncoder('', joints, series=1).encode(stamp, positions)


def test_joints_are_found_by_name_and_missing_ones_are_nan(read):
    recorded = read([
        (TOPIC, encode(BEGIN, ('projectile', 'arm', 'plate'), [2.0, 9.0, 1.0])),
        (TOPIC, encode(BEGIN + 5, ('plate',), [3.0])),
        (OTHER, encode(BEGIN, ('arm',), [4.0])),
    ])
    rows = recorded[TOPIC].rows
    assert rows[BEGIN] == [1.0, 2.0]
    assert rows[BEGIN + 5][0] == 3.0
    assert math.isnan(rows[BEGIN + 5][1])
    assert all(map(math.isnan, recorded[OTHER].rows[BEGIN]))


def test_first_of_equal_stamps_counts(read):
    recorded = read([(TOPIC, encode(BEGIN, JOINTS, [height, 0.0])) for height in (1.0, 2.0)])
    assert recorded[TOPIC].rows == {BEGIN: [1.0, 0.0]}


def test_messages_of_another_content_are_counted(read):
    recorded = read([(TOPIC, text('no joint state')), (TOPIC, encode(BEGIN, JOINTS, [1.0, 2.0]))])
    assert recorded[TOPIC].unreadable == 1
    assert len(recorded[TOPIC].rows) == 1


def test_journal_names_the_joints_and_the_time_scale(read):
    settings = '{"kind":"start","settings":{"joint_names.plate":"table","time_scale":0.1}}'
    recorded = read([
        ('/rig/journal', text(settings)),
        (TOPIC, encode(BEGIN, ('plate', 'table'), [1.0, 2.0])),
        (OTHER, encode(BEGIN, ('plate', 'table'), [3.0, 4.0])),
    ])
    assert recorded[TOPIC].rows[BEGIN][0] == 2.0
    assert recorded[TOPIC].time_scale == 0.1
    assert recorded[OTHER].rows[BEGIN][0] == 3.0
    assert recorded[OTHER].time_scale == 1.0
    assert recorded[TOPIC].names == {'plate', 'table'}
