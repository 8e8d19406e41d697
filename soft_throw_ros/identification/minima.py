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
Choice among several minima of chi squared.

With a stiff layer, on which the projectile chatters, chi squared has several minima. Candidates
are wave speeds beside the best one, with all other values adapted to first order, and other layers
from the search. Promising candidates are fitted. Minima within `NEAR` of the best are reported.
"""

from __future__ import annotations

from collections.abc import Sequence
import contextlib
from operator import attrgetter

import numpy as np
from numpy.typing import NDArray
from soft_throw_ros.core.rig import Rig
from soft_throw_ros.identification.fit_description import LAYER, values_of
from soft_throw_ros.identification.least_squares import Alternative, Fit, FitError
from soft_throw_ros.identification.linear_fit import LinearFit
from soft_throw_ros.identification.rig_model import RigModel

Floats = NDArray[np.float64]

NEAR = 9.0
"""Largest increase of chi squared at another minimum that is reported. [-]"""

_APART = 4.0  # smallest distance of another minimum, in chi squared of the fit's parabola
_SCAN = np.linspace(-0.08, 0.08, 65)  # relative changes of the wave speed in the scan
_PROMISING = 60.0  # largest increase of chi squared at the start of another fit
_MOST_STARTS = 4  # largest number of fits of other minima, the most promising ones first
_EVALUATIONS = 20  # largest number of evaluations of the model in such a fit


def find_best_minimum(model: RigModel, fit: Fit, others: Sequence[Rig] = ()) -> Fit:
    """
    Fit other possible layers; return the best fit with its near alternatives.

    Parameters
    ----------
    model : RigModel
        Model of all throws.
    fit : Fit
        Fit of the model.
    others : sequence of Rig
        Rigs with other possible layers.

    """
    if 'layer.wave_speed' not in model.layout:
        return fit
    starts = _find_valleys(model, fit)
    for rig in others:
        start = fit.values.copy()
        for name, value in values_of(rig, LAYER).items():
            if name in model.layout:
                start[model.layout.indices_of(name)] = value
        starts.append(start)
    if fit.is_mismatch:
        starts.insert(0, model.without_faults(fit.values))
    found = [fit]
    for start in starts[:_MOST_STARTS]:
        if model.simulator.has_budget:
            with contextlib.suppress(FitError):
                found.append(model.fit(start, noise=fit.noise, max_evaluations=_EVALUATIONS))
    first, *rest = sorted(found, key=attrgetter('chi2'))
    known = [first]
    for each in rest:
        if each.chi2 - first.chi2 < NEAR and all(_is_apart(one, each) for one in known):
            known.append(each)
    alternatives = [Alternative(each.values, each.chi2 - first.chi2) for each in known[1:]]
    if first is not fit and model.simulator.has_budget:
        first = model.fit(first.values)  # with its own noise
    return first.spanning(alternatives)


def _is_apart(fit: Fit, other: Fit) -> bool:
    """Return whether a fit is another minimum, and not on the slope of the same one."""
    way = other.values - fit.values
    parabola = float(way @ np.linalg.lstsq(fit.covariance, way, rcond=1e-14)[0])
    return parabola > _APART + 2.0 * (other.chi2 - fit.chi2)


def _find_valleys(model: RigModel, fit: Fit) -> list[Floats]:
    """Find local minima of chi squared over the wave speed, with all other values adapted."""
    places = model.layout.indices_of('layer.wave_speed')
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
