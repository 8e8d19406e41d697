# Copyright 2026 soft_throw_ros developers
#
# Licensed under the Apache License, Version 2.0 (the "License");
# you may not use this file except in compliance with the License.
# You may obtain a copy of the License at
#
#     http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software
# distributed under the License is distributed on an "AS IS" BASIS,
# WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied.
# See the License for the specific language governing permissions and
# limitations under the License.
"""The answer of an identification."""

from dataclasses import replace

import pytest
from soft_throw_ros.core.rig import Rig
from soft_throw_ros.identification.answer import answer_of, GOOD_ENOUGH
from soft_throw_ros.identification.ejection import AlternativeRelease, Ejection
from soft_throw_ros.identification.fit_description import FitDescription
from soft_throw_ros.identification.least_squares import Estimate
from soft_throw_ros.identification.rig_fit import fit_rig


def ejection(*, error=0.02, other=None):
    """Return a release with an energy transfer of 4, and possibly another one."""
    one = Estimate(1.0, 0.01)
    others = [AlternativeRelease(1, 0.2, one, one, Estimate(other, 0.02))] if other else []
    return Ejection(
        time=one, speed=one, peak_plate_speed=one, energy_transfer=Estimate(4.0, error),
        alternatives=tuple(others),
    )


@pytest.fixture(scope='module')
def fits(make_throw):
    """Return the fits of one throw with unknown stiffening and with a linear layer."""
    throw = make_throw(Rig(), rate=2500.0, duration=0.06)
    linear = FitDescription({'layer.stiffening': 'held'})
    return fit_rig([throw], Rig()), fit_rig([throw], Rig(), linear)


def test_wave_speed_at_the_amplitude_is_better_known_than_at_rest(fits):
    unknown, linear = fits
    answer = answer_of(unknown, ejection())
    speed, at_rest = answer.effective_wave_speed, answer.rest_wave_speed
    assert answer.limited_by == 'layer.stiffening'
    assert speed.error < 0.5 * at_rest.error
    assert at_rest.error == unknown.estimate('layer.wave_speed').error
    assert speed.value == pytest.approx(Rig().layer.wave_speed, abs=3.0 * speed.error)
    # A linear layer has the effective wave speed at all amplitudes
    assert speed.error == pytest.approx(linear.estimate('layer.wave_speed').error, rel=0.1)
    same = answer_of(linear, ejection())
    assert same.effective_wave_speed.error == pytest.approx(same.rest_wave_speed.error)
    assert same.limited_by != 'layer.stiffening'


def test_verdict_needs_a_small_error_without_jump_and_mismatch(fits):
    found = fits[1]
    assert answer_of(found, ejection(error=3.9 * GOOD_ENOUGH)).is_good_enough
    assert answer_of(found, ejection(other=4.01)).is_good_enough
    assert not answer_of(found, ejection(error=4.1 * GOOD_ENOUGH)).is_good_enough
    assert not answer_of(found, ejection(other=3.5)).is_good_enough
    poor = replace(found, fit=replace(found.fit, chi2=4.0 * found.fit.chi2))
    assert not answer_of(poor, ejection()).is_good_enough


def test_known_wave_speed_needs_no_answer(fits):
    found = fits[1]
    names = tuple(name.replace('wave_speed', 'other') for name in found.fit.names)
    assert answer_of(replace(found, fit=replace(found.fit, names=names)), ejection()) is None
