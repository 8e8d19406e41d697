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
"""Sentences of the report of a fit."""

import pytest
from soft_throw_ros.commands.identify_report import remark_lines, warning_text
from soft_throw_ros.identification.fit_warnings import (
    Ambiguity,
    Contradiction,
    CorrelatedResiduals,
    InseparablePair,
    Mismatch,
)
from soft_throw_ros.identification.least_squares import Estimate
from soft_throw_ros.identification.model_choice import AddedTerm
from soft_throw_ros.identification.rig_fit import RigFit
from soft_throw_ros.identification.unseen import SkippedEffect


@pytest.mark.parametrize(
    ('warning', 'text'),
    [
        (
            Ambiguity('layer.wave_speed', 7.81234, 4.04),
            'layer.wave_speed may as well be 7.8123 (chi squared is larger by 4.0 there); the '
            'errors span both',
        ),
        (
            InseparablePair(('size', 'rate'), -0.995),
            'size and rate can hardly be told apart by these tracks (correlation -0.9950): the '
            'error of each is 10 times larger than with the other known; hold one',
        ),
        (
            Contradiction('projectile.mass', 5.04, Estimate(0.7, 3e-3)),
            'projectile.mass is found 5.0 errors from what is known of it, 0.7000 +- 0.0030: a '
            'given value may be wrong',
        ),
        (
            Mismatch(2.04, 'plate', 0.0123, 0.0456),
            'the residuals are 2 times the noise: the model leaves out something that these '
            'tracks show, most of plate from 0.0123 s to 0.0456 s; errors are larger by as much, '
            'and may be too small',
        ),
        (
            CorrelatedResiduals('plate', 0, 0.7, 4.0),
            'the residuals of plate are no white noise (correlation of neighbours 0.70): errors '
            'are up to 2 times larger',
        ),
        (
            CorrelatedResiduals('plate', 2, 0.7, 0.5),
            'the residuals of plate and 2 more are no white noise (correlation of neighbours '
            '0.70): errors are up to 1 times larger',
        ),
    ],
)
def test_warning_is_a_sentence_with_its_numbers(warning, text):
    assert warning_text(warning) == text


def test_remarks_name_added_terms_and_omissions():
    values = Estimate(0.0157, 0.002), Estimate(-0.0013, 0.0033)
    result = RigFit(
        model=None,
        fit=None,
        added_terms=(
            AddedTerm('layer.loss_tangent', values[:1], 1.0, 1.5),
            AddedTerm('plate.ringing', values, 1.0, 1.11),
        ),
        is_complete=False,
        skipped_effects=(SkippedEffect('plate.mode', 'too slow'),),
    )
    assert list(remark_lines(result)) == [
        'a plate that rings before the throw explains these throws (chi squared 1.00 per degree '
        'of freedom); without it they are not explained (1.11). plate.ringing: '
        '0.0157 +- 0.0020, -0.0013 +- 0.0033',
        'the search for effects of the bench is incomplete: the fit takes too long',
        'the errors do not include the effect of plate.mode: too slow',
    ]
