# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""The URDF of a rig with its own sizes, for the launch files."""

from __future__ import annotations

from pathlib import Path
from xml.etree import ElementTree as ET

from soft_throw_ros.configuration import files
from soft_throw_ros.configuration.interface import JOINTS, LAYER_JOINTS
from soft_throw_ros.configuration.table import Settings
from soft_throw_ros.configuration.twin import joint_names

_PLATE_OVER_LAYER = 2.5
"""Diameter of the drawn plate over that of the layer, so that its rim is visible. [-]"""

_SLICES_PER_LAYER = 14.0
"""Thickness of the layer over that of a slice: the ten slices leave gaps that can close. [-]"""


def urdf_of_file(urdf: str, path: str | Path, *, node: str, frame_prefix: str = '') -> str:
    """
    Return a URDF with the sizes of the twin that a parameter file describes.

    Parameters
    ----------
    urdf : str
        Model of the default rig.
    path : path_like
        The file; parameters that it lacks have their defaults, as in ROS.
    node : str
        Full name of the twin.
    frame_prefix : str
        Precedes the names of links, but not of joints. RViz looks for the frames of `/tf` by the
        names of links, so that rigs in several namespaces need different ones.

    Raises
    ------
    ParameterError
        If the file cannot be read or has a refused value; the message has its name.

    """
    settings: Settings = files.read(path, node=node, is_required=False)
    diameter = settings['layer.diameter']
    slice_thickness = settings['layer.thickness'] / _SLICES_PER_LAYER
    robot = ET.fromstring(urdf)  # noqa: S314 the file of this package
    for link in robot.iter('link'):
        name = link.attrib['name']
        if name == 'plate':
            _resize(link, diameter=_PLATE_OVER_LAYER * diameter)
        elif name == 'projectile':
            _resize(link, diameter=diameter, length=settings['projectile.length'])
        elif name in LAYER_JOINTS:
            _resize(link, diameter=diameter, length=slice_thickness)
        link.set('name', frame_prefix + name)
    names = dict(zip(JOINTS, joint_names(settings), strict=True))
    for joint in robot.iter('joint'):
        joint.set('name', names.get(joint.attrib['name'], joint.attrib['name']))
    for tag in ('parent', 'child'):
        for end in robot.iter(tag):
            end.set('link', frame_prefix + end.attrib['link'])
    return ET.tostring(robot, encoding='unicode')


def _resize(link: ET.Element, *, diameter: float, length: float | None = None) -> None:
    """Set the size of the cylinder of a link, and scale its distance from the origin likewise."""
    cylinder, origin = link.find('.//cylinder'), link.find('.//origin')
    if cylinder is None or origin is None:
        raise ValueError(f'link {link.attrib["name"]} of the URDF has no cylinder or no origin')
    cylinder.set('radius', repr(0.5 * diameter))
    if length is not None:
        x, y, z = map(float, origin.attrib['xyz'].split())
        height = z * length / float(cylinder.attrib['length'])
        cylinder.set('length', repr(length))
        origin.set('xyz', f'{x!r} {y!r} {height!r}')
