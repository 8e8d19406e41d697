# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Layouts for other viewers and groups of diagnostics name existing topics and nodes."""

import json
from pathlib import Path
import re
from xml.etree import ElementTree as ET

import pytest
from soft_throw_ros.configuration.interface import ARRAY, JOINT_STATE, resolve, TWIN_TOPICS
import yaml

CONFIG = Path(__file__).parents[1] / 'config'
TOPICS = {resolve(topic.name, '/twin'): topic for topic in TWIN_TOPICS}


def test_foxglove_plots_topics_of_the_twin(result_keys):
    panels = json.loads((CONFIG / 'foxglove.json').read_text())['configById'].values()
    for path in [path['value'] for panel in panels for path in panel.get('paths', [])]:
        name, rest = re.fullmatch(r'([\w/]+)\.(.*)', path).groups()
        topic = TOPICS[name]
        if topic.type == JOINT_STATE:
            field, index = re.fullmatch(r'(\w+)\[(\d+)\]', rest).groups()
            assert field in topic.quantities
            assert int(index) < len(topic.joints)
        else:
            assert topic.type == ARRAY
            (key,) = re.fullmatch(r'status\[0\]\.values\[:\]{key=="(\w+)"}\.value', rest).groups()
            assert key in result_keys


def test_plotjuggler_plots_topics_of_the_twin(result_keys):
    root = ET.parse(CONFIG / 'plotjuggler.xml')
    for curve in [curve.get('name') for curve in root.iter('curve')]:
        name = max((name for name in TOPICS if curve.startswith(f'{name}/')), key=len)
        topic, rest = TOPICS[name], curve.removeprefix(f'{name}/')
        if topic.type == JOINT_STATE:
            joint, quantity = rest.split('/')
            assert joint in topic.joints
            assert quantity in topic.quantities
        else:  # hardware_id, name and key
            assert topic.type == ARRAY
            (key,) = re.fullmatch(r'/twin//twin: (?:throw|recommendation)/(\w+)', rest).groups()
            assert key in result_keys


@pytest.mark.parametrize(
    ('node', 'task'), [('twin', 'timing'), ('recorder', 'bag'), ('calibrator', 'identification')]
)
def test_diagnostics_are_grouped_in_every_namespace_by_the_kind_of_node(node, task):
    (parameters,) = yaml.safe_load((CONFIG / 'diagnostic_aggregator.yaml').read_text()).values()
    groups = {
        key: value['regex'][0]
        for key, value in parameters['ros__parameters'].items()
        if isinstance(value, dict)
    }
    for name in (f'/{node}', '/rig1/renamed', '/hall/rig1/t'):
        status = f'{name}: {task}'
        assert [key for key, regex in groups.items() if re.fullmatch(regex, status)] == [node]
