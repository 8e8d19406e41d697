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
"""Time series read from messages of twins, compared with the model of the twin."""

from __future__ import annotations

from collections.abc import Sequence
import json
from typing import Any

import numpy as np
import pytest
from rigs import measured_throw
from scipy.integrate import cumulative_trapezoid
from soft_throw_ros.configuration.interface import (
    TWIN_TOPICS,
)
from soft_throw_ros.core.rig import Layer, Rig
from soft_throw_ros.core.throw import simulate
from soft_throw_ros.recording.message import Message
from soft_throw_ros.recording.timeseries import (
    DECODING_ERRORS,
    find_throws,
    identify,
    LayerStates,
    read_statuses,
    StrainField,
    TwinReader,
)
from twin_messages import TwinMessages


def one_throw(steps: int, **request: Any) -> Any:
    """Return a twin whose throw begins with the first step, with its messages read back."""
    twin = TwinMessages(throw__period=0, **request)
    twin.session.request_throw()
    twin.go(steps)
    twin.read = Read(twin.messages)
    return twin


def journal_message(line: str) -> bytes:
    """Encode a line of a journal as a message std_msgs/String."""
    text = line.encode() + b'\0'
    return b'\0\1\0\0' + len(text).to_bytes(4, 'little') + text


@pytest.fixture(scope='module')
def slow() -> Any:
    return one_throw(1400, time_scale=0.01)


@pytest.fixture(scope='module')
def real() -> Any:
    return one_throw(400, rate__field=1000.0)


@pytest.fixture(scope='module')
def measured() -> Any:
    """Return one throw of a measured plate, with its messages read back."""
    twin = TwinMessages(engine__motion='measured')
    twin.measure(measured_throw(Rig(), begin_ns=twin.now, duration=0.1))
    twin.read = Read(twin.messages)
    return twin


class Read:
    """Series read from messages, one by one or in batches of states."""

    def __init__(self, messages: Sequence[Message], *, batch: int = 1) -> None:
        self.reader = reader = TwinReader()
        self.states: list[Any] = []
        self.layers: list[LayerStates] = []
        self.fields: list[StrainField] = []
        self.throws: list[Any] = []  # positions, layer and energies at the times of the field
        self.positions: dict[Any, list[Any]] = {}
        self.rigs: list[tuple[int, Rig]] = []
        waiting: list[Message] = []
        for message in messages:
            _, topic = identify(message.channel.topic, message.channel.type)
            if topic == TWIN_TOPICS.joint_states:
                waiting.append(message)
                if len(waiting) < batch:
                    continue
            if waiting:
                self._add(self.states, reader.read_states(waiting))
                waiting = []
            rig = reader.rig
            if topic == TWIN_TOPICS.journal:
                reader.read_journal(message)
                if reader.rig is not rig:
                    self.rigs.append((reader.stamp_of(message), reader.rig))
            elif topic == TWIN_TOPICS.layer_joint_states:
                self._add(self.layers, reader.read_layer([message]))
            elif topic == TWIN_TOPICS.throw_result:
                for _, _, values in read_statuses(message):
                    reader.note_result(values)
            elif topic == TWIN_TOPICS.throw_field:
                field = reader.read_field(message)
                self._add(self.fields, field)
                self._add(self.throws, reader.see_throw(field))
            elif topic in AUXILIARY:
                self._add(
                    self.positions.setdefault(topic, []), reader.read_positions(topic, [message])
                )
        if waiting:
            self._add(self.states, reader.read_states(waiting))

    @staticmethod
    def _add(items: list[Any], item: Any) -> None:
        if item is not None:
            items.append(item)


AUXILIARY = (
    TWIN_TOPICS.measured_joint_states,
    TWIN_TOPICS.predicted_joint_states,
    TWIN_TOPICS.residual,
)


def joined(found: Sequence[Any], name: str | int) -> Any:
    return np.concatenate(
        [item[name] if isinstance(name, int) else getattr(item, name) for item in found]
    )


def stamps_of_steps(twin: Any, steps: Sequence[int]) -> list[int]:
    return [twin.pace.deadline(step) for step in steps]


def test_work_of_the_plate_is_conserved_in_projectile_and_layer(slow) -> None:
    read = slow.read
    stamps, plate_work = joined(read.states, 'stamps'), joined(read.states, 'plate_work')
    ((_, layer, energies),) = read.throws
    work = np.interp(layer.stamps, stamps, plate_work)
    assert work.size == 200
    np.testing.assert_allclose(energies[:, 1], work, atol=6e-3 * plate_work.max())


def test_energies_at_the_release_agree_with_the_exact_model(slow) -> None:
    throw = simulate(Rig())
    mass, gravity = throw.rig.projectile.mass, throw.rig.gravity
    rise = throw.first_release.position - throw.rest_height
    projectile_energy = mass * (0.5 * throw.ejection_speed**2 + gravity * rise)
    release = slow.pace.time_ns + throw.ejection_time * 1e9 / 0.01
    states = slow.read.states
    for name, expected in (
        ('plate_work', throw.energies.plate_work), ('projectile_energy', projectile_energy)
    ):
        at_release = np.interp(release, joined(states, 'stamps'), joined(states, name))
        assert at_release == pytest.approx(expected, rel=1e-5), name
    ((_, layer, energies),) = slow.read.throws
    stored = np.interp(release, layer.stamps, energies[:, 0])
    assert stored == pytest.approx(throw.energies.stored - projectile_energy, rel=2e-2)


def test_projectile_at_rest_on_a_layer_of_constant_loss_has_no_energy() -> None:
    layer = {'thickness': 0.05, 'wave_speed': 3.0, 'loss_tangent': 0.2, 'loss': 'constant'}
    read = one_throw(200, **{f'layer__{name}': value for name, value in layer.items()}).read
    weight = Rig().projectile.mass * Rig().gravity
    assert joined(read.states, 'projectile_energy')[0] == pytest.approx(0.0, abs=1e-9 * weight)
    ((_, _, energies),) = read.throws
    # Velocities are differences of the field; an unrelaxed layer would be 4e-6 J off
    assert energies[0, 0] == pytest.approx(0.0, abs=1e-6)


def test_work_converges_with_the_square_of_the_step() -> None:
    throw = simulate(Rig(), until=0.01)
    time = np.linspace(0.0, throw.ejection_time, 40_001)
    layer = throw.rig.layer
    force = layer.youngs_modulus * layer.section * throw.fields(time, points=2).strain[:, 0]
    speed = throw.trajectory(time).plate_velocity
    work = cumulative_trapezoid(-force * speed, time, initial=0.0)
    scales, errors = (0.4, 0.2, 0.1, 0.05, 0.025), []
    for scale in scales:
        twin = one_throw(round(7.6 / scale), time_scale=scale, rate__field=10.0)
        plate_work = joined(twin.read.states, 'plate_work')
        exact = np.interp(np.arange(plate_work.size) * 1e-3 * scale, time, work)
        errors.append(np.abs(plate_work - exact).max())
    order, _ = np.polyfit(np.log(scales), np.log(errors), 1)
    assert order == pytest.approx(2.0, abs=0.25)


def test_layer_agrees_with_the_session(slow) -> None:
    rows = [(step, each.layer) for step, each in enumerate(slow.outputs) if each.layer is not None]
    stamps = stamps_of_steps(slow, [step for step, _ in rows])
    height, _, force = (np.array([layer[place] for _, layer in rows]) for place in range(3))
    strain = -force / (Rig().layer.youngs_modulus * Rig().layer.section)
    layers = slow.read.layers
    assert joined(layers, 'stamps').tolist() == stamps
    np.testing.assert_allclose(joined(layers, 'height'), height, atol=2e-6)
    assert np.abs(joined(layers, 'strain') - strain).mean() < 1e-3


def test_field_of_a_throw_has_its_times_and_ends_at_the_projectile(slow) -> None:
    read = slow.read
    (field,), ((position, layer, _),) = read.fields, read.throws
    (shown,) = [outputs.throw_field for outputs in slow.outputs if outputs.throw_field]
    np.testing.assert_allclose(field.times, shown.times, rtol=1e-12, atol=1e-15)
    np.testing.assert_array_equal(field.strain, shown.strain)
    assert field.stamps[0] == slow.pace.deadline(0)
    np.testing.assert_array_equal(layer.stamps, field.stamps)
    in_contact = field.times < field.ejection_time
    top = layer.height[in_contact, -1]
    np.testing.assert_allclose(top, position[in_contact, 1], atol=2e-6)
    assert np.ptp(top) > 1e-3


def test_positions_between_states_agree_with_the_model(real) -> None:
    """The reader interpolates by a cubic between steps of 1 ms; a contact has eight steps."""
    read = real.read
    (field,), ((position, *_),) = read.fields, read.throws
    path = simulate(Rig(), until=0.02).trajectory(field.times)
    np.testing.assert_allclose(position[:, 0], path.plate_position, atol=2e-7)
    np.testing.assert_allclose(position[:, 1], path.projectile_position, atol=5e-6)


def test_result_does_not_depend_on_batches(real) -> None:
    one = real.read.states
    for batch in (7, 100):
        many = Read(real.messages, batch=batch).states
        for name in ('stamps', 'plate_work', 'projectile_energy'):
            np.testing.assert_allclose(joined(many, name), joined(one, name), rtol=0, atol=1e-15)


def test_rig_changes_with_a_throw_or_reset_and_requests_are_known_before() -> None:
    twin = TwinMessages(throw__period=0.1, time_scale=0.1).go(1500)
    twin.change(layer__thickness=0.01)
    before = Read(twin.messages).reader
    assert (before.wanted_rig(), before.rig) == (Rig(layer=Layer(thickness=0.01)), Rig())
    read = Read(twin.go(1000).messages)
    first, second = find_throws(twin.messages)['/twin'][:2]
    assert first.has_field
    since = joined(read.states, 'stamps') >= second.stamp
    work, stamps = (joined(read.states, name)[since] for name in ('plate_work', 'stamps'))
    assert joined(read.states, 'projectile_energy')[since][0] == work[0] == 0.0
    _, layer, energies = read.throws[1]
    expected = np.interp(layer.stamps, stamps, work)
    np.testing.assert_allclose(energies[:, 1], expected, atol=4e-5)
    twin.change(layer__thickness=0.012)
    twin.session.reset()
    rigs = Read(twin.go(1).messages).rigs
    assert [rig.layer.thickness for _, rig in rigs] == [0.0168, 0.01, 0.012]


def test_former_names_in_a_journal_give_the_present_rig(real) -> None:
    entry = {
        'kind': 'start',
        'step': 3,
        'settings': {'layer.elasticity': 'neo_hookean', 'model': 'finite_difference_elastic'},
    }
    reader = TwinReader()
    data = journal_message(json.dumps(entry))
    reader.read_journal(Message(real.channels['journal'], data, 5, 5))
    assert reader.rig == Rig(layer=Layer(stress_strain_law='neo_hookean'))
    assert reader.settings['model'] == 'cells_elastic'


@pytest.mark.parametrize(
    'line',
    [
        '{}',
        '[' * 100_000,
        '{"kind": "throw", "step": 3}',
        '{"kind": "start", "step": 3, "settings": {"layer.thickness": "thick"}}',
        '{"kind": "start", "step": 3, "settings": [1]}',
        '{"kind": "tick_schedule", "step": 3, "anchor_step": 0, "anchor_time_ns": 0, "rate": -1}',
    ],
)
def test_invalid_journal_lines_are_refused_like_damage(real, line) -> None:
    data = journal_message(line)
    reader = TwinReader()
    with pytest.raises(DECODING_ERRORS):
        reader.read_journal(Message(real.channels['journal'], data, 5, 5))
    assert reader.rig is None


def test_measured_throw_and_states_have_the_same_zero_height(measured) -> None:
    found = measured.read.positions
    (truth, predicted) = (found[topic] for topic in AUXILIARY[:2])
    times, positions = joined(predicted, 0), joined(predicted, 1)
    stamps, heights = joined(truth, 0), joined(truth, 1)
    there = (times[0] < stamps) & (stamps < times[20])
    assert there.sum() > 50
    expected = np.interp(stamps[there], times, positions[:, 0])
    assert heights[there, 1] == pytest.approx(expected, abs=5e-5)  # the prediction is a polygon


def test_measured_throw_starts_with_the_plate_and_the_journal_replaces_a_lost_result(
    measured,
) -> None:
    results = [each for each in measured.messages if each.channel.topic != '/twin/throw_result']
    (field,), (whole,) = Read(results).fields, measured.read.fields
    assert field.stamps[0] == pytest.approx(measured.pace.time_ns + 50_000_000, abs=5000)
    assert field.times[-1] == pytest.approx(1.5 * field.ejection_time)
    assert field.ejection_time == pytest.approx(whole.ejection_time, rel=1e-12)


def test_work_of_a_measured_plate_begins_with_its_throw() -> None:
    twin = TwinMessages(engine__motion='measured')
    noisy = measured_throw(Rig(), begin_ns=twin.now, duration=0.1, noise=5e-6)
    states = Read(twin.measure(noisy).messages).states
    work, velocity = joined(states, 'plate_work'), joined(states, 'velocity')
    begin = int(np.flatnonzero(velocity[:, 0] != velocity[:, 1])[0])
    assert begin > 20
    assert (velocity[1:begin, 0] != 0.0).any()  # it is never quite at rest
    assert (work[:begin] == 0.0).all()
    assert work[begin + 10] > 1e-4
