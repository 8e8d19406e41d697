# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Names and numbers in the report of a fit."""

from types import SimpleNamespace

import pytest
from soft_throw_ros.commands.identify_report import remark_lines, warning_text
from soft_throw_ros.identification.fit_warnings import (
    Ambiguity,
    Contradiction,
    InseparablePair,
    Mismatch,
    NotConverged,
)
from soft_throw_ros.identification.least_squares import Estimate
from soft_throw_ros.identification.rig_fit import RigFit


@pytest.mark.parametrize(
    ('warning', 'values'),
    [
        (Ambiguity('layer.wave_speed', 7.81234, 4.04), ('layer.wave_speed', '7.8123', '4.0')),
        (InseparablePair(('size', 'rate'), -0.995), ('size', 'rate', '-0.9950', '10 times')),
        (
            Contradiction('projectile.mass', 5.04, Estimate(0.7, 3e-3)),
            ('projectile.mass', '5.0 errors', '0.7000 +- 0.0030'),
        ),
        (Mismatch(2.04, 'plate', 0.0123, 0.0456), ('2 times', 'plate', '0.0123 s', '0.0456 s')),
        (NotConverged(), ('limit',)),
    ],
)
def test_warning_has_its_names_and_numbers(warning, values):
    text = warning_text(warning)
    assert [value for value in values if value not in text] == []


def test_remarks_name_ringing_and_an_incomplete_search():
    model = SimpleNamespace(layout={'plate.ringing_cosine': 0})
    ringing, incomplete = remark_lines(RigFit(model=model, fit=None, is_complete=False))
    assert 'rings' in ringing
    assert 'incomplete' in incomplete
