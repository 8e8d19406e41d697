# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Descriptions of a fit: free, fixed and known parameters."""

import re

import pytest
from soft_throw_ros.core.rig import Layer, Projectile, Rig
from soft_throw_ros.identification.fit_description import (
    DEFAULT_FREE,
    DEFAULTS,
    FitDescription,
    FIXED,
    FREE,
    parse_error,
    Treatment,
)
from soft_throw_ros.identification.least_squares import Estimate

RIG = Rig(layer=Layer(thickness=0.02), projectile=Projectile(mass=1e-3))


@pytest.mark.parametrize(('treatment', 'known', 'value'), [
    (FREE, None, 0.02),
    (FIXED, None, 0.02),
    (DEFAULTS['layer.thickness'], Estimate(0.02, 1e-4), 0.02),  # of the paper
    (Treatment(False, 0.012), None, 0.012),
    (Treatment(True, 0.012, 1e-4), Estimate(0.012, 1e-4), 0.012),
    (parse_error('1e-4', '0.02'), Estimate(0.02, 1e-4), 0.02),
    (parse_error(' 2 %', '0.02'), Estimate(0.02, pytest.approx(4e-4)), 0.02),
])
def test_parameter_is_free_or_fixed_or_known_with_an_error(treatment, known, value):
    description = FitDescription({'layer.thickness': treatment})
    assert description.known('layer.thickness', RIG) == known
    assert description.prepare(RIG).layer.thickness == value
    assert description.treatment('layer.thickness').is_free is (treatment == FREE)
    assert all(description.treatment(name).is_varied for name in DEFAULT_FREE)


@pytest.mark.parametrize('treatment', [None, FIXED, Treatment(True, error=1e-5)])
def test_value_that_nobody_stated_is_assumed_and_held(treatment):
    description = FitDescription({'projectile.mass': treatment} if treatment else {})
    result = description.assume(())
    assert result.treatment('projectile.mass') == FIXED
    assert set(result.assumed) == {
        'projectile.mass', 'layer.thickness', 'layer.density', 'layer.diameter'
    }
    assert 'projectile.mass' not in description.assume(['projectile.mass']).assumed
    for stated in (FREE, Treatment(True, 0.002, 2e-5)):
        stated_there = description.change({'projectile.mass': stated})
        assert 'projectile.mass' not in stated_there.assume(()).assumed


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


@pytest.mark.parametrize(('text', 'value'), [
    ('free: [layer.colour]', "'layer.colour'"),
    ('free: layer.thickness', "'layer.thickness'"),
    ('fixed:\n  layer.thickness: often', "'often'"),
    ('prior:\n  layer.thickness: [1, 0]', '[1, 0]'),
    ('prior:\n  layer.thickness: [1e400, 1]', '1e400'),
    ('per_throw: [layer.density]', 'layer.density'),
    ('depths: own', "'depths'"),
    ('- a', 'a mapping'),
])
def test_bad_file_is_refused_with_its_name_and_the_value(write, text, value):
    path = write(text)
    with pytest.raises(ValueError, match=re.escape(f'{path}: ') + f'.*{re.escape(value)}'):
        FitDescription.from_file(path)
