# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""The node `replay`: publish the messages of a bag again, byte for byte."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator
import math
import threading
import time
from typing import Any

from rclpy.duration import Duration
from rclpy.publisher import Publisher
from rclpy.qos import QoSProfile
from rosgraph_msgs.msg import Clock
from soft_throw_ros.configuration.interface import REPLAY_CLOCK, REPLAY_SERVICES
from soft_throw_ros.nodes.conversions import text_to_profiles, time_to_msg, UNKNOWN_DEPTH
from soft_throw_ros.nodes.process import POLL, RunnableNode, STOP_TIMEOUT
from soft_throw_ros.nodes.realtime import PRIORITY, set_priority
from soft_throw_ros.nodes.topics import create_service, load_type, qos_profile
from soft_throw_ros.recording.playback import PlaybackSchedule
from soft_throw_ros.recording.schemas import find_schema, installed_prefixes, SchemaError
from soft_throw_ros.storage.bag_reader import BagReader
from soft_throw_ros.storage.message import BagError, Channel, Message, SECOND

_DISCOVERY_TIME = 0.5  # time for the discovery of subscriptions before the first message [s]
_DRAIN_TIMEOUT = 0.5  # longest wait for acknowledgements of the last message [s]


class Player(RunnableNode):
    """
    A node that plays topics of a bag, or all; `clock` is the rate of `/clock`, 0 for none [Hz].

    The exit code is 0 after playing all, and 1 if some messages could not be played.
    """

    def __init__(
        self,
        reader: BagReader,
        *,
        topics: Collection[str] = (),
        rate: float = 1.0,
        loop: bool = False,
        paused: bool = False,
        clock: float = 0.0,
        **kwargs: Any,
    ) -> None:
        super().__init__('replay', **kwargs)
        self.played = 0  # number of published messages
        self.skipped: dict[Channel, str] = {}  # channels that cannot be published, and why
        self._reader = reader
        self._is_paused_first = paused
        self._is_damaged = False  # set while playing
        self._outlets: dict[Channel, Publisher] = {}
        for channel in reader.channels:
            is_clock = bool(clock) and channel.topic == REPLAY_CLOCK.name
            if not is_clock and (not topics or channel.topic in topics):
                self._make_publisher(channel)
        self._schedule = PlaybackSchedule(
            self._messages,
            begin_ns=reader.start_time,
            end_ns=reader.end_time,
            rate=rate,
            is_looping=loop,
        )
        self._lock = threading.Lock()  # guards the schedule and publishing
        self._is_stopping = False
        self._thread = threading.Thread(name='player', target=self._run, daemon=True)
        self.add_cleanup(self._stop)
        if clock:
            row = REPLAY_CLOCK
            self._clock_publisher = self.create_publisher(Clock, row.name, qos_profile(row))
            self.create_steady_timer(1.0 / clock, self._on_clock)
        pause, resume = self._schedule.pause, self._schedule.resume
        create_service(self, REPLAY_SERVICES.pause, lambda: self._switch(pause, 'paused'))
        create_service(self, REPLAY_SERVICES.resume, lambda: self._switch(resume, 'playing'))

    def start(self) -> None:
        """Start playing after `_DISCOVERY_TIME`."""
        for channel, reason in self.skipped.items():
            self.get_logger().warning(f'{channel.topic} is skipped: {reason}')
        if not self._is_paused_first:
            self._schedule.resume(time.monotonic_ns() + round(_DISCOVERY_TIME * SECOND))
        self._thread.start()

    def close(self) -> None:
        """Stop playing, and log the number of played messages."""
        self._stop()
        self.get_logger().info(f'{self.played} messages of {len(self._outlets)} topics played')

    def _stop(self) -> None:
        self._is_stopping = True
        if self._thread.is_alive():
            self._thread.join(STOP_TIMEOUT)

    def _make_publisher(self, channel: Channel) -> None:
        """Create the publisher of a channel, or note the reason why not."""
        try:  # the schema first, since an import runs code, and a bag may name any module
            _, here = find_schema(channel.type, installed_prefixes())
            if channel.type_hash not in ('', here):
                self.skipped[channel] = f'{channel.type} is defined otherwise here than in the bag'
                return
            self._outlets[channel] = self.create_publisher(
                load_type(channel.type), channel.topic, _offer(channel.qos)
            )
        except SchemaError:
            self.skipped[channel] = f'{channel.type} is not installed here'
        except Exception as error:  # noqa: BLE001  a bag may have any name and quality
            self.skipped[channel] = str(error).partition('\n')[0] or repr(error)

    def _messages(self) -> Iterator[Message]:
        """Read the messages to play, up to damage."""
        topics = {channel.topic for channel in self._outlets}
        if self._is_damaged:  # in an earlier repetition
            return
        try:
            for message in self._reader.messages(topics):
                if message.channel in self._outlets:
                    yield message
        except BagError as error:
            self.get_logger().error(str(error))
            self._is_damaged = True

    def _run(self) -> None:
        set_priority(PRIORITY)
        while not (self._is_stopping or self._schedule.is_over):
            with self._lock:
                self._play_due(time.monotonic_ns())
                deadline = self._schedule.deadline()
            pause = math.inf if deadline is None else (deadline - time.monotonic_ns()) / SECOND
            time.sleep(max(min(pause, POLL), 0.0))
        end = time.monotonic() + _DRAIN_TIMEOUT
        for publisher in self._outlets.values():
            if not self._is_stopping:
                publisher.wait_for_all_acked(Duration(seconds=max(end - time.monotonic(), 0.0)))
        if not self._is_stopping:
            self.exit_code = int(self._is_damaged or not self._outlets)

    def _play_due(self, now: int) -> None:
        """Publish the messages that are due at a time [ns]."""
        while not self._is_stopping and (message := self._schedule.next_due(now)) is not None:
            self._outlets[message.channel].publish(message.data)
            self.played += 1

    def _on_clock(self) -> None:
        """Publish the time after the messages up to it, so that followers have received them."""
        with self._lock:
            now = time.monotonic_ns()
            self._play_due(now)
            self._clock_publisher.publish(Clock(clock=time_to_msg(self._schedule.time(now))))

    def _switch(self, act: Callable[[int], None], state: str) -> str:
        """Pause or resume the schedule, and return the state."""
        with self._lock:
            now = time.monotonic_ns()
            act(now)
            passed = self._schedule.time(now) - self._reader.start_time
        length = self._reader.end_time - self._reader.start_time
        return f'{state} at {passed / SECOND:.3f} s of {length / SECOND:.3f} s'


def _offer(text: str) -> QoSProfile:
    """Return the profile in a bag that fits most subscribers: latched before reliable ones."""
    profiles = text_to_profiles(text) or [QoSProfile(depth=UNKNOWN_DEPTH)]
    return min(profiles, key=lambda profile: (profile.durability, profile.reliability))
