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
"""Messages as bytes, against somebody else's encoder, and against ROS."""

from __future__ import annotations

import contextlib
import math

from hypothesis import given
from hypothesis import strategies as st
import numpy as np
import pytest
from rclpy.serialization import deserialize_message
from rosbags.typesys import get_typestore, Stores
from sensor_msgs.msg import JointState
from soft_throw_ros.recording.cdr import (
    decode,
    decode_array,
    decode_joint_states,
    encode_array,
    JointStateEncoder,
    JointStateReader,
    MessageError,
)
from soft_throw_ros.twin.results import State

STATE = State(1e-3, 0.0168, -0.25, 1.25, -math.pi, math.pi)
STAMP = 1_700_000_000_123_456_789
READER = JointStateReader()
JAZZY = get_typestore(Stores.ROS2_JAZZY)


@pytest.fixture(params=[Stores.ROS2_JAZZY, Stores.ROS2_KILTED], ids=lambda store: store.value)
def typestore(request: pytest.FixtureRequest) -> object:
    """Somebody else's encoder, which writes no padding but zeros."""
    return get_typestore(request.param)


@pytest.mark.parametrize('names', [('plate', 'projectile'), ('a', 'bc'), ('abcd', 'efg', 'h')])
@pytest.mark.parametrize('frame', ['rig', '', 'abcdefgh'])
@pytest.mark.parametrize('series', [1, 2, 3])
def test_joint_state_bytes_are_canonical(typestore, frame, names, series) -> None:
    types = typestore.types
    values = np.random.default_rng(2).normal(size=(series, len(names)))
    message = types['sensor_msgs/msg/JointState'](
        types['std_msgs/msg/Header'](
            types['builtin_interfaces/msg/Time'](STAMP // 10**9, STAMP % 10**9), frame
        ),
        list(names),
        *values,
        *[np.zeros(0)] * (3 - series),
    )
    canonical = bytes(typestore.serialize_cdr(message, 'sensor_msgs/msg/JointState'))
    encoder = JointStateEncoder(frame, names, series=series)
    assert encoder.encode(STAMP, values.ravel().tolist()) == canonical


@pytest.mark.filterwarnings('ignore::DeprecationWarning')  # what rclpy imports is obsolete
def test_joint_state_bytes_are_read_by_ros() -> None:
    encoder = JointStateEncoder('rig', ('plate', 'projectile'))
    encoder.encode(0, State(*[math.nan] * 6))
    message = deserialize_message(encoder.encode(STAMP, STATE), JointState)
    stamp = message.header.stamp
    assert stamp.sec * 10**9 + stamp.nanosec == STAMP
    assert message.header.frame_id == 'rig'
    assert list(message.name) == ['plate', 'projectile']
    assert (*message.position, *message.velocity, *message.effort) == STATE


@pytest.mark.parametrize('dimensions', [{'y': 64}, {'t': 3, 'y': 5}, {'abc': 1}])
def test_array_bytes_are_canonical(typestore, dimensions) -> None:
    types = typestore.types
    values = np.random.default_rng(1).normal(size=tuple(dimensions.values()))
    sizes = list(dimensions.values())
    layout = types['std_msgs/msg/MultiArrayLayout'](
        dim=[
            types['std_msgs/msg/MultiArrayDimension'](
                label=label, size=size, stride=math.prod(sizes[index:])
            )
            for index, (label, size) in enumerate(dimensions.items())
        ],
        data_offset=0,
    )
    message = types['std_msgs/msg/Float64MultiArray'](layout=layout, data=values.reshape(-1))
    canonical = bytes(typestore.serialize_cdr(message, 'std_msgs/msg/Float64MultiArray'))
    assert encode_array(list(dimensions), values) == canonical


def joint_state(stamp: int = STAMP, names=('plate', 'projectile'), lengths=(2, 2, 2)) -> bytes:
    types = JAZZY.types
    values = [np.arange(length) + 10.0 * index for index, length in enumerate(lengths)]
    message = types['sensor_msgs/msg/JointState'](
        types['std_msgs/msg/Header'](
            types['builtin_interfaces/msg/Time'](stamp // 10**9, stamp % 10**9), 'rig'
        ),
        list(names),
        *values,
    )
    return bytes(JAZZY.serialize_cdr(message, 'sensor_msgs/msg/JointState'))


@pytest.mark.parametrize('names', [(), ('a',), ('abc', 'defg', 'h')])
@pytest.mark.parametrize('lengths', [(0, 0, 0), (3, 0, 3), (0, 1, 0), (2, 3, 4)])
def test_joint_states_of_others_come_back(names, lengths) -> None:
    read = decode_joint_states([joint_state(names=names, lengths=lengths)] * 2)
    assert read.names == names
    for index, series in enumerate((read.position, read.velocity, read.effort)):
        expected = np.arange(lengths[index]) + 10.0 * index
        np.testing.assert_array_equal(series, [expected, expected])


@pytest.mark.parametrize('lengths', [(0, 0, 0), (3, 0, 3), (0, 1, 0), (2, 3, 4)])
def test_joint_states_are_read_as_they_come(lengths) -> None:
    reader = JointStateReader()
    for names in ((), ('a',), ('abc', 'defg', 'h'), ('abc', 'defg', 'h'), ('abd', 'defg', 'h')):
        for stamp in (STAMP, STAMP + 1):
            read = reader.read(joint_state(stamp, names, lengths))
            assert read[:2] == (stamp, names)
            for index, series in enumerate(read[2:]):
                assert series == tuple(10.0 * index + n for n in range(lengths[index]))


def test_padding_of_joint_states_may_hold_anything() -> None:
    message = joint_state(names=('a', 'bc'), lengths=(2, 0, 0))
    padded = message.replace(b'a\x00\x00\x00', b'a\x00\x55\xaa')
    assert padded != message
    reader = JointStateReader()
    assert reader.read(padded) == reader.read(message)
    both = decode_joint_states([message, padded])
    np.testing.assert_array_equal(*both.position)


def test_message_after_a_damaged_one_is_read() -> None:
    reader = JointStateReader()
    with pytest.raises(MessageError, match='should be at least'):
        reader.read(joint_state()[:-9])
    with pytest.raises(MessageError, match='not little-endian'):
        reader.read(b'\x00\x00\x00\x00')
    assert reader.read(joint_state()).names == ('plate', 'projectile')


@pytest.mark.parametrize('dimensions', [{}, {'y': 0}, {'y': 64}, {'t': 3, 'y': 5}])
def test_array_comes_back(dimensions) -> None:
    values = np.random.default_rng(4).normal(size=tuple(dimensions.values()))
    labels, decoded = decode_array(encode_array(list(dimensions), values))
    assert labels == list(dimensions)
    np.testing.assert_array_equal(decoded, values)


def test_array_that_is_not_what_it_says_is_refused() -> None:
    data = bytearray(encode_array(['y'], np.zeros(64)))
    data[data.index(64)] = 63
    with pytest.raises(MessageError, match=r'\[63\] cannot have 64'):
        decode_array(bytes(data))


def test_any_message_comes_back() -> None:
    definition, _ = JAZZY.generate_msgdef('sensor_msgs/msg/JointState', ros_version=2)
    message = decode('sensor_msgs/msg/JointState', definition, joint_state())
    assert message.header.stamp.nanosec == STAMP % 10**9
    assert list(message.effort) == [20.0, 21.0]


@given(st.data())
def test_damaged_messages_are_refused_or_read(data) -> None:
    definition, _ = JAZZY.generate_msgdef('sensor_msgs/msg/JointState', ros_version=2)
    message = bytearray(joint_state())
    for _ in range(data.draw(st.integers(0, 3))):
        message[data.draw(st.integers(0, len(message) - 1))] ^= 1 << data.draw(st.integers(0, 7))
    damaged = bytes(message[: data.draw(st.integers(0, len(message)))])
    for read in (
        lambda: decode_joint_states([damaged]),
        lambda: READER.read(damaged),
        lambda: decode_array(damaged),
        lambda: decode('sensor_msgs/msg/JointState', definition, damaged),
    ):
        with contextlib.suppress(MessageError):
            read()
