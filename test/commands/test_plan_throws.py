# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""The command `plan`: the throws to measure next."""

from pathlib import Path
import re

import pytest
from soft_throw_ros.commands import plan

COMMAND = (plan.main,)
TRACKS = Path(__file__).parents[1] / 'data' / 'synthetic_throw.csv'
AT_HAND = ('--masses', 6e-4, 2.4e-3, '--thicknesses', 8e-3, 12e-3, '--thickness', 12e-3)

HOLD_ALL = [
    word
    for name in ('wave_speed', 'thickness', 'loss_tangent')
    for word in ('--hold', f'layer.{name}')
]


@pytest.mark.slow
def test_plan_has_the_best_throw_and_the_sufficient_number(command):
    planned = command.json(*AT_HAND, '--fit', 'layer.thickness', '--goal', 0.5)
    assert len(planned['candidates']) == 4
    assert planned['is_reached']
    best, enough = planned['candidates'][0], planned['throws'][-1]
    assert planned['throws'][0]['condition'] == best['condition']
    assert enough['energy_transfer_error'] <= 0.005
    assert set(best['errors']) >= {'layer.wave_speed', 'layer.thickness', 'engine.frequency'}
    table = command.run(*AT_HAND, '--fit', 'layer.thickness', '--goal', 0.5)
    assert f'{len(planned["throws"])} throw' in table
    assert f'{1e3 * best["condition"]["mass"]:.4g}' in table.splitlines()[2]


def test_plan_continues_from_measured_throws(command):
    known = ('--unit', 'mm', '--masses', 2.4e-3, '--thicknesses', 12e-3, '--thickness', 12e-3)
    before, after = command.json(*known), command.json(TRACKS, *known)
    assert after['before'] < 0.05 < before['before']
    # A second throw gives more information than the first alone
    assert all(each['energy_transfer_error'] < after['before'] for each in after['candidates'])
    assert len(after['throws']) < len(before['throws'])


@pytest.mark.parametrize(
    ('args', 'value'),
    [
        (('--masses', 'heavy'), "argument --masses: projectile.mass must be .*'heavy'"),
        (('--thicknesses', '-1'), 'argument --thicknesses: layer.thickness must be'),
        (('--goal', '0'), "argument --goal: must be finite and positive, got '0'"),
        (('--rate', 'fast'), "argument --rate: must be finite and positive, got 'fast'"),
        (HOLD_ALL, 'nothing is sought'),
        (('--fit-file', 'FILE'), 'heavy'),
    ],
)
def test_impossible_plan_is_refused(command, write, args, value):
    path = write('throws: {heavy.csv: {projectile.mass: 0.002}}', 'fit.yaml')
    args = [path if arg == 'FILE' else arg for arg in args]
    assert re.search(value, command.refused(*args))
