# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Values as messages and texts; `storage.cdr` encodes the messages of every tick."""

from __future__ import annotations

from array import array
from collections.abc import Mapping, Sequence
from functools import lru_cache
import struct
from types import MappingProxyType
from typing import Any

from builtin_interfaces.msg import Duration as DurationMessage
from builtin_interfaces.msg import Time as TimeMessage
from diagnostic_msgs.msg import DiagnosticStatus, KeyValue
import numpy as np
from numpy.typing import NDArray
from rclpy import qos
from rclpy.duration import Duration
from rclpy.serialization import serialize_message
from rclpy.time import Time
from sensor_msgs.msg import PointCloud2, PointField
from soft_throw_ros.configuration import rig_of, rig_values, Scalar, Settings
from soft_throw_ros.configuration.motions import trajectory_points
from soft_throw_ros.configuration.table import number_of
from soft_throw_ros.core.plate import SampledMotion
from soft_throw_ros.core.rig import Rig
from soft_throw_ros.storage.bag_folder import load_profiles
from soft_throw_ros.storage.message import SECOND
from soft_throw_ros.twin.results import ThrowResult
from std_msgs.msg import Header
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

_POLICIES = {
    'history': qos.HistoryPolicy,
    'reliability': qos.ReliabilityPolicy,
    'durability': qos.DurabilityPolicy,
    'liveliness': qos.LivelinessPolicy,
}

_TIMES = ('deadline', 'lifespan', 'liveliness_lease_duration')
_STATE = 3  # position, velocity and acceleration
_STAMP = struct.Struct('<iI')  # seconds and nanoseconds
_HEADER_SIZE = 4  # of a serialized message, before its first field [byte]
UNKNOWN_DEPTH = 1000  # of the queue of a publisher, which few middlewares report [messages]


def msg_to_time(msg: TimeMessage) -> int:
    """Return the time of a message [ns]."""
    return int(Time.from_msg(msg).nanoseconds)


def time_to_msg(time_ns: int) -> TimeMessage:
    """Return a time in nanoseconds as a message."""
    return Time(nanoseconds=time_ns).to_msg()


def profile_to_dict(profile: qos.QoSProfile) -> dict[str, object]:
    """Return a profile in rosbag2's form."""
    times = {name: divmod(getattr(profile, name).nanoseconds, SECOND) for name in _TIMES}
    return {
        **{name: getattr(profile, name).name.lower() for name in _POLICIES},
        **{name: {'sec': sec, 'nsec': nsec} for name, (sec, nsec) in times.items()},
        'depth': profile.depth,
        'avoid_ros_namespace_conventions': profile.avoid_ros_namespace_conventions,
    }


def text_to_profiles(text: str) -> list[qos.QoSProfile]:
    """
    Parse the quality-of-service profiles in a bag, as written by any version of rosbag2.

    Policies are names, or numbers before version 9; unknown policies and all times become
    rclpy's defaults. A text without valid profiles yields an empty list.
    """
    try:
        return [_dict_to_profile(item) for item in load_profiles(text)]
    except (ValueError, TypeError, LookupError, AttributeError):
        return []


def _dict_to_profile(item: Mapping[str, Any]) -> qos.QoSProfile:
    values: dict[str, Any] = {'depth': int(item.get('depth', 0)) or UNKNOWN_DEPTH}
    for name, kind in _POLICIES.items():
        for known in kind:
            if known.name != 'UNKNOWN' and item.get(name) in (known.name.lower(), known.value):
                values[name] = known
    return qos.QoSProfile(**values)


def status_to_msg(
    node_name: str,
    task: str,
    message: str,
    values: Mapping[str, object] = MappingProxyType({}),
    *,
    warn: bool = False,
    level: bytes | None = None,
) -> DiagnosticStatus:
    """Create a diagnostic status of a node from its full name; numbers keep all their digits."""

    def text(value: object) -> str:
        return str(value).lower() if isinstance(value, bool) else str(value)

    return DiagnosticStatus(
        name=f'{node_name}: {task}',
        hardware_id=node_name,
        message=message,
        level=level or (DiagnosticStatus.WARN if warn else DiagnosticStatus.OK),
        values=[KeyValue(key=key, value=text(value)) for key, value in values.items()],
    )


def msg_to_values(msg: DiagnosticStatus) -> dict[str, Scalar]:
    """Return the values of a status with their original types."""
    return {item.key: _value(item.value) for item in msg.values}


def cloud_to_msg(header: Header, names: Sequence[str], points: NDArray[np.float64]) -> PointCloud2:
    """Return points, of shape (columns, fields) or (rows, columns, fields), as a message."""
    rows, columns, count = (1, *points.shape)[-3:]
    return PointCloud2(
        header=header,
        height=rows,
        width=columns,
        fields=[
            PointField(name=name, offset=8 * index, datatype=PointField.FLOAT64, count=1)
            for index, name in enumerate(names)
        ],
        point_step=8 * count,
        row_step=8 * count * columns,
        data=array('B', points.astype('<f8').tobytes()),
        is_dense=True,
    )


def throw_result_to_msg(
    result: ThrowResult, node_name: str, additional: Mapping[str, float] = MappingProxyType({})
) -> DiagnosticStatus:
    """Create a status from the result of a throw, its rig, and additional values."""
    values = {**result.values(), **additional, **rig_values(result.rig)}
    is_bad = not (result.is_linear and result.is_valid)
    return status_to_msg(node_name, 'throw', throw_text(result), values, warn=is_bad)


def msg_to_throw_result(msg: DiagnosticStatus) -> ThrowResult:
    """
    Return the result of a throw.

    Raises
    ------
    ValueError
        If a value is missing or wrong.

    """
    values = msg_to_values(msg)
    try:
        return ThrowResult.from_values(values, values_to_rig(values))
    except (KeyError, TypeError) as error:  # a missing value of the rig, or of the result
        raise ValueError(f'values are missing: {error!r:.80}') from None


def values_to_rig(values: Settings) -> Rig:
    """Return the rig whose numbers are among `values`, each under its parameter's name."""
    named = {name: value for name, value in values.items() if '.' in name or name == 'gravity'}
    return rig_of({'engine.motion': 'underdamped', 'layer.library': '', **named})


def _value(text: str) -> Scalar:
    """Parse the text of a value."""
    number = number_of(text)
    return {'true': True, 'false': False}.get(text, text if number is None else number)


@lru_cache(maxsize=4)
def _serialize_motion(motion: SampledMotion, joint: str, frame: str) -> bytes:
    """Return the serialized message of a motion of the plate that starts at time 0."""
    message = JointTrajectory(
        header=Header(frame_id=frame),
        joint_names=[joint],
        points=[
            JointTrajectoryPoint(
                **{**point, 'time_from_start': DurationMessage(**point['time_from_start'])}
            )
            for point in trajectory_points(motion)
        ],
    )
    return bytes(serialize_message(message))


def encode_command(start_ns: int, motion: SampledMotion, joint: str, frame: str) -> bytes:
    """
    Return the serialized message of a motion of a joint that starts at a time [ns].

    A motion is serialized once, which takes 10 us per state; then only the stamp changes.
    """
    data = bytearray(_serialize_motion(motion, joint, frame))
    _STAMP.pack_into(data, _HEADER_SIZE, *divmod(start_ns, SECOND))
    return bytes(data)


def msg_to_motion(message: JointTrajectory, joint: str) -> SampledMotion:
    """Return the motion of the plate, which is a joint, or raise ValueError."""
    if list(message.joint_names) != [joint]:
        raise ValueError(f'the joints must be [{joint!r}], got {list(message.joint_names)!r:.80}')
    states = [
        [*point.positions, *point.velocities, *point.accelerations] for point in message.points
    ]
    if not all(len(state) == _STATE for state in states):
        raise ValueError('every point must have one position, one velocity and one acceleration')
    times = [
        1e-9 * Duration.from_msg(point.time_from_start).nanoseconds for point in message.points
    ]
    if times and times[0] > 0.0:  # a motion counts from its first state
        times, states = [0.0, *times], [[states[0][0], 0.0, 0.0], *states]
    return SampledMotion(np.array(times), np.array(states).reshape(-1, _STATE))


def throw_text(result: ThrowResult) -> str:
    """Return the release of a throw with warnings, or the reason why the throw is invalid."""
    if not result.is_valid:
        text = (
            f'no plate samples for more than {1e3 * result.rig.crossing_time:.3g} ms (see '
            'measurement in /diagnostics)'
        )
        if result.ended_by == 'noise':
            text = 'the plate samples are noisy: increase measured.smoothing_window or the rate'
        return f'throw {result.throw} is invalid: {text}'
    if result.first is None:
        return f'throw {result.throw}: the projectile was not released'
    event = 'release predicted' if result.stage == 'predicted' else 'released'
    text = (
        f'throw {result.throw}: {event} at {1e3 * result.first.ejection_time:.3f} ms, '
        f'{result.first.ejection_speed:.4f} m/s, alpha {result.first.energy_transfer:.3f}'
    )
    if result.accuracy is not None:
        text += f' +- {result.accuracy.energy_transfer_error:.3f}'
    if result.last is not None and result.recontacts:
        recontacts = f'{result.recontacts} re-contact{"s" * (result.recontacts > 1)}'
        text += f' ({result.last.energy_transfer:.3f} after {recontacts})'
    if not result.is_linear:
        strain, limit = 100.0 * result.peak_strain, 100.0 * result.max_strain
        text += f'; strain {strain:.1f} % exceeds the linear range of {limit:.3g} %'
    return text


def comparison_text(result: ThrowResult) -> str:
    """Return how well the projectile followed the model, and the likely cause of a deviation."""
    comparison = result.comparison
    if comparison is None:
        return 'the projectile was not measured'
    rms, threshold = 1e6 * comparison.position_rms, 1e6 * comparison.threshold
    if comparison.is_within_threshold:
        return f'the projectile followed the model within {rms:.3g} um rms'
    return (
        f'the projectile deviated from the model by {rms:.3g} um rms, more than '
        f'measured.residual_threshold {threshold:.3g} um: the layer has aged or slipped, or the '
        'parameters are wrong'
    )
