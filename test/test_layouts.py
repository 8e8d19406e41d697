# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Layouts for other viewers and groups of diagnostics name existing topics and nodes."""

import json
from pathlib import Path
import re
from xml.etree import ElementTree as ET

import pytest
from soft_throw_ros.configuration.interface import (
    ALL_TWIN_TOPICS,
    JOINT_STATE,
    NUMBER,
    resolve,
)
import yaml

CONFIG = Path(__file__).parents[1] / 'config'
TOPICS = {resolve(topic.name, '/twin'): topic for topic in ALL_TWIN_TOPICS}


def foxglove_paths():
    layout = json.loads((CONFIG / 'foxglove.json').read_text())
    panels = layout['configById'].values()
    return [path['value'] for panel in panels for path in panel.get('paths', [])]


def plotjuggler_curves():
    root = ET.parse(CONFIG / 'plotjuggler.xml')
    return [curve.get('name') for curve in root.iter('curve')]


def test_foxglove_plots_topics_of_the_twin():
    for path in foxglove_paths():
        name, field, index = re.fullmatch(r'([\w/]+)\.(\w+)(?:\[(\d+)\])?', path).groups()
        topic = TOPICS[name]
        if topic.type == JOINT_STATE:
            assert field in topic.quantities
            assert int(index) < len(topic.joints)
        else:
            assert (topic.type, field, index) == (NUMBER, 'data', None)


def test_plotjuggler_plots_topics_of_the_twin():
    for curve in plotjuggler_curves():
        name = max((name for name in TOPICS if curve.startswith(f'{name}/')), key=len)
        topic, fields = TOPICS[name], curve.removeprefix(f'{name}/').split('/')
        if topic.type == JOINT_STATE:
            joint, quantity = fields
            assert joint in topic.joints
            assert quantity in topic.quantities
        else:
            assert (topic.type, fields) == (NUMBER, ['data'])


@pytest.mark.parametrize('node', ['twin', 'recorder'])
def test_diagnostics_of_every_namespace_are_grouped_by_node(node):
    (parameters,) = yaml.safe_load((CONFIG / 'diagnostic_aggregator.yaml').read_text()).values()
    groups = {
        key: value['regex'][0]
        for key, value in parameters['ros__parameters'].items()
        if isinstance(value, dict)
    }
    for namespace in ('', '/rig1', '/hall/rig1'):
        status = f'{namespace}/{node}: timing'
        assert [name for name, regex in groups.items() if re.fullmatch(regex, status)] == [node]
