# SPDX-License-Identifier: Apache-2.0
from typing import Any

from hypothesis import given
from hypothesis import strategies as st
import pytest
from soft_throw_ros.configuration import LAYERS, ParameterError, rig_of, TWIN
from soft_throw_ros.core.rig import Rig

DEFAULTS = TWIN.defaults()
HARMONIC = {**DEFAULTS, 'engine.motion': 'harmonic', 'engine.damping_ratio': 0.0}


def one_change() -> st.SearchStrategy:
    """Draw a single change that is within its range."""
    options = []
    for entry in TWIN.entries:
        if entry.is_result or entry.name in ('layer.library', 'engine.motion_file'):
            continue  # files have tests of their own
        if entry.name == 'layer.name':
            values = st.sampled_from(['custom', *LAYERS])
        elif entry.choices:
            values = st.sampled_from([name for name in entry.choices if name != 'file'])
        elif isinstance(entry.default, tuple):
            numbers = st.lists(st.floats(entry.low, entry.high), min_size=1, max_size=3)
            values = numbers.map(tuple)
        else:
            kind = st.integers if isinstance(entry.default, int) else st.floats
            values = kind(entry.low, entry.high)
        options.append(st.tuples(st.just(entry.name), values))
    return st.one_of(options)


def test_rig_of_defaults_is_the_papers() -> None:
    assert rig_of(DEFAULTS) == Rig()
    assert rig_of({**DEFAULTS, 'engine.motion': 'harmonic'}).engine.damping_ratio == 0.0


@given(changes=st.lists(one_change(), max_size=8))
def test_single_changes_are_accepted_and_leave_settings_that_agree(changes: Any) -> None:
    settings = dict(DEFAULTS)
    for name, value in changes:
        accepted = TWIN.change(settings, {name: value})
        assert accepted[name] == value
        settings.update(accepted)
    assert settings.keys() == DEFAULTS.keys()
    rig = rig_of(settings)
    assert rig.layer.thickness == settings['layer.thickness']
    assert rig.engine.damping_ratio == settings['engine.damping_ratio']
    for name, value in LAYERS.get(settings['layer.name'], {}).items():
        assert settings[name] == value
    if settings['engine.motion'] == 'harmonic':
        assert settings['engine.damping_ratio'] == 0.0


@pytest.mark.parametrize(
    ('settings', 'request_', 'implied'),
    [
        *((DEFAULTS, {'layer.name': name}, values) for name, values in LAYERS.items()),
        (DEFAULTS, {'layer.thickness': 0.01}, {'layer.name': 'custom'}),
        (DEFAULTS, {'layer.thickness': 0.0168}, {}),
        (DEFAULTS, {'layer.name': 'custom', 'layer.thickness': 0.01}, {}),
        (DEFAULTS, {'layer.name': 'gelatin_5.6mm', **LAYERS['gelatin_5.6mm']}, {}),
        (DEFAULTS, {'rate.field': 100.0, 'rate.state': 100.0}, {}),
        (DEFAULTS, {'engine.motion': 'harmonic'}, {'engine.damping_ratio': 0.0}),
        (HARMONIC, {'engine.motion': 'underdamped'}, {'engine.damping_ratio': 0.064}),
        (HARMONIC, {'engine.damping_ratio': 0.1}, {'engine.motion': 'underdamped'}),
        (HARMONIC, {'engine.damping_ratio': 0.0}, {}),
        (DEFAULTS, {'recommendation.target_speed': 2.0}, {'recommendation.target_height': 0.0}),
    ],
)
def test_change_adds_what_is_implied_and_leaves_its_arguments_alone(
    settings, request_, implied
) -> None:
    before = dict(settings), dict(request_)
    assert TWIN.change(settings, request_) == {**request_, **implied}
    assert (settings, request_) == before


@pytest.mark.parametrize(
    'request_',
    [
        {'layer.name': 'gelatin_5.6mm', 'layer.thickness': 0.01},
        {'engine.motion': 'harmonic', 'engine.damping_ratio': 0.1},
        {'recommendation.thickness_min': 0.02, 'recommendation.thickness_max': 0.01},
        {'recommendation.wave_speed_min': 9, 'recommendation.wave_speed_max': 9},
        {'recommendation.target_height': 0.3, 'recommendation.target_speed': 2},
        {'rate.field': 200, 'rate.state': 100},
    ],
)
def test_contradiction_is_refused_at_once_and_accepted_one_by_one(request_) -> None:
    with pytest.raises(ParameterError) as refused:
        TWIN.change(DEFAULTS, request_)
    assert set(refused.value.names) == request_.keys()
    for name, value in request_.items():
        assert name in str(refused.value)
        assert str(value) in str(refused.value)
        assert TWIN.change(DEFAULTS, {name: value})[name] == value
