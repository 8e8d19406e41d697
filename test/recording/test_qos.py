# SPDX-License-Identifier: Apache-2.0
"""Quality of service, as other programs write and read it."""

from hypothesis import given
from hypothesis import strategies as st
import pytest
from rosbags.interfaces import (
    Qos as RosbagsQos,
)
from rosbags.interfaces import (
    QosDurability,
    QosHistory,
    QosLiveliness,
    QosReliability,
    QosTime,
)
from rosbags.rosbag2.metadata import dump_qos_v8, dump_qos_v9, parse_qos
from soft_throw_ros.recording.qos import dump_yaml, from_yaml, INFINITE, Qos, to_yaml

TIMES = st.one_of(st.just(INFINITE), st.integers(0, INFINITE))


@st.composite
def profiles(draw):
    """Draw a profile, and the same one as rosbags describes it."""
    kinds = (QosHistory, QosReliability, QosDurability, QosLiveliness)
    policies = {kind.__name__[3:].lower(): draw(st.sampled_from(kind)) for kind in kinds}
    times = {name: draw(TIMES) for name in ('deadline', 'lifespan', 'liveliness_lease_duration')}
    others = {
        'depth': draw(st.integers(0, 2**31)),
        'avoid_ros_namespace_conventions': draw(st.booleans()),
    }
    ours = Qos(
        **{name: policy.name.lower() for name, policy in policies.items()}, **times, **others
    )
    theirs = RosbagsQos(
        **policies,
        **{name: QosTime(*divmod(time, 10**9)) for name, time in times.items()},
        **others,
    )
    return ours, theirs


@given(st.lists(profiles(), max_size=3))
def test_profiles_are_written_so_that_others_read_them(pairs):
    text = to_yaml([ours for ours, _ in pairs])
    assert parse_qos(text) == [theirs for _, theirs in pairs]
    assert [ours.to_dict() for ours, _ in pairs] == dump_qos_v9([theirs for _, theirs in pairs])


@given(st.lists(profiles(), max_size=3))
def test_profiles_of_every_version_are_read(pairs):
    ours = tuple(ours for ours, _ in pairs)
    theirs = [theirs for _, theirs in pairs]
    assert from_yaml(to_yaml(ours)) == ours
    assert from_yaml(dump_yaml(dump_qos_v9(theirs))) == ours
    assert from_yaml(dump_qos_v8(theirs)) == ours


@pytest.mark.parametrize(
    ('text', 'profiles'),
    [
        (None, ()),
        ('', ()),
        ('[]', ()),
        ('[{depth: 3}]', (Qos(depth=3),)),  # the rest is the default
        # what rosbag2 may have by now, and we do not know
        (
            '[{history: 9, durability: permanent, depth: 1}]',
            (Qos(history='unknown', durability='unknown', depth=1),),
        ),
    ],
)
def test_what_is_not_said_or_not_known_is_read(text, profiles):
    assert from_yaml(text) == profiles


@pytest.mark.parametrize(
    'text', ['{', 'depth', '[3]', '[{depth: many}]', '[{deadline: {sec: 1}}]', '[' * 1000, '[[1]]']
)
def test_what_is_no_profile_is_refused_and_quoted(text):
    with pytest.raises(ValueError, match='quality of service') as refusal:
        from_yaml(text)
    assert repr(text)[:50] in str(refusal.value)


def test_policy_that_does_not_exist_is_refused():
    with pytest.raises(ValueError, match=r"durability .*'latched'"):
        Qos(durability='latched')
