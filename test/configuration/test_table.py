# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Tables of parameters: defaults, ranges and refusals of all nodes."""

import math
import re

from bags import accepted, WORDS
from hypothesis import given, settings
from hypothesis import strategies as st
import pytest
from soft_throw_ros.configuration import ParameterError, RECORDER, TWIN
from soft_throw_ros.configuration.node_tables import CALIBRATOR, RIG, VIEWER

TABLES = (TWIN, RECORDER, VIEWER, RIG, CALIBRATOR)
SETTINGS = [(table, entry) for table in TABLES for entry in table.entries if not entry.is_result]
NUMBERS = [(table, entry) for table, entry in SETTINGS if type(entry.default) in (int, float)]


def test_defaults_obey_their_own_rules() -> None:
    for table, entry in SETTINGS:
        checked = table.check_value(entry.name, entry.default)
        assert checked == entry.default
        assert type(checked) is type(entry.default)


@given(number=st.sampled_from(NUMBERS), share=st.floats(0.0, 1.0))
def test_every_number_in_the_range_and_none_beyond_it_is_accepted(number, share) -> None:
    table, entry = number
    value = min(entry.low + share * (entry.high - entry.low), entry.high)
    value = int(value) if isinstance(entry.default, int) else value
    assert table.check_value(entry.name, value) == value
    assert table.check_value(entry.name, repr(value)) == value
    beyond = 1 if isinstance(entry.default, int) else 1e-6 * (entry.high or 1.0)
    for value in (entry.low - beyond, entry.high + beyond):
        if not (entry.or_zero and value == 0):
            with pytest.raises(ParameterError, match=re.escape(repr(value))):
                table.check_value(entry.name, value)


@pytest.mark.parametrize(
    ('name', 'value', 'words'),
    [
        ('layer.thickness', math.nan, ['0.0005', '0.1 m', 'nan']),
        ('engine.command', 2.0, ['true or false', '2.0']),
        ('layer.loss', 'magic', ["'constant'", "'magic'"]),
        ('throw.period', 0.01, ['or 0', '0.01']),
        ('recommendation.masses', [], ['[]']),
        ('recommendation.masses', [0.01] * 5000, ['at most 16 numbers', '...']),
        ('layer.stack', 'x' * 20_000, ['8e-3 gelatin', '...']),
        ('x' * 20_000, 1.0, ['no parameter of the twin is named', '...']),
        ('recommended.thickness', 0.01, ['set by the twin', '0.01']),
    ],
)
def test_refusal_names_the_allowed_values(name, value, words) -> None:
    with pytest.raises(ParameterError) as refused:
        TWIN.check_value(name, value)
    assert refused.value.names == (name,)
    assert name[:30] in str(refused.value)
    assert all(word in str(refused.value) for word in words), str(refused.value)
    assert len(str(refused.value)) < 500


def test_recorder_takes_topics_and_namespaces_and_nothing_else() -> None:
    for name in ('/', 'twin', '/rig1/twin', 'rig_2/twin'):
        assert RECORDER.check_value('topics', [name]) == (name,)
    for name in ('', 'a b', '//', '/twin/', '1'):
        with pytest.raises(ParameterError, match='topics must be'):
            RECORDER.check_value('topics', ['twin', name])


VALUES = (
    st.floats() | st.integers() | st.booleans() | st.none() | st.sampled_from(WORDS) | st.text()
    | st.lists(st.floats() | st.integers() | st.text(max_size=3), max_size=4)
    | st.sampled_from([10**400, b'x', {}, [[]], ()])
)


@settings(max_examples=300)
@given(data=st.data(), table=st.sampled_from(TABLES))
def test_any_values_become_valid_settings_or_are_refused_by_name_or_value(data, table) -> None:
    names = st.sampled_from([entry.name for entry in table.entries]) | st.text(max_size=8)
    values = st.sampled_from([-1.0, 0.0, 1e-3, 1.0, 1e3]) | VALUES
    request = data.draw(st.dictionaries(names, values, min_size=1, max_size=2))
    changes = accepted(lambda: table.change(table.defaults(), request))
    for name, value in (changes or {}).items():
        entry = table.by_name[name]
        assert type(value) is type(entry.default)
        for item in value if isinstance(value, tuple) else (value,):
            if isinstance(item, (int, float)):
                assert entry.low <= item <= entry.high or (entry.or_zero and item == 0)
