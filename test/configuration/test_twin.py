# SPDX-License-Identifier: Apache-2.0
from typing import Any

from hypothesis import given
from hypothesis import strategies as st
import pytest
from soft_throw_ros.configuration import LAYERS, ParameterError, rig_of, TWIN
from soft_throw_ros.core.rig import Rig

HARMONIC = {**TWIN.defaults(), 'engine.motion': 'harmonic', 'engine.damping_ratio': 0.0}


def one_change() -> st.SearchStrategy:
    """Draw a single change that is within its range."""
    options = []
    for entry in TWIN.entries:
        if entry.is_result or entry.name == 'layer.library':  # which has a test of its own
            continue
        if entry.name == 'layer.name':
            values = st.sampled_from(['custom', *LAYERS])
        elif entry.choices:
            values = st.sampled_from(entry.choices)
        elif isinstance(entry.default, tuple):
            numbers = st.lists(st.floats(entry.low, entry.high), min_size=1, max_size=3)
            values = numbers.map(tuple)
        else:
            kind = st.integers if isinstance(entry.default, int) else st.floats
            values = kind(entry.low, entry.high)
        options.append(st.tuples(st.just(entry.name), values))
    return st.one_of(options)


def test_rig_of_defaults_is_the_papers() -> None:
    assert rig_of(TWIN.defaults()) == Rig()


def test_rig_of_harmonic_motion_has_no_damping() -> None:
    settings = {**TWIN.defaults(), 'engine.motion': 'harmonic'}
    assert rig_of(settings).engine.damping_ratio == 0.0


@given(changes=st.lists(one_change(), max_size=8))
def test_single_changes_are_accepted_and_leave_settings_that_agree(changes: Any) -> None:
    settings = TWIN.defaults()
    for name, value in changes:
        accepted = TWIN.change(settings, {name: value})
        assert accepted[name] == value
        settings.update(accepted)
    assert settings.keys() == TWIN.defaults().keys()
    rig = rig_of(settings)
    assert rig.layer.thickness == settings['layer.thickness']
    assert rig.engine.damping_ratio == settings['engine.damping_ratio']
    for name, value in LAYERS.get(settings['layer.name'], {}).items():
        assert settings[name] == value
    if settings['engine.motion'] == 'harmonic':
        assert settings['engine.damping_ratio'] == 0.0


@pytest.mark.parametrize('name', LAYERS)
def test_layer_name_brings_all_its_values(name: str) -> None:
    assert TWIN.change(TWIN.defaults(), {'layer.name': name}) == {
        'layer.name': name,
        **LAYERS[name],
    }


@pytest.mark.parametrize(
    ('settings', 'request_', 'implied'),
    [
        (TWIN.defaults(), {'layer.thickness': 0.01}, {'layer.name': 'custom'}),
        (TWIN.defaults(), {'layer.thickness': 0.0168}, {}),
        (TWIN.defaults(), {'layer.name': 'custom'}, {}),
        (TWIN.defaults(), {'layer.name': 'custom', 'layer.thickness': 0.01}, {}),
        (TWIN.defaults(), {'engine.motion': 'harmonic'}, {'engine.damping_ratio': 0.0}),
        (TWIN.defaults(), {'engine.motion': 'underdamped'}, {}),
        (HARMONIC, {'engine.motion': 'underdamped'}, {'engine.damping_ratio': 0.064}),
        (HARMONIC, {'engine.damping_ratio': 0.1}, {'engine.motion': 'underdamped'}),
        (HARMONIC, {'engine.damping_ratio': 0.0}, {}),
        (HARMONIC, {'engine.motion': 'underdamped', 'engine.damping_ratio': 0.2}, {}),
    ],
)
def test_change_adds_what_is_implied(settings: Any, request_: Any, implied: Any) -> None:
    assert TWIN.change(settings, request_) == {**request_, **implied}


@pytest.mark.parametrize(
    ('request_', 'message'),
    [
        ({'layer.name': 'gelatin_5.6mm', 'layer.thickness': 0.01},
         'layer.thickness of gelatin_5.6mm is 0.0056, got 0.01; '
         "leave one of the two out, or set layer.name to 'custom'"),
        ({'engine.motion': 'harmonic', 'engine.damping_ratio': 0.1},
         "engine.motion 'harmonic' has no damping, got engine.damping_ratio 0.1; "
         "leave one of the two out, or set engine.motion to 'underdamped'"),
        ({'recommendation.thickness_min': 0.02, 'recommendation.thickness_max': 0.01},
         'recommendation.thickness_min must be below recommendation.thickness_max, '
         'got 0.02 and 0.01'),
        ({'recommendation.wave_speed_min': 9, 'recommendation.wave_speed_max': 9},
         'recommendation.wave_speed_min must be below recommendation.wave_speed_max, '
         'got 9 and 9'),
        ({'rate.field': 200, 'rate.state': 100},
         'rate.field must be at most rate.state, got 200 and 100'),
    ],
)  # fmt: skip
def test_change_refuses_a_contradiction(request_: Any, message: str) -> None:
    with pytest.raises(ParameterError) as refused:
        TWIN.change(TWIN.defaults(), request_)
    assert str(refused.value) == message
    for name, value in request_.items():  # each alone is within its range
        assert TWIN.change(TWIN.defaults(), {name: value})[name] == value


def test_change_accepts_equal_rates() -> None:
    assert TWIN.change(TWIN.defaults(), {'rate.field': 100, 'rate.state': 100}) == {
        'rate.field': 100.0, 'rate.state': 100.0,
    }  # fmt: skip


def test_change_accepts_a_name_with_its_own_values() -> None:
    request = {'layer.name': 'gelatin_5.6mm', **LAYERS['gelatin_5.6mm']}
    assert TWIN.change(TWIN.defaults(), request) == request


def test_change_leaves_its_arguments_alone() -> None:
    settings, request = TWIN.defaults(), {'layer.name': 'gelatin_2.0mm'}
    TWIN.change(settings, request)
    assert settings == TWIN.defaults()
    assert request == {'layer.name': 'gelatin_2.0mm'}
