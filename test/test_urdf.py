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
"""The model of the rig for robot_state_publisher, as another parser reads it."""

from pathlib import Path

import numpy as np
import pytest
from soft_throw_ros.configuration import rig_of, TWIN
from soft_throw_ros.configuration.interface import FRAME, JOINTS, LAYER_JOINTS
from soft_throw_ros.core.throw import simulate
from urdf_parser_py.urdf import URDF
import yaml

MODEL = Path(__file__).parents[1] / 'urdf/soft_throw.urdf'
RIG = rig_of(TWIN.defaults())


@pytest.fixture(scope='module')
def robot():
    """Parse from text, since the parser leaves files open."""
    return URDF.from_xml_string(MODEL.read_bytes())


def test_model_can_be_the_value_of_a_parameter():
    text = MODEL.read_text()
    assert ' '.join(yaml.safe_load(text).split()) == ' '.join(text.split())


def test_joints_are_those_of_the_twin(robot):
    assert robot.get_root() == FRAME
    names = tuple(joint.name for joint in robot.joints)
    assert names[:2] == JOINTS
    assert set(names[2:]) <= set(LAYER_JOINTS)
    assert {names[2], names[-1]} == {LAYER_JOINTS[0], LAYER_JOINTS[-1]}
    for joint in robot.joints:  # positions are heights above the plate at rest
        assert (joint.type, joint.parent, joint.origin) == ('prismatic', FRAME, None)
        assert joint.axis == [0.0, 0.0, 1.0]


@pytest.mark.parametrize(('name', 'side'), [('plate', 1.0), ('projectile', -1.0)])
def test_bodies_are_drawn_where_their_positions_say(robot, name, side):
    visual = robot.link_map[robot.joint_map[name].child].visual
    assert np.allclose(visual.origin.xyz, [0.0, 0.0, -side * visual.geometry.length / 2])


def test_projectile_is_that_of_the_default_rig(robot):
    geometry = robot.link_map['projectile'].visual.geometry
    assert geometry.length == RIG.projectile.length
    assert 2.0 * geometry.radius == RIG.layer.diameter


def test_limits_cover_the_rig(robot):
    largest = TWIN.by_name['engine.amplitude'].high
    fastest = TWIN.by_name['engine.frequency'].high
    plate, projectile = (robot.joint_map[name].limit for name in JOINTS)
    assert plate.lower < 0.0
    assert plate.upper == 2.0 * largest
    assert plate.velocity > 2.0 * np.pi * fastest * largest
    apex = RIG.layer.thickness + simulate(RIG).ejection_speed ** 2 / (2.0 * RIG.gravity)
    assert projectile.lower < 0.0
    assert projectile.upper > 5.0 * apex
    assert projectile.velocity > 2.1 * plate.velocity
