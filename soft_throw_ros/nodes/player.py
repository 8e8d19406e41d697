# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
The node `replay`: publish the messages of a bag again, byte for byte.

One thread publishes due messages; everything else runs in the thread of the executor.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator
import sys
import threading
import time
from typing import Any

from rclpy.duration import Duration
from rclpy.exceptions import NameValidationException
from rclpy.publisher import Publisher
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rosgraph_msgs.msg import Clock
from soft_throw_ros.configuration.interface import REPLAY_SERVICES, REPLAY_TOPICS
from soft_throw_ros.nodes.conversions import text_to_profiles, time_to_msg, UNKNOWN_DEPTH
from soft_throw_ros.nodes.process import POLL, RunnableNode, STOP_TIMEOUT
from soft_throw_ros.nodes.realtime import PRIORITY, set_priority, wake_on_time
from soft_throw_ros.nodes.topics import create_service, load_type, qos_profile
from soft_throw_ros.recording.playback import PlaybackSchedule
from soft_throw_ros.recording.schemas import find_schema, installed_prefixes, SchemaError
from soft_throw_ros.storage.bag_reader import BagReader
from soft_throw_ros.storage.message import BagError, Channel, Message, SECOND

DISCOVERY_TIME = 0.5
"""Time for the discovery of existing subscriptions before the first message. [s]"""

DRAIN_TIMEOUT = 0.5
"""Longest wait for acknowledgements of the last message. [s]"""

_PUBLISHER_ERRORS = (
    ImportError, NameValidationException, ValueError, TypeError, KeyError, OverflowError,
    RuntimeError,
)
"""Errors of rclpy if it cannot create a publisher."""


class Player(RunnableNode):
    """
    A node that plays topics of a bag, or all; `clock` is the rate of `/clock`, 0 for none [Hz].

    BagError is raised if the beginning of the bag cannot be read.
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
        self._code: int | None = None
        self._is_damaged = False  # set while playing
        self._clock_period = round(SECOND / clock) if clock else 0
        self._clock_due = 0
        if clock:
            row = REPLAY_TOPICS.clock
            self._clock_publisher = self.create_publisher(Clock, row.name, qos_profile(row))
        self._publishers_by_channel = self._make_publishers(topics, without_clock=bool(clock))
        self._schedule: PlaybackSchedule[Message] = PlaybackSchedule(
            self._messages,
            lambda message: message.log_time,
            begin_ns=reader.start_time,
            end_ns=reader.end_time,
            rate=rate,
            is_looping=loop,
        )
        self._lock = threading.Lock()  # guards the schedule and publishing
        self._woken = threading.Event()
        self._is_stopping = False
        self._thread = threading.Thread(name='player', target=self._run, daemon=True)
        self.add_cleanup(self._stop)
        create_service(self, REPLAY_SERVICES.pause, self._on_pause)
        create_service(self, REPLAY_SERVICES.resume, self._on_resume)

    @property
    def exit_code(self) -> int | None:
        """Return 0 after playing all, 1 if some messages could not be played; None until then."""
        return self._code

    def start(self) -> None:
        """Start playing after `DISCOVERY_TIME`."""
        for channel, reason in self.skipped.items():
            count = self._reader.counts[channel]
            _print_line(f'{channel.topic} is skipped, {count} messages: {reason}')
        self._clock_due = time.monotonic_ns() + round(DISCOVERY_TIME * SECOND)
        if not self._is_paused_first:
            self._schedule.resume(self._clock_due)
        self._thread.start()

    def close(self) -> None:
        """Stop playing, and log the number of played messages."""
        self._stop()
        _print_line(f'{self.played} messages of {len(self._publishers_by_channel)} topics played')

    def _stop(self) -> None:
        self._is_stopping = True
        self._woken.set()
        if self._thread.is_alive():
            self._thread.join(STOP_TIMEOUT)

    def _make_publishers(
        self, topics: Collection[str], *, without_clock: bool
    ) -> dict[Channel, Publisher]:
        """Create a publisher for every requested channel, or note the reason why not."""
        made = {}
        for channel in self._reader.channels:
            is_ours = without_clock and channel.topic == REPLAY_TOPICS.clock.name
            if is_ours or (topics and channel.topic not in topics):
                continue
            try:
                made[channel] = self._make_publisher(channel)
            except _PUBLISHER_ERRORS as error:
                self.skipped[channel] = str(error).partition('\n')[0] or repr(error)
        return made

    def _make_publisher(self, channel: Channel) -> Publisher:
        try:  # first, since an import runs code, and a bag may name any module
            here = find_schema(channel.type, installed_prefixes()).type_hash
        except SchemaError as error:
            raise ImportError(f'{channel.type} is not installed here') from error
        if here and channel.type_hash and here != channel.type_hash:
            raise ImportError(f'{channel.type} is defined otherwise here than in the bag')
        kind = load_type(channel.type)
        return self.create_publisher(kind, channel.topic, _offer(channel.qos))

    def _messages(self) -> Iterator[Message]:
        """Read the messages to play."""
        topics = {channel.topic for channel in self._publishers_by_channel}
        if self._is_damaged:  # in an earlier repetition
            return
        try:
            for message in self._reader.messages(topics):
                if message.channel in self._publishers_by_channel:
                    yield message
        except BagError as error:
            _print_line(str(error))
            self._is_damaged = True

    # Playing thread

    def _run(self) -> None:
        wake_on_time()
        set_priority(PRIORITY)
        while not (self._is_stopping or self._schedule.is_over):
            due = self._play_due()
            pause = POLL if due is None else (due - time.monotonic_ns()) / SECOND
            if pause > 0.0:
                self._woken.wait(min(pause, POLL))
                self._woken.clear()
        self._wait_for_acknowledgement()
        is_bad = self._is_damaged or not self._publishers_by_channel
        if not self._is_stopping:
            self._code = 1 if is_bad else 0

    def _play_due(self) -> int | None:
        """Publish the due messages; return the time of the next one, None if unknown [ns]."""
        with self._lock:
            now = time.monotonic_ns()
            schedule = self._schedule
            while (message := schedule.next_due(now)) is not None:
                self._publishers_by_channel[message.channel].publish(message.data)
                self.played += 1
                if self._is_stopping:
                    break
            # Publish the time after the messages up to it, so that followers have received them
            if self._clock_period and now >= self._clock_due:
                self._clock_publisher.publish(Clock(clock=time_to_msg(schedule.time(now))))
                missed = (now - self._clock_due) // self._clock_period
                self._clock_due += (missed + 1) * self._clock_period
            deadline = schedule.deadline()
        if not self._clock_period:
            return deadline
        return self._clock_due if deadline is None else min(deadline, self._clock_due)

    def _wait_for_acknowledgement(self) -> None:
        """Wait until subscribers have acknowledged all messages, at most `DRAIN_TIMEOUT`."""
        end = time.monotonic_ns() + round(DRAIN_TIMEOUT * SECOND)
        for publisher in self._publishers_by_channel.values():
            is_done = False
            while not is_done and not self._is_stopping and time.monotonic_ns() < end:
                is_done = publisher.wait_for_all_acked(Duration(nanoseconds=SECOND // 20))

    # Executor thread

    def _on_pause(self) -> str:
        with self._lock:
            self._schedule.pause(time.monotonic_ns())
        return f'paused at {self._position()}'

    def _on_resume(self) -> str:
        with self._lock:
            self._schedule.resume(time.monotonic_ns())
        self._woken.set()
        return f'playing at {self._position()}'

    def _position(self) -> str:
        with self._lock:
            passed = self._schedule.time(time.monotonic_ns()) - self._reader.start_time
        length = self._reader.end_time - self._reader.start_time
        return f'{passed / SECOND:.3f} s of {length / SECOND:.3f} s'


def _offer(text: str) -> QoSProfile:
    """Return the profile in a bag that is compatible with the most subscribers."""
    return max(
        text_to_profiles(text),
        key=lambda profile: (
            profile.durability is DurabilityPolicy.TRANSIENT_LOCAL,
            profile.reliability is ReliabilityPolicy.RELIABLE,
        ),
        default=QoSProfile(depth=UNKNOWN_DEPTH),
    )


def _print_line(text: str) -> None:
    print(f'replay: {text}', file=sys.stderr, flush=True)
