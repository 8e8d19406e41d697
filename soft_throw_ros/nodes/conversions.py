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
"""Values to message objects and back; what goes out at every tick is in `recording.cdr`."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from types import MappingProxyType
from typing import Any

from builtin_interfaces.msg import Time as TimeMessage
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from rclpy.duration import Duration
from rclpy.qos import (
    DurabilityPolicy,
    HistoryPolicy,
    LivelinessPolicy,
    QoSProfile,
    ReliabilityPolicy,
)
from rclpy.time import Time
from soft_throw_ros.configuration import rig_of, rig_values, Scalar, Settings
from soft_throw_ros.configuration.interface import FRAME
from soft_throw_ros.configuration.table import number_of
from soft_throw_ros.core.rig import Rig
from soft_throw_ros.recording.message import LATEST
from soft_throw_ros.twin.results import ThrowResult
from std_msgs.msg import Header
import yaml

_POLICIES = {
    'history': HistoryPolicy,
    'reliability': ReliabilityPolicy,
    'durability': DurabilityPolicy,
    'liveliness': LivelinessPolicy,
}

_TIMES = ('deadline', 'lifespan', 'liveliness_lease_duration')

UNKNOWN_DEPTH = 1000
"""How many messages a publisher keeps if the bag does not tell. A middleware seldom does."""


def msg_to_time(msg: TimeMessage) -> int:
    """Join seconds and nanoseconds [ns]."""
    return int(Time.from_msg(msg).nanoseconds)


def time_to_msg(time_ns: int) -> TimeMessage:
    """Split nanoseconds."""
    return Time(nanoseconds=time_ns).to_msg()


def profile_to_dict(profile: QoSProfile) -> dict[str, object]:
    """Return a profile as rosbag2 writes it into a bag."""
    return {
        'history': profile.history.name.lower(),
        'depth': profile.depth,
        'reliability': profile.reliability.name.lower(),
        'durability': profile.durability.name.lower(),
        'deadline': _time_to_dict(profile.deadline),
        'lifespan': _time_to_dict(profile.lifespan),
        'liveliness': profile.liveliness.name.lower(),
        'liveliness_lease_duration': _time_to_dict(profile.liveliness_lease_duration),
        'avoid_ros_namespace_conventions': profile.avoid_ros_namespace_conventions,
    }


def text_to_profiles(text: str) -> list[QoSProfile]:
    """
    Return the profiles that a bag tells of, as any version of rosbag2 writes them.

    Policies are names, or numbers before version 9; what is not known becomes rclpy's default.
    A text that tells of none gives none.
    """
    try:
        return [_dict_to_profile(item) for item in yaml.safe_load(text) or []]
    except (yaml.YAMLError, ValueError, TypeError, LookupError, AttributeError, RecursionError):
        return []


def _time_to_dict(time: Duration) -> dict[str, int]:
    return dict(zip(('sec', 'nsec'), divmod(time.nanoseconds, 10**9), strict=True))


def _dict_to_profile(item: Mapping[str, Any]) -> QoSProfile:
    values: dict[str, Any] = {'depth': int(item.get('depth', 0)) or UNKNOWN_DEPTH}
    for name, kind in _POLICIES.items():
        policy = item.get(name, 'unknown')
        for known in kind:
            if known.name != 'UNKNOWN' and policy in (known.name.lower(), known.value):
                values[name] = known
    for name in _TIMES:
        if name in item:
            time = int(item[name]['sec']) * 10**9 + int(item[name]['nsec'])
            values[name] = Duration(nanoseconds=min(time, LATEST))
    return QoSProfile(**values)


def status_to_msg(
    node_name: str,
    task: str,
    message: str,
    values: Mapping[str, object] = MappingProxyType({}),
    *,
    warn: bool = False,
    level: bytes | None = None,
) -> DiagnosticStatus:
    """Make a status of a node, by its full name; numbers are written with all their digits."""
    return DiagnosticStatus(
        name=f'{node_name}: {task}',
        hardware_id=node_name,
        message=message,
        level=level or (DiagnosticStatus.WARN if warn else DiagnosticStatus.OK),
        values=[KeyValue(key=key, value=_text(value)) for key, value in values.items()],
    )


def msg_to_values(msg: DiagnosticStatus) -> dict[str, Scalar]:
    """Return the values of a status, read back as what they were."""
    return {item.key: _value(item.value) for item in msg.values}


def statuses_to_msg(stamp_ns: int, statuses: Sequence[DiagnosticStatus]) -> DiagnosticArray:
    """Put statuses under one stamp."""
    header = Header(stamp=time_to_msg(stamp_ns), frame_id=FRAME)
    return DiagnosticArray(header=header, status=list(statuses))


def throw_result_to_msg(
    result: ThrowResult, node_name: str, beside: Mapping[str, float] = MappingProxyType({})
) -> DiagnosticStatus:
    """
    Make a status of what a throw gave, with the rig that threw, and other values beside.

    It is a warning if the layer left its linear range, the plate was not measured, or too many of
    its samples had jumped.
    """
    values = {**result.values(), **beside, **rig_values(result.rig)}
    is_clean = result.accuracy is None or result.accuracy.is_clean
    is_bad = not (result.is_linear and result.is_valid and is_clean)
    return status_to_msg(node_name, 'throw', result.describe(), values, warn=is_bad)


def msg_to_throw_result(msg: DiagnosticStatus) -> ThrowResult:
    """Return what a throw gave."""
    values = msg_to_values(msg)
    return ThrowResult.from_values(values, values_to_rig(values))


_UNSAID = {
    'engine.motion': 'underdamped', 'layer.library': '', 'layer.stack': '',
    'layer.elasticity': 'linear', 'layer.loss': 'kelvin_voigt',
}
"""What a message says nothing about, or did not in version 0.1."""


def values_to_rig(values: Settings) -> Rig:
    """Return the rig whose numbers are among `values`, each under its parameter's name."""
    named = {name: value for name, value in values.items() if '.' in name or name == 'gravity'}
    return rig_of({**_UNSAID, **named})


def _text(value: object) -> str:
    """Write a value; numbers with all their digits, truth in small letters."""
    return str(value).lower() if isinstance(value, bool) else str(value)


def _value(text: str) -> Scalar:
    """Read what `_text` wrote."""
    if text in ('true', 'false'):
        return text == 'true'
    number = number_of(text)
    return text if number is None else number
