# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Sentences on throws and sensors, for the log and for /diagnostics."""

from __future__ import annotations

from soft_throw_ros.twin.results import ThrowResult


def throw_text(result: ThrowResult) -> str:
    """Return the release of a throw with warnings, or the reason why the throw is invalid."""
    if not result.is_valid:
        text = (
            f'no plate samples for more than {1e3 * result.rig.crossing_time:.3g} ms (see '
            'measurement in /diagnostics)'
        )
        if result.ended_by == 'noise':
            text = 'the plate samples are noisy: increase measured.smoothing_window or the rate'
        return f'throw {result.throw} is invalid: {text}'
    if result.first is None:
        return f'throw {result.throw}: the projectile was not released'
    event = 'release predicted' if result.stage == 'predicted' else 'released'
    text = (
        f'throw {result.throw}: {event} at {1e3 * result.first.ejection_time:.3f} ms, '
        f'{result.first.ejection_speed:.4f} m/s, alpha {result.first.energy_transfer:.3f}'
    )
    if result.accuracy is not None:
        text += f' +- {result.accuracy.energy_transfer_error:.3f}'
    if result.last is not None and result.recontacts:
        recontacts = f'{result.recontacts} re-contact{"s" * (result.recontacts > 1)}'
        text += f' ({result.last.energy_transfer:.3f} after {recontacts})'
    if not result.is_linear:
        strain, limit = 100.0 * result.peak_strain, 100.0 * result.max_strain
        text += f'; strain {strain:.1f} % exceeds the linear range of {limit:.3g} %'
    if result.accuracy is not None and not result.accuracy.is_clean:
        outliers, samples = result.accuracy.samples_left_out, result.accuracy.samples
        text += f'; {outliers} of {samples} plate samples were rejected as outliers'
    return text


def comparison_text(result: ThrowResult) -> str:
    """Return how well the projectile followed the model, and the likely cause of a deviation."""
    comparison = result.comparison
    if comparison is None:
        return 'the projectile was not measured'
    rms, threshold = 1e6 * comparison.position_rms, 1e6 * comparison.threshold
    if comparison.is_within_threshold:
        return f'the projectile followed the model within {rms:.3g} um rms'
    return (
        f'the projectile deviated from the model by {rms:.3g} um rms, more than '
        f'measured.residual_threshold {threshold:.3g} um: the layer has aged or slipped, or the '
        'parameters are wrong'
    )
