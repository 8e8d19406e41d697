# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Messages JointState as bytes, compared with an independent encoder, and in bags."""

from __future__ import annotations

from typing import Any

from bags import BEGIN, text, write
from hypothesis import given
from hypothesis import strategies as st
import numpy as np
import pytest
from rosbags.typesys import get_typestore, Stores
from soft_throw_ros.configuration.interface import JOINT_STATE, TEXT
from soft_throw_ros.storage.bag_reader import BagReader
from soft_throw_ros.storage.cdr import JointStateEncoder, JointStateReader, MessageError
from soft_throw_ros.storage.message import Channel, Message
from soft_throw_ros.storage.recorded_positions import read_positions

STAMP = 1_700_000_000_123_456_789
STORES = [get_typestore(Stores.ROS2_JAZZY), get_typestore(Stores.ROS2_KILTED)]
TEXTS = st.text(st.characters(exclude_characters='\0', codec='utf-8'), max_size=9)


def joint_state(names: Any, series: Any, *, frame: str = '', stamp: int = STAMP,
                store: Any = STORES[0]) -> bytes:
    """Serialize a JointState with an independent encoder, which pads with zeros."""
    types = store.types
    time = types['builtin_interfaces/msg/Time'](stamp // 10**9, stamp % 10**9)
    message = types['sensor_msgs/msg/JointState'](
        types['std_msgs/msg/Header'](time, frame), list(names), *map(np.array, series)
    )
    return bytes(store.serialize_cdr(message, 'sensor_msgs/msg/JointState'))


@given(
    frame=TEXTS, names=st.lists(TEXTS, max_size=4), count=st.integers(1, 3), data=st.data(),
    store=st.sampled_from(STORES),
)
def test_joint_states_are_written_and_read_as_by_others(frame, names, count, data, store) -> None:
    numbers = st.floats(allow_nan=False)
    row = st.lists(numbers, min_size=len(names), max_size=len(names))
    values = data.draw(st.lists(row, min_size=count, max_size=count))
    encode = JointStateEncoder(frame, names, series=count).encode
    theirs = joint_state(names, [*values, *[[]] * (3 - count)], frame=frame, store=store)
    assert encode(STAMP, [number for row in values for number in row]) == theirs
    # Foreign messages may have series of other lengths
    series = data.draw(st.lists(st.lists(numbers, max_size=4), min_size=3, max_size=3))
    messages = [joint_state(names, series, frame=frame, stamp=STAMP + n) for n in range(2)]
    reader = JointStateReader()
    many = reader.read_all(messages)
    assert many.names == tuple(names)
    assert many.stamps.tolist() == [STAMP, STAMP + 1]
    for array, expected in zip((many.position, many.velocity, many.effort), series, strict=True):
        assert array.tolist() == [expected, expected]
    cut = data.draw(st.integers(0, len(theirs) - 1))
    with pytest.raises(MessageError):
        reader.read_all([theirs[:cut]])
    assert reader.read_all([theirs]).names == tuple(names)  # after a damaged one


def test_padding_of_joint_states_is_ignored() -> None:
    message = joint_state(('a', 'bc'), [[0.0, 1.0], [], []])
    padded = message.replace(b'a\x00\x00\x00', b'a\x00\x55\xaa')
    assert padded != message
    longer = message + bytes(12)  # `serialize_message` of rclpy leaves up to a dozen bytes
    rows = JointStateReader().read_all([message, padded, longer]).position
    np.testing.assert_array_equal(rows, [[0.0, 1.0]] * 3)


STATES = Channel(topic='/rig/states', type=JOINT_STATE, schema='string name')
OTHERS = Channel(topic='/other', type=JOINT_STATE, schema='string name')
JOURNAL = Channel(topic='/rig/journal', type=TEXT, schema='string data')
SETTINGS = '{"kind":"start","settings":{"joint_names.plate":"table","time_scale":0.1}}'


def test_joints_are_found_by_the_names_of_the_journal_and_other_messages_are_counted(tmp_path):
    def positions(names, values, stamp):
        return joint_state(names, [values, [], []], stamp=stamp)

    contents = [
        *((JOURNAL, text(line)) for line in ('[' * 100_000, '{"settings":{"time_scale":null}}')),
        (JOURNAL, text(SETTINGS)),
        (STATES, positions(('projectile', 'plate', 'table'), [2.0, 9.0, 1.0], 0)),
        (STATES, positions(('table',), [3.0], 5)),
        (STATES, positions(('table',), [4.0], 5)),  # the first of equal stamps counts
        (STATES, text('no joint state')),
        (OTHERS, positions(('plate', 'table'), [3.0, 4.0], 0)),  # without a journal beside it
        (OTHERS, positions(('arm',), [4.0], 1)),
    ]
    messages = [Message(channel, data, BEGIN, BEGIN) for channel, data in contents]
    with BagReader(write(tmp_path / 'bag', messages)) as reader:
        recorded = read_positions(reader, ['/rig/states', '/other'], ('plate', 'projectile'))
    states, others = recorded['/rig/states'], recorded['/other']
    np.testing.assert_equal(states.rows, {0: [1.0, 2.0], 5: [3.0, np.nan]})
    assert (states.unreadable, states.names) == (1, {'plate', 'projectile', 'table'})
    np.testing.assert_equal(others.rows, {0: [3.0, np.nan], 1: [np.nan, np.nan]})
    assert (states.time_scale, others.time_scale) == (0.1, 1.0)
