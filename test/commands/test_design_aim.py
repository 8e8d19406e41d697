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
"""The command `design aim`."""

import re

import pytest
from soft_throw_ros.commands import design, design_search
from soft_throw_ros.commands.design_texts import uncertainty_text
from soft_throw_ros.core.rig import Rig
from soft_throw_ros.core.throws import last_release
from soft_throw_ros.design.aiming import aim, Target
from soft_throw_ros.design.prediction import predict
from soft_throw_ros.design.uncertainty import prediction_uncertainty

COMMAND = (design.main, 'aim')


def test_table_has_the_present_throw_the_aim_and_the_aim_with_this_layer(command):
    printed = command.run('--target-height', 0.15)
    best, this = (aim(Rig(), Target(height=0.15), vary=vary) for vary in ('both', 'amplitude'))
    summary = command.json('--target-height', 0.15)['aim']['summary']
    assert printed.startswith(f'{summary}\n\n')
    columns = {
        'amplitude A': [2.0, 1e3 * best.amplitude, 1e3 * this.amplitude],
        'rise above the layer': [1e3 * last_release(Rig()).height, 150.0, 150.0],
        'peak strain': [1e2 * each.peak_strain for each in (predict(Rig()), best, this)],
    }
    for title, expected in columns.items():
        shown = list(map(float, command.row(printed, title)))
        assert shown == pytest.approx(expected, rel=1e-5)
    assert uncertainty_text(prediction_uncertainty(best.rig)) in printed
    alone = command.run('--target-height', 0.15, '--vary', 'amplitude')
    assert len(command.row(alone, 'amplitude A')) == 2


def test_target_speed_replaces_the_default_height(command):
    printed = command.json('--target-speed', 1.5, '--gravity', 0)
    assert (printed['aim']['target_height'], printed['aim']['target_speed']) == (None, 1.5)
    assert printed['aim']['speed'] == pytest.approx(1.5, rel=1e-9)
    assert printed['aim']['height'] is None  # infinite: JSON has no number for this
    assert printed['parameters']['recommendation.objective'] == 'aim'


def test_target_out_of_reach_names_its_limit_and_ends_with_1(command):
    args = ('--target-height', 0.2, '--vary', 'amplitude', '--max-strain', 0.12)
    first = command.run(*args, code=design_search.NOT_REACHED).splitlines()[0]
    result = command.json(*args, code=design_search.NOT_REACHED)['aim']
    assert result['is_reached'] is False
    assert result['peak_strain'] == pytest.approx(0.12, rel=1e-4)
    assert result['summary'] == first
    assert result['limited_by'] == 'max_strain'


def test_file_that_aims_has_its_target_and_another_needs_one(command, write):
    rig = 'twin: {ros__parameters: {gravity: 5.0'
    aims = write(rig + ', recommendation: {objective: aim, target_speed: 1.5}}}', 'aims.yaml')
    assert command.json('--config', aims)['aim']['target_speed'] == 1.5
    assert 'no target: give' in command.refused('--config', write(rig + '}}', 'other.yaml'))


@pytest.mark.parametrize(
    ('args', 'message'),
    [
        ([], '--target-height M or --target-speed M/S'),
        (['--target-height', '0'], 'target_height .*target_speed .* got 0 for both'),
        (['--target-height', '-1'], r'argument --target-height: .*, got -1\.0'),
        (['--target-height', '0.1', '--target-speed', '2'],
         'argument --target-height: .*, got 0.1 and 2'),
        (['--target-height', '0.1', '--gravity', '0'], 'gravity, got gravity 0'),
        (['--target-height', '1', '--max-amplitude', '1'],
         r'argument --max-amplitude: .* to 0.1 m, got 1\.0'),
        (['--target-height', '1', '--vary', 'colour'], "argument --vary: .*'colour'"),
        (['--objective', 'peak'], 'unrecognized arguments: --objective peak'),
        (['--frequency', '3', '--amplitude', '1e-5', '--vary', 'amplitude',
          '--max-amplitude', '1e-5', '--target-speed', '1'], 'no throw is possible .* 1 m/s'),
        (['--target-height', '1', '--library', 'no.yaml'], 'argument --library: no.yaml'),
    ],
)
def test_refused_arguments_are_quoted(command, args, message):
    assert re.search(message, command.refused(*args))
