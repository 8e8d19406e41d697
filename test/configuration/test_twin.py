# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""The parameters of the twin: changes that imply others, and the rig that they give."""

import os
from typing import Any

from hypothesis import assume, given
from hypothesis import strategies as st
import pytest
from soft_throw_ros.configuration import ParameterError, rig_of, rig_values, TWIN
from soft_throw_ros.configuration.layers import library, STACKED
from soft_throw_ros.core.material import LARGEST_CONSTANT_LOSS

DEFAULTS = TWIN.defaults()
LAYERS = library().layers
HARMONIC = {**DEFAULTS, 'engine.motion': 'harmonic'}


def one_change() -> st.SearchStrategy:
    """Draw a single change that is within its range."""
    texts = {
        'layer.name': ('custom', *LAYERS),
        'layer.stack': ('', '8e-3 gelatin, 2e-3 20 1100 0.1', '5e-3 dragon_skin_10'),
        'engine.motion': ('underdamped', 'harmonic', 'measured'),
    }
    options = []
    for entry in TWIN.entries:
        is_file = entry.name in ('layer.library', 'engine.motion_file')
        if entry.is_result or entry.is_fixed or is_file:
            continue  # files are tested separately
        values = st.sampled_from(texts.get(entry.name, entry.choices) or (True, False))
        if isinstance(entry.default, tuple):
            values = st.tuples(st.floats(entry.low, entry.high))
        elif not isinstance(entry.default, (bool, str)):
            kind = st.integers if isinstance(entry.default, int) else st.floats
            values = kind(entry.low, entry.high)
        options.append(st.tuples(st.just(entry.name), values))
    return st.one_of(options)


@given(changes=st.lists(one_change(), max_size=8))
def test_single_changes_leave_consistent_settings(changes: Any) -> None:
    settings = dict(DEFAULTS)
    for name, value in changes:
        accepted = TWIN.change(settings, {name: value})
        assert name == 'layer.stack' or accepted[name] == value
        settings.update(accepted)
    assert settings.keys() == DEFAULTS.keys()
    if settings['layer.loss'] == 'constant':  # the rig refuses what its model cannot follow
        assume(settings['layer.loss_tangent'] <= LARGEST_CONSTANT_LOSS)
    rig = rig_of(settings)
    for name in (*STACKED, 'stress_strain_law', 'loss'):
        assert getattr(rig.layer, name) == settings[f'layer.{name}']
    assert (rig.layer.parts == ()) is (settings['layer.stack'] == '')
    is_harmonic = settings['engine.motion'] == 'harmonic'
    assert rig.engine.damping_ratio == (0.0 if is_harmonic else settings['engine.damping_ratio'])
    for name, value in LAYERS.get(settings['layer.name'], {}).items():
        assert settings[name] == value
    assert 0.0 in (settings[f'recommendation.target_{name}'] for name in ('height', 'speed'))


@pytest.mark.parametrize(
    ('settings', 'request_', 'implied'),
    [
        (DEFAULTS, {'layer.name': 'gelatin_5.6mm'}, LAYERS['gelatin_5.6mm']),
        (DEFAULTS, {'layer.thickness': 0.01}, {'layer.name': 'custom'}),
        (DEFAULTS, {'layer.name': 'custom', 'layer.thickness': 0.01}, {}),
        (DEFAULTS, {'layer.name': 'gelatin_5.6mm', **LAYERS['gelatin_5.6mm']}, {}),
        (HARMONIC, {'engine.damping_ratio': 0.064}, {}),
        (HARMONIC, {'engine.damping_ratio': 0.1}, {'engine.motion': 'underdamped'}),
        (DEFAULTS, {'recommendation.target_speed': 2.0}, {'recommendation.target_height': 0.0}),
        # the later of two values in the table wins
        (DEFAULTS, {'layer.thickness': 0.01, 'layer.name': 'gelatin_5.6mm'},
         {**LAYERS['gelatin_5.6mm'], 'layer.thickness': 0.01, 'layer.name': 'custom'}),
        (DEFAULTS, {'engine.damping_ratio': 0.1, 'engine.motion': 'harmonic'},
         {'engine.motion': 'underdamped'}),
        (DEFAULTS, {'recommendation.target_speed': 2, 'recommendation.target_height': 0.3},
         {'recommendation.target_height': 0.0}),
    ],
)
def test_change_adds_implied_changes(settings, request_, implied) -> None:
    assert TWIN.change(settings, request_) == {**request_, **implied}


FOAM = """\
foam:
  {description: foam, source: measured, density: 120.0, wave_speed: 20.0, loss_tangent: 0.1}
"""


def test_stack_is_kept_in_numbers_after_changes_of_the_library(write) -> None:
    mine = write(FOAM)
    request_ = {'layer.library': str(mine), 'layer.stack': '8e-3 gelatin, 2e-3 foam'}
    settings = {**DEFAULTS, **TWIN.change(DEFAULTS, request_)}
    numbers = '0.008 7.8 1000.0 0.0, 0.002 20.0 120.0 0.1'
    assert settings['layer.stack'] == numbers
    before = rig_of(settings)
    assert before.layer.sheets[1].diameter == settings['layer.diameter']
    assert rig_of({**DEFAULTS, **rig_values(before)}) == before
    mine.write_text(FOAM.replace(' 20.0', ' 9.0'))
    os.utime(mine, ns=(1, 1))
    assert rig_of(settings) == before
    mine.unlink()
    for change in ({'throw.period': 2.0}, {'layer.stress_strain_law': 'neo_hookean'}):
        assert TWIN.change(settings, change) == change
    assert rig_of(settings) == before
    assert TWIN.change(settings, {'layer.thickness': 0.004})['layer.stack'] == ''
    with pytest.raises(ParameterError, match='No such file'):
        TWIN.change(settings, {'layer.stack': '8e-3 gelatin'})
    mine.write_text(FOAM.replace(' 20.0', ' 9.0'))
    again = TWIN.change(settings, request_)
    assert again['layer.stack'] == numbers.replace(' 20.0', ' 9.0')


@pytest.mark.parametrize(
    ('stack', 'complaint'),
    [
        ('8e-3 jelly', "no material is named 'jelly'; there are gelatin"),
        ('8e-3 7.8 1000, ', r"must be THICKNESS MATERIAL, or .*, got ''"),
        ('8 gelatin', r"thickness must be a number from 0\.0001 to 0\.1 m, got '8'"),
        ('0.06 gelatin, 0.06 gelatin', r'thickness must be .* from 0\.0005 to 0\.1 m, got 0\.12'),
        (', '.join(['1e-4 9 1000'] * 201), 'at most 200 sheets, got 201'),
    ],
)
def test_bad_stacks_are_refused_with_the_value(stack: str, complaint: str) -> None:
    with pytest.raises(ParameterError, match=complaint):
        TWIN.change(DEFAULTS, {'layer.stack': stack})
