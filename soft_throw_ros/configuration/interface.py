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
"""
Every topic and service of the nodes as data: the one place that nodes and recording read.

A new topic of the twin is one row of `TwinTopics` and the line in the node that fills it:
publishers, what a recorder knows of it and docs/topics.md follow from the row. Nothing here needs
ROS; `nodes.topics` makes publishers and subscriptions of the rows.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import NamedTuple

FRAME = 'rig'
"""Frame of everything that has a header: z up, from the plate's rest position."""

JOINTS = ('plate', 'projectile')
"""Joints of the rig."""

FIELD_POINTS = 64
"""Heights at which the layer is published, evenly spaced from plate to top."""

LAYER_JOINTS = tuple(f'layer_{index:02d}' for index in range(FIELD_POINTS))
"""Joints of the layer, from plate to top."""

ARRAY = 'diagnostic_msgs/msg/DiagnosticArray'
JOINT_STATE = 'sensor_msgs/msg/JointState'
MULTI_ARRAY = 'std_msgs/msg/Float64MultiArray'
NUMBER = 'std_msgs/msg/Float64'
TEXT = 'std_msgs/msg/String'
TRIGGER = 'std_srvs/srv/Trigger'

_SEVERAL = 10  # more than are published at once, so that no late subscriber misses one
_ONE_SECOND = 5000  # of ticks at the highest rate
_OF_A_JOURNAL = 1000  # four minutes; the line of every throw has all that a later subscriber needs
_AFTER_A_STALL = 5000  # a second of measurements at the usual rate, which may come at once


def resolve(name: str, node: str) -> str:
    """
    Return the name of a topic or service of the node with the given full name.

    Examples
    --------
    >>> resolve('~/phase', '/rig1/twin'), resolve('/diagnostics', '/rig1/twin')
    ('/rig1/twin/phase', '/diagnostics')

    """
    return f'{node}/{name.removeprefix("~/")}' if name.startswith('~/') else name


@dataclass(frozen=True)
class Topic:
    """
    A topic.

    Parameters
    ----------
    name : str
        `~` stands for the node; a name without leading slash is relative to its namespace.
    type, meaning : str
        Of the messages, as `std_msgs/msg/String`; what it says, a sentence without full stop.
    depth : int
        How many messages are kept for a subscriber that is slow, or late if it is latched.
    is_reliable, is_latched : bool
        Whether messages that are lost on the way are sent again, and whether the last `depth`
        messages reach those who subscribe later (transient local).
    joints, quantities : tuple of str
        Of a JointState, and which of its arrays are filled; an input may lack the last joints.
    axes : tuple of str
        Labels of the dimensions of an array.
    is_input : bool
        Whether the node subscribes to it; otherwise it publishes.

    """

    name: str
    type: str  # noqa: A003
    meaning: str
    depth: int = 1
    is_reliable: bool = True
    is_latched: bool = False
    joints: tuple[str, ...] = ()
    quantities: tuple[str, ...] = ('position', 'velocity', 'effort')
    axes: tuple[str, ...] = ()
    is_input: bool = False

    @property
    def relative_name(self) -> str:
        """Name below the node; a name that is absolute stays so."""
        return self.name.removeprefix('~/')

    def fits(self, name: str) -> bool:
        """Tell whether a full name may be this topic's, of some node."""
        if not self.name.startswith('~'):
            return name == self.name
        ending = resolve(self.name, '')
        return name.endswith(ending) and name != ending

    def at(self, node: str) -> Topic:
        """Return the same topic of a node with the given name."""
        return replace(self, name=resolve(self.name, node))


class Service(NamedTuple):
    """A service, described like a topic."""

    name: str
    type: str  # noqa: A003
    meaning: str


class TwinTopics(NamedTuple):
    """Topics of the twin."""

    joint_states: Topic = Topic(
        '~/joint_states', JOINT_STATE,
        'Height, velocity and force of plate and projectile, one message per tick',
        depth=_ONE_SECOND, joints=JOINTS)
    layer_joint_states: Topic = Topic(
        '~/layer/joint_states', JOINT_STATE,
        'Height and velocity of the layer at 64 points from plate to top, and the force through '
        'each of them, positive in compression, at `rate.field`',
        depth=100, joints=LAYER_JOINTS)
    throw_field: Topic = Topic(
        '~/throw_field', MULTI_ARRAY,
        'Strain of the layer over time and height, from start to after release, once per throw',
        is_latched=True, axes=('t', 'y'))
    phase: Topic = Topic(
        '~/phase', TEXT, '`rest`, `contact`, `flight`, `landed` or `returning`, on change',
        depth=_SEVERAL, is_latched=True)
    throw_result: Topic = Topic(
        '~/throw_result', ARRAY,
        'What a throw gave, at its first release and when it is over; with a measured plate also '
        'what it will give, with its errors: when it is known within measured.prediction_error, '
        'and when it is certain',
        depth=_SEVERAL, is_latched=True)
    ejection_time: Topic = Topic(
        '~/throw/ejection_time', NUMBER,
        'Time from the start of the throw to its first release [s]', is_latched=True)
    ejection_speed: Topic = Topic(
        '~/throw/ejection_speed', NUMBER, 'Speed at the first release [m/s]', is_latched=True)
    energy_transfer: Topic = Topic(
        '~/throw/energy_transfer', NUMBER,
        'Energy transfer factor alpha of the first release', is_latched=True)
    peak_strain: Topic = Topic(
        '~/throw/peak_strain', NUMBER,
        'Largest strain of the layer up to the first release', is_latched=True)
    recommendation: Topic = Topic(
        '~/recommendation', ARRAY, 'The best layer for the rig, after every change',
        is_latched=True)
    recommended_energy_transfer: Topic = Topic(
        '~/recommended/energy_transfer', NUMBER,
        'Energy transfer factor alpha that the recommended layer gives', is_latched=True)
    journal: Topic = Topic(
        '~/journal', TEXT, 'All that is needed to repeat the run, as lines of JSON',
        depth=_OF_A_JOURNAL, is_latched=True)
    predicted_joint_states: Topic = Topic(
        '~/predicted_joint_states', JOINT_STATE,
        'The projectile as far ahead as it is known when the plate is measured, stamped with that '
        'time, one message per tick of a throw',
        depth=_ONE_SECOND, joints=('projectile',))
    residual: Topic = Topic(
        '~/residual', JOINT_STATE,
        'Positions by the model less those measured, if both are, stamped as they were',
        depth=_ONE_SECOND, joints=JOINTS, quantities=('position',))
    measured_joint_states: Topic = Topic(
        '~/measured_joint_states', JOINT_STATE,
        'What the rig measures: positions of the plate and, if it is measured, of the projectile, '
        'velocities or none, stamped with the time of the measurement, at 2 to 10 kHz',
        depth=_AFTER_A_STALL, is_reliable=False, joints=JOINTS,
        quantities=('position', 'velocity'), is_input=True)
    diagnostics: Topic = Topic(
        '/diagnostics', ARRAY, 'How well the twin keeps time, and what is pending, at 1 Hz',
        depth=_SEVERAL)


class RecorderTopics(NamedTuple):
    """Topics of the recorder, besides those that it records."""

    status: Topic = Topic(
        '~/status', ARRAY, 'Whether the recorder records, and where, on change',
        depth=_SEVERAL, is_latched=True)
    diagnostics: Topic = Topic(
        '/diagnostics', ARRAY, 'What is recorded, what was lost, and how the viewer is, at 1 Hz',
        depth=_SEVERAL)


class RigTopics(NamedTuple):
    """Topics of the rig, which is measured in place of a real one."""

    measured_joint_states: Topic = replace(
        TwinTopics().measured_joint_states.at('twin'), quantities=('position',), is_input=False)


class CalibratorTopics(NamedTuple):
    """Topics of the calibrator, by the usual name of its twin."""

    measured_joint_states: Topic = TwinTopics().measured_joint_states.at('twin')
    throw_result: Topic = replace(TwinTopics().throw_result.at('twin'), is_input=True)
    diagnostics: Topic = Topic(
        '/diagnostics', ARRAY, 'What the last identification found, at 1 Hz', depth=_SEVERAL)


class ReplayTopics(NamedTuple):
    """Topics of the node that plays a bag, besides those of the bag."""

    clock: Topic = Topic(
        '/clock', 'rosgraph_msgs/msg/Clock', 'The time of the bag, if asked for', depth=_SEVERAL)


class FormerTopics(NamedTuple):
    """Topics that the twin no longer has, but bags of version 0.1 do."""

    strain: Topic = Topic('~/layer/strain', MULTI_ARRAY, 'Strain of the layer', axes=('y',))
    velocity: Topic = Topic('~/layer/velocity', MULTI_ARRAY, 'Its velocity', axes=('y',))


class TwinServices(NamedTuple):
    """Services of the twin."""

    throw: Service = Service(
        '~/throw', TRIGGER, 'Throw now; refused while a throw is under way, saying for how long')
    reset: Service = Service(
        '~/reset', TRIGGER, 'Break off, and put plate and projectile back')
    apply_recommendation: Service = Service(
        '~/apply_recommendation', TRIGGER,
        'Take over the recommended layer, or amplitude')


class RecorderServices(NamedTuple):
    """Services of the recorder."""

    start: Service = Service('~/start', TRIGGER, 'Begin a new bag')
    stop: Service = Service('~/stop', TRIGGER, 'Finish the bag')


class ReplayServices(NamedTuple):
    """Services of the node that plays a bag."""

    pause: Service = Service('~/pause', TRIGGER, 'Let nothing come')
    resume: Service = Service('~/resume', TRIGGER, 'Go on')
    step: Service = Service('~/step', TRIGGER, 'While paused, play the messages of the next time')


TWIN_TOPICS = TwinTopics()
RECORDER_TOPICS = RecorderTopics()
RIG_TOPICS = RigTopics()
CALIBRATOR_TOPICS = CalibratorTopics()
REPLAY_TOPICS = ReplayTopics()
FORMER_TOPICS = FormerTopics()
TWIN_SERVICES = TwinServices()
RECORDER_SERVICES = RecorderServices()
REPLAY_SERVICES = ReplayServices()


class Interface(NamedTuple):
    """What a node is to others."""

    topics: Iterable[Topic]
    services: Iterable[Service] = ()


INTERFACES = {
    'twin': Interface(TWIN_TOPICS, TWIN_SERVICES),
    'recorder': Interface(RECORDER_TOPICS, RECORDER_SERVICES),
    'replay': Interface(REPLAY_TOPICS, REPLAY_SERVICES),
    'rig': Interface(RIG_TOPICS),
    'calibrator': Interface(CALIBRATOR_TOPICS),
}
"""The interfaces of all nodes, by their usual names."""


class NodeTopic(NamedTuple):
    """A topic, and the full name of the node that it belongs to, empty if it is nobody's own."""

    node: str
    topic: Topic


def find_topic(name: str, type_name: str) -> NodeTopic | None:
    """
    Tell which topic of which node a full name stands for, or None if it is none of ours.

    The longest name that fits wins, so that the layer's joint states are not taken for those of
    a node named `layer`.

    Examples
    --------
    >>> found = find_topic('/rig1/twin/layer/joint_states', 'sensor_msgs/msg/JointState')
    >>> found.node, found.topic.name
    ('/rig1/twin', '~/layer/joint_states')
    >>> find_topic('/camera/image', 'sensor_msgs/msg/Image')

    """
    fitting = [topic for topic in _FINDABLE if topic.type == type_name and topic.fits(name)]
    if not fitting:
        return None
    topic = max(fitting, key=lambda topic: len(topic.name))
    return NodeTopic(name.removesuffix(resolve(topic.name, '')), topic)


_FINDABLE = (*TWIN_TOPICS, *FORMER_TOPICS, *RECORDER_TOPICS)
