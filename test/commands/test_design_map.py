# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""The command `design map`."""

import os
from pathlib import Path
import re
import signal
import subprocess
import sys
import threading

import numpy as np
import pytest
from scipy.io import netcdf_file
from soft_throw_ros.commands import design
from soft_throw_ros.core.rig import Engine, Layer, Projectile, Rig
from soft_throw_ros.design.landscape import compute_landscape

ROOT = Path(__file__).parents[2]

COMMAND = (design.main, 'map')

SMALL = ('x=0.2:0.9:30', 'C=1:12:24')

AXES = {
    'layer.thickness': np.geomspace(2e-3, 0.05, 40),
    'projectile.mass': np.linspace(1e-3, 5e-3, 30),
}

# Prints the progress as lines, so that the test can press Ctrl-C in the middle of a map.
LOUD = """
import signal, sys
from soft_throw_ros.commands import design, design_map

class LoudBar(design_map.tqdm):
    def update(self, count):
        print(count, flush=True)

if __name__ == '__main__':
    signal.signal(signal.SIGINT, signal.default_int_handler)  # which a shell may have ignored
    design_map.tqdm = LoudBar
    sys.exit(design.main(['map', *sys.argv[1:]]))
"""


def test_axes_and_options_reach_the_map(command, tmp_path):
    path = tmp_path / 'map.nc'
    printed = command.run(
        'mu=0.1:10:5:log', 'kappa', '--release', 'first', '--frequency', 31.1, '--output', path,
    )
    assert '5 x 256 throws, first release' in printed
    with netcdf_file(path, mmap=False) as data:
        values = {name: data.variables[name][:] for name in ('mu', 'kappa')}
        assert data.engine_frequency == 31.1
    np.testing.assert_allclose(values['mu'], np.geomspace(0.1, 10.0, 5), rtol=1e-15)
    np.testing.assert_allclose(values['kappa'], np.geomspace(0.5, 50.0, 256))


def test_map_is_summarized_and_saved_in_every_format(command, tmp_path):
    pytest.importorskip('matplotlib', reason='comes with the extra [plot]')
    files = [tmp_path / f'map.{ending}' for ending in ('nc', 'png')]
    printed = command.run(
        'layer.thickness=2e-3:0.05:40:log', 'projectile.mass=1e-3:5e-3:30', '--thickness', 0.01,
        '--mass', 2e-3, '-p', 'gravity:=0', '--motion', 'harmonic', '--output', *files,
    )
    rig = Rig(
        engine=Engine(damping_ratio=0.0), layer=Layer(thickness=0.01),
        projectile=Projectile(mass=2e-3), gravity=0.0,
    )
    landscape = compute_landscape(rig, AXES)
    thickness, mass = landscape.optimum.coordinates
    alpha = f'{landscape.optimum.energy_transfer:.4f}'
    best = f'{alpha} at layer.thickness {thickness:.5g} m, projectile.mass {mass:.5g} kg'
    assert best in printed
    assert all(path.stat().st_size > 1000 for path in files)
    with netcdf_file(files[0], mmap=False) as saved:
        for name in ('ejection_phase', 'energy_transfer'):
            np.testing.assert_array_equal(saved.variables[name][:], getattr(landscape, name))


@pytest.mark.slow
def test_ctrl_c_stops_workers_too_and_leaves_no_file(command, tmp_path):
    command.run(*SMALL, '--release', 'last')  # so that no worker has to compile
    script, path = tmp_path / 'loud.py', tmp_path / 'map.nc'
    script.write_text(LOUD)
    with subprocess.Popen(
        [sys.executable, script, 'x=0.6:0.9:300', 'C=5:8:300', '--release', 'last',
         '--workers', '2', '--output', path],
        env=os.environ | {'PYTHONPATH': str(ROOT)},
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        start_new_session=True,
        text=True,
    ) as process:
        watchdog = threading.Timer(100, os.killpg, (process.pid, signal.SIGKILL))
        watchdog.start()
        assert process.stdout.readline() == '32\n'
        os.killpg(process.pid, signal.SIGINT)  # as a terminal does
        printed = process.stderr.read()
        watchdog.cancel()
    assert process.returncode == 130
    assert 'stopped' in printed
    assert 'Traceback' not in printed
    assert list(tmp_path.iterdir()) == [script]


@pytest.mark.parametrize(
    ('args', 'message'),
    [
        (['x'], 'AXIS .* got x'),
        (['x', 'D'], "'D'; choose from x, C, mu"),
        (['x', 'layer.density'], "layer.density=LOW:HIGH, .* got 'layer.density'"),
        (['x=0.1', 'C'], "x=LOW:HIGH, .* got 'x=0.1'"),
        (['x=0.1:0.9:4.5', 'C'], "x=LOW:HIGH, .* got 'x=0.1:0.9:4.5'"),
        (['x=0.9:0.1', 'C'], "x must .* got 'x=0.9:0.1'"),
        (['x=0.1:0.9:1', 'C'], "x must .* 2 points, got 'x=0.1:0.9:1'"),
        (['x=0.1:1', 'C'], r'x must .* got 1\.0'),
        (['engine.damping_ratio=0:0.3:9:log', 'mu'], 'engine.damping_ratio .* :log'),
        (['--release', 'second'], "argument --release: .*'second'"),
        (['--output', 'map.rrd'], r"--output: .* got 'map.rrd'"),
        (['--output', 'no_such/map.nc'], 'no_such/map.nc: folder no_such not found'),
    ],
)
def test_refused_arguments_are_quoted(command, args, message):
    assert re.search(message, command.refused(*args))
