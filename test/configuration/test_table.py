# SPDX-License-Identifier: Apache-2.0
import math
from typing import Any

from hypothesis import given
from hypothesis import strategies as st
import pytest
from soft_throw_ros.configuration import (
    files,
    LAYERS,
    ParameterError,
    RECORDER,
    Table,
    TWIN,
)

TABLES = (TWIN, RECORDER)
SETTINGS = [(table, entry) for table in TABLES for entry in table.entries if not entry.is_result]
NUMBERS = [(table, entry) for table, entry in SETTINGS if type(entry.default) in (int, float)]
all_settings = st.sampled_from(SETTINGS)
by_name = pytest.mark.parametrize(
    ('table', 'entry'), SETTINGS, ids=lambda value: getattr(value, 'name', '')
)
anything = st.one_of(
    st.none(), st.booleans(), st.integers(), st.floats(), st.text(), st.lists(st.floats()),
    st.lists(st.text()), st.lists(st.builds('/{}'.format, st.text())),
    st.sampled_from([choice for _, entry in SETTINGS for choice in entry.choices]),
)  # fmt: skip


def outcome(table: Table, name: str, value: Any) -> Any:
    """Return the checked value, or the error."""
    try:
        return table.check_value(name, value)
    except ParameterError as error:
        return error


@pytest.mark.parametrize('table', TABLES, ids=lambda table: table.node)
def test_table_names_are_unique(table: Table) -> None:
    assert len(table.by_name) == len(table.entries)


@by_name
def test_default_obeys_its_own_rule(table: Table, entry: Any) -> None:
    checked = table.check_value(entry.name, entry.default)
    assert checked == entry.default
    assert type(checked) is type(entry.default)


@pytest.mark.parametrize('name', LAYERS)
def test_library_layer_obeys_the_rules(name: str) -> None:
    for parameter, value in LAYERS[name].items():
        assert TWIN.check_value(parameter, value) == value


@given(setting=all_settings, value=anything)
def test_check_value_returns_an_allowed_value_or_quotes_it(setting: Any, value: Any) -> None:
    table, entry = setting
    checked = outcome(table, entry.name, value)
    if isinstance(checked, ParameterError):
        assert str(checked).startswith(f'{entry.name} must be {entry.rule}, got {value!r}')
        assert checked.names == (entry.name,)
    else:
        assert type(checked) is type(entry.default)
        assert checked == (tuple(value) if isinstance(checked, tuple) else value)
        if isinstance(checked, tuple):
            assert all(text.startswith('/') for text in checked)
        elif isinstance(checked, str):
            assert checked in entry.choices or not entry.choices
        elif not isinstance(checked, bool):
            assert math.isfinite(checked)
            assert entry.low <= checked <= entry.high or (entry.or_zero and checked == 0)


@given(number=st.sampled_from(NUMBERS), share=st.floats(0.0, 1.0))
def test_check_value_takes_every_number_in_the_range(number: Any, share: float) -> None:
    table, entry = number
    value = min(entry.low + share * (entry.high - entry.low), entry.high)
    value = int(value) if isinstance(entry.default, int) else value
    assert table.check_value(entry.name, value) == value


@pytest.mark.parametrize(('table', 'entry'), NUMBERS, ids=lambda value: getattr(value, 'name', ''))
def test_check_value_refuses_what_is_beyond_either_end(table: Table, entry: Any) -> None:
    step = 1 if isinstance(entry.default, int) else 1e-6 * (entry.high or 1.0)
    for value in (entry.low - step, entry.high + step):
        if not (entry.or_zero and value == 0):
            with pytest.raises(ParameterError, match='must be'):
                table.check_value(entry.name, value)


@pytest.mark.parametrize('value', [math.nan, math.inf, -math.inf, -1.0, 0.0, 0, True, '0.01', []])
def test_check_value_refuses_what_is_no_thickness(value: Any) -> None:
    with pytest.raises(ParameterError) as refused:
        TWIN.check_value('layer.thickness', value)
    rule = 'layer.thickness must be a number from 0.0005 to 0.1 m'
    assert str(refused.value) == f'{rule}, got {value!r}'


@pytest.mark.parametrize(
    ('name', 'value', 'message'),
    [
        ('layer.thicknes', 0.01, "no parameter is named 'layer.thicknes'; "
                                 'did you mean layer.thickness?'),
        ('thickness', 0.01, "no parameter is named 'thickness'; did you mean layer.thickness?"),
        ('xyz', 1, "no parameter is named 'xyz'"),
        ('layer.youngs_modulus', 6e4, "no parameter is named 'layer.youngs_modulus'; the modulus "
                                      'is density times wave speed squared: set layer.wave_speed'),
        ('engine.motion', 'sampled', "engine.motion must be one of 'underdamped', 'harmonic', "
                                     "'measured', got 'sampled'"),
        ('layer.loss_tangent', -0.02, 'layer.loss_tangent must be a number from 0 to 2, '
                                      'got -0.02'),
        ('model', 'magic', "model must be one of 'travelling_wave', 'finite_difference', "
                           "'finite_difference_elastic', 'finite_difference_glued', "
                           "'spring_mass', got 'magic'"),
        ('throw.period', 0.01, 'throw.period must be a number from 0.05 to 3600 s, or 0, '
                               'got 0.01'),
        ('throw.max_events', 2.0, 'throw.max_events must be a whole number from 1 to 1000, '
                                  'got 2.0'),
        ('recommended.thickness', 0.01, 'recommended.thickness is a result; set layer.thickness '
                                        'or call ~/apply_recommendation (got 0.01)'),
        ('recommended.mass_ratio', 0.2, 'recommended.mass_ratio is a result; call '
                                        '~/apply_recommendation (got 0.2)'),
    ],
)  # fmt: skip
def test_check_value_says_what_would_be_right(name: str, value: Any, message: str) -> None:
    with pytest.raises(ParameterError) as refused:
        TWIN.check_value(name, value)
    assert str(refused.value) == message


def test_throw_period_may_be_zero() -> None:
    assert TWIN.check_value('throw.period', 0) == 0.0


@pytest.mark.parametrize('table', TABLES, ids=lambda table: table.node)
def test_parameter_file_gives_the_defaults(table: Table) -> None:
    settings = files.read(files.default_file(table), node=f'/rig1/{table.node}', table=table)
    assert settings == table.defaults()


@pytest.mark.parametrize('request_', [{'storage': 'none'}, {'rerun.sink': 'none'}])
def test_recorder_may_be_told_one_thing_after_another(request_: Any) -> None:
    settings = {**RECORDER.defaults(), 'storage': 'none', 'rerun.sink': 'none'}
    assert RECORDER.change(settings, request_) == request_


def test_recorder_that_would_record_nothing_is_refused() -> None:
    with pytest.raises(ParameterError, match=r'storage and rerun\.sink'):
        RECORDER.change(RECORDER.defaults(), {'storage': 'none', 'rerun.sink': 'none'})
