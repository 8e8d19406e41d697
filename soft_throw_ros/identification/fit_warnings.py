# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Reasons to doubt a fit, one sentence each."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import combinations

import numpy as np
from soft_throw_ros.identification.least_squares import Fit

_INSEPARABLE = 0.99
"""Correlation from which on two parameters cannot be separated. [-]"""

_CONTRADICTION = 4.0
"""Deviation from a prior beyond which chance is unlikely. [standard errors]"""


def fit_warnings(fit: Fit) -> list[str]:
    """Return all reasons to doubt a fit: each enlarges an error, or a value may be wrong."""
    return [
        *_ambiguities(fit),
        *_inseparable_pairs(fit),
        *_contradictions(fit),
        *_mismatches(fit),
    ]


def _ambiguities(fit: Fit) -> Iterator[str]:
    speeds = [index for index, name in enumerate(fit.names) if 'wave_speed' in name]
    for values, excess in fit.alternatives:
        change = np.abs(values - fit.values) / np.maximum(np.abs(fit.values), 1e-300)
        index = speeds[0] if speeds else int(change.argmax())
        yield (
            f'{fit.names[index]} may as well be {values[index]:.5g} (chi squared is larger by '
            f'{excess:.1f} there); the errors span both'
        )


def _inseparable_pairs(fit: Fit) -> Iterator[str]:
    # Parameters of a single one of several throws have its number in brackets
    free = [
        index
        for index, name in enumerate(fit.names)
        if not name.endswith(']') and index not in fit.known
    ]
    for i, j in combinations(free, 2):
        if abs(fit.correlation[i, j]) > _INSEPARABLE:
            yield (
                f'{fit.names[i]} and {fit.names[j]} are hardly separated by these tracks '
                f'(correlation {fit.correlation[i, j]:.4f}): hold one'
            )


def _contradictions(fit: Fit) -> Iterator[str]:
    for index, prior in fit.known.items():
        deviation = float(abs(fit.values[index] - prior.value)) / prior.error
        if deviation > _CONTRADICTION:
            yield (
                f'{fit.names[index]} is found {deviation:.1f} errors from the expected {prior}: a '
                'given value may be wrong'
            )


def _mismatches(fit: Fit) -> Iterator[str]:
    if fit.is_mismatch:
        ratios = [float(np.sqrt(np.mean(residual.usual**2))) for residual in fit.residuals]
        worst = fit.residuals[int(np.argmax(ratios))]
        yield (
            f'the residuals of {worst.name} are {max(ratios):.2g} times the noise: the model '
            'leaves out something (see --figure); the errors of all results include it'
        )
    if not fit.is_converged:
        yield 'the solver stopped at its limit before it converged: the values may be wrong'
