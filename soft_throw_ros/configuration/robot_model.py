# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""The URDF of a rig with its own sizes, for the launch files."""

from __future__ import annotations

from pathlib import Path
from typing import Any
from xml.etree import ElementTree as ET

from soft_throw_ros.configuration import files
from soft_throw_ros.configuration.interface import JOINTS, LAYER_JOINTS
from soft_throw_ros.configuration.table import Settings
from soft_throw_ros.configuration.twin import joint_names, TWIN


def urdf_of_file(urdf: str, path: str | Path, *, node: str, frame_prefix: str = '') -> str:
    """
    Return a URDF of the default rig with the sizes of a twin, by a file and the node's full name.

    Parameters that the file lacks have their defaults, as in ROS. `frame_prefix` precedes the
    names of links, but not of joints: RViz looks for the frames of `/tf` by the names of links.
    """
    settings: Settings = files.read(path, node=node, is_required=False)
    defaults: Settings = TWIN.defaults()
    robot = ET.fromstring(urdf)  # noqa: S314 the file of this package
    lengths = {'projectile': 'projectile.length', **dict.fromkeys(LAYER_JOINTS, 'layer.thickness')}

    def scale(element: Any, key: str, name: str) -> None:
        """Scale a size of the default rig, the last number of an attribute, by a parameter."""
        *others, size = element.attrib[key].split()
        scaled = settings[name] * (float(size) / defaults[name])
        element.set(key, ' '.join([*others, repr(scaled)]))

    for link in robot.iter('link'):
        for cylinder in link.iter('cylinder'):
            scale(cylinder, 'radius', 'layer.diameter')
            if link.attrib['name'] in lengths:
                scale(cylinder, 'length', lengths[link.attrib['name']])
                scale(link.find('.//origin'), 'xyz', lengths[link.attrib['name']])
    names = dict(zip(JOINTS, joint_names(settings), strict=True))
    for joint in robot.iter('joint'):
        joint.set('name', names.get(joint.attrib['name'], joint.attrib['name']))
    for tag, key in (('link', 'name'), ('parent', 'link'), ('child', 'link')):
        for element in robot.iter(tag):
            element.set(key, frame_prefix + element.attrib[key])
    return ET.tostring(robot, encoding='unicode')
