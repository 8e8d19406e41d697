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
SETTINGS = '{"kind":"start","settings":{"joint_names.plate":"table","time_scale":0.1}}'


def test_joints_are_found_by_the_names_of_the_journal_and_other_messages_are_counted(tmp_path):
    contents = [
        (JOURNAL, text(SETTINGS)),
        (STATES, 0, ('projectile', 'plate', 'table'), [2.0, 9.0, 1.0]),
        (STATES, 5, ('table',), [3.0]),
        (STATES, 5, ('table',), [4.0]),  # the first of equal stamps counts
        (STATES, text('no joint state')),
        (OTHERS, 0, ('plate', 'table'), [3.0, 4.0]),  # without a journal beside it
        (OTHERS, 1, ('arm',), [4.0]),
    ]
    messages = [
        Message(channel, data[0] if len(data) == 1 else
                JointStateEncoder('', data[1], series=1).encode(data[0], data[2]), BEGIN, BEGIN)
        for channel, *data in contents
    ]
    with BagReader(write(tmp_path / 'bag', messages)) as reader:
        recorded = read_positions(reader, ['/rig/states', '/other'], ('plate', 'projectile'))
    states, others = recorded['/rig/states'], recorded['/other']
    np.testing.assert_equal(states.rows, {0: [1.0, 2.0], 5: [3.0, np.nan]})
    assert (states.unreadable, states.names) == (1, {'plate', 'projectile', 'table'})
    np.testing.assert_equal(others.rows, {0: [3.0, np.nan], 1: [np.nan, np.nan]})
    assert (states.time_scale, others.time_scale) == (0.1, 1.0)
