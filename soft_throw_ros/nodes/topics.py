# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Publishers, subscriptions and services made from the rows of `configuration.interface`."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from functools import partial
from importlib import import_module
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from rclpy.event_handler import PublisherEventCallbacks
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from soft_throw_ros.configuration import interface
from soft_throw_ros.configuration.interface import FRAME, JOINTS, Service, Topic
from soft_throw_ros.nodes import conversions
from soft_throw_ros.storage.cdr import JointStateEncoder
from std_msgs.msg import Header
from std_srvs.srv import Trigger

_MANY = 8  # number of joints from which on arrays are faster than single values


def load_type(name: str) -> Any:
    """Import the class of a type that `find_schema` knows; ImportError if there is none."""
    package, _, type_name = name.rpartition('/')
    try:
        return getattr(import_module(package.replace('/', '.')), type_name)
    except (ImportError, AttributeError, ValueError) as error:
        raise ImportError(f'{name} is not installed here') from error


def qos_profile(topic: Topic) -> QoSProfile:
    """Return the quality of service of a topic."""
    return make_profile(topic.depth, is_reliable=topic.is_reliable, is_latched=topic.is_latched)


def make_profile(depth: int, *, is_reliable: bool, is_latched: bool) -> QoSProfile:
    """Return a quality of service."""
    return QoSProfile(
        depth=depth,
        reliability=ReliabilityPolicy['RELIABLE' if is_reliable else 'BEST_EFFORT'],
        durability=DurabilityPolicy['TRANSIENT_LOCAL' if is_latched else 'VOLATILE'],
    )


def full_name(node: Node, name: str) -> str:
    """Return the full name of anything, below the namespace of a node unless it begins with /."""
    return name if name.startswith('/') else f'{node.get_namespace().rstrip("/")}/{name}'


def create_subscription(node: Node, topic: Topic, on_message: Callable[..., None]) -> None:
    """Subscribe a node to a topic."""
    node.create_subscription(load_type(topic.type), topic.name, on_message, qos_profile(topic))


def create_service(node: Node, service: Service, act: Callable[[], str]) -> None:
    """Create a service of a node; `act` returns its answer, or raises the reason of a failure."""

    def on_request(_: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        response.message = act()
        response.success = True
        return response

    node.create_service(Trigger, service.name, on_request)


class Publishers:
    """
    The publishers of a node, made from its rows of topics, which convert plain values.

    `joints` are the names of plate and projectile. Latched topics, which most are, fit every
    subscription and have no events for incompatible ones, whose cost multiplies every wait.
    """

    def __init__(
        self, node: Node, topics: Iterable[Topic], joints: tuple[str, str] = JOINTS
    ) -> None:
        self.status = partial(conversions.status_to_msg, node.get_fully_qualified_name())
        self.frame = full_name(node, FRAME).lstrip('/')  # of the rig
        self._clock = node.get_clock()
        self._joints = dict(zip(JOINTS, joints, strict=True))
        self._senders: dict[str, tuple[Callable[..., None], Callable[..., Any]]] = {}
        for topic in topics:
            if not topic.is_input:
                publisher = node.create_publisher(
                    load_type(topic.type),
                    topic.name,
                    qos_profile(topic),
                    event_callbacks=PublisherEventCallbacks(
                        use_default_callbacks=not topic.is_latched
                    ),
                )
                self._senders[topic.name] = publisher.publish, self._converter(topic)

    def send(self, topic: Topic, *values: object) -> None:
        """
        Publish on a topic.

        Joint states take a stamp [ns] and the values of one quantity after another, or one array
        per quantity where there are many joints. Diagnostics take a stamp and statuses, clouds a
        stamp and points, trajectories a start [ns] and a motion, other types a number or a text.
        """
        publish, convert = self._senders[topic.name]
        publish(convert(*values))

    def report(self, topic: Topic, statuses: Sequence[DiagnosticStatus]) -> None:
        """Publish statuses, as made by `status`, with the present time as stamp."""
        self.send(topic, self._clock.now().nanoseconds, statuses)

    def _header(self, stamp_ns: int) -> Header:
        return Header(stamp=conversions.time_to_msg(stamp_ns), frame_id=self.frame)

    def _converter(self, topic: Topic) -> Callable[..., Any]:
        """Return the function that converts values into a message, or its bytes."""
        if topic.type == interface.JOINT_STATE:
            names = [self._joints.get(name, name) for name in topic.joints]
            encoder = JointStateEncoder(self.frame, names, series=len(topic.quantities))
            return encoder.encode if len(topic.joints) < _MANY else encoder.encode_arrays
        if topic.type == interface.CLOUD:
            return lambda stamp_ns, points: conversions.cloud_to_msg(
                self._header(stamp_ns), topic.axes, points
            )
        if topic.type == interface.ARRAY:
            return lambda stamp_ns, statuses: DiagnosticArray(
                header=self._header(stamp_ns), status=statuses
            )
        if topic.type == interface.TRAJECTORY:
            joint = self._joints[JOINTS[0]]
            return partial(conversions.encode_command, joint=joint, frame=self.frame)
        message_type = load_type(topic.type)
        return lambda value: message_type(data=value)
