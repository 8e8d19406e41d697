# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""The scene, written to a file and read back by Rerun itself."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from bags import datas
from hypothesis import given, HealthCheck, settings
from hypothesis import strategies as st
import numpy as np
import pytest
from ros_nodes import DrivenTwin, Ros
from soft_throw_ros.configuration.interface import TWIN_TOPICS
from soft_throw_ros.core.rig import Rig
from soft_throw_ros.core.throw import simulate
from soft_throw_ros.recording.twin_journal import find_throws
from soft_throw_ros.storage.cdr import JointStateEncoder
from soft_throw_ros.storage.message import Channel, Message
from twin_runs import measured_throw

rr = pytest.importorskip('rerun')

from rrd_files import record, RrdFile  # noqa: E402, I100


@pytest.fixture(autouse=True, scope='module')
def mistakes_raise() -> Iterator[None]:
    """Otherwise Rerun logs them and goes on."""
    rr.set_strict_mode(True)
    yield
    rr.set_strict_mode(False)


def start_twin(ros: Ros, *words: str, **values: Any) -> DrivenTwin:
    """Start a twin that has a recommendation."""
    twin = ros.start_twin(*words, **values)
    twin.settle()
    return twin


@pytest.fixture(scope='module')
def twin(module_ros) -> DrivenTwin:
    """Two throws in real time."""
    return start_twin(module_ros, throw__period=0.5).go(1199)


@pytest.fixture(scope='module')
def recording(twin, tmp_path_factory) -> RrdFile:
    path = tmp_path_factory.mktemp('scene') / 'scene.rrd'
    throws = find_throws(twin.of(TWIN_TOPICS.journal))
    return record(path, twin.messages, throw=throws['/twin'][-1])[0]


def test_scene_has_every_state_in_its_units(twin, recording) -> None:
    states = np.array([outputs.state for outputs in twin.outputs])
    due = np.array([twin.session.due_ns(step) for step in range(1200)])
    for name, expected in (
        ('position', 1e3 * states[:, 0:2]),
        ('velocity', states[:, 2:4]),
        ('force', states[:, 4:6] * [-1.0, 1.0]),
    ):
        times, values = recording.scalars(f'/twin/{name}')
        assert times.tolist() == due.tolist()
        np.testing.assert_array_equal(values, expected)
        since, values = recording.scalars(f'/twin/{name}', 'time since throw')
        np.testing.assert_allclose(since, due - twin.session.due_ns(1000), atol=1)
        np.testing.assert_array_equal(values, expected)


def test_side_view_is_to_scale(twin, recording) -> None:
    """Downwards in mm: the top of the layer on the plate is where the projectile's face is."""
    def height_of(entity):
        times, translations = recording.series(entity, 'Transform3D:translation')
        return times, -np.array(translations)[:, 0, 1]

    times, z_of_projectile = height_of('/twin/side/projectile')
    times_of_layer, length = height_of('/twin/side/plate/layer')
    top = length + np.interp(times_of_layer, *height_of('/twin/side/plate'))
    _, scales = recording.series('/twin/side/plate/layer', 'Transform3D:scale')
    width, height = np.array(scales)[:, 0, 0], 64 * np.array(scales)[:, 0, 1]
    begin = twin.session.due_ns(500)
    in_contact = (times_of_layer >= begin) & (times_of_layer < begin + 7_600_000)
    at_layer = np.interp(times_of_layer[in_contact], times, z_of_projectile)
    assert in_contact.sum() > 100
    np.testing.assert_allclose(top[in_contact], at_layer, atol=0.08)  # straight between states
    np.testing.assert_allclose(width, 12.0)
    np.testing.assert_allclose(height[0], 1e3 * Rig().rest_height, atol=1e-4)
    body = recording.last('/twin/side/projectile/body', 'Transform3D:scale')
    assert body[0][:2] == pytest.approx([12.0, 8.2])


def table_of(text: str) -> list[list[str]]:
    """Return the cells of a table in Markdown, the heads first."""
    rows = [line.split('|')[1:-1] for line in text.splitlines() if line.startswith('|')]
    return [[cell.strip(' *') for cell in row] for row in rows if '--' not in row[0]]


def test_twins_have_separate_trees_and_tabs_with_or_without_a_journal(ros, tmp_path) -> None:
    names = ('/rig1', '/rig2')
    twins = [start_twin(ros, '-r', f'__ns:={name}', throw__period=0.1) for name in names]
    messages = [message for twin in twins for message in twin.go(149).messages]
    kept = [item for item in messages if item.channel.topic != '/rig1/twin/journal']
    kept.sort(key=lambda message: message.log_time)
    recording, _ = record(tmp_path / 'scene.rrd', kept)
    for name in names:
        assert len(recording.scalars(f'{name}/twin/position')[0]) == 150
        assert (f'{name}/twin/side/plate/body' in recording.entities) == (name == '/rig2')
    assert recording.layout('ViewBlueprint:display_name').count('Position z (mm)') == 2


def test_repeated_replay_is_drawn_after_the_last_throw_with_its_own_table(ros, tmp_path) -> None:
    twin = start_twin(ros, throw__period=0.5).go(849)
    twin.change(layer__thickness=0.012)
    twin.settle()
    twin.go(500)
    latched = twin.of(TWIN_TOPICS.recommendation)[:1]  # comes first
    again = latched + [message for message in twin.messages[:300] if message not in latched]
    recording, _ = record(tmp_path / 'a.rrd', twin.messages + again)
    times, values = recording.scalars('/twin/position')
    count = times.size - 1350
    assert 200 < count < 300
    assert (np.diff(times) >= 0).all()
    np.testing.assert_array_equal(values[1350:], values[:count])
    times, texts = recording.series('/twin/recommendation', 'TextDocument:text')
    tables = [table_of(text) for (text,) in texts]
    assert [table[1][1] for table in tables if table][-2:] == ['12', '16.8']
    assert times[-1] == twin.session.due_ns(1349)
    assert bytes(recording.last('/twin/landscape', 'EncodedImage:blob')[0])[1:4] == b'PNG'


def test_live_view_keeps_the_rig_for_late_viewers(twin, tmp_path) -> None:
    recording, _ = record(tmp_path / 'live.rrd', twin.messages, batch=100, is_live=True)
    for entity in ('/twin/side/plate/body', '/twin/recommendation', '/twin/landscape'):
        assert recording.entities[entity]
        assert entity not in recording.rows  # no time
    assert recording.rows['/twin/throw_result'] >= 2


def test_measured_throw_is_drawn_with_its_prediction_residual_and_errors(ros, tmp_path) -> None:
    twin = start_twin(ros, engine__motion='measured')
    samples = measured_throw(Rig(), begin_ns=twin.clock.time, duration=0.1, noise=2e-6)
    ros.sensors_of(twin).throw(samples)
    recording, _ = record(tmp_path / 'a.rrd', twin.messages, batch=100)
    predictions = [outputs.prediction for outputs in twin.outputs if outputs.prediction]
    stamps, values = recording.scalars('/twin/position/predicted')
    assert stamps.tolist() == [item.stamp_ns for item in predictions]
    assert values[:, 0] == pytest.approx([1e3 * item.position for item in predictions])
    residuals = [outputs.residual[1:] for outputs in twin.outputs if outputs.residual]
    _, values = recording.scalars('/twin/residual')
    assert sorted(values[:, 0]) == pytest.approx(sorted(1e6 * item[0] for item in residuals))
    _, positions = recording.scalars('/twin/position/measured')
    assert positions[:, 1].max() > 1e3 * Rig().layer.thickness
    (accuracy,) = [item.accuracy for item in twin.results if item.stage == 'release']
    text = recording.last('/twin/throw_result', 'TextDocument:text')[0]
    (cell,) = [row[1] for row in table_of(text) if row[0].startswith('energy transfer')]
    alpha, error = map(float, cell.split(' ± '))
    assert error == pytest.approx(accuracy.energy_transfer_error, rel=0.06)
    assert alpha == pytest.approx(simulate(Rig()).energy_transfer, abs=5.0 * error)


@pytest.mark.slow
@settings(max_examples=10, suppress_health_check=[HealthCheck.too_slow])
@given(st.data())
def test_damaged_messages_are_counted_and_others_are_shown(
    twin, tmp_path_factory, data
) -> None:
    messages, index = list(twin.messages[:60]), data.draw(st.integers(0, 59))
    damaged, time = datas(messages[index].data), st.sampled_from([0, 1, 2**63, 2**64 - 1])
    messages[index] = messages[index]._replace(
        data=data.draw(damaged), publish_time=data.draw(time)
    )
    recording, scene = record(tmp_path_factory.mktemp('damaged') / 'scene.rrd', messages)
    states = sum(item.channel.topic == '/twin/joint_states' for item in messages)
    assert recording.rows['/twin/position'] >= states - 1
    assert scene.damaged <= 2
    assert bool(scene.damage) == bool(scene.damaged)


@pytest.mark.parametrize('name', ['joint_states', 'measured_joint_states', 'residual'])
def test_joint_states_of_other_machines_are_ignored(tmp_path, name) -> None:
    channel = Channel(topic=f'/twin/{name}', type='sensor_msgs/msg/JointState', schema='')
    arm = JointStateEncoder('base', ('shoulder', 'elbow')).encode(1, [0.0] * 6)
    _, scene = record(tmp_path / 'a.rrd', [Message(channel, arm, 1, 1)])
    assert (scene.damaged, scene.drawn_twins()) == (0, [])
