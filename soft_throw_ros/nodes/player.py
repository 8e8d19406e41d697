# SPDX-License-Identifier: Apache-2.0
"""
The node `replay`: publish what is in a bag again, as the bytes that it was.

One thread publishes what is due; all else happens in the executor's.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator
from dataclasses import replace
import math
import sys
import threading
import time
from typing import Any

from rclpy.duration import Duration
from rclpy.exceptions import NameValidationException
from rclpy.publisher import Publisher
from rosgraph_msgs.msg import Clock
from soft_throw_ros.nodes.conversions import qos_to_profile, time_to_msg
from soft_throw_ros.nodes.process import POLL, RunnableNode
from soft_throw_ros.nodes.realtime import set_realtime_priority
from soft_throw_ros.nodes.topics import load_type
from soft_throw_ros.recording.bag_reader import BagReader
from soft_throw_ros.recording.message import BagError, Channel, Message
from soft_throw_ros.recording.playback import PlaybackSchedule
from soft_throw_ros.recording.qos import Qos
from soft_throw_ros.recording.schemas import find_schema, installed_prefixes, SchemaError
from soft_throw_ros.twin.tick_schedule import SECOND, TickSchedule
from std_srvs.srv import Trigger

PAUSE = '~/pause'
RESUME = '~/resume'
STEP = '~/step'

CLOCK = '/clock'

DISCOVERY_TIME = 0.5
"""Before the first message, so that those who listen already get it. [s]"""

DRAIN_TIMEOUT = 0.5
"""Longest wait, after the last message, for those who acknowledge it. [s]"""

STOP_TIMEOUT = 0.3
"""Longest wait for the thread to end. [s]"""

DEPTH = 1000
"""How many messages a publisher keeps if the bag does not tell. A middleware seldom does."""

TERMINAL_PERIOD = 0.1
"""How often progress is shown on a terminal. [s]"""

LOG_PERIOD = 10.0
"""How often it is written elsewhere. [s]"""

_LONG = 1e9  # longer than any bag [s]


class Player(RunnableNode):
    """
    Plays a bag.

    Parameters
    ----------
    reader : BagReader
        Of the bag.
    topics : collection of str
        Which topics; all if there is none.
    start, duration : float
        From when on, counted from the beginning of the bag, and how long. [s]
    rate : float
        Time of the bag over real time. [-]
    loop, paused : bool
        Whether the end is followed by the beginning, and whether to wait to be resumed.
    clock : float
        How often `/clock` tells the time of the bag; 0 for never. [Hz]
    **kwargs
        As for `rclpy.node.Node`.

    Attributes
    ----------
    played : int
        How many messages have been published.
    skipped : dict of Channel to str
        What cannot be published, and why.

    """

    def __init__(
        self,
        reader: BagReader,
        *,
        topics: Collection[str] = (),
        start: float = 0.0,
        duration: float = _LONG,
        rate: float = 1.0,
        loop: bool = False,
        paused: bool = False,
        clock: float = 0.0,
        **kwargs: Any,
    ) -> None:
        super().__init__('replay', **kwargs)
        self._begin = reader.start_time + round(start * SECOND)
        self._end = min(reader.end_time, self._begin + round(min(duration, _LONG) * SECOND))
        self._pace: dict[str, Any] = {'rate': rate, 'is_looping': loop, 'is_paused': paused}
        self._clock_rate = clock
        self.played = 0
        self.skipped: dict[Channel, str] = {}
        self._reader = reader
        self._publishers_by_channel: dict[Channel, Publisher] = {}
        self._clock_publisher: Publisher | None = None
        self._schedule: PlaybackSchedule[Message] | None = None
        self._clock_schedule: TickSchedule | None = None
        self._clock_ticks = 0
        self._code: int | None = None
        self._has_failed = False
        self._is_terminal = sys.stderr.isatty()
        self._lock = threading.Lock()
        self._woken = threading.Event()
        self._is_stopping = False
        self._thread = threading.Thread(name='player', target=self._run, daemon=True)
        try:
            if clock:
                self._clock_publisher = self.create_publisher(Clock, CLOCK, 10)
            for channel in reader.channels:
                is_wanted = not topics or channel.topic in topics
                if not is_wanted or (clock and channel.topic == CLOCK):
                    continue
                try:
                    self._publishers_by_channel[channel] = self._publisher(channel)
                except (ImportError, NameValidationException, *_REFUSALS) as error:
                    self.skipped[channel] = str(error).partition('\n')[0] or repr(error)
            self.create_service(Trigger, PAUSE, self._on_pause)
            self.create_service(Trigger, RESUME, self._on_resume)
            self.create_service(Trigger, STEP, self._on_step)
            self.call_every(TERMINAL_PERIOD if self._is_terminal else LOG_PERIOD, self._show)
        except BaseException:
            super().destroy_node()
            raise

    @property
    def exit_code(self) -> int | None:
        """0 when all has been played, 1 if something could not be; None while it goes on."""
        return self._code

    def start(self) -> None:
        """Begin to play, in a moment."""
        for channel, reason in self.skipped.items():
            count = self._reader.counts[channel]
            _say(f'{channel.topic} is skipped, {count} messages: {reason}')
        now = time.monotonic_ns() + round(DISCOVERY_TIME * SECOND)
        try:
            self._schedule = PlaybackSchedule(
                self._messages,
                lambda message: message.log_time,
                begin_ns=self._begin,
                end_ns=self._end,
                now=now,
                **self._pace,
            )
        except BagError as error:
            self._fail(error)
            self._code = 1
            return
        if self._clock_publisher is not None:
            self._clock_schedule = TickSchedule(step=0, time_ns=now, rate=self._clock_rate)
        self._thread.start()

    def close(self) -> None:
        """Stop playing, and say how much was played."""
        self._stop()
        if self._is_terminal:
            print(file=sys.stderr)
        _say(f'{self.played} messages of {len(self._publishers_by_channel)} topics played')

    def destroy_node(self) -> None:
        """Stop playing, and let go of everything."""
        self._stop()
        super().destroy_node()

    def _stop(self) -> None:
        self._is_stopping = True
        self._woken.set()
        if self._thread.is_alive():
            self._thread.join(STOP_TIMEOUT)

    def _publisher(self, channel: Channel) -> Publisher:
        kind = load_type(channel.type)
        try:
            here = find_schema(channel.type, installed_prefixes()).type_hash
        except SchemaError:
            here = ''
        if here and channel.type_hash and here != channel.type_hash:
            raise ImportError(f'{channel.type} is defined otherwise here than in the bag')
        return self.create_publisher(kind, channel.topic, qos_to_profile(_offer(channel.qos)))

    def _messages(self) -> Iterator[Message]:
        """Read what is to be played."""
        topics = {channel.topic for channel in self._publishers_by_channel}
        for message in self._reader.messages(topics, self._begin, self._end + 1):
            if message.channel in self._publishers_by_channel:
                yield message

    # in the thread that plays

    def _run(self) -> None:
        set_realtime_priority()
        schedule = self._schedule
        assert schedule is not None
        while not (self._is_stopping or self._has_failed or schedule.is_over):
            due = self._play_due(schedule)
            pause = POLL if due is None else (due - time.monotonic_ns()) / SECOND
            if pause > 0.0:
                self._woken.wait(min(pause, POLL))
                self._woken.clear()
        self._wait_for_acknowledgement()
        if self._reader.damage:
            _say(f'damaged, so that something may be missing: {self._reader.damage}')
        is_bad = self._has_failed or self._reader.damage or not self._publishers_by_channel
        if not self._is_stopping:
            self._code = 1 if is_bad else 0

    def _play_due(self, schedule: PlaybackSchedule[Message]) -> int | None:
        """Publish what is due by now; return when something is next, if that is known. [ns]"""
        with self._lock:
            now = time.monotonic_ns()
            clock_tick = self._publish_clock(schedule, now)
            try:
                while (message := schedule.next_due(now)) is not None:
                    self._publishers_by_channel[message.channel].publish(message.data)
                    self.played += 1
                    if self._is_stopping:
                        break
            except BagError as error:
                self._fail(error)
            deadline = schedule.deadline()
        return min((time for time in (clock_tick, deadline) if time is not None), default=None)

    def _publish_clock(self, schedule: PlaybackSchedule[Message], now: int) -> int | None:
        """Publish the time of the bag if it is time to; return when it is next. [ns]"""
        ticks = self._clock_schedule
        if ticks is None or self._clock_publisher is None:
            return None
        if ticks.deadline(self._clock_ticks) <= now:
            self._clock_publisher.publish(Clock(clock=time_to_msg(schedule.time(now))))
            passed = (now - ticks.time_ns) * ticks.rate / SECOND
            self._clock_ticks = max(self._clock_ticks, math.floor(passed)) + 1
        return ticks.deadline(self._clock_ticks)

    def _wait_for_acknowledgement(self) -> None:
        """Give those who acknowledge messages a moment."""
        end = time.monotonic_ns() + round(DRAIN_TIMEOUT * SECOND)
        for publisher in self._publishers_by_channel.values():
            is_done = False
            while not is_done and not self._is_stopping and time.monotonic_ns() < end:
                is_done = publisher.wait_for_all_acked(Duration(nanoseconds=SECOND // 20))

    def _fail(self, error: BagError) -> None:
        _say(str(error))
        self._has_failed = True

    # in the executor's thread

    def _on_pause(self, _: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        with self._lock:
            self._active.pause(time.monotonic_ns())
        return self._answer(response, 'paused')

    def _on_resume(self, _: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        with self._lock:
            self._active.resume(time.monotonic_ns())
        self._woken.set()
        return self._answer(response, 'playing')

    def _on_step(self, _: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        with self._lock:
            has_next = self._active.step(time.monotonic_ns())
            is_over = self._active.is_over
        if has_next:
            self._play_due(self._active)
            return self._answer(response, 'paused')
        response.message = 'nothing follows' if is_over else f'it is not paused; call {PAUSE}'
        return response

    @property
    def _active(self) -> PlaybackSchedule[Message]:
        assert self._schedule is not None  # no service is served before the start
        return self._schedule

    def _answer(self, response: Trigger.Response, state: str) -> Trigger.Response:
        response.success = True
        response.message = f'{state} at {self._position()}'
        return response

    def _position(self) -> str:
        with self._lock:
            passed = self._active.time(time.monotonic_ns()) - self._reader.start_time
        length = self._reader.end_time - self._reader.start_time
        return f'{passed / SECOND:.3f} s of {length / SECOND:.3f} s'

    def _show(self) -> None:
        if self._schedule is None or self._code is not None:
            return
        state = 'paused' if self._schedule.is_paused else 'playing'
        text = f'{state} at {self._position()}, {self.played} messages'
        if self._is_terminal:
            print(f'\r\033[Kreplay: {text}', end='', file=sys.stderr, flush=True)
        else:
            _say(text)


_REFUSALS = (ValueError, TypeError, KeyError, OverflowError, RuntimeError)
"""What rclpy raises if it is asked for a publisher that it cannot make."""


def _offer(offered: Collection[Qos]) -> Qos:
    """Return the offer that suits the most subscribers."""
    qos = max(
        offered,
        key=lambda qos: (qos.durability == 'transient_local', qos.reliability == 'reliable'),
        default=Qos(depth=DEPTH),
    )
    return qos if qos.depth else replace(qos, depth=DEPTH)


def _say(text: str) -> None:
    print(f'replay: {text}', file=sys.stderr, flush=True)
