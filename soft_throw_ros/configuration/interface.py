# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Table of all topics and services; publishers, recording and docs/topics.md follow from it."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from typing import NamedTuple

FRAME = 'rig'  # of all messages with a header, below the namespace of the node
JOINTS = ('plate', 'projectile')  # default names, which `joint_names.*` of a node replaces
FIELD_POINTS = 64  # published points of the layer, evenly spaced from plate to top
LAYER_JOINTS = tuple(f'layer_{index:02d}' for index in range(FIELD_POINTS))
ENERGIES = ('t', 'plate_work', 'projectile', 'layer', 'total')  # axes of `~/throw_energies`

ARRAY = 'diagnostic_msgs/msg/DiagnosticArray'
JOINT_STATE = 'sensor_msgs/msg/JointState'
CLOUD = 'sensor_msgs/msg/PointCloud2'
NUMBER = 'std_msgs/msg/Float64'
TEXT = 'std_msgs/msg/String'
TRAJECTORY = 'trajectory_msgs/msg/JointTrajectory'

_SEVERAL = 10  # depth of a queue for bursts: more messages than are ever published at once
_ONE_SECOND = 5000  # depth for one second of ticks or of measurements at the highest rate
_OF_A_JOURNAL = 1000  # depth for four minutes; later subscribers start at the line of a throw


def resolve(name: str, node: str) -> str:
    """Return the name of a topic or service of the node with the given full name."""
    return f'{node}/{name.removeprefix("~/")}' if name.startswith('~/') else name


@dataclass(frozen=True)
class Topic:
    """A topic."""

    name: str  # `~` stands for the node; without leading slash, relative to its namespace
    type: str  # noqa: A003  of the messages, such as `std_msgs/msg/String`
    meaning: str  # without full stop
    depth: int = 1  # messages kept for slow subscribers, and for late ones if it is latched
    is_reliable: bool = True  # whether lost messages are sent again
    is_latched: bool = False  # whether late subscribers receive them (transient local)
    joints: tuple[str, ...] = ()  # of a JointState; an input may lack the last ones
    quantities: tuple[str, ...] = ('position', 'velocity', 'effort')  # of a JointState, filled
    axes: tuple[str, ...] = ()  # fields of the points of a cloud
    is_input: bool = False  # whether the node subscribes; otherwise it publishes

    def at(self, node: str) -> Topic:
        """Return the same topic of a node with the given name."""
        return replace(self, name=resolve(self.name, node))


class Service(NamedTuple):
    """A service of the type `std_srvs/srv/Trigger`, described like a topic."""

    name: str
    meaning: str


def _diagnostics(meaning: str) -> Topic:
    return Topic('/diagnostics', ARRAY, f'{meaning}, at 1 Hz', depth=_SEVERAL)


class TwinTopics(NamedTuple):
    """Topics of the twin."""

    joint_states: Topic = Topic(
        '~/joint_states', JOINT_STATE, 'Height, velocity and force of plate and projectile, one '
        'message per tick', depth=_ONE_SECOND, joints=JOINTS)
    layer_joint_states: Topic = Topic(
        '~/layer/joint_states', JOINT_STATE, 'Height, velocity and compressive force of 64 points '
        'of the layer from plate to top, at `rate.field`', depth=100, joints=LAYER_JOINTS)
    throw_field: Topic = Topic(
        '~/throw_field', CLOUD, 'Strain of the layer over time t since the stamp (the start) [s] '
        'in rows and height y in the layer at rest [m] in columns, once per throw',
        is_latched=True, axes=('t', 'y', 'strain'))
    throw_energies: Topic = Topic(
        '~/throw_energies', CLOUD, 'Time t [s] as above, work of the plate, and energy of '
        'projectile, layer and both [J], up to the first release', is_latched=True, axes=ENERGIES)
    phase: Topic = Topic(
        '~/phase', TEXT, '`rest`, `contact`, `flight`, `landed` or `returning`, on change',
        is_latched=True)
    phase_change: Topic = Topic(
        '~/phase_change', JOINT_STATE, 'Phase as a number, with the time of the change as stamp: '
        '0 `rest`, 1 `contact`, 2 `flight`, 3 `landed`, 4 `returning`', depth=_SEVERAL,
        is_latched=True, joints=('phase',), quantities=('position',))
    throw_result: Topic = Topic(
        '~/throw_result', ARRAY, 'Result of a throw, stamped with its first release or its end; '
        'of a measured plate also predictions, at 3 % and certain', depth=2, is_latched=True)
    ejection_time: Topic = Topic(
        '~/throw/ejection_time', NUMBER, 'Time from the start of the last throw to its first '
        'release [s]; nan without a release', is_latched=True)
    ejection_speed: Topic = Topic(
        '~/throw/ejection_speed', NUMBER, 'Speed at this release [m/s]', is_latched=True)
    energy_transfer: Topic = Topic(
        '~/throw/energy_transfer', NUMBER, 'Its energy transfer factor alpha', is_latched=True)
    recommendation: Topic = Topic(
        '~/recommendation', ARRAY, 'Best layer for the rig, after every change', is_latched=True)
    journal: Topic = Topic(
        '~/journal', TEXT, 'All data to repeat the run, in JSON', _OF_A_JOURNAL, is_latched=True)
    predicted_joint_states: Topic = Topic(
        '~/predicted_joint_states', JOINT_STATE,
        'With a measured plate, the projectile as far ahead as possible, with the predicted time '
        'as stamp, one message per tick of a throw', depth=_ONE_SECOND, joints=('projectile',))
    residual: Topic = Topic(
        '~/residual', JOINT_STATE, 'Model minus measured positions, if both bodies are measured, '
        'with the stamps of the samples, until a period of the plate after the release',
        depth=_ONE_SECOND, joints=JOINTS, quantities=('position',))
    measured_joint_states: Topic = Topic(
        '~/measured_joint_states', JOINT_STATE, 'Positions of the plate and optionally of the '
        'projectile, with the time of measurement as stamp, at 2 to 10 kHz', depth=_ONE_SECOND,
        is_reliable=False, joints=JOINTS, quantities=('position',), is_input=True)
    plate_trajectory: Topic = Topic(
        '~/plate_trajectory', TRAJECTORY, 'Motion of the plate for a controller, with the start '
        'of the throw as stamp, if `engine.command` is true')
    diagnostics: Topic = _diagnostics('Timing, pending changes and measurements of the twin')


class RecorderTopics(NamedTuple):
    """Topics of the recorder, besides the recorded topics."""

    status: Topic = Topic(
        '~/status', ARRAY, 'State of recorder and bag, on change', depth=_SEVERAL, is_latched=True)
    diagnostics: Topic = _diagnostics('Recorded and lost messages')


TWIN_TOPICS = TwinTopics()
_DEFAULT_TWIN = TwinTopics(*(topic.at('twin') for topic in TWIN_TOPICS))


class RigTopics(NamedTuple):
    """Topics of the simulated rig."""

    measured_joint_states: Topic = replace(_DEFAULT_TWIN.measured_joint_states, is_input=False)
    plate_trajectory: Topic = replace(
        _DEFAULT_TWIN.plate_trajectory, is_input=True,
        meaning='Motion that the plate plays, from the stamp on; periodic throws then stop')


class CalibratorTopics(NamedTuple):
    """Topics of the calibrator for a twin with the default name."""

    measured_joint_states: Topic = _DEFAULT_TWIN.measured_joint_states
    throw_result: Topic = replace(_DEFAULT_TWIN.throw_result, is_input=True)
    plate_trajectory: Topic = replace(_DEFAULT_TWIN.plate_trajectory, is_input=True)
    diagnostics: Topic = _diagnostics('Result of the last identification')


class TwinServices(NamedTuple):
    """Services of the twin."""

    throw: Service = Service('~/throw', 'Throw now; rejected during a throw')
    reset: Service = Service('~/reset', 'Abort the throw, and return plate and projectile to rest')
    apply_recommendation: Service = Service(
        '~/apply_recommendation', 'Apply the recommended layer, amplitude or motion')


class RecorderServices(NamedTuple):
    """Services of the recorder."""

    start: Service = Service('~/start', 'Start recording a new bag')
    stop: Service = Service('~/stop', 'Stop recording and finish the bag')


class ReplayServices(NamedTuple):
    """Services of the node that plays a bag."""

    pause: Service = Service('~/pause', 'Pause playback')
    resume: Service = Service('~/resume', 'Resume playback')


VIEWER_DIAGNOSTICS = _diagnostics('Number of messages that are not shown')
REPLAY_CLOCK = Topic(
    '/clock', 'rosgraph_msgs/msg/Clock', 'Time of the bag, with `--clock`', depth=_SEVERAL)
RECORDER_TOPICS = RecorderTopics()
RIG_TOPICS = RigTopics()
CALIBRATOR_TOPICS = CalibratorTopics()
TWIN_SERVICES = TwinServices()
RECORDER_SERVICES = RecorderServices()
REPLAY_SERVICES = ReplayServices()

# Topics and services of all nodes, by their usual names
INTERFACES: Mapping[str, tuple[Iterable[Topic], Iterable[Service]]] = {
    'twin': (TWIN_TOPICS, TWIN_SERVICES), 'recorder': (RECORDER_TOPICS, RECORDER_SERVICES),
    'viewer': ((VIEWER_DIAGNOSTICS,), ()), 'replay': ((REPLAY_CLOCK,), REPLAY_SERVICES),
    'rig': (RIG_TOPICS, ()), 'calibrator': (CALIBRATOR_TOPICS, ()),
}

_FINDABLE = sorted((*TWIN_TOPICS, *RECORDER_TOPICS), key=lambda topic: -len(topic.name))


def find_topic(name: str, type_name: str) -> tuple[str, Topic] | None:
    """
    Return the node and the topic of a full name, or None for a topic of other packages.

    The node is empty for a topic that several nodes share. The longest matching name has
    precedence, so that the layer's joint states do not match the topic of a node named `layer`.
    """
    for topic in _FINDABLE:
        node = name.removesuffix(resolve(topic.name, ''))
        if topic.type == type_name and node != name and bool(node) is topic.name.startswith('~'):
            return node, topic
    return None
