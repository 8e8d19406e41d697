# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""A few trials with the table of their verdicts, and the tables of the bench."""

import json
import math

from bench import tables
import numpy as np
import pytest
from trials.__main__ import main
from trials.judge import compare, Deviation, HEADS, summary, table_line, Verdict
from trials.rows import ROWS


@pytest.mark.parametrize('row', ROWS, ids=[row.name for row in ROWS])
def test_every_row_has_trials_with_a_truth_determined_by_the_seed(row):
    trial, again = (row.draw(np.random.default_rng(5)) for _ in range(2))
    for record, same in zip(trial.records, again.records, strict=True):
        assert np.isfinite(record).all()
        assert (np.diff(record[:, 0]) > 0.0).all()
        assert np.array_equal(record, same)
    speeds = {'layer.wave_speed', 'layer.rest_wave_speed'} & set(trial.truth)
    assert all(trial.truth[name] > 0.0 for name in speeds)
    assert len(speeds) == 1


def test_truth_within_a_reported_alternative_is_right():
    values = (7.0, 0.1), (9.0, 0.2), (9.1, None)
    rows = [{'name': 'ejection.time', 'value': value, 'error': error} for value, error in values]
    results = compare({'rows': rows}, {'ejection.time': 9.1, 'layer.thickness': 1.0})
    assert results == {'ejection.time': Deviation(9.0, 0.2, 9.1)}


def test_large_deviations_without_a_warning_are_counted_as_silently_wrong():
    results = [
        {'layer.wave_speed': Deviation(1.0, 0.1, truth), 'a': Deviation(1.0, math.inf, 9.0)}
        for truth in (1.0, 1.15, 2.0)
    ]
    verdicts = [Verdict(row='clean', number=0, results=item, seconds=0.1) for item in results]
    assert [verdict.is_silently_wrong for verdict in verdicts] == [False, False, True]
    cells = map(str.strip, table_line('clean', verdicts).strip('|').split('|'))
    counted = dict(zip(HEADS, cells, strict=True))
    assert [counted[name] for name in ('rigs', 'silently wrong', 'c_s')] == ['3', '1', '67 %']
    assert '1 of 3' in summary(verdicts, ['clean'])


def test_command_identifies_a_clean_throw(capsys, tmp_path):
    log, name = tmp_path / 'log.jsonl', 'clean, known exactly'
    main(['--rows', name, '--rigs', '1', '--workers', '1', '--log', str(log)])
    assert capsys.readouterr().out.count(f'\n| {name}') == 1
    clean = json.loads(log.read_text())
    assert [clean[key] for key in ('row', 'refusal', 'warnings')] == [name, '', []]
    for name in ('layer.wave_speed', 'ejection.time'):
        assert Deviation(*clean['results'][name]).errors < 4.0


@pytest.mark.parametrize(('option', 'value'), [('--rows', 'nothing'), ('--rigs', '0')])
def test_command_refuses_impossible_arguments(capsys, option, value):
    with pytest.raises(SystemExit):
        main([option, value])
    assert value in capsys.readouterr().err


def test_cases_are_compared_with_the_first_and_list_their_error(monkeypatch):
    monkeypatch.setattr(tables, 'TURNS', 1)
    monkeypatch.setattr(tables.timeit.Timer, 'autorange', lambda _: (1000, 0.0))
    cases = [
        tables.Case('one', lambda: 1.0),
        tables.Case('two', lambda: sum(range(1000)), 2.0, lambda result: result - 499500.0),
    ]
    first, second = (result := tables.measure('sums', 'the sum', cases)).rows
    assert (first[1], first[3], second[1]) == (None, 1.0, 0.0)
    assert result.ratios == {'two': second[3]}
    assert len(result.lines()) == 5


def test_ratios_that_change_by_more_than_30_percent_are_listed(tmp_path):
    path = tmp_path / 'ratios.json'
    tables.store({'sums': {'steady': 2.0, 'slow': 2.0, 'gone': 1.0}, 'maps': {'one': 5.0}}, path)
    tables.store({'maps': {'one': 6.0}}, path)
    assert tables.deviations({'maps': {'one': 6.0}}, path) == []
    lines = tables.deviations({'sums': {'steady': 1.6, 'slow': 2.7, 'new': 1.0}}, path)
    assert [line.partition(':')[0] for line in lines] == ['sums, gone', 'sums, new', 'sums, slow']
