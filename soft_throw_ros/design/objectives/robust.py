# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""The objective `robust`: the most energy in the worst case of the uncertainties."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
import itertools
from typing import ClassVar

import numpy as np
from soft_throw_ros.configuration import Settings
from soft_throw_ros.core import checks
from soft_throw_ros.core.rig import Rig
from soft_throw_ros.design.objective import Objective
from soft_throw_ros.design.uncertainty import quasi_random_offsets, Uncertainties, Variants

_THROWS_INSIDE = 31
"""Number of candidates for the worst throw between the corners of the uncertainties."""

_THROWS_OF_QUANTILE = 61
"""Number of throws in the estimate of a quantile."""


@dataclass(frozen=True, kw_only=True)
class Robust(Objective):
    """
    The most energy in the worst case of the uncertainties.

    Parameters
    ----------
    uncertainties : Uncertainties
        Largest errors of the rig.
    quantile : float
        Quantile of the energy transfer: 0 is the worst throw, 0.05 is worse than 95 %. [-]

    Raises
    ------
    ValueError
        If `quantile` is not in [0, 1).

    Notes
    -----
    The worst is looked for at the corners of the uncertainties and at points spread between; a
    quantile is taken of points spread evenly. Limits hold for the rig as it should be. A layer
    that could be off by its whole thickness or wave speed throws nothing.

    """

    uncertainties: Uncertainties = field(default_factory=Uncertainties)
    quantile: float = 0.0
    name: ClassVar[str] = 'robust'
    limits_hold_for_all: ClassVar[bool] = False

    def __post_init__(self) -> None:
        checks.require_in_unit_interval('quantile', self.quantile)

    @classmethod
    def from_settings(cls, settings: Settings) -> Robust:
        """Return the objective with `uncertainty.*` and `recommendation.quantile`."""
        return cls(
            uncertainties=Uncertainties.from_settings(settings),
            quantile=settings['recommendation.quantile'],
        )

    @property
    def summary(self) -> str:
        """Name of the score in texts."""
        return f'{100.0 * self.quantile:g} % quantile of alpha' if self.quantile else 'worst alpha'

    def variants(self, rig: Rig) -> Variants:
        """Return the throws of the score; the first one is the nominal throw."""
        if self.quantile > 0.0:
            offsets = quasi_random_offsets(_THROWS_OF_QUANTILE)
        else:
            # Thickness, wave speed and frequency count by c / (L f) above all, which is farthest
            # off where the frequency is off against the wave speed.
            corners = np.array(list(itertools.product((-1.0, 1.0), repeat=4)))
            corners = np.insert(corners, 3, -corners[:, 0], axis=1)
            inside = quasi_random_offsets(_THROWS_INSIDE + 1)[1:]
            offsets = np.concatenate([np.zeros((1, 5)), corners, inside])
        return self.uncertainties.variants(rig, offsets)

    def with_spread(self, spread: float) -> Robust:
        """Return the objective for a material whose wave speed may be off by its spread [m/s]."""
        if spread <= self.uncertainties.wave_speed:
            return self
        return replace(self, uncertainties=replace(self.uncertainties, wave_speed=spread))
