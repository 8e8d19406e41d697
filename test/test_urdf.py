# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""The URDF model of the rig, read by urdf_parser_py."""

from pathlib import Path

import numpy as np
import pytest
from soft_throw_ros.configuration import files, rig_of, TWIN
from soft_throw_ros.configuration.interface import FRAME, JOINTS, LAYER_JOINTS
from soft_throw_ros.configuration.robot_model import urdf_of_file
from urdf_parser_py.urdf import URDF
import yaml

MODEL = Path(__file__).parents[1] / 'urdf/soft_throw.urdf'
RIG = rig_of(TWIN.defaults())


@pytest.fixture(scope='module')
def robot():
    """Return the parsed model; the parser would not close a file."""
    return URDF.from_xml_string(MODEL.read_bytes())


def test_model_can_be_the_value_of_a_parameter():
    text = MODEL.read_text()
    assert ' '.join(yaml.safe_load(text).split()) == ' '.join(text.split())


def test_joints_agree_with_the_twin(robot):
    assert robot.get_root() == FRAME
    names = tuple(joint.name for joint in robot.joints)
    assert names[:2] == JOINTS
    assert set(names[2:]) <= set(LAYER_JOINTS)
    assert {names[2], names[-1]} == {LAYER_JOINTS[0], LAYER_JOINTS[-1]}
    for joint in robot.joints:  # positions are heights above the plate at rest
        assert (joint.type, joint.parent, joint.origin) == ('prismatic', FRAME, None)
        assert joint.axis == [0.0, 0.0, 1.0]


@pytest.fixture
def bodies_of(write):
    """Return a function that returns the model of a rig, and the visuals of its links by name."""

    def bodies_of(settings, **options):
        path = write(files.render(settings))
        text = urdf_of_file(MODEL.read_text(), path, node='/twin', **options)
        robot = URDF.from_xml_string(text.encode())
        return robot, {link.name: link.visual for link in robot.links if link.visual is not None}

    return bodies_of


@pytest.mark.parametrize(
    ('request_', 'thickness'),
    [
        ({}, 16.8e-3),
        ({'layer.thickness': 5.6e-3, 'layer.diameter': 0.02, 'projectile.length': 0.0163}, 5.6e-3),
        ({'layer.stack': '8e-3 19 1350, 20e-3 5 1000'}, 28e-3),
    ],
    ids=['default', 'layer', 'stack'],
)
def test_sizes_are_those_of_the_parameters(robot, bodies_of, request_, thickness):
    settings = TWIN.defaults()
    settings |= TWIN.change(settings, request_)
    sized, visuals = bodies_of(settings)
    assert [joint.name for joint in sized.joints] == [joint.name for joint in robot.joints]
    diameter = settings['layer.diameter']
    plate, projectile = visuals['plate'], visuals['projectile']
    assert plate.origin.xyz == pytest.approx([0.0, 0.0, -0.5 * plate.geometry.length])
    assert 2.0 * plate.geometry.radius == 2.5 * diameter
    assert projectile.geometry.length == settings['projectile.length']
    assert projectile.origin.xyz == [0.0, 0.0, 0.5 * settings['projectile.length']]
    slices = [visuals[name] for name in LAYER_JOINTS if name in visuals]
    assert {2.0 * item.geometry.radius for item in [projectile, *slices]} == {diameter}
    # At rest the slices fill the same part of every layer, from the plate to the top
    heights = [thickness * LAYER_JOINTS.index(name) / (len(LAYER_JOINTS) - 1)
               for name in LAYER_JOINTS if name in visuals]
    middles = [z + item.origin.xyz[2] for z, item in zip(heights, slices, strict=True)]
    halves = [0.5 * item.geometry.length for item in slices]
    assert middles[0] - halves[0] == pytest.approx(0.0, abs=1e-12)
    assert middles[-1] + halves[-1] == pytest.approx(thickness)
    assert np.sum(halves) == pytest.approx(0.5 * thickness * 10.0 / 14.0)
