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
    FREE,
    parse_error,
    Treatment,
)
from soft_throw_ros.identification.least_squares import Estimate

RIG = Rig(layer=Layer(thickness=0.02), projectile=Projectile(mass=1e-3))


@pytest.mark.parametrize(
    ('treatment', 'known', 'value'),
    [
        (FREE, None, 0.02),
        (FIXED, None, 0.02),
        (Treatment(False, 0.012), None, 0.012),
        (Treatment(True, 0.012, 1e-4), Estimate(0.012, 1e-4), 0.012),
        (Treatment(True, None, 1e-4), Estimate(0.02, 1e-4), 0.02),
        (parse_error('1e-4', '0.02'), Estimate(0.02, 1e-4), 0.02),
        (parse_error(' 2 %', '0.02'), Estimate(0.02, pytest.approx(4e-4)), 0.02),
    ],
)
def test_parameter_is_free_or_fixed_or_known_with_an_error(treatment, known, value):
    description = FitDescription({'layer.thickness': treatment})
    assert description.known('layer.thickness', RIG) == known
    assert description.prepare(RIG).layer.thickness == value
    assert description.treatment('layer.thickness').is_free is (treatment == FREE)
    assert all(description.treatment(name).is_varied for name in DEFAULT_FREE)


def test_measured_quantities_have_the_errors_of_the_paper():
    description = FitDescription()
    assert description.known('layer.thickness', RIG) == Estimate(0.02, 1e-4)
    assert description.known('projectile.mass', RIG) == Estimate(1e-3, pytest.approx(1e-5))


@pytest.mark.parametrize(
    ('treatment', 'stated', 'is_assumed'),
    [
        (None, (), True),
        (FIXED, (), True),
        (Treatment(True, error=1e-5), (), True),
        (FREE, (), False),
        (Treatment(True, 0.002, 2e-5), (), False),
        (None, ('projectile.mass',), False),
    ],
)
def test_value_that_nobody_stated_is_assumed_and_held(treatment, stated, is_assumed):
    description = FitDescription({'projectile.mass': treatment} if treatment else {})
    result = description.assume(stated)
    assert ('projectile.mass' in result.assumed) is is_assumed
    assert 'layer.loss_tangent' not in result.assumed
    assert 'layer.wave_speed' not in result.assumed
    if is_assumed:
        assert result.treatment('projectile.mass') == FIXED


def test_file_agrees_with_the_python_description(write):
    path = write(
        'free: [layer.thickness]\nprior:\n  projectile.mass: [0.0012, 1.2e-5]\n'
        'per_throw: [engine.frequency, projectile.mass]\ntopic: /a\n'
    )
    treatments = {
        'layer.thickness': FREE,
        'projectile.mass': Treatment(True, 0.0012, 1.2e-5, is_per_throw=True),
        'engine.frequency': FREE._replace(is_per_throw=True),
    }
    assert FitDescription.from_file(path) == FitDescription(treatments, '/a')


@pytest.mark.parametrize(
    ('text', 'value'),
    [
        ('free: [layer.colour]', "'layer.colour'"),
        ('free: layer.thickness', "'layer.thickness'"),
        ('fixed:\n  layer.thickness: often', "'often'"),
        ('prior:\n  layer.thickness: [1, 0]', '[1, 0]'),
        ('prior:\n  layer.thickness: [1e400, 1]', '1e400'),
        ('per_throw: [layer.density]', 'layer.density'),
        ('depths: own', "'depths'"),
        ('- a', 'a mapping'),
        ('free: [', 'expected'),
    ],
)
def test_bad_file_is_refused_with_its_name_and_the_value(write, text, value):
    path = write(text)
    with pytest.raises(ValueError, match=re.escape(f'{path}: ') + f'.*{re.escape(value)}'):
        FitDescription.from_file(path)
