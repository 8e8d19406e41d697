# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
r"""
Least squares without outliers, with standard errors.

Notes
-----
Weights are one over the noise of each track. By default, `_estimate_noise` estimates the noise
from the second differences of the residuals. Errors of a model change slowly, so they increase
chi squared and not the noise. Standard errors are multiplied by the square root of chi squared per
degree of freedom if this ratio is above 1 or the noise was estimated. They are also multiplied by
the effect of correlated residuals on the variance of a mean (`TrackResidual.inflation`).

A sample is an outlier if its residual deviates from its neighbours by more than `_OUTLIER_LIMIT`
times the noise; errors of a model change slowly, and make no outliers. So outliers are removed
before the first fit. If a fit shows more outliers, it is repeated with a robust loss; then these
outliers are removed, too, and the other samples are fitted by plain least squares.

A prior is one more residual. Information adds up, :math:`C^{-1} = \sum_i F_i`, hence :math:`C =
\sum_i C F_i C`: each term is the contribution of one source, noise or prior, to a variance
(`Fit.budget`).

"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import optimize, sparse, stats
from scipy.ndimage import rank_filter, uniform_filter1d
from soft_throw_ros.identification.tracks import Track

Floats = NDArray[np.float64]
Flags = NDArray[np.bool_]

_OUTLIER_LIMIT = 6.0  # deviation of an outlier from its neighbours [noise]; by chance once in 1e8
_NEIGHBOURHOOD = 7  # number of neighbouring samples, of which two may be outliers
_RANKS = (2, 4)  # ranks of the neighbours, by size, that bound the usual residuals
_MAX_OUTLIER_SHARE = 0.1  # share of outliers of a track above which the model is wrong
_MAX_OUTLIER_ROUNDS = 6  # largest number of repeated fits without outliers
_AUTOCORRELATION_LAGS = 10
_TOLERANCE = 1e-8  # relative tolerance of chi squared: 1e-2 of an error, as exact as steppers
_MAX_DENSE_PARAMETERS = 40  # more ones are of many throws, and their Jacobian is sparse
_SIGNIFICANCE = 1e-4  # probability below which chance is no explanation
_NEGLIGIBLE_RMS = 0.5  # residual over noise below which correlations do not matter (rms)
_ESTIMATED_NOISE_FACTOR = 3.0  # variance of chi squared if noise was estimated, over if known
_MAX_NOISE_ROUNDS = 2  # largest number of fits with a new estimate of the noise
_NOISE_TOLERANCE = 0.1  # relative change of the noise below which no further fit is needed
_NOISE_SIGMAS = 5.0  # standard deviations beyond which a difference is excluded from the noise
_SLOW_WINDOW = 25  # number of residuals in a mean that shows systematic errors
_CURVATURE = np.array([1.0, -2.0, 1.0]) / math.sqrt(6.0)  # preserves the size of white noise


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
    """A sample that was left out: its time [s], and how far above the model it is [m]."""

    time: float
    deviation: float


@dataclass(frozen=True, kw_only=True)
class TrackResidual:
    """The residual of a track after a fit."""

    name: str
    track: Track
    """The data that were fitted, without outliers."""
    fitted: Floats
    """Heights of the model at the same times [m]."""
    noise: Floats
    """Standard deviation of each sample [m]."""
    outliers: tuple[Outlier, ...] = ()

    @property
    def values(self) -> Floats:
        """Residuals, data less model [m]."""
        return self.track.position - self.fitted

    @property
    def rms(self) -> float:
        """Root of the mean square of the residuals [m]."""
        return float(np.sqrt(np.mean(self.values**2)))

    @property
    def rms_noise(self) -> float:
        """Root of the mean square of the noise [m]."""
        return float(np.sqrt(np.mean(self.noise**2)))

    @property
    def reduced_chi2(self) -> float:
        """Mean of the squares of residual over noise [-]."""
        return float(np.mean((self.values / self.noise) ** 2))

    @property
    def autocorrelation(self) -> float:
        """Correlation of neighbouring residuals, 0 for white noise [-]."""
        return float(self._autocorrelations(1)[0])

    @property
    def whiteness(self) -> float:
        """Probability that white noise is as correlated as this (Ljung and Box) [-]."""
        size = self.track.time.size
        lags = np.arange(1, min(_AUTOCORRELATION_LAGS, size // 4) + 1)
        squares = self._autocorrelations(lags.size) ** 2
        statistic = size * (size + 2) * float(np.sum(squares / (size - lags)))
        return float(stats.chi2.sf(statistic, lags.size))

    @property
    def is_white(self) -> bool:
        """Whether the residuals may be white noise, or are negligible beside the noise."""
        is_negligible = self.rms <= _NEGLIGIBLE_RMS * self.rms_noise
        return is_negligible or self.whiteness > _SIGNIFICANCE

    @property
    def inflation(self) -> float:
        r"""Variance of a mean over that of white noise, :math:`1 + 2 \sum_k \rho_k` [-]."""
        if self.is_white:
            return 1.0
        result = self._autocorrelations(self.track.time.size // 4)
        # Sum up to the first correlation that is not significant
        last = int(np.argmax(np.append(result, -1.0) < 2.0 / math.sqrt(self.track.time.size)))
        return 1.0 + 2.0 * float(result[:last].sum())

    @property
    def worst_part(self) -> tuple[float, float]:
        """Begin and end of the section with the largest mean residual over noise [s]."""
        width = min(_SLOW_WINDOW, self.track.time.size)
        slow = np.abs(uniform_filter1d(self.values / self.noise, width, mode='constant'))
        times = self.track.time[max(0, int(np.argmax(slow)) - width // 2):][:width]
        return float(times[0]), float(times[-1])

    def _autocorrelations(self, lags: int) -> Floats:
        """Correlate the residuals with themselves, 1 to `lags` samples later."""
        residuals = self.values / self.noise
        residuals = residuals - np.mean(residuals)
        power = max(float(residuals @ residuals), 1e-300)
        return np.array([residuals[lag:] @ residuals[:-lag] for lag in range(1, lags + 1)]) / power


class Alternative(NamedTuple):
    """Values at another minimum, and the increase of chi squared there."""

    values: Floats
    excess: float


@dataclass(frozen=True, kw_only=True)
class Fit:
    """Parameters that were fitted to tracks."""

    names: tuple[str, ...]
    values: Floats
    """Fitted values, shape (n,), in SI units."""
    covariance: Floats
    chi2: float
    """Sum of the squared residuals over their noise, and of deviations from priors over errors."""
    dof: int
    """Degrees of freedom: samples, and parameters known with an error, less parameters."""
    residuals: tuple[TrackResidual, ...]
    noise: Floats
    """Noise of each sample of all tracks, including outliers [m]."""
    kept: Flags
    """Whether each sample of all tracks was fitted, and is no outlier."""
    known: Mapping[int, Estimate] = field(default_factory=dict)
    """Priors of some parameters, by their indices."""
    alternatives: tuple[Alternative, ...] = ()
    """Other minima that are hardly worse; the covariance spans them."""
    is_converged: bool = True
    """Whether the solver ended before its limit of evaluations."""

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
    def variance_scale(self) -> float:
        """Factor on all variances, above 1 if the residuals are larger than the noise [-]."""
        if self.is_mismatch or not all(item.track.known_noise for item in self.residuals):
            return self.reduced_chi2
        return 1.0

    @property
    def correlation(self) -> Floats:
        """Correlations of the errors, shape (n, n); 0 for parameters without an error."""
        scale = np.outer(self.errors, self.errors)
        zeros = np.zeros_like(scale)
        return np.asarray(np.divide(self.covariance, scale, out=zeros, where=scale > 0.0))

    def budget(self, name: str) -> dict[str, float]:
        """Return the contributions of noise and priors to the error [SI]."""
        index = self.names.index(name)
        row = self.covariance[index]
        contributions = {
            self.names[other]: abs(float(row[other])) / known.error
            for other, known in self.known.items()
        }
        noise = row[index] - sum(contribution**2 for contribution in contributions.values())
        return {'noise': math.sqrt(max(float(noise), 0.0)), **contributions}

    def spanning(self, alternatives: Sequence[Alternative]) -> Fit:
        """Extend the intervals of 95 % to other minima."""
        covariance = self.covariance.copy()
        for item in alternatives:
            covariance += np.outer(*2 * [0.5 * (item.values - self.values)])
        return replace(self, covariance=covariance, alternatives=tuple(alternatives))

    @property
    def is_mismatch(self) -> bool:
        """Whether the residuals are larger than noise explains; estimated noise has errors too."""
        if all(residual.track.known_noise for residual in self.residuals):
            return bool(stats.chi2.sf(self.chi2, self.dof) < _SIGNIFICANCE)
        spread = math.sqrt(_ESTIMATED_NOISE_FACTOR * 2.0 / self.dof)
        return bool(stats.norm.sf((self.reduced_chi2 - 1.0) / spread) < _SIGNIFICANCE)


@dataclass(frozen=True, kw_only=True)
class FitModel:
    """A model of all tracks: their heights in one series [m], and the derivatives."""

    names: tuple[str, ...]
    predict: Callable[[Floats], Floats]
    jacobian: Callable[[Floats], Floats]
    low: Floats
    high: Floats
    known: Mapping[int, Estimate] = field(default_factory=dict)
    """Priors of some parameters, by their indices."""

    @classmethod
    def with_steps(
        cls,
        names: Sequence[str],
        predict: Callable[[Floats], Floats],
        low: Floats,
        high: Floats,
        steps: Floats,
    ) -> FitModel:
        """Return a model whose derivatives are central differences with the given steps."""

        def jacobian(values: Floats) -> Floats:
            columns = []
            for index, step in enumerate(steps):
                above, below = values.copy(), values.copy()
                above[index] = min(values[index] + step, high[index])
                below[index] = max(values[index] - step, low[index])
                width = above[index] - below[index]
                columns.append((predict(above) - predict(below)) / width)
            return np.stack(columns, axis=1)

        return cls(names=tuple(names), predict=predict, jacobian=jacobian, low=low, high=high)


def fit_best(
    model: FitModel, starts: Iterable[Floats], track: tuple[str, Track], *, max_evaluations: int
) -> Fit:
    """Fit a model to a track from several starts, and return the fit of least chi squared."""
    noise = np.full(track[1].time.size, track[1].noise)
    tried = [
        fit_tracks(model, item, [track], noise=noise, max_evaluations=max_evaluations)
        for item in starts
    ]
    best = min(tried, key=lambda result: result.chi2)
    return fit_tracks(model, best.values, [track], max_evaluations=max_evaluations)


def fit_tracks(
    model: FitModel,
    start: Floats,
    tracks: Sequence[tuple[str, Track]],
    *,
    noise: Floats | None = None,
    max_evaluations: int = 100,
) -> Fit:
    """
    Fit a model to tracks, from a sufficiently close start, without outliers.

    Parameters
    ----------
    model : FitModel
        The model of the tracks.
    start : ndarray, shape (n,)
        Initial values of the free parameters.
    tracks : sequence of (str, Track)
        Tracks with their names, in the order of the predictions of the model.
    noise : ndarray, optional
        Noise of each sample of all tracks, to compare fits by their chi squared. By default it
        is estimated, first from the tracks and then from the residuals. [m]
    max_evaluations : int
        Largest number of evaluations of the model in one run of the solver.

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
    problem = _LeastSquares(model, tracks, noise, max_evaluations)
    values = problem.begin(start)
    if noise is None:
        for _ in range(_MAX_NOISE_ROUNDS):
            if not problem.reweigh(values):
                break
            values = problem.leave_out(problem.solve(values))
    return problem.conclude(values)


def _estimate_noise(residuals: Floats) -> float:
    """Estimate the noise from second differences, which suppress slow changes [m]."""
    differences = np.abs(np.convolve(residuals, _CURVATURE, 'valid'))
    kept = differences
    for _ in range(8):
        noise = float(np.sqrt(np.mean(kept**2)))
        inside = differences[differences <= _NOISE_SIGMAS * noise]
        if inside.size == kept.size:
            break
        kept = inside
    return noise


class _LeastSquares:
    """Tracks and a model as SciPy's solver takes them."""

    def __init__(
        self,
        model: FitModel,
        tracks: Sequence[tuple[str, Track]],
        noise: Floats | None,
        max_evaluations: int,
    ) -> None:
        self._model = model
        self._tracks = tracks
        self._max_evaluations = max_evaluations
        sizes = [track.time.size for _, track in tracks]
        self._position = np.concatenate([track.position for _, track in tracks])
        if noise is None:
            noise = np.repeat([track.noise for _, track in tracks], sizes)
        self._noise = noise
        self._ends = np.cumsum(sizes)[:-1]
        self._known = np.array(list(model.known), dtype=np.intp)
        self._known_values, self._known_errors = (
            np.array(list(model.known.values()), dtype=np.float64).reshape(-1, 2).T
        )
        self._kept: Flags = np.ones(self._position.size, bool)
        self._is_converged = False  # of the last run of the solver

    def solve(self, start: Floats, *, loss: str = 'linear') -> Floats:
        """Return the best values."""
        model = self._model
        is_sparse = start.size > _MAX_DENSE_PARAMETERS

        def jacobian(values: Floats) -> object:  # an array, or a sparse one
            slopes = self._jacobian(values)
            return sparse.csr_matrix(slopes) if is_sparse else slopes

        options = {'atol': 1e-12, 'btol': 1e-12, 'regularize': False} if is_sparse else {}
        try:
            with np.errstate(divide='raise', over='raise', invalid='raise'):
                solution = optimize.least_squares(
                    self._residuals,
                    np.clip(start, model.low, model.high),
                    jac=jacobian,
                    tr_solver='lsmr' if is_sparse else 'exact',
                    tr_options=options,
                    bounds=(model.low, model.high),
                    x_scale='jac',
                    xtol=_TOLERANCE,
                    ftol=_TOLERANCE,
                    gtol=_TOLERANCE,
                    loss=loss,
                    max_nfev=self._max_evaluations,
                )
        except FloatingPointError:
            raise FitError(
                'the numbers of the fit overflow; check the heights of the tracks'
            ) from None
        self._is_converged = solution.status > 0  # 0 is the limit of evaluations
        return np.asarray(solution.x)

    def begin(self, start: Floats) -> Floats:
        """Return the best values without outliers, starting from given values."""
        # A fit with the outliers that are visible at the start might end in a wrong minimum
        self._kept = ~self._find_outliers(np.clip(start, self._model.low, self._model.high))
        return self.leave_out(self.solve(start))

    def leave_out(self, values: Floats) -> Floats:
        """Remove outliers and fit again, until the outliers stay the same."""
        outliers = self._find_outliers(values)
        if (outliers & self._kept).any():
            values = self.solve(values, loss='soft_l1')
            outliers = self._find_outliers(values)
        for _ in range(_MAX_OUTLIER_ROUNDS):
            if (outliers == ~self._kept).all():
                break
            self._kept = ~outliers
            values = self.solve(values)
            outliers = self._find_outliers(values)
        return values

    def reweigh(self, values: Floats) -> bool:
        """Estimate the noise of tracks where it is not known; return whether it changes much."""
        residuals = self._position - self._model.predict(values)
        noises = []
        for (_, track), residual, kept, noise in self._by_track(
            residuals, self._kept, self._noise
        ):
            if track.known_noise:
                noises.append(noise)
            else:
                estimate = max(_estimate_noise(residual[kept]), track.least_noise, 1e-15)
                noises.append(np.full_like(noise, estimate))
        before, self._noise = self._noise, np.concatenate(noises)
        return float(np.max(np.abs(np.log(self._noise / before)))) > _NOISE_TOLERANCE

    def _by_track(self, *series: NDArray[Any]) -> Iterator[Any]:
        """Yield each track with its name, and its samples of each series."""
        samples = (np.split(item, self._ends) for item in series)
        return zip(self._tracks, *samples, strict=True)

    def _find_outliers(self, values: Floats) -> Flags:
        """Return which samples are outliers of the model with these values."""
        residuals = (self._model.predict(values) - self._position) / self._noise
        flags = []
        for residual in np.split(residuals, self._ends):
            low, high = (
                rank_filter(residual, rank, _NEIGHBOURHOOD, mode='mirror') for rank in _RANKS
            )
            deviation = np.maximum(residual - high, low - residual).clip(0.0)
            scale = max(1.0, 1.4826 * float(np.median(np.abs(residual - 0.5 * (low + high)))))
            flagged = deviation > _OUTLIER_LIMIT * scale
            flags.append(flagged & (flagged.mean() < _MAX_OUTLIER_SHARE))
        return np.concatenate(flags)

    def conclude(self, values: Floats) -> Fit:
        """Return the fit with its covariance."""
        squares = self._residuals(values) ** 2
        dof = squares.size - values.size
        chi2 = float(squares.sum())
        residuals = tuple(
            TrackResidual(
                name=name,
                track=track if kept.all() else track.where(kept),
                fitted=fitted[kept],
                noise=noise[kept],
                outliers=tuple(map(
                    Outlier,
                    track.time[~kept].tolist(),
                    (track.position - fitted)[~kept].tolist(),
                )),
            )
            for (name, track), fitted, noise, kept in self._by_track(
                self._model.predict(values), self._noise, self._kept
            )
        )
        fit = Fit(
            names=self._model.names,
            values=values,
            covariance=np.eye(values.size),
            chi2=chi2,
            dof=dof,
            residuals=residuals,
            noise=self._noise,
            kept=self._kept,
            known=dict(self._model.known),
            is_converged=self._is_converged,
        )
        scale = max(math.sqrt(fit.variance_scale), 1e-150)
        sizes = [residual.values.size for residual in residuals]
        scales = [scale * math.sqrt(max(residual.inflation, 1.0)) for residual in residuals]
        jacobian = self._jacobian(values)
        jacobian[: sum(sizes)] /= np.repeat(scales, sizes)[:, None]
        return replace(fit, covariance=_covariance(jacobian))

    def _residuals(self, values: Floats) -> Floats:
        """Return the weighted residuals of the samples and of the priors."""
        residuals = (self._model.predict(values) - self._position) / self._noise
        known = (values[self._known] - self._known_values) / self._known_errors
        return np.concatenate([residuals[self._kept], known])

    def _jacobian(self, values: Floats) -> Floats:
        """Differentiate the residuals."""
        slopes = self._model.jacobian(values) / self._noise[:, None]
        known = np.zeros((self._known.size, values.size))
        known[np.arange(self._known.size), self._known] = 1.0 / self._known_errors
        return np.concatenate([slopes[self._kept], known])


def _covariance(jacobian: Floats) -> Floats:
    """Compute the covariance of the values."""
    sizes = np.maximum(np.linalg.norm(jacobian, axis=0), 1e-60)
    triangle = np.linalg.qr(jacobian / sizes, mode='r')
    _, strengths, directions = np.linalg.svd(triangle)
    strengths = np.maximum(strengths, 1e-12 * strengths[0])  # limits the errors
    spread = directions.T / strengths
    return np.asarray((spread @ spread.T) / np.outer(sizes, sizes))
