# SPDX-License-Identifier: Apache-2.0
"""
Least squares: what comes out of a fit, how far to trust it, and what it cannot tell apart.

Notes
-----
Weights are one over the noise of each track. If somebody knows the noise it is taken as it is,
and so are the standard errors; if it was estimated, they are multiplied by the square root of
chi squared per degree of freedom, so that only the ratios of noises matter to them.

"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from itertools import combinations
import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import optimize, sparse, stats
from soft_throw_ros.identification.tracks import Track

Floats = NDArray[np.float64]

INSEPARABLE = 0.99
"""Correlation from which on two parameters are not told apart."""

_LAGS = 10  # of the residual's autocorrelation that are looked at together
_MANY = 40  # parameters, beyond which there are few of them in each residual
_DOUBT = 1e-4  # probability below which chance is no explanation
_SLIGHT = 0.5  # of the noise, below which it does not matter what residuals look like
_SPREAD = 3.0  # variance of chi squared if the noise was estimated, over that if it was known


class FitError(ValueError):
    """The tracks do not give what was asked for; the message says why."""


class Value(NamedTuple):
    """A number and its standard error, of the same unit."""

    value: float
    error: float

    def __str__(self) -> str:
        if not 0.0 < self.error < math.inf:
            return f'{self.value:.6g} +- {self.error:.2g}'
        digits = 1 - math.floor(math.log10(self.error))
        if -4 <= digits <= 9:
            digits = max(digits, 0)
            return f'{self.value:.{digits}f} +- {self.error:.{digits}f}'
        return f'{self.value:.6g} +- {self.error:.2g}'


@dataclass(frozen=True, kw_only=True)
class Residual:
    """
    What a fit leaves of a track.

    Parameters
    ----------
    name : str
        Of the track.
    track : Track
        The data.
    fitted : ndarray, shape (n,)
        What the model says at the same times. [m]

    """

    name: str
    track: Track
    fitted: Floats

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
        lags = np.arange(1, min(_LAGS, size // 4) + 1)
        squares = self._autocorrelations(lags.size) ** 2
        statistic = size * (size + 2) * float(np.sum(squares / (size - lags)))
        return float(stats.chi2.sf(statistic, lags.size))

    def _autocorrelations(self, lags: int) -> Floats:
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
        Of the parameters.
    values : ndarray, shape (n,)
        In SI units.
    covariance : ndarray, shape (n, n)
        Of their errors.
    chi2 : float
        Sum of the squared residuals, each over its noise.
    dof : int
        Degrees of freedom: samples less parameters.
    residuals : tuple of Residual
        Track by track.

    """

    names: tuple[str, ...]
    values: Floats
    covariance: Floats
    chi2: float
    dof: int
    residuals: tuple[Residual, ...]

    def __getitem__(self, name: str) -> Value:
        place = self.names.index(name)
        return Value(float(self.values[place]), float(self.errors[place]))

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

    def inseparable(self) -> Iterator[tuple[str, str, float]]:
        """
        Yield pairs of parameters that the tracks do not tell apart, and their correlation.

        Of what belongs to a single one of several throws, named with its number in brackets,
        nobody asks.
        """
        correlation = self.correlation
        asked = [place for place, name in enumerate(self.names) if not name.endswith(']')]
        for i, j in combinations(asked, 2):
            if abs(correlation[i, j]) > INSEPARABLE:
                yield self.names[i], self.names[j], float(correlation[i, j])

    def warnings(self) -> list[str]:
        """Say what there is to doubt, each in a sentence."""
        found = []
        for first, second, correlation in self.inseparable():
            factor = 1.0 / math.sqrt(max(1.0 - correlation**2, 1e-12))
            found.append(
                f'{first} and {second} can hardly be told apart by these tracks (correlation '
                f'{correlation:.4f}): the error of each is {factor:.0f} times what it would be if '
                'the other were known; hold one'
            )
        if self.is_misfit:
            found.append(
                f'the residuals are {math.sqrt(self.reduced_chi2):.2g} times the noise: the model '
                'leaves out something that these tracks show, and the errors do not tell how much'
            )
        coloured = [
            residual
            for residual in self.residuals
            if residual.whiteness < _DOUBT / len(self.residuals)
            and residual.rms > _SLIGHT * residual.track.noise
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
    def is_misfit(self) -> bool:
        """Whether the residuals are larger than noise explains."""
        return self._misfit_probability() < _DOUBT

    def _misfit_probability(self) -> float:
        """Compute the probability of so large a chi squared; estimated noise has errors too."""
        if all(residual.track.known_noise for residual in self.residuals):
            return float(stats.chi2.sf(self.chi2, self.dof))
        spread = math.sqrt(_SPREAD * 2.0 / self.dof)
        return float(stats.norm.sf((self.reduced_chi2 - 1.0) / spread))


class Model(NamedTuple):
    """What is fitted: `predict` gives the heights of all tracks in one series."""

    names: tuple[str, ...]
    predict: Callable[[Floats], Floats]
    slopes: Callable[[Floats], Floats]
    """Derivatives of `predict`, shape (samples, parameters)."""
    low: Floats
    high: Floats


def fit_tracks(
    model: Model, start: Floats, tracks: Sequence[tuple[str, Track]], *, max_steps: int = 100
) -> Fit:
    """
    Fit a model to tracks, from a start that is near enough.

    Parameters
    ----------
    model : Model
    start : ndarray, shape (n,)
        Values to begin with.
    tracks : sequence of (str, Track)
        With their names, in the order of what the model predicts.
    max_steps : int
        Evaluations of the model at most.

    Raises
    ------
    FitError
        If there are not more samples than parameters.

    """
    position = np.concatenate([track.position for _, track in tracks])
    noise = np.concatenate([np.full(track.time.size, track.noise) for _, track in tracks])
    dof = position.size - start.size
    if dof < 1:
        raise FitError(
            f'{position.size} samples are too few for {start.size} parameters: '
            f'{", ".join(model.names)}'
        )
    # strictly within the bounds, as SciPy wants it
    margin = 1e-9 * np.where(np.isfinite(model.high - model.low), model.high - model.low, 1.0)
    # Of many throws each has parameters of its own, which no other depends on
    is_sparse = start.size > _MANY

    def slopes(values: Floats) -> Any:
        weighted = model.slopes(values) / noise[:, None]
        return sparse.csr_matrix(weighted) if is_sparse else weighted

    solution = optimize.least_squares(
        lambda values: (model.predict(values) - position) / noise,
        np.clip(start, model.low + margin, model.high - margin),
        jac=slopes,
        tr_solver='lsmr' if is_sparse else 'exact',
        tr_options={'atol': 1e-12, 'btol': 1e-12, 'regularize': False} if is_sparse else {},
        bounds=(model.low, model.high),
        x_scale='jac',
        xtol=1e-10,
        ftol=1e-10,
        gtol=1e-10,
        max_nfev=max_steps,
    )
    chi2 = 2.0 * float(solution.cost)
    covariance = _covariance(solution.jac.toarray() if is_sparse else solution.jac)
    if not all(track.known_noise for _, track in tracks):
        covariance *= chi2 / dof
    fitted = np.split(
        model.predict(solution.x), np.cumsum([track.time.size for _, track in tracks])[:-1]
    )
    return Fit(
        names=model.names,
        values=solution.x,
        covariance=covariance,
        chi2=chi2,
        dof=dof,
        residuals=tuple(
            Residual(name=name, track=track, fitted=heights)
            for (name, track), heights in zip(tracks, fitted, strict=True)
        ),
    )


def _covariance(jacobian: Floats) -> Floats:
    """Compute the covariance of the values."""
    sizes = np.maximum(np.linalg.norm(jacobian, axis=0), 1e-60)
    triangle = np.linalg.qr(jacobian / sizes, mode='r')
    _, strengths, directions = np.linalg.svd(triangle)
    strengths = np.maximum(strengths, 1e-12 * strengths[0])  # what is not seen at all is very wide
    spread = directions.T / strengths
    return np.asarray((spread @ spread.T) / np.outer(sizes, sizes))
