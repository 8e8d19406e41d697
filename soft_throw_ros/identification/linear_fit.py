# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
r"""
A fit as a linear problem: residuals after a change of some parameters, all others adapted.

Notes
-----
The residuals of other values are projected off the columns of the derivatives :math:`J` at the
fitted values. The result is chi squared after a Gauss-Newton step. So profiles, and gains by
further parameters (a score test), need no new fit.

"""

from __future__ import annotations

from collections.abc import Sequence
import contextlib

import numpy as np
from numpy.typing import NDArray
from soft_throw_ros.identification.fit_description import LAYER
from soft_throw_ros.identification.fit_warnings import INSEPARABLE
from soft_throw_ros.identification.least_squares import Fit, FitError
from soft_throw_ros.identification.rig_model import RigModel

Floats = NDArray[np.float64]

_NEWTON_STEPS = 3  # Gauss-Newton steps per point of a profile
_CHI2_95 = 3.84  # 95 % quantile of chi squared with one degree of freedom
_MAX_HALF_WIDTH = 6.0  # largest half-width of an interval [standard errors]
_BISECTIONS = 8  # number of bisections of the end of an interval


class LinearFit:
    """
    Weighted samples and priors as linear functions of the parameters.

    The values with the indices `fixed` are not adapted to the others.
    """

    def __init__(self, model: RigModel, fit: Fit, fixed: Sequence[int] = ()) -> None:
        self.model, self.fit = model, fit
        self._position = np.concatenate([track.position for _, track in model.tracks()])
        self._others = np.delete(np.arange(fit.values.size), fixed)
        self._known = [index for index in self._others.tolist() if index in model.known]
        rows = np.zeros((len(self._known), fit.values.size))
        for row, index in zip(rows, self._known, strict=True):
            row[index] = 1.0 / model.known[index].error
        slopes = self._weigh(model.jacobian(fit.values).T).T
        self._slopes = slopes
        design = np.concatenate([slopes, rows])[:, self._others]
        self._sizes = np.maximum(np.linalg.norm(design, axis=0), 1e-300)
        self._basis, self._triangle = np.linalg.qr(design / self._sizes)

    def adapt(self, values: Floats) -> tuple[Floats, float]:
        """Adapt the others to such values; return all, and chi squared to first order."""
        residuals = self._weighted_residuals(values)
        change, *_ = np.linalg.lstsq(self._triangle, self._basis.T @ residuals, rcond=1e-12)
        adapted: Floats = values.copy()
        adapted[self._others] += change / self._sizes
        return adapted, float(np.sum(self._project(residuals) ** 2))

    def gain(self, columns: Floats) -> tuple[float, Floats]:
        """Return the fall of chi squared by further parameters, and their values, in any units."""
        extra = self._weigh(columns.T).T
        unseen = np.zeros((len(self._known), extra.shape[1]))
        extra = self._project(np.concatenate([extra, unseen]))
        extra /= np.maximum(np.linalg.norm(extra, axis=0), 1e-300)
        residuals = self._project(self._weighted_residuals(self.fit.values))
        result, *_ = np.linalg.lstsq(extra, residuals, rcond=1e-6)
        remainder = residuals - extra @ result
        return float(residuals @ residuals - np.sum(remainder**2)), np.asarray(result)

    def _weigh(self, heights: Floats) -> Floats:
        """Divide heights of all samples by their noise, and leave out outliers."""
        return np.asarray((heights / self.fit.noise)[..., self.fit.kept])

    def _weighted_residuals(self, values: Floats) -> Floats:
        """Return the weighted residuals of the model with these values."""
        known = self.model.known
        residuals = self._weigh(self._position - self.model.predict(values))
        priors = [(known[p].value - values[p]) / known[p].error for p in self._known]
        return np.append(residuals, priors)

    def _project(self, residuals: Floats) -> Floats:
        """Subtract the part that the parameters can explain."""
        return np.asarray(residuals - self._basis @ (self._basis.T @ residuals))


def profile_intervals(model: RigModel, fit: Fit) -> dict[str, tuple[float, float]]:
    """
    Compute profile intervals of 95 % for parameters that the tracks hardly separate.

    The covariance is inaccurate for such parameters. An interval ends where chi squared has grown
    by 3.84, while Gauss-Newton steps with the derivatives of the fit adapt all other parameters.
    """
    correlation = np.abs(fit.correlation)
    indices = {name: fit.names.index(name) for name in LAYER if name in fit.names}
    result = {}
    for name, index in indices.items():
        others = [item for item in indices.values() if item != index]
        if correlation[index, others].max(initial=0.0) > INSEPARABLE:
            with contextlib.suppress(FitError):
                system = LinearFit(model, fit, [index])
                low, high = (_end_of_interval(system, fit, index, sign) for sign in (-1.0, 1.0))
                result[name] = (low, high)
    return result


def _end_of_interval(system: LinearFit, fit: Fit, index: int, sign: float) -> float:
    """Find an end of the interval of 95 % of a parameter by bisection of its profile."""
    limit = system.adapt(fit.values)[1] + _CHI2_95 * max(1.0, fit.reduced_chi2)
    direction = fit.covariance[index] / fit.covariance[index, index]

    def is_inside(distance: float) -> bool:
        moved = fit.values + sign * distance * direction
        try:
            for _ in range(_NEWTON_STEPS):
                moved, _chi2 = system.adapt(moved)
            return system.adapt(moved)[1] < limit
        except (FitError, ValueError):
            return False  # such a rig is impossible

    inside, outside = 0.0, _MAX_HALF_WIDTH * fit.errors[index]
    for _ in range(_BISECTIONS):
        middle = 0.5 * (inside + outside)
        inside, outside = (middle, outside) if is_inside(middle) else (inside, middle)
    return float(fit.values[index] + sign * inside)
