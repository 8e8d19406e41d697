# Copyright 2026 soft_throw_ros developers
#
# Licensed under the Apache License, Version 2.0 (the "License");
# you may not use this file except in compliance with the License.
# You may obtain a copy of the License at
#
#     http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software
# distributed under the License is distributed on an "AS IS" BASIS,
# WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied.
# See the License for the specific language governing permissions and
# limitations under the License.
"""The command `identify --plan`: what to measure next."""

from pathlib import Path
import re

import pytest
from soft_throw_ros.commands import identify

COMMAND = (identify.main,)
TRACKS = Path(__file__).parents[1] / 'data' / 'synthetic_throw.csv'
AT_HAND = ('--masses', 6e-4, 2.4e-3, '--thicknesses', 8e-3, 12e-3, '--thickness', 12e-3)

HOLD_ALL = [
    word
    for name in ('wave_speed', 'thickness', 'loss_tangent')
    for word in ('--hold', f'layer.{name}')
]


def test_plan_tells_the_best_throw_and_how_many_are_enough(command):
    plan = command.json('--plan', *AT_HAND, '--fit', 'layer.thickness', '--goal', 0.5)
    assert len(plan['candidates']) == 4
    assert plan['is_reached']
    best, enough = plan['candidates'][0], plan['throws'][-1]
    assert plan['throws'][0]['condition'] == best['condition']
    assert enough['energy_transfer_error'] <= 0.005
    assert set(best['errors']) >= {'layer.wave_speed', 'layer.thickness', 'engine.frequency'}
    table = command.run('--plan', *AT_HAND, '--fit', 'layer.thickness', '--goal', 0.5)
    assert f'{len(plan["throws"])} throw' in table
    assert f'{1e3 * best["condition"]["mass"]:.4g}' in table.splitlines()[2]


def test_plan_goes_on_from_what_is_measured(command):
    known = ('--unit', 'mm', *AT_HAND)
    before, after = command.json('--plan', *known), command.json(TRACKS, '--plan', *known)
    assert after['before'] < 0.05 < before['before']
    # A throw more tells more than the one that is there
    assert all(each['energy_transfer_error'] < after['before'] for each in after['candidates'])
    assert len(after['throws']) < len(before['throws'])


@pytest.mark.parametrize(
    ('args', 'value'),
    [
        (('--plan', '--masses', 'heavy'), "argument --masses: projectile.mass must be .*'heavy'"),
        (('--plan', '--thicknesses', '-1'), 'argument --thicknesses: layer.thickness must be'),
        (('--plan', '--goal', '0'), 'argument --goal: must be finite and positive, got 0'),
        (('--plan', '--rate', 'fast'), 'argument --rate: must be finite and positive, got fast'),
        (('--plan', *HOLD_ALL), 'nothing is sought'),
        ((TRACKS, '--masses', '1'), 'argument --masses: is for --plan'),
    ],
)
def test_plan_that_cannot_be_is_refused(command, args, value):
    assert re.search(value, command.refused(*args))
