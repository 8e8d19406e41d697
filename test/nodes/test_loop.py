# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""The closed loop of rig, twin, calibrator and recorder as processes, read from its bag."""

from __future__ import annotations

from dataclasses import replace
import statistics

from bags import notes
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
import pytest
from rclpy.serialization import deserialize_message
from soft_throw_ros.configuration import rig_of
from soft_throw_ros.configuration.node_tables import RIG, to_twin
from soft_throw_ros.design.motion import design_motion
from soft_throw_ros.design.recommendation import predict, recommend
from soft_throw_ros.nodes.conversions import msg_to_throw_result
from soft_throw_ros.recording.check import check_bag
from soft_throw_ros.storage.bag_reader import BagReader

HIDDEN = {  # true parameters of the rig that differ from those of the twin
    'engine.frequency': 61.8, 'engine.amplitude': 2.1e-3, 'engine.damping_ratio': 0.075,
    'layer.thickness': 29.1e-3, 'layer.wave_speed': 7.3,
}


@pytest.mark.slow
@pytest.mark.once
@pytest.mark.timeout(500)
def test_loop_finds_the_rig_improves_layer_and_motion_and_records_all(
    start_node, record, tmp_path, monkeypatch
) -> None:
    monkeypatch.setenv('ROS_HOME', str(tmp_path))  # the twin writes the motion below it
    calibrator = start_node('calibrator', 'rig:=/rig', 'throws:=2', 'motion_after:=5')
    rules = 'layer.name:=gelatin_29.1mm', 'recommendation.vary:=thickness'
    twin = start_node('twin', 'engine.motion:=measured', *rules)
    recorder = record('bag', 'topics:=[twin, /diagnostics]')
    for process in (calibrator, twin):
        process.wait_for('ready')
    hidden = [f'{name}:={value}' for name, value in HIDDEN.items()]
    rig = start_node('rig', 'rate:=2500.0', 'throw.period:=0.6', *hidden)
    calibrator.wait_for('measured gain', 300.0)  # a minute on two quiet cores
    for process in (rig, twin, calibrator, recorder):
        process.end_well()
    assert ' lost, ' in recorder.lines[-1]
    losses = notes(tmp_path / 'bag')['losses']  # of shallow or best-effort topics, on few cores
    assert not losses.keys() & {'/twin/joint_states', '/twin/journal'}
    results, statuses, models = [], [], []
    with BagReader(tmp_path / 'bag') as bag:
        for message in bag.messages(['/twin/throw_result', '/diagnostics']):
            for status in deserialize_message(message.data, DiagnosticArray).status:
                if status.name == '/twin: throw':
                    results.append(msg_to_throw_result(status))
                elif status.name == '/twin: model':
                    models.append(status.level)
                elif status.name == '/calibrator: identification':
                    values = {item.key: item.value.split()[0] for item in status.values}
                    statuses.append((status.message, values))
        assert [check.exit_code for check in check_bag(bag)] == [0]

    # The rig is identified once
    assert sum('; identifying' in line for line in calibrator.lines) == 1
    identified = next(values for text, values in statuses if text.startswith('identified'))
    assert float(identified['layer.wave_speed']) == pytest.approx(7.3, rel=0.01)
    (line,) = (line for line in rig.lines if 'layer.thickness is now ' in line)
    thickness = float(line.split()[-1])
    true = rig_of(to_twin({**RIG.defaults(), **HIDDEN}))
    new = replace(true, layer=replace(true.layer, thickness=thickness))
    before = [item for item in results if item.rig.layer.thickness == 29.1e-3]
    assert not all(item.comparison.is_within_threshold for item in before if item.comparison)
    leads = [item.lead for item in before if item.stage == 'predicted']
    assert max(leads) > true.crossing_time / 4

    # Its throws with the recommended layer are better, and predicted well
    finals = [item for item in results if item.stage == 'final' and item.comparison]
    after = [item for item in finals if abs(item.rig.layer.thickness - thickness) < 1e-9]
    speed = statistics.mean(item.first.ejection_speed for item in after)
    assert speed == pytest.approx(predict(new).ejection_speed, rel=0.01)
    assert {DiagnosticStatus.WARN, DiagnosticStatus.OK} <= set(models)
    errors = [item.comparison.position_rms for item in after]
    assert statistics.median(errors) <= after[0].comparison.threshold
    best = recommend(true, vary='thickness')
    assert predict(new).energy_transfer == pytest.approx(best.energy_transfer, rel=0.01)
    assert predict(new).kinetic_energy > 1.05 * predict(true).kinetic_energy

    # The best motion is commanded, and its gain is measured
    gain = {name: float(value) for name, value in statuses[-1][1].items()}
    assert (gain['engine.throws'], gain['commanded.throws']) == (5, 2)
    for name, throw in (('engine', predict(new)), ('commanded', design_motion(new))):
        assert gain[f'{name}.ejection_speed'] == pytest.approx(throw.ejection_speed, rel=0.01)
