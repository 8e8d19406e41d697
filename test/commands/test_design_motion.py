# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""The command `design motion`."""

from pathlib import Path
import re

import numpy as np
import pytest
from rosbags.typesys import get_typestore, Stores
from soft_throw_ros.commands import design, throw
from soft_throw_ros.configuration import motions
from soft_throw_ros.core.plate import SampledMotion
from soft_throw_ros.core.rig import Engine, Rig
from soft_throw_ros.core.throw import simulate
from soft_throw_ros.design.motion import PlateLimits
import yaml

COMMAND = (design.main, 'motion')
QUICK = ('-p', 'gravity:=0')
DATA = Path(__file__).parents[1] / 'data'


def test_motion_for_throw_and_controller_is_written(command, tmp_path, capsys):
    files = [tmp_path / f'best.{ending}' for ending in ('csv', 'yaml', 'png')]
    printed = command.run(*QUICK, '--output', *files)
    assert printed.startswith('with the same motor, ')
    speed = float(command.row(printed, 'ejection speed V_e')[1])
    assert float(command.row(printed, 'energy transfer alpha')[1]) > 4.1
    assert all(path.stat().st_size > 1000 for path in files)
    assert throw.main(['--verbose', '--motion', str(files[0]), '-p', 'gravity:=0']) == 0
    assert float(command.row(capsys.readouterr().out, 'ejection speed V_e')[-2]) == speed
    # read by an independent parser
    types = get_typestore(Stores.ROS2_JAZZY).types
    duration = types['builtin_interfaces/msg/Duration']
    message = yaml.safe_load(files[1].read_text())
    points = [
        types['trajectory_msgs/msg/JointTrajectoryPoint'](
            time_from_start=duration(**point.pop('time_from_start')),
            **{name: np.array(values) for name, values in point.items()}, effort=np.empty(0),
        )
        for point in message['points']
    ]
    assert message['joint_names'] == ['plate']
    motion = motions.read(files[0])
    times = [point.time_from_start.sec + 1e-9 * point.time_from_start.nanosec for point in points]
    np.testing.assert_allclose(times, motion.times, rtol=1e-14)  # whole nanoseconds
    # A controller that interpolates by quintics keeps the limits and throws once, at equal speed
    states = [(p.positions[0], p.velocities[0], p.accelerations[0]) for p in points]
    sent = SampledMotion(np.array(times), np.array(states))
    limits, plate = PlateLimits.of(Rig().engine), PlateLimits.of(Engine(motion=sent))
    assert plate.speed <= limits.speed * (1.0 + 1e-9)
    assert np.abs(sent.states[:, 2]).max() <= limits.acceleration * (1.0 + 1e-9)
    assert plate.travel <= limits.travel * (1.0 + 1e-9)
    for exported in (motion, sent):
        result = simulate(Rig(engine=Engine(motion=exported), gravity=0.0))
        assert result.recontacts == 0
        assert result.ejection_speed == pytest.approx(speed, rel=1e-5)


@pytest.mark.slow
def test_recorded_motion_is_improved(command):
    printed = command.run(*QUICK, '--motion', DATA / 'reference_tracks.csv')
    assert '% more energy by the best motion' in printed


@pytest.mark.parametrize(
    ('arguments', 'message'),
    [
        (['--output', 'best.txt'], "must end with .csv, .yaml, .png, got 'best.txt'"),
        (['--plate-speed', '-1'], 'argument --plate-speed: .*-1'),
        (['--vary', 'thickness'], 'unrecognized arguments: --vary'),
        (['--motion', 'nosuch.csv'], 'nosuch.csv: No such file'),
    ],
)
def test_bad_arguments_are_refused(command, arguments, message):
    assert re.search(message, command.refused(*arguments))
