# SPDX-License-Identifier: Apache-2.0
"""What messages of twins say, against the model that the twin follows."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
import runpy
from typing import Any

from hypothesis import given, settings
from hypothesis import strategies as st
import numpy as np
import pytest
from scipy.integrate import cumulative_trapezoid
from soft_throw_ros.configuration.interface import (
    FORMER_TOPICS,
    FRAME,
    LAYER_JOINTS,
    TWIN_TOPICS,
)
from soft_throw_ros.core.rig import Rig
from soft_throw_ros.core.throw import simulate
from soft_throw_ros.recording.cdr import encode_array, JointStateEncoder
from soft_throw_ros.recording.message import Channel, Message
from soft_throw_ros.recording.timeseries import (
    Decoder,
    find_throws,
    is_shown,
    LayerStates,
    LogLine,
    PhaseChange,
    Positions,
    RecommendationSummary,
    RigChange,
    RigStates,
    StrainField,
    ThrowStart,
    ThrowSummary,
)

HERE = Path(__file__).parent
TwinMessages: Any = runpy.run_path(str(HERE / 'twin_messages.py'))['TwinMessages']
measured_throw: Any = runpy.run_path(str(HERE.parent / 'twin' / 'rigs.py'))['measured_throw']


def one_throw(steps: int, **request: Any) -> Any:
    """Give a twin whose throw begins with the first step."""
    twin = TwinMessages(throw__period=0, **request)
    twin.session.request_throw()
    return twin.go(steps)


@pytest.fixture(scope='module')
def slow() -> Any:
    return one_throw(1400, time_scale=0.01)


@pytest.fixture(scope='module')
def real() -> Any:
    return one_throw(400, rate__field=1000.0)


@pytest.fixture(scope='module')
def measured() -> Any:
    """Give one throw of a measured plate."""
    twin = TwinMessages(engine__motion='measured')
    return twin.measure(measured_throw(Rig(), begin_ns=twin.now, duration=0.1))


def items(messages: Sequence[Message], kind: Any, *, batch: int = 10**9) -> list[Any]:
    """Return what of a kind is decoded of messages, as they come in batches."""
    decoder = Decoder()
    found = []
    for begin in range(0, len(messages), batch):
        found += list(decoder.decode(messages[begin : begin + batch]))
    assert not decoder.damaged, decoder.damage
    return [item for _, item in found if isinstance(item, kind)]


def joined(found: Sequence[Any], name: str) -> Any:
    return np.concatenate([getattr(item, name) for item in found])


def stamps_of_steps(twin: Any, steps: Sequence[int]) -> list[int]:
    return [twin.pace.deadline(step) for step in steps]


def test_states_are_those_of_the_session(slow) -> None:
    found = items(slow.messages, RigStates)
    states = np.array([outputs.state for outputs in slow.outputs])
    assert joined(found, 'stamps').tolist() == stamps_of_steps(slow, range(1400))
    for columns, name in enumerate(('position', 'velocity', 'force')):
        expected = states[:, 2 * columns : 2 * columns + 2]
        np.testing.assert_array_equal(joined(found, name), expected)


def test_work_of_the_plate_is_conserved_in_projectile_and_layer(slow) -> None:
    states = items(slow.messages, RigStates)
    stamps, plate_work = joined(states, 'stamps'), joined(states, 'plate_work')
    layers = items(slow.messages, LayerStates)
    assert sum(layer.stamps.size for layer in layers) > 200
    for layer in layers:
        work = np.interp(layer.stamps, stamps, plate_work)
        np.testing.assert_allclose(layer.total_energy, work, atol=6e-3 * plate_work.max())


def test_energies_are_those_of_the_exact_model_at_the_release(slow) -> None:
    throw = simulate(Rig())
    mass, gravity = throw.rig.projectile.mass, throw.rig.gravity
    rise = throw.first_release.position - (throw.rig.layer.thickness - throw.rig.static_sag)
    projectile_energy = mass * (0.5 * throw.ejection_speed**2 + gravity * rise)
    release = slow.pace.time_ns + throw.ejection_time * 1e9 / 0.01
    states = items(slow.messages, RigStates)
    layers = [each for each in items(slow.messages, LayerStates) if each.is_throw]
    for found, name, expected, tolerance in (
        (states, 'plate_work', throw.energies.plate_work, 1e-5),
        (states, 'projectile_energy', projectile_energy, 1e-5),
        (layers, 'energy', throw.energies.stored - projectile_energy, 2e-2),
    ):
        at_release = np.interp(release, joined(found, 'stamps'), joined(found, name))
        assert at_release == pytest.approx(expected, rel=tolerance), name


def test_work_begins_anew_with_every_throw() -> None:
    twin = TwinMessages(throw__period=0.2, rate__field=10.0).go(500)
    states = items(twin.messages, RigStates)
    work, stamps = joined(states, 'plate_work'), joined(states, 'stamps')
    first, second = np.searchsorted(stamps, stamps_of_steps(twin, [200, 400]))
    assert work[first] == work[second] == 0.0
    np.testing.assert_allclose(work[first : first + 90], work[second : second + 90], atol=1e-12)
    assert work[first + 10] > 1e-3
    assert np.isnan(work[second - 50])  # being put back


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
        states = items(twin.messages, RigStates)[-1]
        exact = np.interp(np.arange(states.stamps.size) * 1e-3 * scale, time, work)
        errors.append(np.abs(states.plate_work - exact).max())
    order, _ = np.polyfit(np.log(scales), np.log(errors), 1)
    assert order == pytest.approx(2.0, abs=0.25)


def layer_messages(twin: Any, topics: Sequence[Any]) -> list[Message]:
    """Make messages of the layer as the model has it, a row for every tenth state of a throw."""
    channels = [
        Channel(topic=topic.at('/twin').name, type=topic.type, schema='') for topic in topics
    ]
    encode_states = JointStateEncoder(FRAME, LAYER_JOINTS).encode
    rig = Rig()
    time = np.arange(0, 800, 10) * 1e-5
    fields = simulate(rig, until=0.02).fields(time, points=64)
    plate = simulate(rig, until=0.02).trajectory(time).plate_position
    step = rig.layer.thickness / 63
    height = plate[:, None] + step * cumulative_trapezoid(1.0 + fields.strain, axis=1, initial=0.0)
    force = -rig.layer.youngs_modulus * rig.layer.section * fields.strain
    messages = []
    for row, number in enumerate(range(0, 800, 10)):
        stamp = twin.pace.deadline(number)
        if len(channels) == 1:
            values = (*height[row], *fields.velocity[row], *force[row])
            datas = [encode_states(stamp, values)]
        else:
            datas = [encode_array('y', each[row]) for each in (fields.strain, fields.velocity)]
        messages += [
            Message(channel, data, stamp + 200_000, stamp + 200_000, 0)
            for channel, data in zip(channels, datas, strict=True)
        ]
    return messages


@pytest.mark.parametrize(
    'topics', [[TWIN_TOPICS.layer_joint_states], list(FORMER_TOPICS)], ids=['0.2', '0.1']
)
def test_layer_is_that_of_the_model_in_new_and_former_bags(slow, topics) -> None:
    others = [each for each in slow.messages if '/layer/' not in each.channel.topic]
    messages = sorted(others + layer_messages(slow, topics), key=lambda message: message.log_time)
    found = [each for each in items(messages, LayerStates, batch=500) if not each.is_throw]
    assert joined(found, 'stamps').tolist() == stamps_of_steps(slow, range(0, 800, 10))
    throw = simulate(Rig(), until=0.02)
    time = np.arange(0, 800, 10) * 1e-5
    path, exact = throw.trajectory(time), throw.fields(time, points=64).strain
    in_contact = time < throw.ejection_time
    height = joined(found, 'height')
    np.testing.assert_allclose(height[:, 0], path.plate_position, atol=1e-9)
    np.testing.assert_allclose(
        height[in_contact, -1], path.projectile_position[in_contact], atol=2e-6
    )
    assert np.abs(joined(found, 'strain') - exact).mean() < 1e-3
    states = items(messages, RigStates, batch=500)
    work = np.interp(
        joined(found, 'stamps'), joined(states, 'stamps'), joined(states, 'plate_work')
    )
    total = joined(found, 'total_energy')
    np.testing.assert_allclose(total[1:], work[1:], atol=2e-3 * work.max())


def test_field_of_a_throw_has_its_times_and_ends_at_the_projectile(slow) -> None:
    (field,) = items(slow.messages, StrainField)
    (shown,) = [outputs.throw_field for outputs in slow.outputs if outputs.throw_field]
    np.testing.assert_allclose(field.times, shown.times, rtol=1e-12, atol=1e-15)
    np.testing.assert_array_equal(field.strain, shown.strain)
    assert field.start == slow.pace.deadline(0)
    (positions,) = items(slow.messages, Positions)
    (layer,) = [each for each in items(slow.messages, LayerStates) if each.is_throw]
    np.testing.assert_array_equal(layer.stamps, positions.stamps)
    in_contact = field.times < field.ejection_time
    top = layer.height[in_contact, -1]
    np.testing.assert_allclose(top, positions.position[in_contact, 1], atol=2e-6)
    assert np.ptp(top) > 1e-3


def test_positions_between_states_are_those_of_the_model(real) -> None:
    """A cubic between steps of 1 ms, of which a contact has eight."""
    (positions,) = items(real.messages, Positions)
    (field,) = items(real.messages, StrainField)
    path = simulate(Rig(), until=0.02).trajectory(field.times)
    np.testing.assert_allclose(positions.position[:, 0], path.plate_position, atol=2e-7)
    np.testing.assert_allclose(positions.position[:, 1], path.projectile_position, atol=5e-6)


@pytest.mark.parametrize('ahead', [0, 3 * 10**17, -(10**17)])
def test_message_without_stamp_gets_that_of_its_step(real, ahead) -> None:
    """Also if the twin follows another clock than messages are published by."""
    messages = [
        message._replace(publish_time=message.publish_time + ahead) for message in real.messages
    ]
    entered = [
        (real.pace.deadline(step), phase.value)
        for step, outputs in enumerate(real.outputs)
        for phase in outputs.phases
    ]
    phases = items(messages, PhaseChange)
    assert [(phase.stamp, phase.phase) for phase in phases] == entered


@pytest.mark.parametrize('batch', [1, 7, 100])
def test_batches_do_not_matter(real, batch) -> None:
    for kind, name in (
        (RigStates, 'plate_work'),
        (RigStates, 'projectile_energy'),
        (LayerStates, 'stamps'),
        (LayerStates, 'total_energy'),
    ):
        whole = joined(items(real.messages, kind), name)
        pieces = joined(items(real.messages, kind, batch=batch), name)
        np.testing.assert_allclose(np.sort(pieces, 0), np.sort(whole, 0), atol=1e-15)


def test_rig_changes_with_a_throw_and_recommendations_are_for_what_is_wanted() -> None:
    twin = TwinMessages(throw__period=0.1, time_scale=0.1).go(1500)
    twin.change(layer__thickness=0.01)
    begun = len(twin.messages)
    twin.go(1000)
    first, second = items(twin.messages, RigChange)
    assert (first.rig.layer.thickness, second.rig.layer.thickness) == (0.0168, 0.01)
    starts = items(twin.messages, ThrowStart)
    assert second.stamp == starts[1].stamp
    assert find_throws(twin.messages)['/twin'][0].has_field
    before, wanted = items(twin.messages[:begun], RecommendationSummary)
    assert (before.rig, wanted.rig) == (first.rig, second.rig)
    states = items(twin.messages, RigStates)
    since = joined(states, 'stamps') >= second.stamp
    work, stamps = joined(states, 'plate_work')[since], joined(states, 'stamps')[since]
    assert joined(states, 'projectile_energy')[since][0] == work[0] == 0.0
    layers = [each for each in items(twin.messages, LayerStates) if each.stamps[0] >= second.stamp]
    for layer in layers:
        expected = np.interp(layer.stamps, stamps, work)
        np.testing.assert_allclose(layer.total_energy, expected, atol=4e-5)
    assert layers


def test_rig_changes_with_a_reset() -> None:
    twin = TwinMessages(throw__period=0).go(50)
    twin.change(layer__thickness=0.01)
    assert len(items(twin.messages, RigChange)) == 1
    twin.session.reset()
    changes = items(twin.go(50).messages, RigChange)
    assert [change.rig.layer.thickness for change in changes] == [0.0168, 0.01]


def test_summaries_have_their_numbers_and_logs_their_words(real) -> None:
    summary = items(real.messages, ThrowSummary)[0]
    assert (summary.values['stage'], summary.stamp) == ('release', real.pace.deadline(0))
    expected = simulate(Rig()).energy_transfer
    assert summary.values['energy_transfer'] == pytest.approx(expected, rel=1e-5)
    line = items(real.messages, LogLine)[0]
    assert (line.node, line.level) == ('twin', 20)
    assert 'throw 1' in line.text


@pytest.mark.parametrize(
    'name', ['joint_states', 'measured_joint_states', 'predicted_joint_states', 'residual']
)
def test_joint_states_of_other_machines_are_no_damage(real, name) -> None:
    arm = JointStateEncoder('base', ('shoulder', 'elbow')).encode(1, [0.0] * 6)
    assert items([Message(real.channels[name], arm, 1, 1)], object) == []


def test_only_topics_of_a_twin_are_shown() -> None:
    assert is_shown('/a/b/joint_states', 'sensor_msgs/msg/JointState')
    assert is_shown('/a/b/layer/strain', 'std_msgs/msg/Float64MultiArray')
    assert not is_shown('/a/joint_states', 'std_msgs/msg/String')
    assert not is_shown('/my_joint_states', 'sensor_msgs/msg/JointState')
    assert not is_shown('/scan', 'sensor_msgs/msg/LaserScan')


@settings(max_examples=200)
@given(st.data())
def test_damaged_messages_are_counted_and_the_rest_is_shown(real, data) -> None:
    messages = list(real.messages[:60])
    place = data.draw(st.integers(0, len(messages) - 1))
    damaged = bytearray(messages[place].data)
    for _ in range(data.draw(st.integers(0, 3))):
        damaged[data.draw(st.integers(0, len(damaged) - 1))] ^= 1 << data.draw(st.integers(0, 7))
    cut = data.draw(st.integers(0, len(damaged)))
    messages[place] = messages[place]._replace(
        data=bytes(damaged[:cut]),
        publish_time=data.draw(st.sampled_from([0, 1, 2**63, 2**64 - 1])),
    )
    decoder = Decoder()
    found = [item for _, item in decoder.decode(messages) if isinstance(item, RigStates)]
    states = sum(each.channel.topic == '/twin/joint_states' for each in messages)
    assert sum(item.stamps.size for item in found) >= states - 1
    assert decoder.damaged <= 2
    assert bool(decoder.damage) == bool(decoder.damaged)


@pytest.mark.parametrize(
    'line',
    [
        '{}',
        '[' * 100_000,
        '{"kind": "throw", "step": 3}',
        '{"kind": "start", "step": 3, "settings": {"layer.thickness": "thick"}}',
        '{"kind": "start", "step": 3, "settings": [1]}',
        '{"kind": "pace", "step": 3, "anchor_step": 0, "anchor_time_ns": 0, "rate": -1}',
    ],
)
def test_lines_of_no_journal_are_counted(real, line) -> None:
    data = line.encode() + b'\0'
    data = b'\0\1\0\0' + len(data).to_bytes(4, 'little') + data
    decoder = Decoder()
    assert list(decoder.decode([Message(real.channels['journal'], data, 5, 5)])) == []
    assert decoder.damaged == 1
    assert decoder.damage.startswith('/twin/journal: ')


def test_measured_throw_is_beside_the_states_at_the_same_height(measured) -> None:
    found = {
        topic: [item for item in items(measured.messages, Positions) if item.topic == topic]
        for topic in (
            TWIN_TOPICS.measured_joint_states,
            TWIN_TOPICS.predicted_joint_states,
            TWIN_TOPICS.residual,
        )
    }
    truth, predicted, residual = found.values()
    predictions = [outputs.prediction for outputs in measured.outputs if outputs.prediction]
    times, positions = joined(predicted, 'stamps'), joined(predicted, 'position')
    assert times.tolist() == [item.stamp_ns for item in predictions]
    assert positions[:, 0].tolist() == [item.position for item in predictions]
    residuals = [outputs.residual for outputs in measured.outputs if outputs.residual]
    assert joined(residual, 'position').tolist() == [list(item[1:]) for item in residuals]
    stamps, heights = joined(truth, 'stamps'), joined(truth, 'position')
    there = (times[0] < stamps) & (stamps < times[20])
    assert there.sum() > 50
    expected = np.interp(stamps[there], times, positions[:, 0])
    assert heights[there, 1] == pytest.approx(expected, abs=5e-5)  # the prediction is a polygon


def test_measured_throw_starts_with_the_plate(measured) -> None:
    onset = measured.pace.time_ns + 50_000_000
    (field,) = items(measured.messages, StrainField)
    assert field.start == pytest.approx(onset, abs=5000)
    assert field.times[-1] == pytest.approx(1.5 * field.ejection_time)
    summaries = items(measured.messages, ThrowSummary)
    stamps = {summary.values.get('stage'): summary.stamp for summary in summaries}
    assert stamps['predicted'] == stamps['release'] == field.start


def test_work_of_a_measured_plate_begins_with_its_throw() -> None:
    twin = TwinMessages(engine__motion='measured')
    noisy = measured_throw(Rig(), begin_ns=twin.now, duration=0.1, noise=5e-6)
    states = items(twin.measure(noisy).messages, RigStates)
    work, velocity = joined(states, 'plate_work'), joined(states, 'velocity')
    begin = int(np.flatnonzero(velocity[:, 0] != velocity[:, 1])[0])
    assert begin > 20
    assert (velocity[1:begin, 0] != 0.0).any()  # it is never quite at rest
    assert (work[:begin] == 0.0).all()
    assert work[begin + 10] > 1e-4
