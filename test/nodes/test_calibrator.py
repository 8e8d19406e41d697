# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""The calibrator in this process; as a process it is in `test_loop`."""

from __future__ import annotations

from collections import deque
import contextlib
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from ros_nodes import MILLISECOND
from soft_throw_ros.configuration.interface import CALIBRATOR_TOPICS
from soft_throw_ros.core.plate import Underdamped
from soft_throw_ros.core.rig import Engine, Layer, Rig
from soft_throw_ros.identification.least_squares import Estimate
from soft_throw_ros.identification.plate_fit import fit_plate
from soft_throw_ros.identification.rig_fit import RigFit
from soft_throw_ros.identification.tracks import Track, TrackError
from soft_throw_ros.nodes import calibrator as module
from soft_throw_ros.nodes.calibrator import Calibrator, MeasuredPositions, MeasuredThrow
from soft_throw_ros.nodes.conversions import msg_to_values
from soft_throw_ros.nodes.process import RunnableNode
from soft_throw_ros.storage.message import SECOND
from soft_throw_ros.twin.sample_buffer import Sample
from twin_runs import measured_throw, stroke


def test_twin_that_refuses_a_command_is_left_as_it_was(ros, write, monkeypatch) -> None:
    twin = ros.start_twin(engine__motion='measured', time_scale=0.5)
    before = twin.parameters.settings
    file = {'engine.motion_file': str(write(stroke(), 'plate.csv'))}
    calibrator = ros.node(Calibrator)
    modes = []

    def apply() -> None:
        calibrator._twin.set(file)
        modes.append(twin.parameters.settings['engine.motion'])

    monkeypatch.setattr(calibrator, '_apply_recommendation', apply)
    calibrator._submit(calibrator._command_motion, 'designing the motion')
    ros.spin_until(lambda: 'engine.command needs' in calibrator._status.message, 'the refusal')
    assert modes == ['file']
    assert twin.parameters.settings == before


@pytest.mark.parametrize(('second_mode', 'is_converged', 'reason'), [
    (0.0, False, 'before it converged'), (0.1, True, 'no parameters of the model'),
])
def test_calibrator_rejects_a_fit_that_is_wrong(ros, second_mode, is_converged, reason) -> None:
    time = np.arange(0.0, 0.1, 1e-3)
    plates = Underdamped.of(Engine()), Underdamped.of(Engine(frequency=150.0))
    height, mode = (plate.position(time - 0.01) for plate in plates)
    noise = 1e-5 * np.random.default_rng(0).normal(size=time.size)
    fit = fit_plate(Track(time=time, position=height + second_mode * mode + noise))
    wrong = RigFit(model=None, fit=replace(fit, is_converged=is_converged))
    with pytest.raises(ValueError, match=reason):
        ros.node(Calibrator)._apply_fit(wrong)


@pytest.mark.parametrize(
    ('behind', 'stamp_error'), [(0.3, 3e-4), (-1e5, 0.0)]  # the twin cannot follow the first throw
)
def test_rig_is_identified_whatever_the_prediction_and_the_clock_of_the_sensors(
    ros, capfd, behind, stamp_error
) -> None:
    twin = ros.start_twin(engine__motion='measured', measured__stamp_error=stamp_error)
    sensors = ros.sensors_of(twin)
    listener = ros.listen_to(ros.node(Calibrator, ros_args=('-p', 'throws:=1')))
    listener.listen(CALIBRATOR_TOPICS.diagnostics)
    ros.spin_until(lambda: sensors.publisher.get_subscription_count() == 2, 'the calibrator')
    rig = Rig(engine=Engine(frequency=55.0), layer=Layer(wave_speed=7.3))
    for gap in (10 * MILLISECOND, 0):  # the first throw has no whole track
        begin_ns = twin.clock.time
        samples = measured_throw(
            rig, begin_ns=begin_ns, onset=0.35, duration=0.55, rate=2500.0, noise=5e-6
        )
        first_ns = begin_ns + 352 * MILLISECOND
        samples = [item for item in samples if not 0 <= item.stamp_ns - first_ns < gap]
        errors = stamp_error * SECOND * np.random.default_rng(4).standard_normal(len(samples))
        sensors.throw([
            item._replace(stamp_ns=item.stamp_ns + round(error))
            for item, error in zip(samples, errors.tolist(), strict=True)
        ], behind_ns=round(behind * SECOND))
        twin.session.reset()
        twin.go(1)
    finals = [result for result in twin.results if result.stage == 'final']
    assert [final.ended_by for final in finals] == ['gap', 'reset']

    status = listener.status(
        CALIBRATOR_TOPICS.diagnostics, 'identification', lambda s: s.message.startswith('identi')
    )
    values = msg_to_values(status)
    for name, value in (('engine.frequency', 55.0), ('layer.wave_speed', 7.3)):
        assert float(str(values[name]).split()[0]) == pytest.approx(value, rel=0.05)
    assert capfd.readouterr().err.count('; identifying') == 1


def test_only_wrong_predictions_in_a_row_make_the_rig_identified(ros, monkeypatch) -> None:
    calibrator = ros.node(Calibrator, ros_args=('-p', 'throws:=2'))
    tasks: list[object] = []
    monkeypatch.setattr(calibrator, '_submit', lambda task, _reason: tasks.append(task))
    monkeypatch.setattr(calibrator._measured, 'between', lambda *_: None)
    for is_right, count in ((False, 0), (True, 0), (False, 0), (False, 1)):
        calibrator._on_measured_throw(SimpleNamespace(
            throw=1, rig=Rig(), disturbances=True, ended_by='period', first=None,
            comparison=SimpleNamespace(is_within_threshold=is_right),
        ), 0, SECOND)
        assert len(tasks) == count


def test_measurements_are_forgotten_after_their_clock_was_set_back_or_stands_still(ros) -> None:
    node = ros.node(RunnableNode, 'calibrator')
    positions = MeasuredPositions(node, '/twin', ('plate', 'projectile'))
    positions._batches = deque(maxlen=9)
    sensors = ros.sensors_of()

    def heights(first_ns: int, height: float) -> list[float]:
        for stamp_ns in range(first_ns, first_ns + 100 * MILLISECOND, MILLISECOND):
            sensors.send(Sample(stamp_ns, height, 0.0))
        positions.read_messages()
        with contextlib.suppress(TrackError):  # few have arrived
            return positions.between(first_ns, first_ns + SECOND).plate.position.tolist()
        return []

    for first_ns, height in ((10 * SECOND, 1.0), (2 * SECOND, 2.0), (2 * SECOND, 3.0)):
        ros.spin_until(
            lambda f=first_ns, h=height: set(heights(f, h)) == {h}, 'the measurements'
        )
    with pytest.raises(TrackError):
        positions.between(SECOND, 2 * SECOND)
    with pytest.raises(TrackError, match='no samples for 901 ms'):
        positions.between(2 * SECOND, 3 * SECOND, max_gap=0.9)


def test_error_of_the_gain_has_the_larger_scatter_and_the_common_error() -> None:
    for speeds, error, expected in (
        ([1.5, 1.5, 1.5, 1.5], 4e-3, 2e-3),  # the scatter within the throws
        ([1.49, 1.51], 1e-4, 1e-2),  # the scatter among them: sqrt(2) 0.01 / sqrt(2)
        ([1.5], 0.0, 0.0),  # the common error alone
    ):
        throws = [MeasuredThrow(Estimate(speed, error), 0.75) for speed in speeds]
        _, values = module.describe_gain(throws, throws, gravity=10.0)
        value, total = map(float, str(values['engine.ejection_speed']).split(' +- '))
        assert value == pytest.approx(1.5, abs=1e-3)
        assert total == pytest.approx(np.hypot(expected, 1e-3), rel=0.06)
