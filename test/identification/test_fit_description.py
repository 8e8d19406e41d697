# SPDX-License-Identifier: Apache-2.0
"""What is fitted, and how that is said."""

import re

import pytest
from soft_throw_ros.core.rig import Layer, Projectile, Rig
from soft_throw_ros.identification.fit_description import FitDescription, USUAL
from soft_throw_ros.identification.least_squares import Estimate

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
    ],
)
def test_parameter_is_free_or_held_or_known_with_an_error(text, known, value):
    description = FitDescription({'layer.thickness': text})
    assert description.known(RIG).get('layer.thickness') == known
    assert description.prepare(RIG).layer.thickness == value
    assert ('layer.thickness' in description.varied) is (text == 'free' or known is not None)
    assert description.is_free('layer.thickness') is (text == 'free')
    assert description.per_throw == (('layer.thickness',) if 'per throw' in text else ())
    assert set(USUAL) <= set(description.varied)


def test_file_says_what_python_says(tmp_path):
    path = tmp_path / 'fit.yaml'
    path.write_text(
        'parameters:\n  projectile.mass: 0.0012 +- 1 %\n  engine.amplitude: free per throw\n'
        'heights: common\nreference: centre\n'
    )
    parameters = {'projectile.mass': '0.0012 +- 1 %', 'engine.amplitude': 'free per throw'}
    assert FitDescription.from_file(path) == FitDescription(parameters, 'common', 'centre')


@pytest.mark.parametrize(
    ('text', 'line', 'value'),
    [
        ('parameters:\n  layer.colour: free', 2, "'layer.colour'"),
        ('parameters:\n  layer.thickness: often', 2, "'often'"),
        ('parameters:\n  layer.thickness: 1 +- 0', 2, "'1 +- 0'"),
        ('parameters:\n  layer.thickness: held per throw', 2, "'held per throw'"),
        ('heights: any', 1, "'any'"),
        ('reference: top', 1, "'top'"),
        ('depths: own', 1, "'depths'"),
        ('- a', 1, 'a mapping'),
        ('parameters: [', 1, 'expected'),
    ],
)
def test_file_that_is_wrong_is_refused_with_its_line(tmp_path, text, line, value):
    path = tmp_path / 'fit.yaml'
    path.write_text(text)
    with pytest.raises(ValueError, match=re.escape(f'{path}:{line}: ') + f'.*{re.escape(value)}'):
        FitDescription.from_file(path)
