# SPDX-License-Identifier: Apache-2.0
"""Values to message objects and back; what goes out at every tick is in `recording.cdr`."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
import dataclasses
from typing import Any

from builtin_interfaces.msg import Time
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
import numpy as np
from rclpy.duration import Duration
from rclpy.qos import (
    DurabilityPolicy,
    HistoryPolicy,
    LivelinessPolicy,
    QoSProfile,
    ReliabilityPolicy,
)
from soft_throw_ros.configuration.interface import FRAME
from soft_throw_ros.core.rig import Engine, Layer, Projectile, Rig
from soft_throw_ros.recording.qos import Qos
from soft_throw_ros.twin.results import Comparison, Floats, Release, ThrowResult
from std_msgs.msg import Float64MultiArray, Header

_SECOND = 1_000_000_000


def time_to_msg(time_ns: int) -> Time:
    """Split nanoseconds."""
    seconds, nanoseconds = divmod(time_ns, _SECOND)
    return Time(sec=seconds, nanosec=nanoseconds)


def msg_to_time(msg: Time) -> int:
    """Join to nanoseconds."""
    return int(msg.sec) * _SECOND + int(msg.nanosec)


def profile_to_qos(profile: QoSProfile) -> Qos:
    """Return a profile as it stands in a bag."""
    values = {name: getattr(profile, name).name.lower() for name in _POLICIES}
    times = {name: getattr(profile, name).nanoseconds for name in _TIMES}
    return Qos(
        depth=profile.depth,
        avoid_ros_namespace_conventions=profile.avoid_ros_namespace_conventions,
        **values,
        **times,
    )


def qos_to_profile(qos: Qos) -> QoSProfile:
    """
    Return the profile that a bag tells of.

    What a bag does not know, since the middleware did not tell its recorder, or rclpy does not
    know any more, becomes what rclpy takes by default.

    """
    values = {
        name: policy[getattr(qos, name).upper()]
        for name, policy in _POLICIES.items()
        if getattr(qos, name) != 'unknown' and getattr(qos, name).upper() in policy.__members__
    }
    times = {name: Duration(nanoseconds=getattr(qos, name)) for name in _TIMES}
    return QoSProfile(
        depth=max(qos.depth, 1),
        avoid_ros_namespace_conventions=qos.avoid_ros_namespace_conventions,
        **values,
        **times,
    )


_POLICIES = {
    'history': HistoryPolicy,
    'reliability': ReliabilityPolicy,
    'durability': DurabilityPolicy,
    'liveliness': LivelinessPolicy,
}

_TIMES = ('deadline', 'lifespan', 'liveliness_lease_duration')


def msg_to_array(msg: Float64MultiArray) -> tuple[list[str], Floats]:
    """Return the labels of the dimensions, and the values in their shape."""
    sizes = [dimension.size for dimension in msg.layout.dim]
    return [dimension.label for dimension in msg.layout.dim], np.reshape(msg.data, sizes)


def status_to_msg(
    node_name: str,
    task: str,
    message: str,
    values: Mapping[str, Any],
    *,
    level: bytes = DiagnosticStatus.OK,
) -> DiagnosticStatus:
    """Make a status of a node, by its full name; numbers are written with all their digits."""
    return DiagnosticStatus(
        name=f'{node_name}: {task}',
        hardware_id=node_name,
        message=message,
        level=level,
        values=[KeyValue(key=key, value=_text(value)) for key, value in values.items()],
    )


def msg_to_values(msg: DiagnosticStatus) -> dict[str, Any]:
    """Return the values of a status, read back as what they were."""
    return {item.key: _value(item.value) for item in msg.values}


def statuses_to_msg(stamp_ns: int, statuses: Sequence[DiagnosticStatus]) -> DiagnosticArray:
    """Put statuses under one stamp."""
    header = Header(stamp=time_to_msg(stamp_ns), frame_id=FRAME)
    return DiagnosticArray(header=header, status=list(statuses))


def throw_result_to_msg(
    result: ThrowResult, node_name: str, uncertainty: Mapping[str, float] | None = None
) -> DiagnosticStatus:
    """
    Make a status of what a throw gave; what has not happened, or is not known, is left out.

    It is a warning if the layer left its linear range, or the plate was not measured.

    """
    values: dict[str, Any] = {
        item.name: getattr(result, item.name)
        for item in dataclasses.fields(result)
        if item.name not in _STRUCTURED
    }
    values['is_linear'] = result.is_linear
    values.update(_release_to_values(result.first))
    values.update(_release_to_values(result.last, 'last_'))
    for model, release in result.models.items():
        values.update(_release_to_values(release, f'{model}.'))
    values.update(uncertainty or {})
    if result.lead is not None:
        values['lead'] = result.lead
    if result.comparison is not None:
        values.update(_comparison_to_values(result.comparison))
    values.update(rig_to_values(result.rig))
    is_good = result.is_linear and result.is_valid
    level = DiagnosticStatus.OK if is_good else DiagnosticStatus.WARN
    return status_to_msg(node_name, 'throw', result.describe(), values, level=level)


def msg_to_throw_result(msg: DiagnosticStatus) -> ThrowResult:
    """Return what a throw gave."""
    values = msg_to_values(msg)
    prefixes = {key[: -len('ejection_time')] for key in values if key.endswith('ejection_time')}
    plain = {
        item.name: values[item.name]
        for item in dataclasses.fields(ThrowResult)
        if item.name not in _STRUCTURED
    }
    return ThrowResult(
        **plain,
        rig=values_to_rig(values),
        first=_values_to_release(values, ''),
        last=_values_to_release(values, 'last_'),
        models={
            prefix[:-1]: _values_to_release(values, prefix)
            for prefix in prefixes
            if prefix.endswith('.')
        },
        lead=values.get('lead'),
        comparison=_values_to_comparison(values),
    )


_STRUCTURED = ('rig', 'first', 'last', 'models', 'lead', 'comparison')
"""What of a result is not one value, or may be none."""

_COMPARISON = 'residual.'


def _comparison_to_values(comparison: Comparison) -> dict[str, float]:
    values = dataclasses.asdict(comparison)
    return {f'{_COMPARISON}{name}': value for name, value in values.items() if value is not None}


def _values_to_comparison(values: Mapping[str, Any]) -> Comparison | None:
    if f'{_COMPARISON}samples' not in values:
        return None
    parts = {key.removeprefix(_COMPARISON): value for key, value in values.items()}
    names = {item.name for item in dataclasses.fields(Comparison)}
    return Comparison(**{name: parts[name] for name in names & parts.keys()})


def _release_to_values(release: Release | None, prefix: str = '') -> dict[str, float]:
    if release is None:
        return {}
    return {
        f'{prefix}ejection_time': release.time,
        f'{prefix}ejection_speed': release.speed,
        f'{prefix}energy_transfer': release.energy_transfer,
    }


def _values_to_release(values: Mapping[str, Any], prefix: str) -> Release | None:
    if f'{prefix}ejection_time' not in values:
        return None
    return Release(
        time=values[f'{prefix}ejection_time'],
        speed=values[f'{prefix}ejection_speed'],
        energy_transfer=values[f'{prefix}energy_transfer'],
    )


def rig_to_values(rig: Rig) -> dict[str, float]:
    """Return the numbers of a rig under the names of their parameters."""
    values: dict[str, float] = {}
    for part, content in dataclasses.asdict(rig).items():
        if isinstance(content, dict):
            values.update({f'{part}.{name}': value for name, value in content.items()})
        else:
            values[part] = content
    return values


def values_to_rig(values: Mapping[str, Any]) -> Rig:
    """Return the rig whose numbers are among `values`, each under its parameter's name."""
    return Rig(
        engine=Engine(**_part(values, 'engine', Engine)),
        layer=Layer(**_part(values, 'layer', Layer)),
        projectile=Projectile(**_part(values, 'projectile', Projectile)),
        gravity=values['gravity'],
    )


def _part(values: Mapping[str, Any], group: str, kind: type) -> dict[str, Any]:
    return {item.name: values[f'{group}.{item.name}'] for item in dataclasses.fields(kind)}


def _text(value: Any) -> str:
    """Write a value; numbers with all their digits, truth in small letters."""
    return str(value).lower() if isinstance(value, bool) else str(value)


def _value(text: str) -> Any:
    """Read what `_text` wrote."""
    if text in ('true', 'false'):
        return text == 'true'
    for kind in (int, float):
        try:
            return kind(text)
        except ValueError:
            pass
    return text
