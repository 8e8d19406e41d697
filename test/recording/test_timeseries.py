# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Time series read from messages of twins, compared with the model of the twin."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from bags import text
import numpy as np
import pytest
from soft_throw_ros.configuration.interface import JOINT_STATE, Topic, TWIN_TOPICS
from soft_throw_ros.core.rig import Layer, Rig
from soft_throw_ros.core.throw import simulate
from soft_throw_ros.recording.timeseries import (
    DECODING_ERRORS,
    find_throws,
    identify,
    READERS,
    TwinReader,
)
from soft_throw_ros.storage.message import Message
from soft_throw_ros.twin.tick_schedule import SECOND
from twin_messages import TwinMessages
from twin_runs import BEGIN


def one_throw(steps: int, **request: Any) -> Any:
    """Return a twin whose throw begins with the first step, with its messages read back."""
    twin = TwinMessages(throw__period=0, **request)
    twin.session.request_throw()
    twin.go(steps)
    twin.read = Read(twin.messages)
    return twin


@pytest.fixture(scope='module')
def slow() -> Any:
    return one_throw(1400, time_scale=0.01)


@pytest.fixture(scope='module')
def real() -> Any:
    return one_throw(400, rate__field=1000.0)


@pytest.fixture(scope='module', params=[0, BEGIN - 100 * SECOND], ids=['right', 'since boot'])
def measured(request: Any) -> Any:
    """Return one throw of a measured plate, with its messages read back."""
    twin = TwinMessages(engine__motion='measured', behind_ns=request.param)
    twin.measure(duration=0.1)
    twin.read = Read(twin.messages)
    return twin


class Read:
    """The content of messages, read one by one, by topic."""

    def __init__(self, messages: Sequence[Message]) -> None:
        self.reader = TwinReader()
        self.contents: dict[Topic, list[Any]] = {topic: [] for topic in READERS}
        self.fields = self.contents[TWIN_TOPICS.throw_field]
        self.throws: list[Any] = []  # positions and layer at the times of the field
        for message in messages:
            _, topic = identify(message.channel.topic, message.channel.type)
            if topic not in READERS:
                continue
            data = [message] if topic.type == JOINT_STATE else message
            content = READERS[topic](self.reader, data)
            if content:
                self.contents[topic].append(content)
            if content and topic == TWIN_TOPICS.throw_field:
                self.throws.append(self.reader.interpolate_throw(content))


def joined(items: Sequence[Any], index: int) -> Any:
    return np.concatenate([item[index] for item in items])


def test_energies_of_a_throw_have_its_times(slow) -> None:
    ((stamps, energies),) = slow.read.contents[TWIN_TOPICS.throw_energies]
    (field,) = slow.read.fields
    (shown,) = [outputs.throw_field() for outputs in slow.outputs if outputs.throw_field]
    np.testing.assert_array_equal(energies, shown.energies[:, 1:])
    assert stamps.tolist() == field.stamps[::4][:stamps.size].tolist()
    assert 0.0 < field.throw.ejection_time - shown.energies[-1, 0] <= field.times[4]


def test_layer_agrees_with_the_session(slow) -> None:
    rows = [(step, item.layer) for step, item in enumerate(slow.outputs) if item.layer is not None]
    stamps = [slow.schedule.deadline(step) for step, _ in rows]
    height, _, force = (np.array([layer[index] for _, layer in rows]) for index in range(3))
    strain = -force / (Rig().layer.youngs_modulus * Rig().layer.section)
    layers = slow.read.contents[TWIN_TOPICS.layer_joint_states]
    assert joined(layers, 0).tolist() == stamps
    np.testing.assert_allclose(joined(layers, 1), height[:, 0], atol=2e-6)
    np.testing.assert_allclose(joined(layers, 2), height[:, -1], atol=2e-6)
    assert np.abs(joined(layers, 3) - strain).mean() < 1e-3


def test_field_of_a_throw_has_its_times_and_ends_at_the_projectile(slow) -> None:
    read = slow.read
    (field,), ((position, layer),) = read.fields, read.throws
    (shown,) = [outputs.throw_field() for outputs in slow.outputs if outputs.throw_field]
    np.testing.assert_allclose(field.times, shown.times, rtol=1e-12, atol=1e-15)
    np.testing.assert_array_equal(field.strain, shown.strain)
    assert field.stamps[0] == slow.schedule.deadline(0)
    np.testing.assert_array_equal(layer.stamps, field.stamps)
    in_contact = field.times < field.throw.ejection_time
    top = layer.top[in_contact]
    np.testing.assert_allclose(top, position[in_contact, 1], atol=2e-6)
    assert np.ptp(top) > 1e-3


def test_positions_between_states_agree_with_the_model(real) -> None:
    """The reader interpolates by a cubic between steps of 1 ms; a contact has eight steps."""
    read = real.read
    (field,), ((position, _),) = read.fields, read.throws
    path = simulate(Rig(), until=0.02).trajectory(field.times)
    np.testing.assert_allclose(position[:, 0], path.plate_position, atol=2e-7)
    np.testing.assert_allclose(position[:, 1], path.projectile_position, atol=5e-6)


def test_rig_changes_with_a_throw_or_reset_and_requests_are_known_before() -> None:
    twin = TwinMessages(throw__period=0.1, time_scale=0.1).go(1500)
    twin.change(layer__thickness=0.01)
    before = Read(twin.messages).reader
    assert (before.wanted_rig(), before.rig) == (Rig(layer=Layer(thickness=0.01)), Rig())
    read = Read(twin.go(1000).messages)
    journal = [item for item in twin.messages if item.channel.topic == '/twin/journal']
    first, second = find_throws(journal)['/twin'][:2]
    assert first.ejection_time == read.fields[0].throw.ejection_time
    energies = read.contents[TWIN_TOPICS.throw_energies]
    assert energies[1][0][0] == read.fields[1].stamps[0] == second.stamp
    twin.change(layer__thickness=0.012)
    twin.session.reset()
    rigs = Read(twin.go(1).messages).contents[TWIN_TOPICS.journal]
    assert [rig.layer.thickness for _, rig in rigs] == [0.0168, 0.01, 0.012]


@pytest.mark.parametrize(
    'line',
    [
        '{}',
        '[' * 100_000,
        '{"kind": "throw", "step": 3}',
        '{"kind": "start", "step": 3, "settings": {"layer.thickness": "thick"}}',
        '{"kind": "start", "step": 3, "settings": [1]}',
        '{"kind": "throw", "step": 3, "throw": 1, "settings": {}, "schedule": {"rate": -1}}',
    ],
)
def test_invalid_journal_lines_are_refused_like_damage(real, line) -> None:
    data = text(line)
    reader = TwinReader()
    with pytest.raises(DECODING_ERRORS):
        reader.read_journal(Message(real.channels['journal'], data, 5, 5))
    assert reader.rig is None


def test_measured_throw_and_states_have_the_same_time_and_zero_height(measured) -> None:
    truth = measured.read.contents[TWIN_TOPICS.measured_joint_states]
    predicted = measured.read.contents[TWIN_TOPICS.predicted_joint_states]
    times, positions = joined(predicted, 0), joined(predicted, 1)
    stamps, heights = joined(truth, 0), joined(truth, 1)
    is_compared = (times[0] < stamps) & (stamps < times[20])
    assert is_compared.sum() > 50
    # The prediction is a polygon
    expected = np.interp(stamps[is_compared], times, positions[:, 0])
    assert heights[is_compared, 1] == pytest.approx(expected, abs=5e-5)


def test_measured_throw_starts_with_the_plate_and_the_journal_replaces_a_lost_result(
    measured,
) -> None:
    results = [item for item in measured.messages if item.channel.topic != '/twin/throw_result']
    (field,), (whole,) = Read(results).fields, measured.read.fields
    assert field.stamps[0] == pytest.approx(measured.schedule.time_ns + 50_000_000, abs=5000)
    assert field.times[-1] == pytest.approx(1.5 * field.throw.ejection_time)
    assert field.throw.ejection_time == pytest.approx(whole.throw.ejection_time, rel=1e-12)


def test_a_throw_is_over_when_its_end_is_reported() -> None:
    twin = TwinMessages(throw__period=0.3).go(620)  # the second throw has been released
    journals = [item for item in twin.messages if item.channel.topic == '/twin/journal']
    first, second = find_throws(journals)['/twin'][-2:]
    assert first.ejection_time == second.ejection_time
    assert (first.is_over, second.is_over) == (True, False)
    last = next(item for item in reversed(journals) if '"throw":1,' in str(item.data))
    cut = journals[:journals.index(last)]  # repeated, up to before the end of the first throw
    assert find_throws(journals + cut)['/twin'][-2].is_over
