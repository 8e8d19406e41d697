# SPDX-License-Identifier: Apache-2.0
"""
Numbers to messages and back.

What goes out at every tick is not built as a message object: its bytes (CDR, little endian) are
made once, and only stamp and numbers are written into them. Padding is zero, so that equal
messages are equal bytes; `rclpy.serialization` leaves in it what was in memory.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
import dataclasses
import math
import struct
from typing import Any

from builtin_interfaces.msg import Time
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
import numpy as np
from soft_throw_ros.core.rig import Engine, Layer, Projectile, Rig
from soft_throw_ros.twin.results import Floats, Release, State, ThrowResult
from std_msgs.msg import Float64MultiArray

_SECOND = 1_000_000_000


def time_to_msg(time_ns: int) -> Time:
    """Split nanoseconds."""
    seconds, nanoseconds = divmod(time_ns, _SECOND)
    return Time(sec=seconds, nanosec=nanoseconds)


def msg_to_time(msg: Time) -> int:
    """Join to nanoseconds."""
    return int(msg.sec) * _SECOND + int(msg.nanosec)


class _Template:
    """Bytes of a message, written field by field; `offset` counts as CDR does, from the header."""

    def __init__(self) -> None:
        self.data = bytearray(b'\x00\x01\x00\x00')  # CDR, little endian, no options

    def add(self, code: str, *values: Any) -> int:
        """Append numbers of one type, aligned, and return where they begin in `data`."""
        size = struct.calcsize(f'<{code}')
        self.data.extend(bytes(-(len(self.data) - 4) % size))
        begin = len(self.data)
        self.data.extend(struct.pack(f'<{len(values)}{code}', *values))
        return begin

    def add_string(self, text: str) -> None:
        """Append a string: its length with the final zero, its bytes, the zero."""
        encoded = text.encode() + b'\x00'
        self.add('I', len(encoded))
        self.data.extend(encoded)

    def add_doubles(self, count: int) -> int:
        """Append a sequence of doubles, zero for now, and return where they begin in `data`."""
        self.add('I', count)
        return self.add('d', *[0.0] * count)


class JointStateEncoder:
    """
    Write sensor_msgs/JointState of plate and projectile.

    Parameters
    ----------
    frame : str
        `header.frame_id`.
    names : sequence of str
        The two joints.

    """

    def __init__(self, frame: str, names: Sequence[str]) -> None:
        template = _Template()
        self._stamp = template.add('i', 0)
        template.add('I', 0)
        template.add_string(frame)
        template.add('I', len(names))
        for name in names:
            template.add_string(name)
        self._position, self._velocity, self._effort = (
            template.add_doubles(len(names)) for _ in range(3)
        )
        self._data = template.data
        self._pack_stamp = struct.Struct('<iI').pack_into
        self._pack_pair = struct.Struct('<2d').pack_into

    def encode(self, stamp_ns: int, state: State) -> bytes:
        """Return the message for a state at a time, as bytes to publish."""
        data = self._data
        self._pack_stamp(data, self._stamp, *divmod(stamp_ns, _SECOND))
        self._pack_pair(data, self._position, state[0], state[1])
        self._pack_pair(data, self._velocity, state[2], state[3])
        self._pack_pair(data, self._effort, state[4], state[5])
        return bytes(data)


class ArrayEncoder:
    """
    Write std_msgs/Float64MultiArray of always the same shape.

    Parameters
    ----------
    dimensions : mapping of str to int
        Labels and sizes, the slowest first.

    """

    def __init__(self, dimensions: Mapping[str, int]) -> None:
        template = _Template()
        template.add('I', len(dimensions))
        sizes = list(dimensions.values())
        for index, (label, size) in enumerate(dimensions.items()):
            template.add_string(label)
            template.add('I', size)
            template.add('I', math.prod(sizes[index:]))
        template.add('I', 0)  # data_offset
        count = math.prod(sizes)
        begin = template.add_doubles(count)
        self._data = template.data
        self._values = np.frombuffer(self._data, '<f8', count, begin)

    def encode(self, values: Floats) -> bytes:
        """Return the message as bytes to publish."""
        self._values[:] = values.reshape(-1)
        return bytes(self._data)


def msg_to_array(msg: Float64MultiArray) -> tuple[list[str], Floats]:
    """Return the labels of the dimensions, and the values in their shape."""
    sizes = [dimension.size for dimension in msg.layout.dim]
    return [dimension.label for dimension in msg.layout.dim], np.reshape(msg.data, sizes)


def status_to_msg(
    name: str,
    *,
    hardware_id: str,
    message: str,
    values: Mapping[str, Any],
    level: bytes = DiagnosticStatus.OK,
) -> DiagnosticStatus:
    """Make a status; numbers are written with all their digits."""
    return DiagnosticStatus(
        name=name,
        hardware_id=hardware_id,
        message=message,
        level=level,
        values=[KeyValue(key=key, value=_text(value)) for key, value in values.items()],
    )


def msg_to_values(msg: DiagnosticStatus) -> dict[str, Any]:
    """Return the values of a status, read back as what they were."""
    return {item.key: _value(item.value) for item in msg.values}


def statuses_to_msg(stamp_ns: int, statuses: Sequence[DiagnosticStatus]) -> DiagnosticArray:
    """Put statuses under one stamp."""
    msg = DiagnosticArray(status=list(statuses))
    msg.header.stamp = time_to_msg(stamp_ns)
    return msg


def throw_result_to_msg(result: ThrowResult, *, name: str, hardware_id: str) -> DiagnosticStatus:
    """Make a status of what a throw gave; what has not happened is left out."""
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
    return status_to_msg(
        name,
        hardware_id=hardware_id,
        message=result.sentence(),
        values={**values, **rig_to_values(result.rig)},
        level=DiagnosticStatus.OK if result.is_linear else DiagnosticStatus.WARN,
    )


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
    )


_STRUCTURED = ('rig', 'first', 'last', 'models')
"""What of a result is not one value."""


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
