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
"""
Which of several minima explains throws.

Where a stiff layer makes the projectile chatter, chi squared has several minima. Wave speeds
beside the best one are looked at with all else adapted to first order, and other layers that the
search has found; each that may be as good is fitted. What is not worse by more than `NEAR` is
named.
"""

from __future__ import annotations

from collections.abc import Sequence
import contextlib
from operator import attrgetter

import numpy as np
from numpy.typing import NDArray
from soft_throw_ros.core.rig import Rig
from soft_throw_ros.identification.fit_description import LAYER, values_of
from soft_throw_ros.identification.forward import EffortError
from soft_throw_ros.identification.least_squares import Alternative, Fit, FitError
from soft_throw_ros.identification.linear_fit import LinearFit
from soft_throw_ros.identification.rig_model import RigModel

Floats = NDArray[np.float64]

NEAR = 9.0
"""By how much chi squared of another minimum may be larger for it to be named."""

_APART = 4.0  # of chi squared, that another minimum is farther than chance and its slope explain
_SCAN = np.linspace(-0.08, 0.08, 65)  # relative changes of the wave speed, to see other minima
_PROMISING = 60.0  # chi squared above the best from which a fit is still tried
_MOST_STARTS = 4  # of other minima, the most promising ones first, each with ...
_EVALUATIONS = 20  # of the model


def find_best_minimum(model: RigModel, fit: Fit, others: Sequence[Rig] = ()) -> Fit:
    """
    Try what else the layer may be: take what is better, and name what is hardly worse.

    Parameters
    ----------
    model : RigModel
        Of all throws.
    fit : Fit
        Of the model.
    others : sequence of Rig
        That the layer may be of.

    """
    if 'layer.wave_speed' not in model.places:
        return fit
    starts = _find_valleys(model, fit)
    for rig in others:
        start = fit.values.copy()
        for name, value in values_of(rig, LAYER).items():
            if name in model.places:
                start[model.places_of(name)] = value
        starts.append(start)
    if fit.is_mismatch:
        starts.insert(0, model.without_faults(fit.values))
    found = [fit]
    for start in starts[:_MOST_STARTS]:
        try:
            found.append(model.fit(start, noise=fit.noise, max_evaluations=_EVALUATIONS))
        except EffortError:
            break
        except FitError:
            continue
    first, *rest = sorted(found, key=attrgetter('chi2'))
    known = [first]
    for each in rest:
        if each.chi2 - first.chi2 < NEAR and all(_is_apart(one, each) for one in known):
            known.append(each)
    alternatives = [Alternative(each.values, each.chi2 - first.chi2) for each in known[1:]]
    if first is not fit:
        with contextlib.suppress(EffortError):
            first = model.fit(first.values)  # with its own noise
    return first.spanning(alternatives)


def _is_apart(fit: Fit, other: Fit) -> bool:
    """Tell another minimum from the slope of a valley, where chi squared is a parabola."""
    way = other.values - fit.values
    parabola = float(way @ np.linalg.lstsq(fit.covariance, way, rcond=1e-14)[0])
    return parabola > _APART + 2.0 * (other.chi2 - fit.chi2)


def _find_valleys(model: RigModel, fit: Fit) -> list[Floats]:
    """Find wave speeds at which chi squared is lower than beside, all else being adapted."""
    places = model.places_of('layer.wave_speed')
    profile, values = [], []
    try:
        system = LinearFit(model, fit, places)
        for part in _SCAN:
            moved = fit.values.copy()
            moved[places] *= 1.0 + part
            adapted, chi2 = system.adapt(moved)
            profile.append(chi2)
            values.append(adapted)
    except FitError:
        return []
    limit = min(profile) + _PROMISING
    valleys = [
        k
        for k in range(1, len(profile) - 1)
        if profile[k] < min(profile[k - 1], profile[k + 1], limit) and k != _SCAN.size // 2
    ]
    return [values[k] for k in sorted(valleys, key=profile.__getitem__)]
