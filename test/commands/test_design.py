# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""The command `design` and its tasks, beside the functions that they call."""

import filecmp
from functools import partial
import os
from pathlib import Path
import subprocess
import sys

import numpy as np
import pytest
from scipy.io import netcdf_file
from soft_throw_ros.commands import design, throw
from soft_throw_ros.configuration import motions
from soft_throw_ros.core.plate import SampledMotion
from soft_throw_ros.core.rig import Engine, Projectile, Rig
from soft_throw_ros.core.throw import simulate
from soft_throw_ros.design.aiming import aim
from soft_throw_ros.design.landscape import compute_landscape
from soft_throw_ros.design.motion import PlateLimits
from soft_throw_ros.design.prediction import prediction_uncertainty, Uncertainties
from soft_throw_ros.design.recommendation import predict, recommend
from soft_throw_ros.design.score import Limits, robust
import yaml

COMMAND = (design.main,)
ROOT = Path(__file__).parents[2]
MINE = (
    'jelly: {description: Firm jelly, source: measured, density: 1050.0, wave_speed: '
    '{value: 18.0, range: [17.0, 19.0]}, loss_tangent: 0.01, thicknesses: [10e-3, 40e-3]}'
)
CLUSTER = """
from distributed import LocalCluster
from soft_throw_ros.commands.design import main

if __name__ == '__main__':
    options = {'threads_per_worker': 1, 'host': '127.0.0.1', 'dashboard_address': None}
    with LocalCluster(n_workers=2, **options) as cluster:
        words = ['map', 'x=0.6:0.9:40', 'C=2:8:40', '-p', 'layer.loss_tangent:=0.05', '--output']
        assert main([*words, 'here.nc']) == 0
        assert main([*words, 'there.nc', '--dask', cluster.scheduler_address]) == 0
"""


def test_recommendation_is_complete_in_json_and_in_the_table(command):
    args = ('recommend', '--mass', 2e-3, '--vary', 'wave_speed')
    rig = Rig(projectile=Projectile(mass=2e-3))
    best = recommend(rig, vary='wave_speed')
    data, printed = command.json(*args), command.run(*args)
    result = data['recommendation']
    assert result['wave_speed'] == best.wave_speed
    assert result['now']['energy_transfer'] == predict(rig).energy_transfer
    assert result['tolerances'] == best.tolerances
    assert data['parameters']['recommendation.vary'] == 'wave_speed'
    assert data['uncertainty'] == prediction_uncertainty(best.rig).values()
    assert result['summary'] == best.summary == printed.splitlines()[0]
    columns = (best.now, best, best.by_thickness, best.by_wave_speed)
    expected = [1e3 * column.thickness for column in columns]
    assert list(map(float, command.row(printed, 'thickness'))) == pytest.approx(expected, rel=1e-5)
    scores = list(map(float, command.row(printed, 'score')[:2]))
    assert scores == pytest.approx([best.now_score, best.score], rel=1e-5)
    heavy = command.json('recommend', '--mass', 0.3, '--vary', 'thickness')['recommendation']
    assert (heavy['now'], heavy['now_score']) == (None, 0.0)


def test_options_and_file_define_the_request(command, write):
    path = write(
        'twin: {ros__parameters: {engine.motion: measured, engine.frequency: 58.0, '
        'recommendation: {vary: thickness, thickness_max: 0.012, max_strain: 0.12}}}'
    )
    result = command.json(
        'recommend', '--config', path, '--objective', 'robust', '--max-strain', 0.25,
        '-p', 'uncertainty.wave_speed:=6e-1', '-p', 'uncertainty.mass:=0.05',
    )['recommendation']
    best = recommend(
        Rig(engine=Engine(frequency=58.0)), vary='thickness',
        limits=Limits(thickness_max=0.012, max_strain=0.25),
        objective=partial(robust, uncertainties=Uncertainties(wave_speed=0.6, mass=0.05)),
    )
    assert (result['thickness'], result['score']) == (best.thickness, best.score)


def test_layer_is_chosen_from_a_user_library(command, write):
    words = ('recommend', '--vary', 'library', '--library', write(MINE))
    result = command.json(*words)['recommendation']
    best, *_ = result['candidates']
    assert result['layer'] == best['layer'] == 'jelly_40.0mm'
    assert best['score'] == pytest.approx(result['energy_transfer'], rel=1e-6)
    assert 'jelly_40.0mm' in command.run(*words).partition('from the library')[2]


def test_aim_reaches_the_target_of_an_option_or_of_a_file(command, write):
    best = aim(Rig(), height=0.15)
    printed = command.run('aim', '--target-height', 0.15)
    assert printed.startswith(f'{best.summary}\n\n')
    shown = list(map(float, command.row(printed, 'amplitude')))
    assert shown == pytest.approx([2.0, 1e3 * best.amplitude], rel=1e-3)
    rig = 'twin: {ros__parameters: {gravity: 5.0'
    aims = write(rig + ', recommendation: {objective: aim, target_speed: 1.5}}}', 'aims.yaml')
    assert command.json('aim', '--config', aims)['aim']['speed'] == pytest.approx(1.5)
    assert command.json('recommend', '--config', aims)['recommendation']['amplitude'] > 0.0


def test_motion_for_throw_and_controller_is_written(command, tmp_path, capsys):
    files = [tmp_path / f'best.{ending}' for ending in ('csv', 'yaml', 'png')]
    printed = command.run('motion', '-p', 'gravity:=0', '--output', *files)
    speed = float(command.row(printed, 'ejection_speed')[1])
    assert all(path.stat().st_size > 1000 for path in files)
    assert throw.main(['--verbose', '--motion', str(files[0]), '-p', 'gravity:=0']) == 0
    assert float(command.row(capsys.readouterr().out, 'ejection_speed')[0]) == speed
    message = yaml.safe_load(files[1].read_text())
    assert message['joint_names'] == ['plate']
    since = [point.pop('time_from_start') for point in message['points']]
    times = [time['sec'] + 1e-9 * time['nanosec'] for time in since]
    assert list(message['points'][0]) == ['positions', 'velocities', 'accelerations']
    states = [np.concatenate(list(point.values())) for point in message['points']]
    np.testing.assert_allclose(times, motions.read(files[0]).times, rtol=1e-14)  # whole ns
    # A controller that interpolates by quintics keeps the limits and throws once, at equal speed
    sent = SampledMotion(np.array(times), np.array(states))
    limits, plate = PlateLimits.of(Rig().engine), PlateLimits.of(Engine(motion=sent))
    assert plate.speed <= limits.speed * (1.0 + 1e-9)
    assert np.abs(sent.states[:, 2]).max() <= limits.acceleration * (1.0 + 1e-9)
    assert plate.travel <= limits.travel * (1.0 + 1e-9)
    result = simulate(Rig(engine=Engine(motion=sent), gravity=0.0))
    assert len(result.ejections) == 1
    assert result.ejection_speed == pytest.approx(speed, rel=1e-5)


def test_map_is_summarised_and_saved_in_every_format(command, tmp_path):
    pytest.importorskip('matplotlib', reason='comes with the extra [plot]')
    files = [tmp_path / f'map.{ending}' for ending in ('nc', 'png')]
    printed = command.run(
        'map', 'layer.thickness=2e-3:0.05:40:log', 'projectile.mass=1e-3:5e-3:30',
        '--frequency', 31.1, '-p', 'gravity:=0', '--output', *files,
    )
    axes = {'layer.thickness': np.geomspace(2e-3, 0.05, 40)}
    axes['projectile.mass'] = np.linspace(1e-3, 5e-3, 30)
    landscape = compute_landscape(Rig(engine=Engine(frequency=31.1), gravity=0.0), axes)
    thickness, mass = landscape.optimum.coordinates
    assert f'layer.thickness {thickness:.5g} m, projectile.mass {mass:.5g} kg' in printed
    assert all(path.stat().st_size > 1000 for path in files)
    with netcdf_file(files[0], mmap=False) as saved:
        assert saved.engine_frequency == 31.1
        for name in ('ejection_phase', 'energy_transfer'):
            np.testing.assert_array_equal(saved.variables[name][:], getattr(landscape, name))


@pytest.mark.slow
def test_map_by_a_dask_cluster_is_equal(write, tmp_path):
    # A separate process, because a cluster leaves threads and warnings behind
    pytest.importorskip('distributed', reason='comes with the extra [dask]')
    subprocess.run(
        [sys.executable, write(CLUSTER, 'cluster.py')], cwd=tmp_path, check=True, timeout=100,
        env=os.environ | {'PYTHONPATH': str(ROOT)},
    )
    assert filecmp.cmp(tmp_path / 'here.nc', tmp_path / 'there.nc', shallow=False)
