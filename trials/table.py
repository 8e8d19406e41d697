# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Verdicts in a Markdown table."""

from __future__ import annotations

from collections.abc import Collection, Sequence

from trials.judge import Verdict

_COLUMNS = {
    'c_s': ('layer.wave_speed', 'layer.rest_wave_speed'),
    'loss': ('layer.loss_tangent',),
    'A': ('engine.amplitude',),
    'f, zeta': ('engine.frequency', 'engine.damping_ratio'),
    't_e': ('ejection.time',),
    'V_e, alpha': ('ejection.speed', 'ejection.energy_transfer'),
}
"""Quantities whose intervals are counted in a column, by the head of the column."""

HEADS = ('row', 'rigs', 'refused', 'warned', 'silently wrong', 'all', *_COLUMNS)


def header() -> list[str]:
    """Write the head of the table."""
    return [f'| {" | ".join(HEADS)} |', '|---' + '|---:' * (len(HEADS) - 1) + '|']


def line(name: str, verdicts: Sequence[Verdict]) -> str:
    """Write the line of a row."""
    fitted = [verdict for verdict in verdicts if not verdict.refusal]
    names = {name for verdict in fitted for name in verdict.results}
    counts = (
        len(verdicts),
        len(verdicts) - len(fitted),
        sum(bool(verdict.warnings) for verdict in verdicts),
        sum(verdict.is_silently_wrong for verdict in verdicts),
    )
    shares = [_coverage(fitted, quantities) for quantities in (names, *_COLUMNS.values())]
    return f'| {" | ".join([name, *map(str, counts), *shares])} |'


def summary(verdicts: Sequence[Verdict], clean: Collection[str]) -> str:
    """Compare the numbers of silently wrong trials and of false alarms with their goals."""
    silent = sum(verdict.is_silently_wrong for verdict in verdicts)
    alarms = [
        bool(verdict.refusal or verdict.warnings) for verdict in verdicts if verdict.row in clean
    ]
    return (
        f'{silent} of {len(verdicts)} are silently wrong (goal: 0), and {sum(alarms)} of '
        f'{len(alarms)} clean trials have a false alarm (goal: at most 2 %).'
    )


def _coverage(verdicts: Sequence[Verdict], names: Collection[str]) -> str:
    """Return the fraction of 95 % intervals that contain the true value."""
    results = [verdict.results[name] for verdict in verdicts for name in names
               if name in verdict.results]
    covered = sum(result.is_covered for result in results)
    return f'{100.0 * covered / len(results):.0f} %' if results else '-'
