# SPDX-License-Identifier: Apache-2.0
r"""
Least squares with outliers left out: what comes out of a fit, and how far to trust it.

Notes
-----
Weights are one over the noise of each track. If somebody knows the noise it is taken as it is,
and so are the standard errors; if it was estimated, they are multiplied by the square root of
chi squared per degree of freedom, so that only the ratios of noises matter to them.

A sample is an outlier if its residual is away from those around it by more than `OUTLIER_LIMIT`
times the noise; what a model that does not fit leaves changes slowly, and makes none. If there
are any, the fit is repeated with a robust loss; then they are left out, and the rest is fitted by
plain least squares.

"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import combinations
import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import optimize, sparse, stats
from scipy.ndimage import rank_filter
from soft_throw_ros.identification.tracks import Track

Floats = NDArray[np.float64]
Flags = NDArray[np.bool_]

INSEPARABLE = 0.99
"""Correlation from which on two parameters are not told apart."""

OUTLIER_LIMIT = 6.0
"""How many times the noise a sample must be off to be left out; noise alone is not in 1e8."""

_NEIGHBOURHOOD = 7  # samples, of which two may be outliers: one is away from all ...
_RANKS = (2, 4)  # from the third to the fifth of them in size
_MAX_OUTLIER_SHARE = 0.1  # of a track; if there are more, it is the model that does not fit
_OUTLIER_ROUNDS = 6  # of leaving them out and fitting again
_AUTOCORRELATION_LAGS = 10
_SPARSE_ABOVE = 40  # parameters: of many throws each has its own, which no other depends on
_SIGNIFICANCE = 1e-4  # probability below which chance is no explanation
_NEGLIGIBLE_RMS = 0.5  # of the noise, below which the colour of residuals does not matter
_ESTIMATED_NOISE_FACTOR = 3.0  # variance of chi squared if noise was estimated, over if known


class FitError(ValueError):
    """The tracks do not give what was asked for; the message says why."""


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
    """A sample that was left out: its time [s], and how far above the model it is [m]."""

    time: float
    deviation: float


@dataclass(frozen=True, kw_only=True)
class TrackResidual:
    """
    What a fit leaves of a track.

    Parameters
    ----------
    name : str
    track : Track
        The data that were fitted, without outliers.
    fitted : ndarray, shape (n,)
        What the model says at the same times. [m]
    outliers : tuple of Outlier

    """

    name: str
    track: Track
    fitted: Floats
    outliers: tuple[Outlier, ...] = ()

    @property
    def values(self) -> Floats:
        """Data less model. [m]"""
        return self.track.position - self.fitted

    @property
    def rms(self) -> float:
        """Root of their mean square. [m]"""
        return float(np.sqrt(np.mean(self.values**2)))

    @property
    def reduced_chi2(self) -> float:
        """Mean of their squares over that of the noise. [-]"""
        return (self.rms / self.track.noise) ** 2

    @property
    def autocorrelation(self) -> float:
        """Correlation of neighbouring residuals: 0 if what is left is white noise. [-]"""
        return float(self._autocorrelations(1)[0])

    @property
    def whiteness(self) -> float:
        """Probability that white noise is as correlated as this (Ljung and Box). [-]"""
        size = self.track.time.size
        lags = np.arange(1, min(_AUTOCORRELATION_LAGS, size // 4) + 1)
        squares = self._autocorrelations(lags.size) ** 2
        statistic = size * (size + 2) * float(np.sum(squares / (size - lags)))
        return float(stats.chi2.sf(statistic, lags.size))

    def _autocorrelations(self, lags: int) -> Floats:
        """Correlate the residuals with themselves, 1 to `lags` samples later."""
        left = self.values - np.mean(self.values)
        power = max(float(left @ left), 1e-300)
        return np.array([left[lag:] @ left[:-lag] for lag in range(1, lags + 1)]) / power


@dataclass(frozen=True, kw_only=True)
class Fit:
    """
    Parameters that were fitted to tracks.

    Parameters
    ----------
    names : tuple of str
    values : ndarray, shape (n,)
        In SI units.
    covariance : ndarray, shape (n, n)
    chi2 : float
        Sum of the squared residuals, each over its noise, and of what is known over its error.
    dof : int
        Degrees of freedom: samples, and parameters known with an error, less parameters.
    residuals : tuple of TrackResidual

    """

    names: tuple[str, ...]
    values: Floats
    covariance: Floats
    chi2: float
    dof: int
    residuals: tuple[TrackResidual, ...]

    def __getitem__(self, name: str) -> Estimate:
        place = self.names.index(name)
        return Estimate(float(self.values[place]), float(self.errors[place]))

    def __contains__(self, name: str) -> bool:
        return name in self.names

    @property
    def errors(self) -> Floats:
        """Standard errors."""
        return np.sqrt(np.diag(self.covariance))

    @property
    def reduced_chi2(self) -> float:
        """Chi squared per degree of freedom: 1 if the model leaves nothing but noise."""
        return self.chi2 / self.dof

    @property
    def correlation(self) -> Floats:
        """Correlations of the errors, shape (n, n)."""
        errors = self.errors
        return self.covariance / np.outer(errors, errors)

    def warnings(self) -> list[str]:
        """Say what there is to doubt, each in a sentence."""
        found = []
        correlation = self.correlation
        # Parameters of a single one of several throws have its number in brackets
        shared = [place for place, name in enumerate(self.names) if not name.endswith(']')]
        for i, j in combinations(shared, 2):
            if abs(correlation[i, j]) > INSEPARABLE:
                factor = 1.0 / math.sqrt(max(1.0 - correlation[i, j] ** 2, 1e-12))
                found.append(
                    f'{self.names[i]} and {self.names[j]} can hardly be told apart by these '
                    f'tracks (correlation {correlation[i, j]:.4f}): the error of each is '
                    f'{factor:.0f} times what it would be if the other were known; hold one'
                )
        if self.is_mismatch:
            found.append(
                f'the residuals are {math.sqrt(self.reduced_chi2):.2g} times the noise: the model '
                'leaves out something that these tracks show, and the errors do not tell how much'
            )
        coloured = [
            residual
            for residual in self.residuals
            if residual.whiteness < _SIGNIFICANCE / len(self.residuals)
            and residual.rms > _NEGLIGIBLE_RMS * residual.track.noise
        ]
        if coloured:
            worst = max(coloured, key=lambda residual: residual.autocorrelation)
            more = f' and {len(coloured) - 1} more' if len(coloured) > 1 else ''
            found.append(
                f'the residuals of {worst.name}{more} are no white noise (correlation of '
                f'neighbours {worst.autocorrelation:.2f}): the errors are too small'
            )
        return found

    @property
    def is_mismatch(self) -> bool:
        """Whether the residuals are larger than noise explains; estimated noise has errors too."""
        if all(residual.track.known_noise for residual in self.residuals):
            return bool(stats.chi2.sf(self.chi2, self.dof) < _SIGNIFICANCE)
        spread = math.sqrt(_ESTIMATED_NOISE_FACTOR * 2.0 / self.dof)
        return bool(stats.norm.sf((self.reduced_chi2 - 1.0) / spread) < _SIGNIFICANCE)


@dataclass(frozen=True, kw_only=True)
class FitModel:
    """What is fitted: heights of all tracks in one series [m], and their derivatives."""

    names: tuple[str, ...]
    predict: Callable[[Floats], Floats]
    jacobian: Callable[[Floats], Floats]
    low: Floats
    high: Floats
    known: Mapping[int, Estimate] = field(default_factory=dict)
    """What is known of some parameters, by their places."""

    @classmethod
    def with_steps(
        cls,
        names: Sequence[str],
        predict: Callable[[Floats], Floats],
        low: Floats,
        high: Floats,
        steps: Floats,
    ) -> FitModel:
        """Make a model whose derivatives are central differences with such steps."""

        def jacobian(values: Floats) -> Floats:
            columns = []
            for place, step in enumerate(steps):
                change, (width,) = central_difference(
                    predict, values, [place], step=step, low=low[place], high=high[place]
                )
                columns.append(change / width)
            return np.stack(columns, axis=1)

        return cls(names=tuple(names), predict=predict, jacobian=jacobian, low=low, high=high)


def fit_best(
    model: FitModel, starts: Iterable[Floats], track: tuple[str, Track], *, max_evaluations: int
) -> Fit:
    """Fit a model to a track from several starts, and return the fit of least chi squared."""
    tried = [fit_tracks(model, each, [track], max_evaluations=max_evaluations) for each in starts]
    return min(tried, key=lambda found: found.chi2)


def fit_tracks(
    model: FitModel,
    start: Floats,
    tracks: Sequence[tuple[str, Track]],
    *,
    max_evaluations: int = 100,
) -> Fit:
    """
    Fit a model to tracks, from a start that is near enough, without their outliers.

    Parameters
    ----------
    model : FitModel
    start : ndarray, shape (n,)
    tracks : sequence of (str, Track)
        With their names, in the order of what the model predicts.
    max_evaluations : int
        Of the model, in one run of the solver.

    Raises
    ------
    FitError
        If there are not more samples than parameters.

    """
    samples = sum(track.time.size for _, track in tracks)
    if samples + len(model.known) <= start.size:
        raise FitError(
            f'{samples} samples are too few for {start.size} parameters: {", ".join(model.names)}'
        )
    problem = _LeastSquares(model, tracks, max_evaluations)
    values = problem.solve(start)
    outliers = problem.find_outliers(values)
    if outliers.any():
        values = problem.solve(values, loss='soft_l1')
        for _ in range(_OUTLIER_ROUNDS):
            outliers = problem.find_outliers(values)
            if (outliers == ~problem.kept).all():
                break
            problem.kept = ~outliers
            values = problem.solve(values)
    return problem.conclude(values)


class _LeastSquares:
    """Tracks and a model as SciPy's solver takes them."""

    def __init__(
        self, model: FitModel, tracks: Sequence[tuple[str, Track]], max_evaluations: int
    ) -> None:
        self._model = model
        self._tracks = tracks
        self._max_evaluations = max_evaluations
        sizes = [track.time.size for _, track in tracks]
        self._position = np.concatenate([track.position for _, track in tracks])
        self._noise = np.repeat([track.noise for _, track in tracks], sizes)
        self._ends = np.cumsum(sizes)[:-1]
        self._known = np.array(list(model.known), dtype=np.intp)
        self._known_values, self._known_errors = (
            np.array(list(model.known.values()), dtype=np.float64).reshape(-1, 2).T
        )
        self.kept: Flags = np.ones(self._position.size, bool)

    def solve(self, start: Floats, *, loss: str = 'linear') -> Floats:
        """Return the best values."""
        model = self._model
        is_sparse = start.size > _SPARSE_ABOVE

        def jacobian(values: Floats) -> Any:  # an array, or a sparse one
            slopes = self._jacobian(values)
            return sparse.csr_matrix(slopes) if is_sparse else slopes

        solution = optimize.least_squares(
            self._residuals,
            np.clip(start, model.low, model.high),
            jac=jacobian,
            tr_solver='lsmr' if is_sparse else 'exact',
            tr_options={'atol': 1e-12, 'btol': 1e-12, 'regularize': False} if is_sparse else {},
            bounds=(model.low, model.high),
            x_scale='jac',
            xtol=1e-10,
            ftol=1e-10,
            gtol=1e-10,
            loss=loss,
            max_nfev=self._max_evaluations,
        )
        return np.asarray(solution.x)

    def find_outliers(self, values: Floats) -> Flags:
        """Tell which samples are outliers beside a model with such values."""
        residuals = (self._model.predict(values) - self._position) / self._noise
        flags = []
        for left in np.split(residuals, self._ends):
            low, high = (rank_filter(left, rank, _NEIGHBOURHOOD, mode='mirror') for rank in _RANKS)
            apart = np.maximum(left - high, low - left).clip(0.0)
            scale = max(1.0, 1.4826 * float(np.median(np.abs(left - 0.5 * (low + high)))))
            flagged = apart > OUTLIER_LIMIT * scale
            flags.append(flagged & (flagged.mean() < _MAX_OUTLIER_SHARE))
        return np.concatenate(flags)

    def conclude(self, values: Floats) -> Fit:
        """Say how good a fit is."""
        squares = self._residuals(values) ** 2
        dof = squares.size - values.size
        chi2 = float(squares.sum())
        scale = 1.0
        if not all(track.known_noise for _, track in self._tracks):
            scale = math.sqrt(chi2 / dof)
        jacobian = self._jacobian(values)
        jacobian[: jacobian.shape[0] - self._known.size] /= max(scale, 1e-150)
        residuals = []
        fitted = np.split(self._model.predict(values), self._ends)
        kept = np.split(self.kept, self._ends)
        for (name, track), heights, is_kept in zip(self._tracks, fitted, kept, strict=True):
            left_out = zip(track.time[~is_kept], (track.position - heights)[~is_kept], strict=True)
            residuals.append(
                TrackResidual(
                    name=name,
                    track=track if is_kept.all() else track.where(is_kept),
                    fitted=heights[is_kept],
                    outliers=tuple(Outlier(float(at), float(apart)) for at, apart in left_out),
                )
            )
        return Fit(
            names=self._model.names,
            values=values,
            covariance=_covariance(jacobian),
            chi2=chi2,
            dof=dof,
            residuals=tuple(residuals),
        )

    def _residuals(self, values: Floats) -> Floats:
        """Weigh model less data, and values less what is known of them."""
        left = (self._model.predict(values) - self._position) / self._noise
        known = (values[self._known] - self._known_values) / self._known_errors
        return np.concatenate([left[self.kept], known])

    def _jacobian(self, values: Floats) -> Floats:
        """Differentiate the residuals."""
        slopes = self._model.jacobian(values) / self._noise[:, None]
        known = np.zeros((self._known.size, values.size))
        known[np.arange(self._known.size), self._known] = 1.0 / self._known_errors
        return np.concatenate([slopes[self.kept], known])


def central_difference(
    function: Callable[[Floats], Floats],
    values: Floats,
    places: Sequence[int],
    *,
    step: float,
    low: float,
    high: float,
) -> tuple[Floats, Floats]:
    """
    Change values at `places` by a step up and down, within bounds.

    Returns the change of the function, and for each place that of its value. Their quotient is
    the derivative, of second order in the step, where no other of the values matters.
    """
    above, below = values.copy(), values.copy()
    above[places] = np.minimum(values[places] + step, high)
    below[places] = np.maximum(values[places] - step, low)
    return function(above) - function(below), (above - below)[places]


def _covariance(jacobian: Floats) -> Floats:
    """Compute the covariance of the values."""
    sizes = np.maximum(np.linalg.norm(jacobian, axis=0), 1e-60)
    triangle = np.linalg.qr(jacobian / sizes, mode='r')
    _, strengths, directions = np.linalg.svd(triangle)
    strengths = np.maximum(strengths, 1e-12 * strengths[0])  # what is not seen at all is very wide
    spread = directions.T / strengths
    return np.asarray((spread @ spread.T) / np.outer(sizes, sizes))
