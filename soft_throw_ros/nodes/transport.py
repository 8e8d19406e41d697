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
"""How messages get from process to process; `config/fastdds.xml` says what and why."""

from __future__ import annotations

from importlib import metadata, resources
import os

_KILTED = 9  # version of rclpy

_DISTRIBUTIONS = {'7': 'jazzy', f'{_KILTED}': 'kilted'}

_CHOICES = (
    'FASTDDS_BUILTIN_TRANSPORTS',
    'FASTDDS_DEFAULT_PROFILES_FILE',
    'FASTRTPS_DEFAULT_PROFILES_FILE',
)
"""Who sets one of these has chosen."""

_RANGE = 'ROS_AUTOMATIC_DISCOVERY_RANGE'


def distribution() -> str:
    """Return the name of the ROS distribution, empty if it is not known."""
    return os.environ.get('ROS_DISTRO', _DISTRIBUTIONS.get(_rclpy_version(), ''))


def use_transport_profile() -> None:
    """
    Have Fast DDS, if that is the middleware, let messages wait for a second; before `init`.

    Where discovery is limited to this machine, its ports are open to this machine only.

    """
    if not any(name in os.environ for name in _CHOICES):
        is_former = int(_rclpy_version()) < _KILTED  # which would read the other one, too
        name = f'FAST{"RTPS" if is_former else "DDS"}_DEFAULT_PROFILES_FILE'
        is_local = os.environ.get(_RANGE) in {'LOCALHOST', 'OFF'}
        file = 'fastdds_loopback.xml' if is_local else 'fastdds.xml'
        os.environ[name] = str(resources.files('soft_throw_ros') / 'config' / file)


def _rclpy_version() -> str:
    return metadata.version('rclpy').partition('.')[0]
