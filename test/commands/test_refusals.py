# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""The contract of refusals: exit code 2, and one line with the name, the value and the rule."""

from importlib import import_module
from pathlib import Path
import re

import pytest

SAMPLE = Path(__file__).parents[1] / 'data' / 'synthetic_throw.csv'
TRACKS = f'{SAMPLE} --unit mm --mass 1.206e-3 --thickness 12e-3 --diameter 12e-3 --density 1000'
REFUSALS = [
    ('throw --bogus=1\n2', '--bogus=1 2'),
    ('throw --thickness 16.8', r'argument --thickness: layer\.thickness .* m, got 16\.8'),
    ('throw --thickness soft', "argument --thickness: .* got 'soft'"),
    ('throw --layer jelly', "argument --layer: .* got 'jelly'"),
    ('throw --motion nosuch.csv', 'argument --motion: nosuch.csv: No such file'),
    ('throw --config nosuch.yaml', 'nosuch.yaml: '),
    ('throw -p gravity:=-1', 'argument -p: gravity must be .* got -1'),
    ('throw -p gravitation:=3', "argument -p: must be NAME:=VALUE .* 'gravitation:=3'"),
    ('throw -p gravity:=[3', r"argument -p: gravity must be YAML, got '\[3'"),
    ('throw --thicknes 0.01', '--thicknes 0.01'),
    ('design mop', "'mop'"),
    ('design recommend --objective best', "argument --objective: .*'best'"),
    ('design recommend --max-strain -1', r'argument --max-strain: .* or 0, got -1\.0'),
    ('design recommend -p recommendation.masses:=[0.001,x]', r"argument -p: .* \[0.001, 'x'\]"),
    ('design recommend --objective robust -p uncertainty.wave_speed:=10', '7.8, got 10'),
    ('design recommend --max-strain 0.001', 'no layer throws .* max_strain=0.001'),
    ('design recommend -p gravity:=30 --amplitude 1e-5', 'gravity is 19 of the largest'),
    ('design motion --output best.txt', r"must end with \.csv, \.yaml, \.png, got 'best.txt'"),
    ('design map x', 'a landscape has two axes, got x'),
    ('design map x D=1:2', "'D'; choose from x, C, mu"),
    ('design map x layer.density', "AXIS must be .* got 'layer.density'"),
    ('design map x=0.9:0.1 C', 'x must be increasing'),
    ('design map x=0.1:0.9:1 C', "AXIS must .* got 'x=0.1:0.9:1'"),
    ('design map x=0.1:1 C', r'x must .* got 1\.0'),
    ('design map engine.damping_ratio=0:0.3:9:log mu', 'AXIS must .* LOW above 0 '),
    ('design map --output no_such/map.nc', 'no_such/map.nc: folder no_such not found'),
    ('identify none.csv', 'none.csv: No such file or directory'),
    ('identify throw.avi', 'throw.avi: is a video; first convert it to tracks'),
    (f'identify {SAMPLE} -p measured.position_noise:=0', 'argument -p: measured.position_noise'),
    (f'identify {SAMPLE} --hold layer.colour', 'argument --hold: a parameter must be one of '),
    (f'identify {SAMPLE} -p layer.thickness:=0.01+-x', 'argument -p: layer.thickness must be'),
    (f'identify {TRACKS} --from 0.025', f'{SAMPLE.name}: the plate does not move as a damped'),
    (f'identify {TRACKS} --mass 0.0012+-0%', r'argument --mass: projectile\.mass must be'),
    (f'identify {TRACKS} --mass 1+-1% --hold projectile.mass', '--hold: projectile.mass is '),
    (f'identify {TRACKS} --fit-file nosuch.yaml', 'nosuch.yaml: No such file'),
    (f'identify {TRACKS} --from 1', f'{SAMPLE.name}: only 0 samples from 1 s to inf s'),
    (f'free_layers 0.01 {SAMPLE} 0.02', r"argument M FILE: must be pairs, got '0\.02' alone"),
    (f'free_layers 7 {SAMPLE}', r"argument M FILE: layer\.thickness must be .* got '7'"),
    ('track a.avi --rate 1 --scale 1 0', "argument --scale: .* positive, got '0'"),
    ('track none.avi --rate 1 --scale 1 1', 'none.avi: No such file or directory'),
    ('inspect_bag bag --port 80', "argument --port: .* got '80'"),
    ('inspect_bag nosuch --save a.rrd', 'nosuch'),
    ('recover nosuch', 'nosuch'),
]


@pytest.mark.parametrize(('words', 'message'), REFUSALS, ids=[words for words, _ in REFUSALS])
def test_refusal_is_one_line(capsys, tmp_path, monkeypatch, words, message):
    monkeypatch.chdir(tmp_path)
    name, *args = words.split(' ')
    with pytest.raises(SystemExit) as end:
        import_module(f'soft_throw_ros.commands.{name}').main(args)
    out, err = capsys.readouterr()
    assert (end.value.code, out) == (2, '')
    (line,) = [line for line in err.splitlines() if not re.search('computing', line)]
    assert re.search(message, line.partition('error: ')[2])
    assert not list(tmp_path.iterdir())
