# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""The search for the best layer, on landscapes with a known maximum."""

import numpy as np
import pytest
from soft_throw_ros.design.maximise import Box, maximise

LAYERS = Box(thickness=(1e-3, 50e-3), wave_speed=(1.0, 50.0))


def hill(thickness, wave_speed, _needed=0.0, *, top=(0.02, 9.0), width=0.5):
    """Return a hill of height 1 around a point."""
    x, y = np.log(thickness / top[0]), np.log(wave_speed / top[1])
    return np.exp(-(x**2 + (y - x) ** 2) / width**2)


def cliff(thickness, wave_speed, _needed=0.0):
    """Return a slope up to a cliff, a line of equal c_s / L_s along which the edge rises."""
    ratio, x = wave_speed / thickness, np.log(thickness / 0.03)
    return np.where(ratio < 500.0, (ratio / 500.0) ** 2, 0.3) * np.exp(-(x**2))


@pytest.mark.parametrize('top', [(0.02, 9.0), (2.3e-3, 41.0)])
def test_narrow_hill_that_is_higher_than_a_wide_one_is_found(top):
    def score(*layers):
        return np.maximum(0.95 * hill(*layers), hill(*layers, top=top, width=0.15))

    best = maximise(score, LAYERS, step=0.06)
    assert best[:2] == pytest.approx(top, rel=1e-4)
    assert best.score == pytest.approx(1.0, rel=1e-7)


def test_edge_of_a_cliff_is_found_from_above():
    best = maximise(cliff, LAYERS, step=0.1)
    assert best.score == pytest.approx(1.0, rel=1e-3)
    assert best.wave_speed / best.thickness < 500.0


@pytest.mark.parametrize('fixed', [0, 1])
def test_fixed_value_is_unchanged(fixed):
    layers = LAYERS._replace(**{LAYERS._fields[fixed]: ((0.02, 9.0)[fixed],) * 2})
    best = maximise(hill, layers, step=0.01)
    assert best[fixed] == (0.02, 9.0)[fixed]
    assert best[:2] == pytest.approx((0.02, 9.0), rel=1e-4)
    both = Box((0.02, 0.02), (9.0, 9.0))
    assert maximise(hill, both, step=0.01) == (0.02, 9.0, 1.0)


def test_nothing_is_found_where_all_scores_are_0():
    def score(*layers):
        return 0.0 * layers[0]

    assert maximise(score, LAYERS, step=0.2, starts=[(0.01, 10.0)]) is None
