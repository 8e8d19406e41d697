# SPDX-License-Identifier: Apache-2.0
"""The topics and services of the twin: names, types and quality of service, once for all nodes."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray, String


@dataclass(frozen=True, kw_only=True)
class Topic:
    """
    A topic.

    Parameters
    ----------
    name : str
        `~` stands for the node.
    type : type
        Of the messages.
    qos : QoSProfile
        As published; a subscriber may take the same.
    content : str
        What it says.

    """

    name: str
    type: Any
    qos: QoSProfile
    content: str

    @property
    def type_name(self) -> str:
        """Name of the type, as `std_msgs/msg/String`."""
        return f'{self.type.__module__.partition(".")[0]}/msg/{self.type.__name__}'

    def at(self, node: str) -> Topic:
        """Return the topic of another node, by its full name."""
        return replace(self, name=self.name.replace('~', node, 1))

    def publisher(self, node: Node) -> Publisher:
        """Make the publisher of a node."""
        return node.create_publisher(self.type, self.name, self.qos)


def _latched(depth: int = 1) -> QoSProfile:
    """Reliable, and the last `depth` messages reach those who come late."""
    return QoSProfile(
        depth=depth,
        reliability=ReliabilityPolicy.RELIABLE,
        durability=DurabilityPolicy.TRANSIENT_LOCAL,
    )


DRAINED = 5000
"""More than come before they are drained, even after a stall."""

SEVERAL = 10
"""More than come at once, so that no subscriber misses one."""

_BEST_EFFORT = QoSProfile(depth=5, reliability=ReliabilityPolicy.BEST_EFFORT)

JOINT_STATES = Topic(
    name='~/joint_states',
    type=JointState,
    qos=QoSProfile(depth=1000, reliability=ReliabilityPolicy.RELIABLE),
    content='Position, velocity and effort of `plate` and `projectile`, one message per tick',
)
STRAIN = Topic(
    name='~/layer/strain',
    type=Float64MultiArray,
    qos=_BEST_EFFORT,
    content='Strain of the layer at 64 heights `y`, from plate to top',
)
VELOCITY = Topic(
    name='~/layer/velocity',
    type=Float64MultiArray,
    qos=_BEST_EFFORT,
    content='Velocity of the layer at 64 heights `y`, from plate to top',
)
THROW_FIELD = Topic(
    name='~/throw_field',
    type=Float64MultiArray,
    qos=_latched(),
    content='Strain of the layer over `t` and `y`, from start to after release, once per throw',
)
PHASE = Topic(
    name='~/phase',
    type=String,
    qos=_latched(SEVERAL),
    content='`rest`, `contact`, `flight`, `landed` or `returning`, on change',
)
THROW_RESULT = Topic(
    name='~/throw_result',
    type=DiagnosticArray,
    qos=_latched(SEVERAL),
    content='What a throw gave, at its first release and when it is over; with a measured plate '
    'also what it will give, as soon as that is known',
)
RECOMMENDATION = Topic(
    name='~/recommendation',
    type=DiagnosticArray,
    qos=_latched(),
    content='The best layer for the rig, after every change',
)
JOURNAL = Topic(
    name='~/journal',
    type=String,
    qos=_latched(1000),
    content='All that is needed to repeat the run, as lines of JSON',
)
DIAGNOSTICS = Topic(
    name='/diagnostics',
    type=DiagnosticArray,
    qos=QoSProfile(depth=10),
    content='How well the twin keeps time, and what waits, at 1 Hz',
)

PREDICTED = Topic(
    name='~/predicted_joint_states',
    type=JointState,
    qos=QoSProfile(depth=1000, reliability=ReliabilityPolicy.RELIABLE),
    content='The `projectile` as far ahead as it is known when the plate is measured, stamped '
    'with that time, one message per tick of a throw',
)
RESIDUAL = Topic(
    name='~/residual',
    type=JointState,
    qos=QoSProfile(depth=1000, reliability=ReliabilityPolicy.RELIABLE),
    content='Positions of `plate` and `projectile` by the model less those measured, if both '
    'are, stamped as they were',
)
MEASURED = Topic(
    name='~/measured_joint_states',
    type=JointState,
    qos=QoSProfile(depth=DRAINED, reliability=ReliabilityPolicy.BEST_EFFORT),
    content='What the rig measures: positions of `plate` and, if it is, `projectile`, velocities '
    'or none, stamped with the time of the measurement, at 2 to 10 kHz',
)

STATUS = Topic(
    name='~/status',
    type=DiagnosticArray,
    qos=_latched(),
    content='Whether the recorder records, and where, on change',
)

TOPICS = (
    JOINT_STATES,
    STRAIN,
    VELOCITY,
    THROW_FIELD,
    PHASE,
    THROW_RESULT,
    RECOMMENDATION,
    JOURNAL,
    PREDICTED,
    RESIDUAL,
    DIAGNOSTICS,
)

THROW = '~/throw'
RESET = '~/reset'
APPLY_RECOMMENDATION = '~/apply_recommendation'

START = '~/start'
STOP = '~/stop'

FRAME = 'rig'
"""z up, from the plate's rest position."""

JOINTS = ('plate', 'projectile')

PREDICTED_JOINTS = ('projectile',)


def markdown() -> str:
    """Write the table of topics for the README."""
    rows = ['| topic | type | QoS | content |', '|---|---|---|---|']
    for topic in TOPICS:
        qos = [topic.qos.reliability.name.lower().replace('_', ' ')]
        if topic.qos.durability is DurabilityPolicy.TRANSIENT_LOCAL:
            qos.append('transient local')
        qos.append(f'keep last {topic.qos.depth}')
        kind = topic.type_name.replace('/msg', '')
        rows.append(f'| `{topic.name}` | {kind} | {", ".join(qos)} | {topic.content} |')
    return '\n'.join(rows) + '\n'
