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
"""A few trials, and the table of their verdicts."""

import math

import numpy as np
import pytest
from trials import table
from trials.__main__ import main
from trials.judge import compare, Deviation, judge, Verdict
from trials.rows import ROWS


def verdict(**found):
    numbers = {name: Deviation(*value) for name, value in found.items()}
    return Verdict(row='clean', number=0, results=numbers, seconds=0.1)


def test_clean_throw_is_identified_within_its_errors():
    result = judge('clean, known exactly', 3, seed=1)
    assert not result.refusal
    assert not result.warnings
    assert not result.is_silently_wrong
    assert result.results['layer.wave_speed'].errors < 4.0
    assert result.results['ejection.time'].errors < 4.0


def test_trial_is_determined_by_its_seed():
    row = next(row for row in ROWS if 'outliers' in row.name)
    first, again, other = (
        row.draw(np.random.default_rng(seed)).records[0] for seed in (0, 0, 1)
    )
    assert np.array_equal(first, again)
    assert not np.array_equal(first[:, 1], other[:, 1])


@pytest.mark.parametrize('row', ROWS, ids=[row.name for row in ROWS])
def test_every_row_has_trials_with_a_truth(row):
    trial = row.draw(np.random.default_rng(5))
    assert all(np.isfinite(record).all() for record in trial.records)
    assert all((np.diff(record[:, 0]) > 0.0).all() for record in trial.records)
    assert trial.truth['layer.wave_speed'] > 0.0


def test_large_deviation_without_a_warning_is_silently_wrong():
    right, wrong = verdict(a=(1.0, 0.1, 1.15)), verdict(a=(1.0, 0.1, 1.6), b=(1.0, math.inf, 9.0))
    assert right.results['a'].is_covered
    assert not right.is_silently_wrong
    assert wrong.wrong == ['a']
    assert wrong.is_silently_wrong


def test_truth_within_a_reported_alternative_is_right():
    one, other = {'value': 7.0, 'error': 0.1}, {'value': 9.0, 'error': 0.2}
    truth = {'ejection.time': 9.1}
    (alone,) = compare({'ejection': {'time': one, 'alternatives': []}}, truth).values()
    ejection = {'time': one, 'alternatives': [{'time': other}]}
    (both,) = compare({'ejection': ejection}, truth).values()
    assert not alone.is_covered
    assert both == Deviation(9.0, 0.2, 9.1)


def test_table_counts_verdicts():
    verdicts = [verdict(**{'layer.wave_speed': (1.0, 0.1, truth)}) for truth in (1.0, 1.1, 2.0)]
    cells = [cell.strip() for cell in table.line('clean', verdicts).strip('|').split('|')]
    counted = dict(zip(table.HEADS, cells, strict=True))
    assert counted['rigs'] == '3'
    assert counted['silently wrong'] == '1'
    assert counted['c_s'] == '67 %'
    assert '1 of 3' in table.summary(verdicts, ['clean'])[0]


def test_command_writes_a_table_and_a_log(capsys, tmp_path):
    log = tmp_path / 'log.jsonl'
    main(['--rows', 'free layers,', '--rigs', '2', '--workers', '1', '--log', str(log)])
    assert capsys.readouterr().out.count('\n| free layers, losses') == 1
    assert log.read_text().count('\n') == 2


@pytest.mark.parametrize(
    ('args', 'value'), [(['--rows', 'nothing'], 'nothing'), (['--rigs', '0'], '0')]
)
def test_command_refuses_impossible_arguments(capsys, args, value):
    with pytest.raises(SystemExit):
        main(args)
    assert value in capsys.readouterr().err
