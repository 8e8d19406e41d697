# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Reasons to doubt a fit, one sentence each."""

from __future__ import annotations

from itertools import combinations

import numpy as np
from soft_throw_ros.identification.least_squares import Fit

_INSEPARABLE = 0.99
"""Correlation from which on two parameters cannot be separated. [-]"""

_CONTRADICTION = 4.0
"""Deviation from a prior beyond which chance is unlikely. [standard errors]"""


def fit_warnings(fit: Fit) -> list[str]:
    """Return all reasons to doubt a fit: each enlarges an error, or a value may be wrong."""
    warnings = []
    speeds = [index for index, name in enumerate(fit.names) if 'wave_speed' in name]
    for values, excess in fit.alternatives:
        change = np.abs(values - fit.values) / np.maximum(np.abs(fit.values), 1e-300)
        index = speeds[0] if speeds else int(change.argmax())
        warnings.append(
            f'{fit.names[index]} may as well be {values[index]:.5g} (chi squared is larger by '
            f'{excess:.1f} there); the errors span both'
        )
    # Parameters of a single one of several throws have its number in brackets
    free = [
        index for index, name in enumerate(fit.names)
        if not name.endswith(']') and index not in fit.known
    ]
    warnings += [
        f'{fit.names[i]} and {fit.names[j]} are hardly separated by these tracks (correlation '
        f'{fit.correlation[i, j]:.4f}): hold one'
        for i, j in combinations(free, 2) if abs(fit.correlation[i, j]) > _INSEPARABLE
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
