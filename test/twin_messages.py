# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Messages of a simulated twin without a node, whose ticks are never late."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
import sys
from typing import Any
import warnings

from rcl_interfaces.msg import Log
from rclpy.serialization import serialize_message
from soft_throw_ros.configuration.interface import (
    FRAME,
    JOINTS,
    LAYER_JOINTS,
    TWIN_TOPICS,
)
from soft_throw_ros.configuration.twin_config import TwinConfig
from soft_throw_ros.nodes.conversions import (
    cloud_to_msg,
    status_to_msg,
    statuses_to_msg,
    throw_result_to_msg,
    time_to_msg,
)
from soft_throw_ros.nodes.recommendations import recommend_for, uncertainty_values
from soft_throw_ros.nodes.texts import throw_text
from soft_throw_ros.recording.schemas import find_schema
from soft_throw_ros.storage.cdr import JointStateEncoder
from soft_throw_ros.storage.message import Channel, Message
from soft_throw_ros.twin.results import Outputs, Phase
from soft_throw_ros.twin.sample_buffer import Sample, Samples
from std_msgs.msg import String
from twin_runs import named, Run

with warnings.catch_warnings():
    warnings.simplefilter('ignore', DeprecationWarning)
    import lark  # noqa: F401  imported later by rclpy, with a deprecation warning

PHASES = tuple(Phase)

_LATE = 40_000
"""Time from the deadline to the published state, and to each later message. [ns]"""


class TwinMessages(Run):
    """
    A run of the session of a node, and the messages of its outputs so far.

    The clock of the sensors is `behind_ns` [ns].
    """

    def __init__(self, node: str = '/twin', *, behind_ns: int = 0, **request: Any) -> None:
        self.node = node
        self.behind_ns = behind_ns
        self.messages: list[Message] = []
        self._counts: Counter[str] = Counter()  # number of messages by topic
        self.channels = {
            topic.relative_name: self._channel(topic.at(node).name, topic.type)
            for topic in TWIN_TOPICS
        }
        self.channels['rosout'] = self._channel('/rosout', 'rcl_interfaces/msg/Log')
        self._encode_state = JointStateEncoder(FRAME, JOINTS).encode
        self._encode_prediction = JointStateEncoder(FRAME, JOINTS[1:]).encode
        self.encode_positions = JointStateEncoder(FRAME, JOINTS, series=1).encode
        self._encode_phase = JointStateEncoder(
            FRAME, TWIN_TOPICS.phase_change.joints, series=1
        ).encode
        self._encode_layer = JointStateEncoder(FRAME, LAYER_JOINTS).encode_arrays
        super().__init__(**request)
        self._wanted = self.settings
        self._advise(self._wanted)

    def go(self, steps: int) -> TwinMessages:
        """Advance a number of steps."""
        super().go(steps)
        return self

    def on_samples(self, samples: Sequence[Sample]) -> None:
        for sample in samples:
            stamp_ns = sample.stamp_ns - self.behind_ns
            data = self.encode_positions(stamp_ns, (sample.plate, sample.projectile))
            self._send('measured_joint_states', data, 0)
        self.session.measure(Samples.of(samples), clock_offset_ns=self.behind_ns)

    def on_step(self, outputs: Outputs) -> None:
        super().on_step(outputs)
        self._publish(outputs)
        if self.session.rate != self.schedule.rate:
            self.schedule.change_rate(step=self.session.step - 1, rate=self.session.rate)
            self.session.set_tick_schedule(self.schedule)

    def on_entry(self, line: str) -> None:
        super().on_entry(line)
        self._send('journal', serialize_message(String(data=line)), 3)

    def diagnose(self, node: str, task: str, message: str, values: dict[str, Any]) -> None:
        """Publish the status of a task on /diagnostics."""
        array = statuses_to_msg(self.now, [status_to_msg(node, task, message, values)])
        self._send('/diagnostics', serialize_message(array), 9)

    def change(self, **request: Any) -> None:
        """Change settings."""
        changes = named(request)
        self.session.change(changes)
        self._wanted = {**self._wanted, **changes}
        self._advise(self._wanted)

    def _channel(self, name: str, kind: str) -> Channel:
        schema = find_schema(kind, [sys.prefix])
        return Channel(
            topic=name,
            type=kind,
            schema=schema.text,
            type_hash=schema.type_hash,
        )

    def _publish(self, outputs: Outputs) -> None:
        self._send('joint_states', self._encode_state(self.now, outputs.state), 1)
        if outputs.layer is not None:
            self._send('layer/joint_states', self._encode_layer(self.now, outputs.layer), 2)
        if outputs.prediction is not None:
            stamp, *values = outputs.prediction[:4]
            self._send('predicted_joint_states', self._encode_prediction(stamp, values), 2)
        if outputs.residual is not None:
            stamp, *values = outputs.residual
            self._send('residual', self.encode_positions(stamp, values), 2)
        for phase, stamp_ns in outputs.phases:
            data = self._encode_phase(stamp_ns, (float(PHASES.index(phase)),))
            self._send('phase_change', data, 4)
            self._send('phase', serialize_message(String(data=phase.value)), 4)
        if outputs.throw_field is not None:
            field = outputs.throw_field()
            for name, points in (
                ('throw_field', field.points), ('throw_energies', field.energies)
            ):
                message = cloud_to_msg(field.start_ns, getattr(TWIN_TOPICS, name).axes, points)
                self._send(name, serialize_message(message), 5)
        for result in outputs.results:
            beside = uncertainty_values(result.rig, self.settings)
            status = throw_result_to_msg(result, self.node, beside)
            array = statuses_to_msg(result.stamp(self.now), [status])
            self._send('throw_result', serialize_message(array), 6)
            line = Log(stamp=time_to_msg(self.now), level=20, name='twin', msg=throw_text(result))
            self._send('rosout', serialize_message(line), 7)

    def _advise(self, settings: Any) -> None:
        status = recommend_for(TwinConfig.from_settings(settings)).to_status(self.node)
        self._send('recommendation', serialize_message(statuses_to_msg(self.now, [status])), 8)

    def _send(self, name: str, data: bytes, order: int) -> None:
        time, channel = self.now + order * _LATE, self.channels[name]
        self._counts[name] += 1
        self.messages.append(Message(channel, data, time, time, self._counts[name]))
