# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Messages of a simulated twin without a node, whose ticks are never late."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Sequence
import sys
from types import SimpleNamespace
from typing import Any
import warnings

from rcl_interfaces.msg import Log
from rclpy.serialization import serialize_message
from soft_throw_ros.configuration.interface import RIG_TOPICS, TWIN_TOPICS
from soft_throw_ros.configuration.twin_config import TwinConfig
from soft_throw_ros.nodes.conversions import status_to_msg, throw_result_to_msg, time_to_msg
from soft_throw_ros.nodes.recommendations import recommend_for, uncertainty_values
from soft_throw_ros.nodes.texts import throw_text
from soft_throw_ros.nodes.topics import Publishers
from soft_throw_ros.nodes.twin import Twin
from soft_throw_ros.recording.schemas import find_schema
from soft_throw_ros.storage.message import Channel, Message
from soft_throw_ros.twin.results import Outputs, ThrowResult
from soft_throw_ros.twin.sample_buffer import Sample, Samples
from twin_runs import named, Run

with warnings.catch_warnings():
    warnings.simplefilter('ignore', DeprecationWarning)
    import lark  # noqa: F401  imported later by rclpy, with a deprecation warning

_DELAYS = {
    'measured_joint_states': 0, 'joint_states': 1, 'layer/joint_states': 2,
    'predicted_joint_states': 2, 'residual': 2, 'journal': 3, 'phase_change': 4, 'phase': 4,
    'throw_field': 5, 'throw_energies': 5, 'throw_result': 6, 'rosout': 7, 'recommendation': 8,
    '/diagnostics': 9,
}
"""Times from the deadline to the publication. [40 us]"""


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
        self.outgoing = Publishers(self, (*TWIN_TOPICS, *RIG_TOPICS))
        super().__init__(**request)
        self._wanted = self.settings
        self._advise()

    # What `Publishers` needs of a node

    def get_fully_qualified_name(self) -> str:
        return self.node

    def get_namespace(self) -> str:
        return self.node.rpartition('/')[0]

    def get_clock(self) -> Any:
        return SimpleNamespace(now=lambda: SimpleNamespace(nanoseconds=self.now))

    def create_publisher(self, _type: Any, name: str, _qos: Any, **_: Any) -> Any:
        name = name.removeprefix('~/').removeprefix('twin/')
        return SimpleNamespace(publish=lambda message: self.publish(name, message))

    def publish(self, name: str, message: Any) -> None:
        """Append a message of a topic, which may be serialized."""
        data = message if isinstance(message, bytes) else serialize_message(message)
        time, channel = self.now + 40_000 * _DELAYS[name], self.channels[name]
        self._counts[name] += 1
        self.messages.append(Message(channel, data, time, time, self._counts[name]))

    def go(self, steps: int) -> TwinMessages:
        """Advance a number of steps."""
        super().go(steps)
        return self

    def on_samples(self, samples: Sequence[Sample]) -> None:
        for sample in samples:
            positions = sample.plate, sample.projectile
            stamp_ns = sample.stamp_ns - self.behind_ns
            self.outgoing.send(RIG_TOPICS.measured_joint_states, stamp_ns, positions)
        self.session.measure(Samples.of(samples), clock_offset_ns=self.behind_ns)

    def on_step(self, outputs: Outputs) -> None:
        super().on_step(outputs)
        Twin.on_step(self, outputs, self.now)
        if self.session.rate != self.schedule.rate:
            self.schedule.change_rate(step=self.session.step - 1, rate=self.session.rate)
            self.session.set_tick_schedule(self.schedule)

    def _run_in_executor(self, job: Callable[[], None]) -> None:
        job()

    _publish_outputs = Twin._publish_outputs

    def _publish_result(self, result: ThrowResult, due: int) -> None:
        status = throw_result_to_msg(
            result, self.node, uncertainty_values(result.rig, self.settings)
        )
        self.outgoing.send(TWIN_TOPICS.throw_result, result.stamp(due), [status])
        line = Log(stamp=time_to_msg(due), level=20, name='twin', msg=throw_text(result))
        self.publish('rosout', line)

    def on_entry(self, line: str) -> None:
        super().on_entry(line)
        self.outgoing.send(TWIN_TOPICS.journal, line)

    def diagnose(self, node: str, task: str, message: str, values: dict[str, Any]) -> None:
        """Publish the status of a task on /diagnostics."""
        status = status_to_msg(node, task, message, values)
        self.outgoing.send(TWIN_TOPICS.diagnostics, self.now, [status])

    def change(self, **request: Any) -> None:
        """Change settings."""
        changes = named(request)
        self.session.change(changes)
        self._wanted = {**self._wanted, **changes}
        self._advise()

    def _channel(self, name: str, kind: str) -> Channel:
        schema = find_schema(kind, [sys.prefix])
        return Channel(topic=name, type=kind, schema=schema.text, type_hash=schema.type_hash)

    def _advise(self) -> None:
        status = recommend_for(TwinConfig.from_settings(self._wanted)).to_status(self.node)
        self.outgoing.send(TWIN_TOPICS.recommendation, self.now, [status])
