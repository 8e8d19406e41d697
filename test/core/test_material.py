# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Materials of layers."""

import numpy as np
import pytest
from soft_throw_ros.core.material import BAND, relaxation, RELAXATION_RATES
from soft_throw_ros.core.rig import Layer


def modulus(loss_tangent, frequency):
    """Return the complex modulus over that at the plate's frequency."""
    relaxed, *strengths = relaxation(loss_tangent)
    ratio = 1j * np.asarray(frequency)[..., None] / np.array(RELAXATION_RATES)
    return relaxed + (strengths * ratio / (1.0 + ratio)).sum(axis=-1)


@pytest.mark.parametrize(('loss_tangent', 'error'), [(1e-3, 0.06), (0.2, 0.06), (0.8, 0.13)])
def test_loss_tangent_is_the_same_over_the_band(loss_tangent, error):
    computed = modulus(loss_tangent, np.geomspace(*BAND, 100))
    assert computed.imag / computed.real == pytest.approx(loss_tangent, rel=error)


@pytest.mark.parametrize('loss_tangent', [1e-3, 0.1, 0.5, 0.8])
def test_material_is_passive_and_causal_with_its_measured_stiffness(loss_tangent):
    relaxed, *strengths = relaxation(loss_tangent)
    assert min(strengths) >= 0.0 < relaxed  # passive: it never generates energy
    assert modulus(loss_tangent, 1.0).real == pytest.approx(1.0)
    stiffness = modulus(loss_tangent, np.geomspace(1e-3, 1e3, 50)).real
    assert (np.diff(stiffness) >= 0.0).all()  # Kramers and Kronig: loss stiffens


def test_nearly_liquid_material_is_refused():
    with pytest.raises(ValueError, match=r'at most 0.8 if it is constant, got 1\.5'):
        Layer(loss='constant', loss_tangent=1.5)
