# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""The table of topics, searched by a name and a type."""

from soft_throw_ros.configuration.interface import find_topic, RECORDER_TOPICS, TWIN_TOPICS


def test_topic_is_found_by_its_full_name_and_type_and_no_other_is() -> None:
    for topic in (topic for topic in (*TWIN_TOPICS, *RECORDER_TOPICS) if '~' in topic.name):
        for node in ('/twin', '/rig1/twin', '/layer'):
            assert find_topic(topic.at(node).name, topic.type) == (node, topic)
    joint_state = TWIN_TOPICS.joint_states.type
    for name in ('/twin/phase', '/twin/joint_states_too'):
        assert find_topic(name, joint_state) is None
    assert find_topic('/rig1/diagnostics', TWIN_TOPICS.diagnostics.type) is None
    assert len({topic.name for topic in TWIN_TOPICS}) == len(TWIN_TOPICS)
