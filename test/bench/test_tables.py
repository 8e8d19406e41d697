# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""The tables of the bench and the comparison of their ratios."""

from bench import tables


def test_cases_are_compared_with_the_first_and_list_their_error(monkeypatch):
    monkeypatch.setattr(tables, 'TURNS', 1)
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
