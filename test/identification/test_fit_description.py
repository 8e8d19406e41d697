# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Descriptions of a fit: free, fixed and known parameters."""

import re

import pytest
from soft_throw_ros.core.rig import Layer, Projectile, Rig
from soft_throw_ros.identification.fit_description import (
    DEFAULT_FREE,
    FitDescription,
    FIXED,
    parse_treatments,
    ThrowConditions,
)
from soft_throw_ros.identification.least_squares import Estimate, FitError

RIG = Rig(layer=Layer(thickness=0.02), projectile=Projectile(mass=1e-3))


@pytest.mark.parametrize(
    ('text', 'known', 'value'),
    [
        ('free', None, 0.02),
        ('held', None, 0.02),
        ('0.012', None, 0.012),
        ('0.012 +- 1e-4', Estimate(0.012, 1e-4), 0.012),
        ('12e-3+-2%', Estimate(0.012, pytest.approx(2.4e-4)), 0.012),
        ('+- 1 % per throw', Estimate(0.02, pytest.approx(2e-4)), 0.02),
        ('+- 1 % per throw if seen', Estimate(0.02, pytest.approx(2e-4)), 0.02),
    ],
)
def test_parameter_is_free_or_held_or_known_with_an_error(text, known, value):
    description = FitDescription(parse_treatments({'layer.thickness': text}))
    treatment = description.treatment('layer.thickness')
    assert description.known('layer.thickness', RIG, 'a throw') == known
    assert description.prepare(RIG).layer.thickness == value
    assert treatment.is_varied is ((text == 'free' or known is not None) and 'seen' not in text)
    assert description.is_free('layer.thickness') is (text == 'free')
    assert treatment.is_per_throw is ('per throw' in text)
    assert description.activate('layer.thickness').treatment('layer.thickness').is_varied is (
        treatment.is_varied or treatment.only_if_significant
    )
    assert all(description.treatment(name).is_varied for name in DEFAULT_FREE)


def test_measured_quantities_have_the_errors_of_the_paper():
    description = FitDescription()
    assert description.known('layer.thickness', RIG, '') == Estimate(0.02, 1e-4)
    assert description.known('projectile.mass', RIG, '') == Estimate(1e-3, pytest.approx(1e-5))


@pytest.mark.parametrize(
    ('text', 'stated', 'by_throw', 'is_assumed'),
    [
        (None, (), {}, True),
        ('held', (), {}, True),
        ('+- 1 %', (), {}, True),
        ('free', (), {}, False),
        ('0.002 +- 1 %', (), {}, False),
        (None, ('projectile.mass',), {}, False),
        (None, (), {'heavy.csv': '0.002'}, True),
        (None, (), {'heavy.csv': '0.002', 'light.csv': '0.001'}, False),
    ],
)
def test_value_that_nobody_stated_is_assumed_and_held(text, stated, by_throw, is_assumed):
    def treatments(text):
        return parse_treatments({'projectile.mass': text} if text else {})

    throws = {name: ThrowConditions(treatments(item), {}) for name, item in by_throw.items()}
    description = FitDescription(treatments(text), throws=throws)
    result = description.assume(stated, ['heavy.csv', 'light.csv'])
    assert ('projectile.mass' in result.assumed) is is_assumed
    assert 'layer.loss_tangent' not in result.assumed
    assert 'layer.wave_speed' not in result.assumed
    if is_assumed:
        assert result.treatment('projectile.mass') == FIXED


def test_throws_share_equal_descriptions():
    description = FitDescription(
        throws={
            'heavy_*': ThrowConditions(parse_treatments({'projectile.mass': '0.002 +- 1 %'}), {}),
            'heavy_2.csv': ThrowConditions({}, {'layer': 'old'}),
        }
    )
    names = ('light.csv', 'heavy_1.csv', 'heavy_2.csv', 'heavy_3.csv')

    def groups(name):
        return [description.group(name, throw, number) for number, throw in enumerate(names)]

    light, *heavy = groups('projectile.mass')
    assert len(set(heavy)) == 1
    assert light not in heavy
    first, second, third, fourth = groups('layer.wave_speed')
    assert first == second == fourth != third
    assert len(set(groups('engine.amplitude'))) == 4
    assert len(set(groups('engine.frequency'))) == 1
    assert description.prepare(RIG, 'heavy_1.csv').projectile.mass == 0.002
    assert description.prepare(RIG, 'light.csv').projectile.mass == 0.001


@pytest.mark.parametrize(
    ('throw', 'patterns'),
    [
        ('heavy.csv', ['heavy.csv', 'heavy*', '*.csv']),
        ('heavy_1.csv, throw 2', ['heavy_*.csv', 'heavy_1.csv', 'heavy_1.csv, throw 2', '*2']),
        ('heavy_1.csv, part 1, throw 2', ['heavy_*.csv', '*, part 1', '*, part 1, throw 2']),
    ],
)
def test_pattern_is_of_a_throw_or_of_its_file(throw, patterns):
    for pattern in patterns:
        description = FitDescription(throws={pattern: ThrowConditions({}, {'layer': 'old'})})
        description.check_throws(['other.csv', throw])
        assert description.conditions(throw).parts == {'layer': 'old'}
        assert description.conditions('other').parts == {}


@pytest.mark.parametrize('throws', [['light.csv, throw 1', 'light.csv, throw 2'], []])
def test_pattern_that_matches_no_throw_is_refused_with_the_names_of_all(throws):
    conditions = ThrowConditions({'projectile.mass': FIXED}, {})
    description = FitDescription(throws={'heavy_*.csv': conditions})
    with pytest.raises(FitError) as refusal:
        description.check_throws(throws)
    for value in ('heavy_*.csv', *throws):
        assert value in str(refusal.value)


def test_file_agrees_with_the_python_description(tmp_path):
    path = tmp_path / 'fit.yaml'
    path.write_text(
        'parameters:\n  projectile.mass: 0.0012 +- 1 %\n  engine.amplitude: free per throw\n'
        'heights: common\nreference: centre\n'
        'throws:\n  a.csv: {layer: soft, layer.thickness: 0.01}\n'
    )
    texts = {'projectile.mass': '0.0012 +- 1 %', 'engine.amplitude': 'free per throw'}
    thickness = parse_treatments({'layer.thickness': '0.01'})
    throws = {'a.csv': ThrowConditions(thickness, {'layer': 'soft'})}
    expected = FitDescription(parse_treatments(texts), 'common', 'centre', throws)
    assert FitDescription.from_file(path) == expected


@pytest.mark.parametrize(
    ('text', 'line', 'value'),
    [
        ('parameters:\n  layer.colour: free', 2, "'layer.colour'"),
        ('parameters:\n  layer.thickness: often', 2, "'often'"),
        ('parameters:\n  layer.thickness: 1 +- 0', 2, "'1 +- 0'"),
        ('parameters:\n  layer.thickness: 1e400 +- 1 %', 2, "'1e400 +- 1 %'"),
        ('parameters:\n  layer.thickness: held per throw', 2, "'held per throw'"),
        ('parameters:\n  layer.thickness: held if seen', 2, "'held if seen'"),
        ('throws:\n  a.csv:\n    layer.thickness: often', 3, "'often'"),
        ('throws:\n  a.csv: 1', 2, '1'),
        ('throws:\n  a.csv:\n    layer.loss_tangent: free if seen', 3, "'free if seen'"),
        ('heights: any', 1, "'any'"),
        ('reference: top', 1, "'top'"),
        ('depths: own', 1, "'depths'"),
        ('- a', 1, 'a mapping'),
        ('parameters: [', 1, 'expected'),
    ],
)
def test_bad_file_is_refused_with_its_line(tmp_path, text, line, value):
    path = tmp_path / 'fit.yaml'
    path.write_text(text)
    with pytest.raises(ValueError, match=re.escape(f'{path}:{line}: ') + f'.*{re.escape(value)}'):
        FitDescription.from_file(path)
