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
"""The answer of an identification: wave speeds, and whether the fit suits its purpose."""

from __future__ import annotations

from dataclasses import dataclass

from soft_throw_ros.identification.ejection import Ejection
from soft_throw_ros.identification.least_squares import Estimate
from soft_throw_ros.identification.rig_fit import RigFit

GOOD_ENOUGH = 0.01
"""
Relative error of the energy transfer that is small enough to choose a layer. [-]

A better layer increases the energy transfer by some 10 %; one of 1 % does not change the choice.
"""

_MAIN_SHARE = 0.5
"""Smallest share of a variance of its main source. [-]"""


@dataclass(frozen=True, kw_only=True)
class Answer:
    """The numbers that an experimenter wants first."""

    effective_wave_speed: Estimate
    """Wave speed at the amplitude of the throws. [m/s]"""
    rest_wave_speed: Estimate
    """Wave speed of the layer at rest. [m/s]"""
    limited_by: str | None
    """Main source of the error of the wave speed at rest, as in `Fit.budget`; None if several."""
    energy_transfer_error: float
    """Error of the energy transfer over its value. [-]"""
    is_good_enough: bool
    """
    Whether the fit is good enough to choose a layer.

    The energy transfer is known to `GOOD_ENOUGH`, also if the projectile leaves after another
    number of echoes, and the model explains the tracks.
    """


def answer_of(found: RigFit, ejection: Ejection) -> Answer | None:
    """Return the answer of a fit; None if it does not determine the wave speed."""
    name = next((n for n in found.fit.names if n.partition('[')[0] == 'layer.wave_speed'), None)
    if name is None:
        return None
    squares = {source: part**2 for source, part in found.fit.budget(name).items()}
    main = max(squares, key=squares.__getitem__)
    alpha = ejection.energy_transfer
    limit = GOOD_ENOUGH * alpha.value
    others = [each.energy_transfer.value for each in ejection.alternatives]
    return Answer(
        effective_wave_speed=found.effective_wave_speed(),
        rest_wave_speed=found.rest_wave_speed(),
        limited_by=main if squares[main] > _MAIN_SHARE * sum(squares.values()) else None,
        energy_transfer_error=alpha.error / alpha.value,
        is_good_enough=alpha.error <= limit
        and all(abs(other - alpha.value) <= limit for other in others)
        and not found.fit.is_mismatch,
    )
