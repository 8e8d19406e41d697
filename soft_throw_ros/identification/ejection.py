# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""The first release of a fitted rig with its alternatives near a jump, and the verdict."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from soft_throw_ros.core.rig import values_of
from soft_throw_ros.core.throw import throw_many
from soft_throw_ros.identification.least_squares import Estimate, fit_warnings, FitError
from soft_throw_ros.identification.rig_fit import RigFit
from soft_throw_ros.identification.systematics import with_floor

_DRAWS = 400  # number of rigs drawn from the covariance of a fit; the errors are then known to 4 %
_MIN_PROBABILITY = 0.025  # of a reported alternative; intervals of 95 % then hold with 95 %

GOOD_ENOUGH = 0.01
"""Relative error of the energy transfer, of which a better layer gains some 10 %. [-]"""


class Release(NamedTuple):
    """A first release with standard errors, after some number of echoes of the wave."""

    time: Estimate  # ejection time, since the plate began to move [s]
    speed: Estimate  # [m/s]
    peak_plate_speed: Estimate  # [m/s]
    energy_transfer: Estimate  # [-]
    echoes: int = 0  # number of echoes more than in the most likely rig; negative if fewer
    probability: float = 1.0  # share among the rigs drawn from the errors of the fit [-]


def releases_of(result: RigFit) -> list[Release]:
    r"""
    Compute the first release of a fitted rig; raise FitError if there is none.

    Ejection time and energy transfer jump where the release passes an odd multiple of the
    crossing time. If the errors of the fit reach such a jump, the releases beyond it follow, the
    most probable one first. Errors are the systematic ones of a release, and the deviations of
    rigs that are drawn from the errors of the fit, since :math:`t_e` and :math:`\alpha` have no
    derivative at a jump.
    """
    rigs = [result.rig, *result.draw(_DRAWS)]
    drawn = [values_of(rig) for rig in rigs]
    changes = {name: np.array([values[name] for values in drawn]) for name in drawn[0]}
    time, speed, energy_transfer = throw_many(result.rig, changes)[:3]
    is_released = ~np.isnan(time)
    if not is_released[0]:
        raise FitError(
            'the projectile of the fitted rig does not leave the layer '
            f'({100.0 * is_released.mean():.2g} % of the rigs within the errors throw it)'
        )
    crossings = time / [rig.crossing_time for rig in rigs]
    echoes = ((np.nan_to_num(crossings) - 1.0) // 2.0).astype(np.int64)
    echoes -= echoes[0]
    columns = {
        'time': time,
        'speed': speed,
        'peak_plate_speed': speed / np.sqrt(energy_transfer),
        'energy_transfer': energy_transfer,
    }

    def release(count: int) -> Release:
        chosen = is_released & (echoes == count)
        estimates = {}
        for name, column in columns.items():
            value = float(column[chosen].mean() if count else column[0])
            error = float(np.sqrt(np.mean((column[chosen] - value) ** 2)))
            found = Estimate(value, error)
            estimates[name] = with_floor(f'ejection.{name}', found, result.growth)
        share = float(chosen.sum() / is_released.sum())
        return Release(**estimates, echoes=count, probability=share)

    others = [release(int(count)) for count in np.unique(echoes[is_released]) if count]
    likely = [item for item in others if item.probability > _MIN_PROBABILITY]
    return [release(0), *sorted(likely, key=lambda item: -item.probability)]


def doubt(result: RigFit, releases: Sequence[Release]) -> str:
    """
    Return why a fit is not good enough to choose a layer; empty if it is.

    It is if the energy transfer is known to `GOOD_ENOUGH`, also if the projectile leaves after
    another number of echoes, and there is neither a warning nor an assumption.
    """
    if assumed := result.model.description.assumed:
        return f'nobody stated {", ".join(assumed)}'
    if not releases:
        return 'no release is predicted'
    if warnings := fit_warnings(result.fit):
        return warnings[0]
    value, error = releases[0].energy_transfer
    if any(abs(item.energy_transfer.value - value) > GOOD_ENOUGH * value for item in releases):
        return 'another number of echoes is possible'
    if error > GOOD_ENOUGH * value:
        known = f'{100.0 * error / value:.2g} %, more than {100.0 * GOOD_ENOUGH:g} %'
        return f'the energy transfer is known to {known}'
    return ''
