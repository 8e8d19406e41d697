# SPDX-License-Identifier: Apache-2.0
"""A rig that is measured, through DDS: in this process, and as two."""

from __future__ import annotations

from collections.abc import Iterable
import math
from pathlib import Path
import runpy
import sys
import threading
import time
from typing import Any

from diagnostic_msgs.msg import DiagnosticStatus
import pytest
from rclpy.node import Node
from rclpy.qos import QoSProfile
from sensor_msgs.msg import JointState
from soft_throw_ros.core.rig import Rig
from soft_throw_ros.core.throw import simulate
from soft_throw_ros.nodes import topics
from soft_throw_ros.nodes.conversions import (
    msg_to_throw_result,
    msg_to_time,
    msg_to_values,
    time_to_msg,
)
from soft_throw_ros.nodes.realtime import SystemClock
from soft_throw_ros.nodes.twin import Twin
from soft_throw_ros.twin.plate_estimator import Sample
from soft_throw_ros.twin.replay import replay
from soft_throw_ros.twin.results import Outputs

ROOT = Path(__file__).parents[1]
rigs: Any = runpy.run_path(str(ROOT / 'twin' / 'rigs.py'))
GivenClock: Any = runpy.run_path(str(Path(__file__).with_name('test_twin.py')))['GivenClock']

SECOND = 1_000_000_000
MILLISECOND = SECOND // 1000
BATCH = 10  # [ms]


class Driven(Twin):
    """A twin of which the test is the clock, and which has got what is sent before it goes on."""

    def __init__(self, **kwargs: Any) -> None:
        self.clock = GivenClock()
        self.outputs: list[Outputs] = []
        self.lines: list[str] = []
        super().__init__(system_clock=self.clock, **kwargs)
        self.ticker.run_due()

    def _on_step(self, outputs: Outputs, due: int) -> None:
        self.outputs.append(outputs)
        super()._on_step(outputs, due)

    def _on_entry(self, line: str) -> None:
        self.lines.append(line)
        super()._on_entry(line)

    def go(self, milliseconds: int) -> None:
        self.clock.time += milliseconds * MILLISECOND
        self.ticker.run_due()

    def has(self, count: int) -> bool:
        """Take what has come, and tell if that makes so many in all."""
        self._steps.take()
        return (
            self.session.sample_counts.taken + sum(self.session.sample_counts.refused.values())
            >= count
        )


class Bench(Node):
    """Somebody who measures, and listens."""

    def __init__(self, ros: Any, twin: Node | None = None, **kwargs: Any) -> None:
        super().__init__('bench', **kwargs)
        self._ros = ros
        self.sent = 0
        self.heard: dict[str, list[Any]] = {}
        name = topics.MEASURED.name.replace('~', '/twin')
        self._publisher = self.create_publisher(JointState, name, QoSProfile(depth=1000))
        if twin is not None:
            ros.spin_until(lambda: self._publisher.get_subscription_count() > 0, 'the twin')

    def listen(self, *listed: topics.Topic) -> None:
        """Take topics of the twin, and wait until they are there."""
        for topic in listed:
            name = topic.name.replace('~', '/twin')
            heard = self.heard.setdefault(topic.name, [])
            self.create_subscription(topic.type, name, heard.append, topic.qos)
            self._ros.spin_until(lambda name=name: self.count_publishers(name) > 0, name)

    def send(self, sample: Sample, names: tuple[str, ...] = topics.JOINTS) -> None:
        message = JointState(name=list(names), position=[sample.plate, sample.projectile])
        message.header.stamp = time_to_msg(sample.stamp_ns)
        self._publisher.publish(message)
        self.sent += 1

    def throw(self, twin: Driven, samples: Iterable[Sample]) -> None:
        """Send what is measured as the twin goes on."""
        waiting = list(samples)
        while waiting:
            until = twin.clock.time + BATCH * MILLISECOND
            count = sum(sample.stamp_ns <= until for sample in waiting)
            for sample in waiting[:count]:
                self.send(sample)
            del waiting[:count]
            self._ros.spin_until(lambda: twin.has(self.sent), 'what was sent')
            twin.go(BATCH)


@pytest.fixture
def twin(ros: Any) -> Driven:
    return ros.node(Driven, ros_args=('-p', 'engine.motion:=measured'))


@pytest.fixture
def bench(ros: Any, twin: Driven) -> Bench:
    return ros.node(Bench, ros, twin)


def results(bench: Bench, stage: str) -> list[Any]:
    """Return what was heard of throws."""
    messages = bench.heard[topics.THROW_RESULT.name]
    read = [msg_to_throw_result(message.status[0]) for message in messages]
    return [result for result in read if result.stage == stage]


def test_throw_is_predicted_and_compared(ros: Any, twin: Driven, bench: Bench) -> None:
    bench.listen(topics.PREDICTED, topics.RESIDUAL, topics.THROW_RESULT)
    bench.throw(twin, rigs['measured_throw'](Rig(), begin_ns=twin.clock.time, noise=5e-6))
    ros.spin_until(lambda: bool(results(bench, 'release')), 'the release')
    (predicted,) = results(bench, 'predicted')
    assert predicted.first.speed == pytest.approx(simulate(Rig()).ejection_speed, rel=0.01)
    assert predicted.lead > 0.0

    expected = [outputs for outputs in twin.outputs if outputs.prediction]
    heard = bench.heard[topics.PREDICTED.name]
    ros.spin_until(lambda: len(heard) == len(expected), 'predictions')
    for message, outputs in zip(heard, expected, strict=True):
        prediction = outputs.prediction
        assert prediction is not None
        assert message.name == ['projectile']
        assert message.header.frame_id == 'rig'
        assert msg_to_time(message.header.stamp) == prediction.stamp_ns
        assert [*message.position, *message.velocity, *message.effort] == list(prediction[1:4])

    differences = [outputs.residual for outputs in twin.outputs if outputs.residual]
    heard = bench.heard[topics.RESIDUAL.name]
    ros.spin_until(lambda: len(heard) == len(differences), 'residuals')
    for message, residual in zip(heard, differences, strict=True):
        assert message.name == ['plate', 'projectile']
        assert msg_to_time(message.header.stamp) == residual.stamp_ns
        assert list(message.position) == list(residual[1:])
        assert list(message.velocity) == list(message.effort) == []


def test_run_is_repeated_from_what_was_published(ros: Any, twin: Driven, bench: Bench) -> None:
    bench.throw(twin, rigs['measured_throw'](Rig(), begin_ns=twin.clock.time, noise=5e-6))
    twin.session.close()
    again = list(replay(twin.lines, until=twin.session.step))
    assert len(again) == len(twin.outputs)
    for ours, theirs in zip(twin.outputs, again, strict=True):
        assert (ours.state, ours.prediction) == (theirs.state, theirs.prediction)
        assert (ours.residual, ours.results) == (theirs.residual, theirs.results)


def test_other_messages_are_refused_with_a_reason(ros: Any, twin: Driven, bench: Bench) -> None:
    now = twin.clock.time
    bench.send(Sample(now, 0.0, math.nan, 0.0), ('plank', 'projectile'))
    bench.send(Sample(now, 0.0, math.nan, 0.0), ('plate',))
    bench.send(Sample(now, math.nan, math.nan, 0.0))
    bench.send(Sample(now + SECOND, 0.0, math.nan, 0.0))
    bench.send(Sample(now, 0.0, math.nan, math.nan))
    bench.send(Sample(now, 0.0, math.nan, math.nan))
    bench.send(Sample(now - MILLISECOND, 0.0, math.nan, math.nan))
    ros.spin_until(lambda: twin.has(7), 'seven messages')
    counts = twin.session.sample_counts
    assert counts.taken == 2
    assert counts.refused == {
        'names': 2,
        'not finite': 1,
        'future': 1,
        'doubled': 1,
    }
    bench.listen(topics.DIAGNOSTICS)
    statuses = hear_statuses(ros, bench, 'twin: measurement')
    values = msg_to_values(statuses)
    assert statuses.level == DiagnosticStatus.WARN
    assert (values['samples'], values['samples_refused'], values['refused.names']) == (2, 5, 2)
    assert values['samples_out_of_order'] == 1
    assert '5 refused: ' in statuses.message


def hear_statuses(ros: Any, bench: Bench, name: str) -> Any:
    """Wait for a status."""
    heard = bench.heard[topics.DIAGNOSTICS.name]

    def found() -> list[Any]:
        return [status for message in heard for status in message.status if status.name == name]

    ros.spin_until(lambda: bool(found()), name)
    return found()[0]


def test_aged_layer_warns_in_log_and_diagnostics(ros: Any, twin: Driven, bench: Bench) -> None:
    bench.listen(topics.THROW_RESULT)
    rig = rigs['aged'](Rig(), 0.93)
    bench.throw(twin, rigs['measured_throw'](rig, begin_ns=twin.clock.time))
    twin.session.reset()
    twin.go(2)
    ros.spin_until(lambda: bool(results(bench, 'final')), 'the end')
    (final,) = results(bench, 'final')
    assert not final.comparison.is_within_threshold
    bench.listen(topics.DIAGNOSTICS)
    status = hear_statuses(ros, bench, 'twin: model')
    assert status.level == DiagnosticStatus.WARN
    assert 'the layer has aged' in status.message
    assert msg_to_values(status)['position_rms'] == final.comparison.position_rms


def test_without_measurement_nothing_is_told_of_it(ros: Any) -> None:
    twin = ros.node(Driven)
    bench = ros.node(Bench, ros, twin)
    bench.listen(topics.DIAGNOSTICS)
    bench.send(Sample(twin.clock.time, 0.0, math.nan, 0.0))
    hear_statuses(ros, bench, 'twin: layer')
    statuses = bench.heard[topics.DIAGNOSTICS.name][0].status
    assert not {'twin: measurement', 'twin: model'} & {status.name for status in statuses}
    assert twin.session.sample_counts.taken == 0


def test_twin_in_another_process_follows_a_rig_in_real_time(start: Any, ros: Any) -> None:
    process = start(
        sys.executable, '-m', 'soft_throw_ros', 'twin', '--ros-args',
        '-p', 'engine.motion:=measured', '-p', 'layer.name:=gelatin_29.1mm',
    )  # fmt: skip
    process.wait_for('ready')
    bench = ros.node(Bench, ros)
    bench.listen(topics.THROW_RESULT)
    ros.spin_until(lambda: bench.count_subscribers('/twin/measured_joint_states') > 0, 'the twin')
    layer = Rig().layer
    rig = Rig(layer=type(layer)(thickness=29.1e-3))

    def measure() -> None:
        clock = SystemClock()
        for _ in range(5):  # in case that messages are lost, or late by more than a second
            for sample in rigs['measured_throw'](
                rig, begin_ns=clock.now(), rate=2500.0, onset=0.15, duration=0.4
            ):
                while clock.now() < sample.stamp_ns:
                    time.sleep(1e-4)
                bench.send(sample)
            if results(bench, 'release'):
                return

    thread = threading.Thread(target=measure)
    thread.start()
    ros.spin_until(lambda: bool(results(bench, 'release')), 'the release')
    thread.join()
    release = results(bench, 'release')[0]
    assert release.first.speed == pytest.approx(simulate(rig).ejection_speed, rel=0.01)
    assert release.lead is not None
    process.end(2)
    assert not any('Traceback' in line for line in process.lines), process.lines
