# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Messages as bytes, compared with an independent encoder and with ROS."""

from __future__ import annotations

import math

import numpy as np
import pytest
from rosbags.typesys import get_typestore, Stores
from soft_throw_ros.storage.cdr import JointStateEncoder, JointStateReader, MessageError
from soft_throw_ros.twin.results import State

STATE = State(1e-3, 0.0168, -0.25, 1.25, -math.pi, math.pi)
STAMP = 1_700_000_000_123_456_789
JAZZY = get_typestore(Stores.ROS2_JAZZY)


def joint_state(names, values, *, stamp=STAMP, frame='rig', typestore=JAZZY) -> bytes:
    """Serialize a JointState with an independent encoder."""
    types = typestore.types
    message = types['sensor_msgs/msg/JointState'](
        types['std_msgs/msg/Header'](
            types['builtin_interfaces/msg/Time'](stamp // 10**9, stamp % 10**9), frame
        ),
        list(names),
        *values,
    )
    return bytes(typestore.serialize_cdr(message, 'sensor_msgs/msg/JointState'))


@pytest.fixture(params=[Stores.ROS2_JAZZY, Stores.ROS2_KILTED], ids=lambda store: store.value)
def typestore(request: pytest.FixtureRequest) -> object:
    """Return the types of an independent encoder, which pads with zeros."""
    return get_typestore(request.param)


@pytest.mark.parametrize('names', [('plate', 'projectile'), ('a', 'bc'), ('abcd', 'efg', 'h')])
@pytest.mark.parametrize('frame', ['rig', '', 'abcdefgh'])
@pytest.mark.parametrize('series', [1, 2, 3])
def test_joint_state_bytes_are_canonical(typestore, frame, names, series) -> None:
    values = np.random.default_rng(2).normal(size=(series, len(names)))
    complete = [*values, *[np.zeros(0)] * (3 - series)]
    canonical = joint_state(names, complete, frame=frame, typestore=typestore)
    encoder = JointStateEncoder(frame, names, series=series)
    assert encoder.encode(STAMP, values.ravel().tolist()) == canonical


@pytest.mark.parametrize('lengths', [(0, 0, 0), (3, 0, 3), (0, 1, 0), (2, 3, 4)])
def test_foreign_joint_states_are_decoded(lengths) -> None:
    reader = JointStateReader()
    expected = [np.arange(length) + 10.0 * index for index, length in enumerate(lengths)]
    for names in ((), ('a',), ('abc', 'defg', 'h'), ('abc', 'defg', 'h'), ('abd', 'defg', 'h')):
        messages = [joint_state(names, expected, stamp=stamp) for stamp in (STAMP, STAMP + 1)]
        many = JointStateReader().read_all(messages)
        assert (many.stamps.tolist(), many.names) == ([STAMP, STAMP + 1], names)
        for series, values in zip(
            (many.position, many.velocity, many.effort), expected, strict=True
        ):
            np.testing.assert_array_equal(series, [values, values])
        for message, stamp in zip(messages, many.stamps, strict=True):
            one = reader.read(message)
            assert one[:2] == (stamp, names)
            assert [*map(list, one[2:])] == [*map(list, expected)]


def test_padding_of_joint_states_is_ignored() -> None:
    message = joint_state(('a', 'bc'), [np.arange(2.0), np.zeros(0), np.zeros(0)])
    padded = message.replace(b'a\x00\x00\x00', b'a\x00\x55\xaa')
    assert padded != message
    reader = JointStateReader()
    assert reader.read(padded) == reader.read(message)
    both = JointStateReader().read_all([message, padded])
    np.testing.assert_array_equal(*both.position)


def test_message_after_a_damaged_one_is_read() -> None:
    reader, message = JointStateReader(), joint_state(('plate', 'projectile'), np.ones((3, 2)))
    with pytest.raises(MessageError, match='should be at least'):
        reader.read(message[:-9])
    with pytest.raises(MessageError, match='not little-endian'):
        reader.read(b'\x00\x00\x00\x00')
    assert reader.read(message).names == ('plate', 'projectile')
