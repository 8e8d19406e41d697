# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Transport of messages between processes, explained in `config/fastdds.xml`."""

from __future__ import annotations

from importlib import metadata, resources
import os

_KILTED = 9  # version of rclpy
_DISTRIBUTIONS = {7: 'jazzy', _KILTED: 'kilted'}

_RANGE = 'ROS_AUTOMATIC_DISCOVERY_RANGE'

_LOCAL = ('LOCALHOST', 'OFF')  # discovery ranges that are limited to this machine

# Variables that select a transport; if one is set, the package changes nothing
_CHOICES = (
    'FASTDDS_BUILTIN_TRANSPORTS',
    'FASTDDS_DEFAULT_PROFILES_FILE',
    'FASTRTPS_DEFAULT_PROFILES_FILE',
)


def distribution() -> str:
    """Return the name of the ROS distribution, empty if unknown."""
    return os.environ.get('ROS_DISTRO', _DISTRIBUTIONS.get(_rclpy_version(), ''))


def discovery_range() -> str:
    """Return the discovery range of this process, with the precedence that ROS uses."""
    if os.environ.get('ROS_LOCALHOST_ONLY') == '1':  # obsolete, and has precedence
        return 'LOCALHOST'
    return os.environ.get(_RANGE) or 'SUBNET'


def describe_discovery() -> str:
    """Return which machines can reach a node of this process, and how to limit them."""
    reach = discovery_range()
    verb = 'do not' if reach in _LOCAL else f'may, unless {_RANGE}=LOCALHOST,'
    return f'discovery range {reach}: other machines {verb} reach this node'


def use_transport_profile() -> None:
    """Let Fast DDS buffer a second of messages, and use local ports if discovery is local."""
    if not any(name in os.environ for name in _CHOICES):
        is_former = _rclpy_version() < _KILTED  # whose Fast DDS reads the former name only
        name = f'FAST{"RTPS" if is_former else "DDS"}_DEFAULT_PROFILES_FILE'
        is_local = discovery_range() in _LOCAL
        file = 'fastdds_loopback.xml' if is_local else 'fastdds.xml'
        os.environ[name] = str(resources.files('soft_throw_ros') / 'config' / file)


def _rclpy_version() -> int:
    return int(metadata.version('rclpy').partition('.')[0])
