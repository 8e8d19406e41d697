# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Positions of joints in the messages of a bag."""

from bags import BEGIN, text, write
import numpy as np
from soft_throw_ros.configuration.interface import JOINT_STATE, TEXT
from soft_throw_ros.storage.bag_reader import BagReader
from soft_throw_ros.storage.cdr import JointStateEncoder
from soft_throw_ros.storage.message import Channel, Message
from soft_throw_ros.storage.recorded_positions import read_positions

STATES = Channel(topic='/rig/states', type=JOINT_STATE, schema='string name')
OTHERS = Channel(topic='/other', type=JOINT_STATE, schema='string name')
JOURNAL = Channel(topic='/rig/journal', type=TEXT, schema='string data')


def read(path, *messages):
    """Record joint states or texts, and read the positions."""
    messages = [
        Message(topic, text(content[0]) if len(content) == 1 else
                JointStateEncoder('', content[1], series=1).encode(content[0], content[2]),
                BEGIN, BEGIN)
        for topic, *content in messages
    ]
    with BagReader(write(path / 'bag', messages)) as reader:
        recorded = read_positions(reader, ['/rig/states', '/other'], ('plate', 'projectile'))
    return recorded['/rig/states'], recorded['/other']


def test_joints_are_found_by_name_and_other_messages_are_counted(tmp_path):
    states, others = read(
        tmp_path,
        (STATES, 0, ('projectile', 'arm', 'plate'), [2.0, 9.0, 1.0]),
        (STATES, 5, ('plate',), [3.0]),
        (STATES, 5, ('plate',), [4.0]),  # the first of equal stamps counts
        (STATES, 'no joint state'),
        (OTHERS, 0, ('arm',), [4.0]),
    )
    np.testing.assert_equal(states.rows, {0: [1.0, 2.0], 5: [3.0, np.nan]})
    assert (states.unreadable, states.names) == (1, {'plate', 'projectile', 'arm'})
    np.testing.assert_equal(others.rows, {0: [np.nan, np.nan]})


def test_journal_names_the_joints_and_the_time_scale(tmp_path):
    settings = '{"kind":"start","settings":{"joint_names.plate":"table","time_scale":0.1}}'
    states, others = read(
        tmp_path,
        (JOURNAL, settings),
        (STATES, 0, ('plate', 'table'), [1.0, 2.0]),
        (OTHERS, 0, ('plate', 'table'), [3.0, 4.0]),
    )
    assert (states.rows[0][0], states.time_scale) == (2.0, 0.1)
    assert (others.rows[0][0], others.time_scale) == (3.0, 1.0)
