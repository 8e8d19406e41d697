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
_PROFILES = ('FASTDDS_DEFAULT_PROFILES_FILE', 'FASTRTPS_DEFAULT_PROFILES_FILE')


def distribution() -> str:
    """Return the name of the ROS distribution, empty if unknown."""
    return os.environ.get('ROS_DISTRO', _DISTRIBUTIONS.get(_rclpy_version(), ''))


def _discovery_range() -> str:
    is_local = os.environ.get('ROS_LOCALHOST_ONLY') == '1'  # obsolete, and has precedence
    return 'LOCALHOST' if is_local else os.environ.get(_RANGE) or 'SUBNET'


def describe_discovery() -> str:
    """Return which machines can reach a node of this process, and how to limit them."""
    reach = _discovery_range()
    verb = 'do not' if reach in _LOCAL else f'may, unless {_RANGE}=LOCALHOST,'
    return f'discovery range {reach}: other machines {verb} reach this node'


def use_transport_profile() -> None:
    """Let Fast DDS buffer a second of messages, and use local ports if discovery is local."""
    # if another transport is selected, the package changes nothing
    if not any(name in os.environ for name in ('FASTDDS_BUILTIN_TRANSPORTS', *_PROFILES)):
        is_former = _rclpy_version() < _KILTED  # whose Fast DDS reads the former name only
        file = 'fastdds_loopback.xml' if _discovery_range() in _LOCAL else 'fastdds.xml'
        path = resources.files('soft_throw_ros') / 'config' / file
        os.environ[_PROFILES[is_former]] = str(path)


def _rclpy_version() -> int:
    return int(metadata.version('rclpy').partition('.')[0])
