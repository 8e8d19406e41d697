# SPDX-License-Identifier: Apache-2.0
"""What messages of twins say, against the model that the twin follows."""

from __future__ import annotations

from collections.abc import Sequence
import json
from pathlib import Path
import runpy
from typing import Any

from hypothesis import given, settings
from hypothesis import strategies as st
import numpy as np
import pytest
from scipy.integrate import cumulative_trapezoid
from soft_throw_ros.core.rig import Rig
from soft_throw_ros.core.throw import simulate
from soft_throw_ros.recording.cdr import JointStateEncoder
from soft_throw_ros.recording.digest import (
    Beside,
    Digest,
    is_shown,
    LayerEnergy,
    LayerStrain,
    LogLine,
    MEASURED,
    Motion,
    PhaseChange,
    Places,
    PREDICTED,
    Report,
    RESIDUAL,
    RigChange,
    ThrowPicture,
)
from soft_throw_ros.recording.message import Message
from soft_throw_ros.twin import journal
from soft_throw_ros.twin.results import State

TwinMessages: Any = runpy.run_path(str(Path(__file__).with_name('twin_messages.py')))[
    'TwinMessages'
]


rigs: Any = runpy.run_path(str(Path(__file__).parents[1] / 'twin' / 'rigs.py'))


def one_throw(steps: int, **request: Any) -> Any:
    """A throw that begins with the first step."""
    twin = TwinMessages(throw__period=0, **request)
    twin.session.request_throw()
    return twin.go(steps)


@pytest.fixture(scope='module')
def slow() -> Any:
    return one_throw(1400, time_scale=0.01)


@pytest.fixture(scope='module')
def real() -> Any:
    return one_throw(400, rate__field=1000.0)


def parts(messages: Sequence[Message], kind: Any, *, batch: int = 10**9) -> list[Any]:
    """Return what of a kind a digest makes of messages, as they come in batches."""
    digest = Digest()
    found = []
    for begin in range(0, len(messages), batch):
        found += list(digest.take(messages[begin : begin + batch]))
    assert not digest.damaged, digest.damage
    return [part for _, part in found if isinstance(part, kind)]


def joined(items: Sequence[Any], name: str) -> Any:
    return np.concatenate([getattr(item, name) for item in items])


def stamps_of_steps(twin: Any, steps: Sequence[int]) -> list[int]:
    return [twin.pace.deadline(step) for step in steps]


def rig_of(twin: Any) -> Any:
    (change,) = parts(twin.messages, RigChange)
    return change.rig


def test_motion_is_what_the_session_gave(slow) -> None:
    motion = parts(slow.messages, Motion)
    states = np.array([outputs.state for outputs in slow.outputs])
    assert joined(motion, 'stamps').tolist() == stamps_of_steps(slow, range(1400))
    np.testing.assert_array_equal(joined(motion, 'position'), states[:, 0:2])
    np.testing.assert_array_equal(joined(motion, 'velocity'), states[:, 2:4])
    np.testing.assert_array_equal(joined(motion, 'force'), states[:, 4:6])


def test_energies_are_those_of_the_exact_model_at_the_release(slow) -> None:
    throw = simulate(rig_of(slow))
    release = slow.pace.time_ns + throw.ejection_time * 1e9 / 0.01
    (motion,) = parts(slow.messages, Motion)[-1:]
    layer = parts(slow.messages, LayerEnergy)
    work = np.interp(release, motion.stamps, motion.plate_work)
    carried = np.interp(release, motion.stamps, motion.projectile_energy)
    order = np.argsort(joined(layer, 'stamps'), kind='stable')
    stored = np.interp(release, joined(layer, 'stamps')[order], joined(layer, 'layer')[order])
    assert work == pytest.approx(throw.energies.plate_work, rel=1e-5)
    assert carried == pytest.approx(throw.energies.projectile, rel=1e-5)
    assert stored == pytest.approx(throw.energies.layer, rel=2e-2)


def test_work_of_the_plate_is_in_projectile_and_layer(slow) -> None:
    motion = parts(slow.messages, Motion)[-1]
    from_fields = parts(slow.messages, LayerEnergy)
    largest = motion.plate_work.max()
    assert sum(energy.stamps.size for energy in from_fields) > 200
    for energy in from_fields:
        work = np.interp(energy.stamps, motion.stamps, motion.plate_work)
        np.testing.assert_allclose(energy.total, work, atol=6e-3 * largest)


def test_work_converges_with_the_square_of_the_step() -> None:
    throw = simulate(Rig(), until=0.01)
    time = np.linspace(0.0, throw.ejection_time, 40_001)
    layer = throw.rig.layer
    force = layer.youngs_modulus * layer.section * throw.fields(time, points=2).strain[:, 0]
    speed = throw.trajectory(time).plate_velocity
    work = cumulative_trapezoid(-force * speed, time, initial=0.0)
    errors = []
    scales = (0.2, 0.1, 0.05, 0.025)
    for scale in scales:
        twin = one_throw(round(7.6 / scale), time_scale=scale, rate__field=10.0)
        motion = parts(twin.messages, Motion)[-1]
        exact = np.interp(np.arange(motion.stamps.size) * 1e-3 * scale, time, work)
        errors.append(np.abs(motion.plate_work - exact).max())
    order, _ = np.polyfit(np.log(scales), np.log(errors), 1)
    assert order == pytest.approx(2.0, abs=0.25)


def test_work_begins_anew_with_every_throw() -> None:
    twin = TwinMessages(throw__period=0.2, rate__field=10.0).go(500)
    motion = parts(twin.messages, Motion)
    work, stamps = joined(motion, 'plate_work'), joined(motion, 'stamps')
    first, second = np.searchsorted(stamps, stamps_of_steps(twin, [200, 400]))
    assert work[first] == work[second] == 0.0
    np.testing.assert_allclose(work[first : first + 90], work[second : second + 90], atol=1e-12)
    assert work[first + 10] > 1e-3
    assert np.isnan(work[second - 50])  # being put back


def test_field_of_a_throw_has_the_times_of_the_plan(slow) -> None:
    (picture,) = parts(slow.messages, ThrowPicture)
    (shown,) = [outputs.throw_field for outputs in slow.outputs if outputs.throw_field]
    np.testing.assert_allclose(picture.times, shown.times, rtol=1e-12, atol=1e-15)
    np.testing.assert_array_equal(picture.strain, shown.strain)
    assert picture.start == slow.pace.deadline(0)
    last = picture.start + round(shown.times[-1] * 1e9 / 0.01)
    assert abs(int(picture.stamps()[-1]) - last) <= 1


def test_layer_ends_where_the_projectile_begins(slow) -> None:
    (places,) = parts(slow.messages, Places)
    (layer,) = [layer for layer in parts(slow.messages, LayerStrain) if len(layer.stamps) == 200]
    np.testing.assert_array_equal(layer.stamps, places.stamps)
    (picture,) = parts(slow.messages, ThrowPicture)
    in_contact = picture.times < picture.ejection_time
    top = layer.heights()[in_contact, -1]
    np.testing.assert_allclose(top, places.position[in_contact, 1], atol=2e-6)
    assert np.ptp(top) > 1e-3


def test_places_between_states_are_those_of_the_model(real) -> None:
    """A cubic between steps of 1 ms, of which a contact has eight."""
    (places,) = parts(real.messages, Places)
    (picture,) = parts(real.messages, ThrowPicture)
    path = simulate(rig_of(real), until=0.02).trajectory(picture.times)
    np.testing.assert_allclose(places.position[:, 0], path.plate_position, atol=2e-7)
    np.testing.assert_allclose(places.position[:, 1], path.projectile_position, atol=5e-6)


def test_layer_energy_comes_from_the_strain_alone_if_it_must(real) -> None:
    without = [
        message for message in real.messages if not message.channel.topic.endswith('velocity')
    ]
    (energy,) = parts(without, LayerEnergy)
    throw = simulate(rig_of(real))
    release = real.pace.time_ns + throw.ejection_time * 1e9
    assert np.interp(release, energy.stamps, energy.layer) == pytest.approx(
        throw.energies.layer, rel=2e-2
    )


@pytest.mark.parametrize('ahead', [0, 3 * 10**17, -(10**17)])
def test_what_has_no_stamp_gets_that_of_its_step(real, ahead) -> None:
    """Also if the twin follows another clock than messages are published by."""
    messages = [
        message._replace(publish_time=message.publish_time + ahead) for message in real.messages
    ]
    entered = [
        (step, phase.value)
        for step, outputs in enumerate(real.outputs)
        for phase in outputs.phases
    ]
    phases = parts(messages, PhaseChange)
    assert [phase.phase for phase in phases] == [name for _, name in entered]
    assert [phase.stamp for phase in phases] == stamps_of_steps(
        real, [step for step, _ in entered]
    )
    fields = [step for step, outputs in enumerate(real.outputs) if outputs.field is not None]
    layers = parts(messages, LayerStrain)
    of_topic = [layer for layer in layers if layer.strain.shape[0] != 200]
    assert joined(of_topic, 'stamps').tolist() == stamps_of_steps(real, fields)


@pytest.mark.parametrize('batch', [1, 7, 100])
def test_batches_do_not_matter(real, batch) -> None:
    for kind, name in (
        (Motion, 'plate_work'),
        (Motion, 'projectile_energy'),
        (LayerEnergy, 'stamps'),
        (LayerEnergy, 'total'),
        (LayerStrain, 'strain'),
    ):
        whole = joined(parts(real.messages, kind), name)
        pieces = joined(parts(real.messages, kind, batch=batch), name)
        np.testing.assert_allclose(np.sort(pieces, 0), np.sort(whole, 0), atol=1e-15)


def test_rig_changes_when_a_throw_begins_with_another() -> None:
    twin = TwinMessages(throw__period=0.1, time_scale=0.1).go(1500)
    twin.change(layer__thickness=0.01)
    twin.go(1000)
    first, second = parts(twin.messages, RigChange)
    assert (first.rig.layer.thickness, second.rig.layer.thickness) == (0.0168, 0.01)
    starts = [
        entry['step']
        for entry in map(journal.decode, journal_lines(twin))
        if entry['kind'] == 'throw'
    ]
    assert second.stamp == twin.pace.deadline(starts[1])
    motion = parts(twin.messages, Motion)
    begun = joined(motion, 'stamps') >= second.stamp
    work, stamps = joined(motion, 'plate_work')[begun], joined(motion, 'stamps')[begun]
    assert joined(motion, 'projectile_energy')[begun][0] == work[0] == 0.0
    energies = parts(twin.messages, LayerEnergy)
    since = joined(energies, 'stamps') >= second.stamp
    total, times = joined(energies, 'total')[since], joined(energies, 'stamps')[since]
    assert times.size > 200
    np.testing.assert_allclose(total, np.interp(times, stamps, work), atol=4e-5)


def journal_lines(twin: Any) -> list[str]:
    return [
        message.data[8:].rstrip(b'\0').decode()
        for message in twin.messages
        if message.channel.topic.endswith('journal')
    ]


def test_reports_have_their_numbers_and_logs_their_words(real) -> None:
    results = [report for report in parts(real.messages, Report) if report.kind == 'throw_result']
    throw = simulate(rig_of(real))
    assert results[0].values['stage'] == 'release'
    assert results[0].stamp == real.pace.deadline(0)
    assert results[0].values['energy_transfer'] == pytest.approx(throw.energy_transfer, rel=1e-5)
    lines = parts(real.messages, LogLine)
    assert lines[0].text == results[0].message
    assert (lines[0].node, lines[0].level) == ('twin', 20)


def test_twins_are_kept_apart() -> None:
    one, two = TwinMessages('/rig1/twin'), TwinMessages('/rig2/twin', layer__thickness=0.01)
    messages = sorted(one.go(50).messages + two.go(50).messages, key=lambda each: each.log_time)
    digest = Digest()
    rigs = {
        prefix: part.rig.layer.thickness
        for prefix, part in digest.take(messages)
        if isinstance(part, RigChange)
    }
    assert rigs == {'/rig1/twin': 0.0168, '/rig2/twin': 0.01}


def test_joint_states_of_other_machines_are_left_alone(real) -> None:
    channel = real.channels['joint_states']
    arm = JointStateEncoder('base', ('shoulder', 'elbow')).encode(1, State(*[0.0] * 6))
    digest = Digest()
    assert list(digest.take([Message(channel, arm, 1, 1)])) == []
    assert not digest.damaged


def test_only_topics_of_a_twin_are_shown() -> None:
    assert is_shown('/a/b/joint_states', 'sensor_msgs/msg/JointState')
    assert not is_shown('/joint_states', 'std_msgs/msg/String')
    assert not is_shown('/my_joint_states', 'sensor_msgs/msg/JointState')
    assert not is_shown('/scan', 'sensor_msgs/msg/LaserScan')


@settings(max_examples=300)
@given(st.data())
def test_damaged_messages_are_counted_and_the_rest_is_shown(real, data) -> None:
    messages = list(real.messages[:60])
    place = data.draw(st.integers(0, len(messages) - 1))
    message = messages[place]
    damaged = bytearray(message.data)
    for _ in range(data.draw(st.integers(0, 3))):
        damaged[data.draw(st.integers(0, len(damaged) - 1))] ^= 1 << data.draw(st.integers(0, 7))
    cut = data.draw(st.integers(0, len(damaged)))
    messages[place] = message._replace(
        data=bytes(damaged[:cut]),
        publish_time=data.draw(st.sampled_from([0, 1, 2**63, 2**64 - 1])),
    )
    digest = Digest()
    motion = [part for _, part in digest.take(messages) if isinstance(part, Motion)]
    states = sum(each.channel.topic.endswith('joint_states') for each in messages)
    assert sum(part.stamps.size for part in motion) >= states - 1
    assert digest.damaged <= 2
    assert bool(digest.damage) == bool(digest.damaged)


@pytest.mark.parametrize(
    'line',
    [
        '',
        '{}',
        '[' * 100_000,
        json.dumps({'kind': 'throw', 'step': 3}),
        json.dumps({'kind': 'start', 'step': 3, 'settings': {'time_scale': 0.0}}),
        json.dumps({'kind': 'start', 'step': 3, 'settings': {'layer.thickness': 'thick'}}),
        json.dumps({'kind': 'throw', 'step': 'x', 'settings': {}}),
        json.dumps({'kind': 'start', 'step': 3, 'settings': [1]}),
        json.dumps({'kind': 'pace', 'step': 3, 'anchor_step': 0, 'anchor_time_ns': 0, 'rate': -1}),
    ],
)
def test_lines_that_are_of_no_journal_are_counted(real, line) -> None:
    channel = real.channels['journal']
    data = line.encode() + b'\0'
    message = Message(channel, b'\0\1\0\0' + len(data).to_bytes(4, 'little') + data, 5, 5)
    digest = Digest()
    assert list(digest.take([message])) == []
    assert digest.damaged == 1
    assert digest.damage.startswith('/twin/journal: ')


@pytest.fixture(scope='module')
def measured() -> Any:
    """One throw of a measured plate."""
    twin = TwinMessages(engine__motion='measured')
    return twin.measure(rigs['measured_throw'](Rig(), begin_ns=twin.now, duration=0.1))


def test_measured_throw_is_beside_the_states_at_the_same_height(measured) -> None:
    found = parts(measured.messages, Beside)
    beside = {
        kind: [part for part in found if part.kind == kind]
        for kind in (MEASURED, PREDICTED, RESIDUAL)
    }
    predictions = [outputs.prediction for outputs in measured.outputs if outputs.prediction]
    assert joined(beside[PREDICTED], 'stamps').tolist() == [item.stamp_ns for item in predictions]
    positions = joined(beside[PREDICTED], 'position')
    assert positions[:, 0].tolist() == [item.position for item in predictions]
    residuals = [outputs.residual for outputs in measured.outputs if outputs.residual]
    assert joined(beside[RESIDUAL], 'position').tolist() == [list(item[1:]) for item in residuals]
    # what was measured is there from the start of the throw on, and where the prediction is
    stamps, truth = joined(beside[MEASURED], 'stamps'), joined(beside[MEASURED], 'position')
    assert stamps.size > 200
    there = (predictions[0].stamp_ns < stamps) & (stamps < predictions[20].stamp_ns)
    assert there.sum() > 50
    times = joined(beside[PREDICTED], 'stamps')
    expected = np.interp(stamps[there], times, positions[:, 0])
    assert truth[there, 1] == pytest.approx(expected, abs=5e-5)  # the prediction is a polygon


def test_measured_throw_starts_with_the_plate(measured) -> None:
    onset = measured.pace.time_ns + 50_000_000
    (picture,) = parts(measured.messages, ThrowPicture)
    assert picture.start == pytest.approx(onset, abs=5000)
    assert picture.times[-1] == pytest.approx(1.5 * picture.ejection_time)
    reports = parts(measured.messages, Report)
    stamps = {report.values.get('stage'): report.stamp for report in reports}
    assert stamps['predicted'] == stamps['release'] == picture.start


def test_work_of_a_measured_plate_begins_with_its_throw() -> None:
    twin = TwinMessages(engine__motion='measured')
    noisy = rigs['measured_throw'](Rig(), begin_ns=twin.now, duration=0.1, noise=5e-6)
    motion = parts(twin.measure(noisy).messages, Motion)
    work, velocity = joined(motion, 'plate_work'), joined(motion, 'velocity')
    begin = int(np.flatnonzero(velocity[:, 0] != velocity[:, 1])[0])
    assert begin > 20
    assert (velocity[1:begin, 0] != 0.0).any()  # it is never quite at rest
    assert (work[:begin] == 0.0).all()
    assert work[begin + 10] > 1e-4


def test_positions_of_other_joints_are_no_damage() -> None:
    twin = one_throw(20)
    data = JointStateEncoder('arm', ('elbow', 'wrist')).encode(0, [0.0] * 6)
    for name in ('measured_joint_states', 'predicted_joint_states', 'residual'):
        twin._send(name, data, 0)
    assert parts(twin.messages, Beside) == []
