# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Reasons to doubt a fit, as values; `commands.identify_report` words them."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import combinations
import math
from typing import NamedTuple, TypeAlias

import numpy as np
from soft_throw_ros.identification.least_squares import Estimate, Fit

_INSEPARABLE = 0.99
"""Correlation from which on two parameters cannot be separated. [-]"""

_CONTRADICTION = 4.0
"""Deviation from a prior beyond which chance is unlikely. [standard errors]"""


class Ambiguity(NamedTuple):
    """Another minimum that is hardly worse."""

    name: str
    """Parameter that differs: the wave speed, or else the one that differs most."""
    value: float
    """Value of the parameter there, in SI units."""
    excess: float
    """Chi squared there, above the best one. [-]"""


class InseparablePair(NamedTuple):
    """Two parameters that the tracks hardly separate."""

    names: tuple[str, str]
    correlation: float

    @property
    def error_ratio(self) -> float:
        """Error of each parameter over its error with the other one known [-]."""
        return 1.0 / math.sqrt(max(1.0 - self.correlation**2, 1e-12))


class Contradiction(NamedTuple):
    """A fitted value far from its prior."""

    name: str
    deviation: float
    """[standard errors of the prior]"""
    prior: Estimate


class Mismatch(NamedTuple):
    """Residuals that are larger than the noise."""

    ratio: float
    """Residual over noise. [-]"""
    track: str
    """The worst track, and from when to when its residuals are largest."""
    start: float
    """[s]"""
    end: float
    """[s]"""


class NotConverged(NamedTuple):
    """A solver that stopped at its limit of evaluations."""


FitWarning: TypeAlias = Ambiguity | InseparablePair | Contradiction | Mismatch | NotConverged


def fit_warnings(fit: Fit) -> list[FitWarning]:
    """Return all reasons to doubt a fit."""
    return [
        *_ambiguities(fit),
        *_inseparable_pairs(fit),
        *_contradictions(fit),
        *_mismatches(fit),
        *([] if fit.is_converged else [NotConverged()]),
    ]


def _ambiguities(fit: Fit) -> Iterator[Ambiguity]:
    speeds = [index for index, name in enumerate(fit.names) if 'wave_speed' in name]
    for values, excess in fit.alternatives:
        change = np.abs(values - fit.values) / np.maximum(np.abs(fit.values), 1e-300)
        index = speeds[0] if speeds else int(change.argmax())
        yield Ambiguity(fit.names[index], float(values[index]), excess)


def _inseparable_pairs(fit: Fit) -> Iterator[InseparablePair]:
    # Parameters of a single one of several throws have its number in brackets
    free = [
        index
        for index, name in enumerate(fit.names)
        if not name.endswith(']') and index not in fit.known
    ]
    correlation = fit.correlation
    for i, j in combinations(free, 2):
        if abs(correlation[i, j]) > _INSEPARABLE:
            yield InseparablePair((fit.names[i], fit.names[j]), float(correlation[i, j]))


def _contradictions(fit: Fit) -> Iterator[Contradiction]:
    for index, prior in fit.known.items():
        deviation = float(abs(fit.values[index] - prior.value)) / prior.error
        if deviation > _CONTRADICTION:
            yield Contradiction(fit.names[index], deviation, prior)


def _mismatches(fit: Fit) -> Iterator[Mismatch]:
    if fit.is_mismatch:
        worst = max(fit.residuals, key=lambda residual: residual.rms / residual.track.noise)
        yield Mismatch(math.sqrt(fit.reduced_chi2), worst.name, *worst.worst_part)
