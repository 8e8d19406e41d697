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
r"""
A layer that sticks for a time s when the projectile would leave it.

Notes
-----
It shifts the projectile by about :math:`s^2`, so that near 0 nothing is seen of s, and it is in no
sense normally distributed. So all is fitted first without it. Its distribution is computed along
its axis, all else being adapted to first order (a profile), and its second moments about the fit
take the place of the covariance. Only where the profile is lower than without it is all fitted
again from there, and kept if that is better.

"""

from __future__ import annotations

from collections.abc import Sequence
import contextlib
from dataclasses import replace
import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from soft_throw_ros.identification.least_squares import Fit, FitError
from soft_throw_ros.identification.linear_fit import LinearFit
from soft_throw_ros.identification.plate_fit import PlateFit
from soft_throw_ros.identification.rig_model import RigModel, START_OF_STICKING, STICKING

Floats = NDArray[np.float64]

_NOTICED = 1.0  # by how much chi squared must be lower for a layer to be said to stick
_EVALUATIONS = 20  # of the model
_PROFILE = np.linspace(-5.0, 5.0, 31)  # errors of sticking at which its profile is computed, ...
_ROUNDS = 12  # each with the errors of the one before, until they are ...
_SAME = 0.8  # of those at least, and at most over that
_NARROWER = 0.1  # of them at least: between two of the times that were tried it is blind


class _Profile(NamedTuple):
    """How a fit changes with the time that a layer sticks, all else being adapted."""

    changes: Floats
    """Of all values, from those of the fit, shape (k, n)."""
    weights: Floats
    """Of these, shape (k,), whose sum is 1."""
    gain: float
    """By how much chi squared is lower than that of the fit, at its lowest, ..."""
    best: Floats
    """... and the values there."""


def let_stick(model: RigModel, plates: Sequence[PlateFit], fit: Fit) -> tuple[RigModel, Fit]:
    """
    Let the layer stick, too, as far as the tracks allow.

    It sticks for no time unless that lowers chi squared by more than chance does; then all is
    fitted again from where its profile is lowest, and taken if it is better in truth.
    """
    if STICKING not in model.places:
        narrower, model = model, replace(model, description=model.description.see(STICKING))
        fit = _widen(narrower, fit, model, plates)
    profile = _profile(model, fit)
    if profile is not None and profile.gain > _NOTICED:
        with contextlib.suppress(FitError):
            found = model.fit(profile.best, noise=fit.noise, max_evaluations=_EVALUATIONS)
            if found.dof >= fit.dof and fit.chi2 - found.chi2 > _NOTICED:
                fit = model.fit(found.values).spanning(fit.alternatives)
                profile = _profile(model, fit)
    return model, _spread(model, fit, profile)


def _widen(model: RigModel, fit: Fit, wider: RigModel, plates: Sequence[PlateFit]) -> Fit:
    """Take a fit for one of a wider model, in which the layer might stick, but does not."""

    def widened(values: Floats) -> Floats:
        found = wider.start_from(replace(fit, values=values), plates)
        found[wider.places_of(STICKING)] = 0.0
        return found

    places = [wider.names.index(name) for name in model.names]
    covariance = np.zeros(2 * (len(wider.names),))
    covariance[np.ix_(places, places)] = fit.covariance
    return replace(
        fit,
        names=wider.names,
        values=widened(fit.values),
        covariance=covariance,
        known=wider.known,
        alternatives=tuple(e._replace(values=widened(e.values)) for e in fit.alternatives),
    )


def _profile(model: RigModel, fit: Fit) -> _Profile | None:
    """Follow chi squared along the time that the layer sticks; None if that cannot be done."""
    places = model.places_of(STICKING)
    known = model.known.get(places[0])
    best, width = float(fit.values[places[0]]), known.error if known else START_OF_STICKING
    try:
        system = LinearFit(model, fit, places)
        for _ in range(_ROUNDS):
            times = np.unique(np.maximum(np.append(best + width * _PROFILE, 0.0), 0.0))
            values, chi2 = np.empty((times.size, fit.values.size)), np.empty(times.size)
            for row, time in enumerate(times.tolist()):
                moved = fit.values.copy()
                moved[places] = time
                values[row], chi2[row] = system.adapt(moved)
            if known:
                chi2 += ((times - known.value) / known.error) ** 2
            excess = (chi2 - chi2.min()) / max(fit.variance_scale, 1e-300)
            weights = np.exp(-0.5 * excess) * np.gradient(times)
            weights /= weights.sum()
            spread = math.sqrt(float(weights @ (times - best) ** 2))
            if _SAME < spread / width < 1.0 / _SAME:
                break
            width = max(spread, _NARROWER * width)
    except FitError:
        return None
    if spread == 0.0:
        return None  # next to the fit, however close, chi squared jumps
    here, lowest = int(np.argmin(np.abs(times - best))), int(np.argmin(chi2))
    gain = float(chi2[here] - chi2[lowest]) / max(1.0, fit.reduced_chi2)
    return _Profile(values - fit.values, weights, gain, values[lowest])


def _spread(model: RigModel, fit: Fit, profile: _Profile | None) -> Fit:
    """Let the covariance span how long the layer may stick: as its profile tells, or the prior."""
    places = model.places_of(STICKING)
    covariance = fit.covariance.copy()
    own = covariance[np.ix_(places, places)] + 1e-300 * np.eye(len(places))
    covariance -= covariance[:, places] @ np.linalg.solve(own, covariance[places])
    if profile is not None:
        changes = profile.changes
        covariance += np.einsum('k,ki,kj->ij', profile.weights, changes, changes)
    else:
        for place in places:
            covariance[place, place] += model.known[place].error ** 2 if model.known else 0.0
    return replace(fit, covariance=covariance)
