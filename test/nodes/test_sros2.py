# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
The SROS 2 policies allow each node its own topics and services only.

The enforcement by DDS is not tested: the wheels of ROS are built without DDS security.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
import contextlib
from pathlib import Path
from typing import Any

import bags
import pytest
from rclpy.node import Node
from soft_throw_ros.configuration.interface import ALL_TWIN_TOPICS, INTERFACES, resolve
from soft_throw_ros.nodes.calibrator import Calibrator
from soft_throw_ros.nodes.player import Player
from soft_throw_ros.nodes.recorder import Recorder
from soft_throw_ros.nodes.viewer import Viewer
from soft_throw_ros.storage.bag_reader import BagReader

etree = pytest.importorskip('lxml.etree')  # supports XInclude, like sros2

POLICY = Path(__file__).parents[2] / 'config/sros2/policy.xml'
NODES = ('twin', 'recorder', 'viewer', 'replay', 'calibrator')
OF_ALL = {
    'publish': {'/parameter_events', '/rosout', '/diagnostics'},
    'subscribe': {'/parameter_events', '/clock'},
}
"""Topics that every node may use, besides the services of its parameters and types."""

OF_THE_TWIN = {resolve(topic.name, '/twin') for topic in ALL_TWIN_TOPICS}

ENDINGS = (
    '/describe_parameters', '/get_parameter_types', '/get_parameters', '/get_type_description',
    '/list_parameters', '/set_parameters', '/set_parameters_atomically',
)

Rules = dict[str, set[str]]


def rules_of(name: str, enclave: str = '') -> Rules:
    """Read the permissions of a node from the policy, with full names."""
    policy = etree.parse(POLICY)
    policy.xinclude()
    (profile,) = policy.findall(
        f'.//enclave[@path="/soft_throw/{enclave or name}"]/profiles/profile[@node="{name}"]'
    )
    assert profile.get('ns') == '/'
    rules: Rules = {}
    for listed in profile:
        names = {resolve(item.text, f'/{name}') for item in listed}
        assert all(item.startswith('/') for item in names)
        for verb, value in listed.attrib.items():
            if not verb.startswith('{'):  # XInclude adds the path of the included file
                assert value == 'ALLOW'
                rules.setdefault(verb, set()).update(names)
    return rules


def test_every_topic_and_service_of_the_tables_is_in_a_policy() -> None:
    for name in NODES:
        allowed = rules_of(name)
        topics, services = INTERFACES[name]
        for topic in topics:
            verb = 'subscribe' if topic.is_input else 'publish'
            full = topic.name if topic.name.startswith(('~', '/')) else f'/{topic.name}'
            assert resolve(full, f'/{name}') in allowed[verb]
        own = {resolve(service.name, f'/{name}') for service in services}
        about_parameters = {item for item in allowed['reply'] if item.endswith(ENDINGS)}
        assert allowed['reply'] == own | about_parameters
        assert len(about_parameters) == len(ENDINGS)


def test_recorder_receives_and_replay_sends_all_topics_of_a_twin() -> None:
    assert rules_of('recorder')['subscribe'] >= OF_THE_TWIN
    assert rules_of('replay')['publish'] >= OF_THE_TWIN


def test_viewer_has_equal_permissions_by_either_start() -> None:
    by_hand, by_recorder = rules_of('viewer'), rules_of('recorder_viewer', enclave='recorder')
    assert by_hand['subscribe'] == by_recorder['subscribe']
    assert by_hand['publish'] == by_recorder['publish']


@pytest.mark.parametrize('name', NODES)
def test_node_may_publish_only_its_own_topics(name) -> None:
    published = rules_of(name)['publish'] - OF_ALL['publish']
    if name == 'replay':
        assert published == OF_THE_TWIN - {'/diagnostics'} | {'/clock'}
    else:
        assert all(item.startswith(f'/{name}/') for item in published)


@pytest.fixture
def make(ros: Any, start_twin: Any, tmp_path: Path) -> Iterator[Callable[[str], Node]]:
    """Yield a function that makes a node with all its topics and services in use."""
    readers = contextlib.ExitStack()

    def make(name: str) -> Node:
        if name == 'twin':
            return start_twin('-p', 'engine.motion:=measured', '-p', 'use_sim_time:=true')
        if name == 'replay':
            path = tmp_path / 'bag'
            bags.write(path, [bags.Message(bags.channel('/twin/phase'), bags.text('rest'), 1, 1)])
            return ros.node(Player, readers.enter_context(BagReader(path)), clock=10.0)
        words = ('-p', 'rig:=rig')
        if name in ('recorder', 'viewer'):
            start_twin()
            words = ('-p', f'folder:={tmp_path}')
        if name == 'viewer':
            pytest.importorskip('rerun')
            words = ('-p', 'sink:=file', '-p', f'file:={tmp_path}/live.rrd')
        node = ros.node(
            {'recorder': Recorder, 'viewer': Viewer, 'calibrator': Calibrator}[name],
            ros_args=words,
            arguments=('--ros-args', *words),
        )
        if name in ('recorder', 'viewer'):
            node.start()
            ros.spin_until(lambda: '/twin/journal' in subscribed(node), 'the topics of the twin')
        return node

    yield make
    readers.close()


def subscribed(node: Node) -> set[str]:
    return {item.topic_name for item in node.subscriptions}


@pytest.mark.parametrize('name', NODES)
def test_node_needs_no_forbidden_topic_or_service(make, name) -> None:
    node = make(name)
    full_name = (node.get_name(), node.get_namespace())
    does = {
        'publish': node.get_publisher_names_and_types_by_node(*full_name),
        'subscribe': node.get_subscriber_names_and_types_by_node(*full_name),
        'reply': node.get_service_names_and_types_by_node(*full_name),
        'request': node.get_client_names_and_types_by_node(*full_name),
    }
    allowed = rules_of(name)
    for verb, endpoints in does.items():
        names = {full for full, _ in endpoints}
        assert names <= allowed.get(verb, set()), verb
    assert does['publish']
    assert does['reply']
