# SPDX-License-Identifier: Apache-2.0
import math
from pathlib import Path
from typing import Any

from hypothesis import given
from hypothesis import strategies as st
import pytest
from soft_throw_ros.configuration import (
    BY_NAME,
    check_value,
    document,
    files,
    LAYERS,
    ParameterError,
    TABLE,
)

ROOT = Path(__file__).parents[2]
SETTINGS = [entry for entry in TABLE if not entry.is_result]
NUMBERS = [entry for entry in SETTINGS if not entry.choices]
entries = st.sampled_from(SETTINGS)
anything = st.one_of(
    st.none(), st.booleans(), st.integers(), st.floats(), st.text(), st.lists(st.floats()),
    st.sampled_from([choice for entry in TABLE for choice in entry.choices]),
)  # fmt: skip


def outcome(name: str, value: Any) -> Any:
    """Return the checked value, or the error."""
    try:
        return check_value(name, value)
    except ParameterError as error:
        return error


def test_table_names_are_unique() -> None:
    assert len(BY_NAME) == len(TABLE)


@pytest.mark.parametrize('entry', SETTINGS, ids=lambda entry: entry.name)
def test_default_obeys_its_own_rule(entry: Any) -> None:
    checked = check_value(entry.name, entry.default)
    assert checked == entry.default
    assert type(checked) is type(entry.default)


@pytest.mark.parametrize('name', LAYERS)
def test_library_layer_obeys_the_rules(name: str) -> None:
    for parameter, value in LAYERS[name].items():
        assert check_value(parameter, value) == value


@given(entry=entries, value=anything)
def test_check_value_returns_an_allowed_value_or_quotes_it(entry: Any, value: Any) -> None:
    checked = outcome(entry.name, value)
    if isinstance(checked, ParameterError):
        assert str(checked).startswith(f'{entry.name} must be {entry.rule}, got {value!r}')
        assert checked.names == (entry.name,)
    else:
        assert type(checked) is type(entry.default)
        assert checked == value
        if isinstance(checked, str):
            assert checked in entry.choices
        else:
            assert math.isfinite(checked)
            assert entry.low <= checked <= entry.high or (entry.or_zero and checked == 0)


@given(entry=st.sampled_from(NUMBERS), share=st.floats(0.0, 1.0))
def test_check_value_takes_every_number_in_the_range(entry: Any, share: float) -> None:
    value = min(entry.low + share * (entry.high - entry.low), entry.high)
    value = int(value) if isinstance(entry.default, int) else value
    assert check_value(entry.name, value) == value


@pytest.mark.parametrize('entry', NUMBERS, ids=lambda entry: entry.name)
def test_check_value_refuses_what_is_beyond_either_end(entry: Any) -> None:
    step = 1 if isinstance(entry.default, int) else 1e-6 * (entry.high or 1.0)
    for value in (entry.low - step, entry.high + step):
        with pytest.raises(ParameterError, match='must be'):
            check_value(entry.name, value)


@pytest.mark.parametrize('value', [math.nan, math.inf, -math.inf, -1.0, 0.0, 0, True, '0.01', []])
def test_check_value_refuses_what_is_no_thickness(value: Any) -> None:
    with pytest.raises(ParameterError) as refused:
        check_value('layer.thickness', value)
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
        ('engine.motion', 'measured', "engine.motion must be one of 'underdamped', 'harmonic', "
                                      "got 'measured'; 'measured' needs plate measurements as "
                                      'input, which this version does not take'),
        ('layer.loss_tangent', 0.02, 'layer.loss_tangent must be 0, got 0.02; internal loss needs '
                                     'the finite-difference model, which this version has not'),
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
        check_value(name, value)
    assert str(refused.value) == message


def test_throw_period_may_be_zero() -> None:
    assert check_value('throw.period', 0) == 0.0


def test_twin_yaml_is_what_the_table_says() -> None:
    """Bring it up to date with `python -m soft_throw_ros.configuration config/twin.yaml`."""
    assert (ROOT / 'config/twin.yaml').read_text('utf-8') == document.twin_yaml()
    assert files.default_file().read_text('utf-8') == document.twin_yaml()


def test_markdown_has_a_row_for_every_parameter() -> None:
    rows = document.markdown().splitlines()[2:]
    assert [row.split('`')[1] for row in rows] == [entry.name for entry in TABLE]
    assert {row.count(' | ') for row in rows} == {3}


def test_insert_markdown_replaces_what_is_between_the_marks() -> None:
    text = 'before\n<!-- parameters -->\nold\n<!-- /parameters -->\nafter\n'
    new = document.insert_markdown(text)
    assert new == text.replace('old\n', document.markdown())
    assert document.insert_markdown(new) == new


@pytest.mark.parametrize(
    'text', ['', '<!-- parameters -->', '<!-- /parameters --><!-- parameters -->']
)
def test_insert_markdown_refuses_a_text_without_marks(text: str) -> None:
    with pytest.raises(ValueError, match='<!-- parameters -->'):
        document.insert_markdown(text)


def test_module_brings_files_up_to_date(tmp_path: Path, capsys: pytest.CaptureFixture) -> None:
    from soft_throw_ros.configuration.__main__ import main

    readme, config = tmp_path / 'README.md', tmp_path / 'twin.yaml'
    readme.write_text('<!-- parameters --><!-- /parameters -->\n')
    main([str(readme), str(config)])
    assert document.markdown() in readme.read_text()
    assert config.read_text() == document.twin_yaml()
    main([])
    assert capsys.readouterr().out == document.markdown()
