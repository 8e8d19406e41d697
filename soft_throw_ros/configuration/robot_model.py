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
from soft_throw_ros.configuration.twin import joint_names

_PLATE_OVER_LAYER = 2.5  # diameters of plate and layer, so that the rim of the plate is visible
_SLICES_PER_LAYER = 14.0  # of which ten are drawn, whose gaps can close


def urdf_of_file(urdf: str, path: str | Path, *, node: str, frame_prefix: str = '') -> str:
    """
    Return a URDF of the default rig with the sizes of a twin, by a file and the node's full name.

    Parameters that the file lacks have their defaults, as in ROS. `frame_prefix` precedes the
    names of links, but not of joints: RViz looks for the frames of `/tf` by the names of links.
    """
    settings: Settings = files.read(path, node=node, is_required=False)
    diameter, thickness = settings['layer.diameter'], settings['layer.thickness']
    sizes = {
        'plate': (_PLATE_OVER_LAYER * diameter, None),
        'projectile': (diameter, settings['projectile.length']),
        **dict.fromkeys(LAYER_JOINTS, (diameter, thickness / _SLICES_PER_LAYER)),
    }
    names = dict(zip(JOINTS, joint_names(settings), strict=True))
    robot = ET.fromstring(urdf)  # noqa: S314 the file of this package
    for link in robot.iter('link'):
        if link.attrib['name'] in sizes:
            _resize(link, *sizes[link.attrib['name']])
    for joint in robot.iter('joint'):
        joint.set('name', names.get(joint.attrib['name'], joint.attrib['name']))
    for tag, key in (('link', 'name'), ('parent', 'link'), ('child', 'link')):
        for element in robot.iter(tag):
            element.set(key, frame_prefix + element.attrib[key])
    return ET.tostring(robot, encoding='unicode')


def _resize(link: Any, diameter: float, length: float | None) -> None:
    """Set the size of the cylinder of a link, and scale its distance from the origin likewise."""
    cylinder, origin = link.find('.//cylinder'), link.find('.//origin')
    cylinder.set('radius', repr(0.5 * diameter))
    if length is not None:
        x, y, z = map(float, origin.attrib['xyz'].split())
        height = z * length / float(cylinder.attrib['length'])
        cylinder.set('length', repr(length))
        origin.set('xyz', f'{x!r} {y!r} {height!r}')
