# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
The results of a fit: the first release with its alternatives near a jump, and the answer.

The answer consists of the wave speeds, and whether the fit suits its purpose.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from soft_throw_ros.identification.forward import FirstReleases
from soft_throw_ros.identification.least_squares import Estimate, FitError
from soft_throw_ros.identification.rig_fit import RigFit
from soft_throw_ros.identification.systematics import with_floor

Floats = NDArray[np.float64]

_DRAWS = 400
"""Number of rigs drawn from the covariance of a fit; the errors are then known to 4 %."""

_MIN_PROBABILITY = 0.025
"""
Smallest probability of a reported alternative.

The intervals of 95 % of the result and its alternatives then contain the truth with 95 %.
"""

GOOD_ENOUGH = 0.01
"""
Relative error of the energy transfer that is small enough to choose a layer. [-]

A better layer increases the energy transfer by some 10 %; one of 1 % does not change the choice.
"""

_MAIN_SHARE = 0.5
"""Smallest share of a variance of its main source. [-]"""


class AlternativeRelease(NamedTuple):
    """The first release if it comes after more, or fewer, echoes of the wave."""

    echoes: int
    """Number of echoes more than in the most likely rig; negative if fewer."""
    probability: float
    """Share of such releases among the rigs drawn from the errors of the fit. [-]"""
    time: Estimate
    """[s]"""
    speed: Estimate
    """[m/s]"""
    energy_transfer: Estimate
    """[-]"""


@dataclass(frozen=True, kw_only=True)
class Ejection:
    r"""
    The first release of the projectile, with standard errors.

    Ejection time and energy transfer jump where the release passes an odd multiple of the
    crossing time. If the errors of the fit reach such a jump, the releases beyond it are
    `alternatives`, and the standard errors are those on the near side of the jump.
    """

    time: Estimate
    r""":math:`t_e`, since the plate began to move. [s]"""
    speed: Estimate
    r""":math:`V_e`. [m/s]"""
    peak_plate_speed: Estimate
    r""":math:`V_p^*`. [m/s]"""
    energy_transfer: Estimate
    r""":math:`\alpha = (V_e / V_p^*)^2`. [-]"""
    alternatives: tuple[AlternativeRelease, ...] = ()
    """Releases after another number of echoes, the most probable one first."""


def ejection_of(result: RigFit) -> Ejection:
    r"""
    Compute the first release of a fitted rig.

    Raises
    ------
    FitError
        If the projectile does not leave the layer.

    Notes
    -----
    Errors are the deviations of rigs that are drawn from the covariance of the fit, since
    :math:`t_e` and :math:`\alpha` jump and have no derivative there, and the systematic errors of
    `FLOORS`, such as that of a layer that sticks and releases the projectile later.

    """
    releases = result.releases(_DRAWS)
    if np.isnan(releases.time[0]):
        share = 100.0 * float(np.isfinite(releases.time).mean())
        raise FitError(
            'the projectile of the fitted rig does not leave the layer '
            f'({share:.2g} % of the rigs within the errors throw it)'
        )
    is_released = ~np.isnan(releases.time)
    echoes = releases.echoes - releases.echoes[0]
    is_near = is_released & (echoes == 0)

    def estimate(name: str, values: Floats) -> Estimate:
        deviations = values[is_near] - values[0]
        drawn = Estimate(float(values[0]), float(np.sqrt(np.mean(deviations**2))))
        return with_floor(name, drawn)

    alternatives = [
        _alternative(releases, is_released & (echoes == other), int(other))
        for other in np.unique(echoes[is_released])
        if other and np.mean(echoes[is_released] == other) > _MIN_PROBABILITY
    ]
    return Ejection(
        time=estimate('ejection.time', releases.time),
        speed=estimate('ejection.speed', releases.speed),
        # which is proportional to the amplitude
        peak_plate_speed=estimate('engine.amplitude', releases.peak_plate_speed),
        energy_transfer=estimate('ejection.energy_transfer', releases.energy_transfer),
        alternatives=tuple(sorted(alternatives, key=lambda item: -item.probability)),
    )


def _alternative(
    releases: FirstReleases, chosen: NDArray[np.bool_], echoes: int
) -> AlternativeRelease:
    """Return the mean and the spread of some of the releases."""
    time, speed, energy_transfer = (
        with_floor(
            f'ejection.{name}',
            Estimate(float(values[chosen].mean()), float(values[chosen].std(ddof=1))),
        )
        for name, values in (
            ('time', releases.time),
            ('speed', releases.speed),
            ('energy_transfer', releases.energy_transfer),
        )
    )
    probability = float(chosen.sum() / np.isfinite(releases.time).sum())
    return AlternativeRelease(echoes, probability, time, speed, energy_transfer)


@dataclass(frozen=True, kw_only=True)
class Answer:
    """The numbers that an experimenter wants first."""

    effective_wave_speed: Estimate
    """Wave speed at the amplitude of the throws. [m/s]"""
    rest_wave_speed: Estimate
    """Wave speed of the layer at rest. [m/s]"""
    limited_by: str | None
    """Main source of the error of the wave speed at rest, see `RigFit.budget`; None if several."""
    energy_transfer_error: float | None
    """Error of the energy transfer over its value; None without a release. [-]"""
    is_good_enough: bool
    """
    Whether the fit is good enough to choose a layer.

    The energy transfer is known to `GOOD_ENOUGH`, also if the projectile leaves after another
    number of echoes, the model explains the tracks, the solver has converged, and nothing is
    assumed.
    """


def answer_of(result: RigFit, ejection: Ejection | None) -> Answer | None:
    """
    Return the answer of a fit; None if it does not determine the wave speed.

    Without an ejection no release is predicted.
    """
    name = next((n for n in result.fit.names if n.partition('[')[0] == 'layer.wave_speed'), None)
    if name is None:
        return None
    squares = {source: part**2 for source, part in result.budget(name).items()}
    main = max(squares, key=squares.__getitem__)
    error, is_known = None, False
    if ejection is not None:
        alpha = ejection.energy_transfer
        error = alpha.error / alpha.value
        others = [item.energy_transfer.value for item in ejection.alternatives]
        off = max((abs(other - alpha.value) / alpha.value for other in others), default=0.0)
        is_known = max(error, off) <= GOOD_ENOUGH
    return Answer(
        effective_wave_speed=result.estimate('layer.wave_speed'),
        rest_wave_speed=result.rest_wave_speed(),
        limited_by=main if squares[main] > _MAIN_SHARE * sum(squares.values()) else None,
        energy_transfer_error=error,
        is_good_enough=is_known
        and not result.fit.is_mismatch
        and result.fit.is_converged
        and not result.model.description.assumed,
    )
