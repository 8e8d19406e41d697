# SPDX-License-Identifier: Apache-2.0
"""Whether bags of a measured plate are what their journals give."""

from __future__ import annotations

from pathlib import Path
import runpy
from typing import Any

import numpy as np
import pytest
from soft_throw_ros.core.rig import Rig
from soft_throw_ros.recording.cdr import JointStateEncoder
from soft_throw_ros.recording.message import Channel
from soft_throw_ros.twin import journal
from soft_throw_ros.twin.measurement import SECOND
from soft_throw_ros.twin.results import Outputs

HERE = Path(__file__).parent
bags: Any = runpy.run_path(str(HERE / 'test_check.py'))
rigs: Any = runpy.run_path(str(HERE.parent / 'twin' / 'rigs.py'))
by_topic, check, is_entry, is_of, repeat, step_entry, write = (
    bags[name]
    for name in ('by_topic', 'check', 'is_entry', 'is_of', 'repeat', 'step_entry', 'write')
)
Twin: Any = bags['Twin']

JOINT_STATE = 'sensor_msgs/msg/JointState'


class MeasuredTwin(Twin):  # type: ignore[misc]
    """A twin whose plate is measured."""

    def __init__(self, **request: Any) -> None:
        super().__init__(engine__motion='measured', **request)
        schema = self.channels['joint_states'].schema
        for name in ('predicted_joint_states', 'residual'):
            self.channels[name] = Channel(topic=f'/twin/{name}', type=JOINT_STATE, schema=schema)
        self._prediction = JointStateEncoder('rig', ('projectile',)).encode
        self._residual = JointStateEncoder('rig', ('plate', 'projectile'), series=1).encode

    def throw(self, seed: int = 0, **kwargs: Any) -> None:
        """Measure a throw, and what comes after it."""
        begin_ns = self.pace.deadline(self.session.step)
        samples = rigs['measured_throw'](
            Rig(), begin_ns=begin_ns, noise=5e-6, jitter=0.4, seed=seed, **kwargs
        )
        delays = np.random.default_rng(seed).integers(0, 900_000, len(samples)).tolist()
        arrivals = sorted(
            (sample.stamp_ns + delay, sample)
            for sample, delay in zip(samples, delays, strict=True)
        )
        while arrivals:
            now = self.pace.deadline(self.session.step)
            count = sum(arrival <= now for arrival, _ in arrivals)
            self.session.measure([sample for _, sample in arrivals[:count]])
            del arrivals[:count]
            self.go(1)

    def _publish(self, outputs: Outputs) -> None:
        super()._publish(outputs)
        if outputs.prediction is not None:
            stamp, *values = outputs.prediction[:4]
            self._send('predicted_joint_states', self._prediction(stamp, values))
        if outputs.residual is not None:
            stamp, *values = outputs.residual
            self._send('residual', self._residual(stamp, values))


@pytest.fixture(scope='module')
def measured() -> Any:
    """A twin that follows three throws, and is changed and stalled meanwhile."""
    twin = MeasuredTwin(measured__wait=2e-4)
    twin.go(20)
    twin.throw(1, duration=0.2)
    twin.stall(13)
    twin.session.reset()
    twin.session.change({'layer.wave_speed': 8.1, 'measured.window': 1.6e-3})
    twin.throw(2)
    twin.session.reset()
    twin.set_clock(twin.now + SECOND // 2)
    twin.throw(3, duration=0.3)
    twin.go(5)
    twin.session.close()
    assert twin.session.throws == 3
    return twin


def test_measured_run_is_the_same_to_the_last_bit(tmp_path, measured) -> None:
    report = check(write(tmp_path / 'bag', measured.messages))
    assert report.exit_code == 0
    counts = {
        name: sum(is_of(message, name) for message in measured.messages)
        for name in measured.channels
    }
    assert report.states.same == counts['joint_states']
    for name in ('predicted_joint_states', 'residual', 'phase', 'throw_field', 'layer/strain'):
        assert counts[name] > 0
        assert report.sides[name].same == counts[name], name
    assert (report.gaps, report.misfits, report.differences) == ([], [], [])


def test_measured_run_comes_again_as_the_same_messages(tmp_path, measured) -> None:
    path = write(tmp_path / 'bag', measured.messages)
    repeat(path, tmp_path / 'again')
    again = check(tmp_path / 'again')
    assert again.exit_code == 0
    with bags['BagReader'](tmp_path / 'again') as reader:
        repeated = by_topic(reader.messages())
    expected = by_topic(measured.messages)
    assert expected['/twin/journal'].pop()  # which was written after the last step
    assert repeated == expected


@pytest.mark.parametrize('name', ['predicted_joint_states', 'residual', 'joint_states'])
def test_one_bit_of_a_prediction_is_noticed(tmp_path, measured, name) -> None:
    messages = list(measured.messages)
    places = [index for index, message in enumerate(messages) if is_of(message, name)]
    place = places[5]
    data = bytearray(messages[place].data)
    position = len(data) - 8 * {'residual': 2, 'predicted_joint_states': 4}.get(name, 8)
    data[position] ^= 1
    messages[place] = messages[place]._replace(data=bytes(data))
    report = check(write(tmp_path / 'bag', messages))
    assert report.exit_code == 1
    assert len(report.differences) == 1
    assert report.differences[0].startswith(f'{name}: ')


def test_run_can_be_checked_from_a_throw_on(tmp_path, measured) -> None:
    [second] = [
        index
        for index, message in enumerate(measured.messages)
        if is_entry(message, kind='throw', throw=2)
    ]
    later = measured.messages[second - 1 :]
    assert step_entry(later[0])['kind'] == 'pace'
    report = check(write(tmp_path / 'bag', later))
    assert report.exit_code == 0
    assert report.states.same > 300
    assert report.sides['predicted_joint_states'].different == 0


def test_samples_that_are_missing_are_noticed(tmp_path, measured) -> None:
    entries = [
        index for index, message in enumerate(measured.messages)
        if is_entry(message, kind='samples')
    ]  # fmt: skip
    messages = list(measured.messages)
    del messages[entries[1]]
    report = check(write(tmp_path / 'bag', messages))
    assert any('samples are missing before step' in gap for gap in report.gaps)
    assert report.states.different == 0
    assert report.states.unchecked > 0
    assert report.states.same > 300


def test_end_of_a_recording_without_its_samples_is_not_checked(tmp_path, measured) -> None:
    last = max(
        index for index, message in enumerate(measured.messages)
        if is_entry(message, kind='samples')
    )  # fmt: skip
    report = check(write(tmp_path / 'bag', measured.messages[:last]))
    assert report.exit_code == 0
    assert 0 < report.states.unchecked <= 110
    assert report.states.different == 0


def test_journal_is_small(measured) -> None:
    entries = [step_entry(message) for message in measured.messages if is_of(message, 'journal')]
    batches = [entry for entry in entries if entry['kind'] == 'samples']
    size = sum(len(journal.encode(entry)) for entry in batches)
    assert size < 40 * measured.session.taken  # with position of the projectile
    assert len(batches) < 0.03 * measured.session.step
