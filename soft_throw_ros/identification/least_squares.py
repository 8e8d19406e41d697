# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
r"""
Least squares with a robust loss, by SciPy, with standard errors.

Notes
-----
Residuals are weighted by the noise of each track, which is estimated once from the track alone,
and by the errors of its times, which count where a body is fast.
Huber's loss is quadratic up to `_LIMIT` times the noise and linear beyond, so that outliers
hardly matter. If a model leaves more than noise, the limit grows with the median residual. The
covariance of the values is multiplied by chi squared per degree of freedom if that is above 1, or
by chi squared of the means of `_SLOW_WINDOW` residuals, in which a slow misfit shows that single
residuals hide. No sample contributes more than the square of the limit.

A prior is one more residual. Information adds up, :math:`C^{-1} = \sum_i F_i`, hence :math:`C =
\sum_i C F_i C`: each term is the contribution of one source, noise or prior, to a variance.

"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import combinations
import math
from typing import Any, NamedTuple

import numpy as np
from scipy import optimize, sparse
from soft_throw_ros.identification.tracks import Floats, Track

_LIMIT = 5.0  # residual of an outlier [noise]; by chance once in 2e6
_NORMAL = 1.4826  # standard deviation of normal numbers over their median deviation
_TOLERANCE = 1e-6  # relative tolerance of chi squared: 3e-2 of an error
_ROUGHLY = 1e-3  # the same before outliers are known
_MAX_DENSE_PARAMETERS = 40  # more ones are of many throws, and their Jacobian is sparse
_MISMATCH = 9.0  # excess of chi squared per degree, times the root of the degrees; by chance 1e-4
_SLOW_WINDOW = 25  # number of residuals in a mean that shows systematic errors
_INSEPARABLE = 0.99  # correlation from which on two parameters cannot be separated
_WELL_KNOWN = 0.05  # relative error up to which it does not matter that another value fits as well
_CONTRADICTION = 4.0  # deviation from a prior beyond which chance is unlikely [standard errors]


class FitError(ValueError):
    """The tracks do not determine the requested parameters; the message has the reason."""


class Estimate(NamedTuple):
    """A number and its standard error, of the same unit."""

    value: float
    error: float

    def __str__(self) -> str:
        if 0.0 < self.error < math.inf:
            digits = 1 - math.floor(math.log10(self.error))
            if -4 <= digits <= 9:
                digits = max(digits, 0)
                return f'{self.value:.{digits}f} +- {self.error:.{digits}f}'
        return f'{self.value:.6g} +- {self.error:.2g}'


class Outlier(NamedTuple):
    """A sample beyond the limit: its time [s], and how far above the model it is [m]."""

    time: float
    deviation: float


@dataclass(frozen=True, kw_only=True)
class TrackResidual:
    """The residual of a track after a fit."""

    name: str
    track: Track
    fitted: Floats  # heights of the model at the same times [m]
    limit: float  # residual of an outlier [standard deviations of the sample]

    @property
    def values(self) -> Floats:
        """Residuals, data less model [m]."""
        return self.track.position - self.fitted

    @property
    def outliers(self) -> list[Outlier]:
        """Samples beyond the limit."""
        is_far = np.abs(self.scaled) > self.limit
        pairs = np.stack([self.track.time, self.values], axis=1)[is_far].tolist()
        return [Outlier(*pair) for pair in pairs]

    @property
    def scaled(self) -> Floats:
        """Residuals over the standard deviations of the samples."""
        return self.values / self.track.deviations

    @property
    def rms(self) -> float:
        """Root of the mean square of the residuals within the limit [m]."""
        return float(np.sqrt(np.mean(self.values[np.abs(self.scaled) <= self.limit] ** 2)))

    @property
    def usual(self) -> Floats:
        """Scaled residuals within the limit."""
        return self.scaled[np.abs(self.scaled) <= self.limit]


class Alternative(NamedTuple):
    """Values at another minimum, and the increase of chi squared there."""

    values: Floats
    excess: float


@dataclass(frozen=True, kw_only=True)
class Fit:
    """Parameters that were fitted to tracks."""

    names: tuple[str, ...]
    values: Floats  # fitted values, shape (n,), in SI units
    covariance: Floats
    chi2: float  # sum of squared residuals and deviations from priors, over their errors
    dof: int  # degrees of freedom: samples, and parameters known with an error, less parameters
    residuals: tuple[TrackResidual, ...]
    known: Mapping[int, Estimate] = field(default_factory=dict)  # priors, by indices
    alternatives: tuple[Alternative, ...] = ()  # other minima, spanned by the covariance
    is_converged: bool = True  # whether the solver ended before its limit of evaluations

    def __getitem__(self, name: str) -> Estimate:
        index = self.names.index(name)
        return Estimate(float(self.values[index]), float(self.errors[index]))

    def __contains__(self, name: str) -> bool:
        return name in self.names

    @property
    def by_name(self) -> dict[str, float]:
        """Return the values by their names."""
        return dict(zip(self.names, self.values.tolist(), strict=True))

    @property
    def errors(self) -> Floats:
        """Return standard errors."""
        return np.sqrt(np.diag(self.covariance))

    @property
    def reduced_chi2(self) -> float:
        """Chi squared per degree of freedom: 1 if the model leaves nothing but noise."""
        return self.chi2 / self.dof

    @property
    def correlation(self) -> Floats:
        """Correlations of the errors, shape (n, n); 0 for parameters without an error."""
        scale = np.outer(self.errors, self.errors)
        zeros = np.zeros_like(scale)
        return np.asarray(np.divide(self.covariance, scale, out=zeros, where=scale > 0.0))

    @property
    def is_mismatch(self) -> bool:
        """Whether the residuals but outliers are larger than noise and its error explain."""
        usual = np.concatenate([residual.usual for residual in self.residuals])
        dof = max(1, usual.size - self.values.size)
        return float(usual @ usual) / dof > 1.0 + _MISMATCH / math.sqrt(dof)


def fit_tracks(
    predict: Callable[[Floats], Floats],
    start: Floats,
    tracks: Sequence[tuple[str, Track]],
    *,
    names: tuple[str, ...],
    bounds: tuple[Floats, Floats],
    jacobian: Callable[[Floats], Floats] | None = None,
    known: Mapping[int, Estimate] | None = None,
    max_evaluations: int = 200,
) -> Fit:
    """
    Fit a model to tracks with names, from a sufficiently close start.

    `predict` returns the heights of all tracks in their order [m], `jacobian` the derivatives, by
    default differences of values near 1. `known` has the priors by indices of the values. Raise
    FitError if there are not more samples than parameters.
    """
    known = known or {}
    sizes = [track.time.size for _, track in tracks]
    samples = sum(sizes)
    if samples + len(known) <= start.size:
        raise FitError(
            f'{samples} samples are too few for {start.size} parameters: {", ".join(names)}'
        )
    position = np.concatenate([track.position for _, track in tracks])
    noise = np.concatenate([track.deviations for _, track in tracks])
    indices = np.array(list(known), dtype=np.intp)
    means, errors = np.array(list(known.values()), dtype=np.float64).reshape(-1, 2).T

    def residuals(values: Floats) -> Floats:
        return np.concatenate([
            (predict(values) - position) / noise, (values[indices] - means) / errors
        ])

    def slopes_of(values: Floats) -> Any:
        assert jacobian is not None
        priors = np.eye(values.size)[indices] / errors[:, None]
        slopes = np.concatenate([jacobian(values) / noise[:, None], priors])
        return sparse.csr_matrix(slopes) if values.size > _MAX_DENSE_PARAMETERS else slopes

    def solve(begin: Floats, tolerance: float, **loss: Any) -> Any:
        try:
            with np.errstate(divide='raise', over='raise', invalid='raise'):
                return optimize.least_squares(
                    residuals, begin, jac=slopes_of if jacobian else '3-point', bounds=bounds,
                    x_scale='jac', xtol=tolerance, ftol=tolerance, gtol=tolerance,
                    max_nfev=max_evaluations, **loss,
                )
        except FloatingPointError:
            raise FitError('the heights of the tracks are too large for a fit') from None

    solution = solve(np.clip(start, *bounds), _ROUGHLY)
    limit = _LIMIT * max(1.0, _NORMAL * float(np.median(np.abs(solution.fun))))
    is_far = (np.abs(solution.fun[:samples]) > limit).any()
    loss = {'loss': 'huber', 'f_scale': limit} if is_far else {}
    solution = solve(solution.x, _TOLERANCE, **loss)
    squares = solution.fun**2
    squares[:samples] = np.minimum(squares[:samples], limit**2)
    chi2 = float(squares.sum())
    dof = solution.fun.size - start.size
    # An outlier has no weight in the Jacobian of Huber's loss
    slopes = solution.jac.toarray() if sparse.issparse(solution.jac) else solution.jac
    parts = np.split(np.clip(solution.fun[:samples], -limit, limit), np.cumsum(sizes)[:-1])
    slopes[:samples] /= math.sqrt(max(chi2 / dof, _slow_chi2(parts), 1.0))
    heights = np.split(position + noise * solution.fun[:samples], np.cumsum(sizes)[:-1])
    return Fit(
        names=names,
        values=np.asarray(solution.x),
        covariance=_covariance(slopes),
        chi2=chi2,
        dof=dof,
        residuals=tuple(
            TrackResidual(name=name, track=track, fitted=fitted, limit=limit)
            for (name, track), fitted in zip(tracks, heights, strict=True)
        ),
        known=known,
        is_converged=solution.status > 0,  # 0 is the limit of evaluations
    )


def _slow_chi2(parts: Sequence[Floats]) -> float:
    """Return chi squared per mean of `_SLOW_WINDOW` residuals, which is 1 for white noise."""
    width = _SLOW_WINDOW
    means = [part[:part.size // width * width].reshape(-1, width).mean(axis=1) for part in parts]
    return width * float(np.mean(np.square(np.concatenate([*means, [width**-0.5]]))))


def _covariance(jacobian: Floats) -> Floats:
    """Compute the covariance of the values."""
    sizes = np.maximum(np.linalg.norm(jacobian, axis=0), 1e-60)
    triangle = np.linalg.qr(jacobian / sizes, mode='r')
    _, strengths, directions = np.linalg.svd(triangle)
    strengths = np.maximum(strengths, 1e-12 * strengths[0])  # limits the errors
    spread = directions.T / strengths
    return np.asarray((spread @ spread.T) / np.outer(sizes, sizes))


def fit_warnings(fit: Fit) -> list[str]:
    """Return all reasons to doubt a fit: each enlarges an error, or a value may be wrong."""
    warnings = []
    is_vague = fit.errors > _WELL_KNOWN * np.abs(fit.values)
    speeds = [index for index, name in enumerate(fit.names) if 'wave_speed' in name]
    for values, excess in fit.alternatives:
        change = np.abs(values - fit.values) / np.maximum(np.abs(fit.values), 1e-300)
        index = speeds[0] if speeds else int(change.argmax())
        if is_vague[index]:
            warnings.append(
                f'{fit.names[index]} may as well be {values[index]:.5g} (chi squared is larger by '
                f'{excess:.1f} there); the errors span both'
            )
    # Parameters of a single one of several throws have its number in brackets
    free = [i for i, name in enumerate(fit.names) if name[-1] != ']' and i not in fit.known]
    warnings += [
        f'{fit.names[i]} and {fit.names[j]} are hardly separated by these tracks (correlation '
        f'{fit.correlation[i, j]:.4f}): hold one'
        for i, j in combinations(free, 2)
        if abs(fit.correlation[i, j]) > _INSEPARABLE and (is_vague[i] or is_vague[j])
    ]
    for index, prior in fit.known.items():
        deviation = float(abs(fit.values[index] - prior.value)) / prior.error
        if deviation > _CONTRADICTION:
            warnings.append(
                f'{fit.names[index]} is found {deviation:.1f} errors from the expected {prior}: a '
                'given value may be wrong'
            )
    if fit.is_mismatch:
        ratios = [float(np.sqrt(np.mean(residual.usual**2))) for residual in fit.residuals]
        worst = fit.residuals[int(np.argmax(ratios))]
        warnings.append(
            f'the residuals of {worst.name} are {max(ratios):.2g} times the noise: the model '
            'leaves out something (see --figure); the errors of all results include it'
        )
    if not fit.is_converged:
        warnings.append(
            'the solver stopped at its limit before it converged: the values may be wrong'
        )
    return warnings
