# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Verdicts in a Markdown table."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from trials.judge import Verdict

_COLUMNS = {
    'c_s': ('layer.wave_speed',),
    'loss': ('layer.loss_tangent',),
    'A': ('engine.amplitude',),
    'f, zeta': ('engine.frequency', 'engine.damping_ratio'),
    't_e': ('ejection.time',),
    'V_e, alpha': ('ejection.speed', 'ejection.energy_transfer'),
}
"""Quantities whose intervals are counted in a column, by the head of the column."""

HEADS = (
    'row', 'rigs', 'refused', 'warned', 'silently wrong', 'all', *_COLUMNS, 'largest', 'slowest',
)


def header() -> list[str]:
    """Write the head of the table."""
    return [
        '| ' + ' | '.join(HEADS) + ' |',
        '|---' + '|---:' * (len(HEADS) - 1) + '|',
    ]


def line(name: str, verdicts: Sequence[Verdict]) -> str:
    """Write the line of a row."""
    fitted = [verdict for verdict in verdicts if not verdict.refusal]
    names = sorted({name for verdict in fitted for name in verdict.results})
    largest = max(
        ((result.errors, name) for verdict in fitted for name, result in verdict.results.items()),
        default=(0.0, '-'),
    )
    cells = [
        name,
        str(len(verdicts)),
        str(sum(bool(verdict.refusal) for verdict in verdicts)),
        str(sum(bool(verdict.warnings) for verdict in verdicts)),
        str(sum(verdict.is_silently_wrong for verdict in verdicts)),
        _coverage(fitted, names),
        *(_coverage(fitted, quantities) for quantities in _COLUMNS.values()),
        f'{largest[0]:.1f} ({largest[1].removeprefix("ejection.").removeprefix("layer.")})',
        f'{max(verdict.seconds for verdict in verdicts):.1f} s',
    ]
    return '| ' + ' | '.join(cells) + ' |'


def summary(verdicts: Sequence[Verdict], clean: Iterable[str]) -> list[str]:
    """Compare the numbers of silently wrong trials and of false alarms with their goals."""
    silent = sum(verdict.is_silently_wrong for verdict in verdicts)
    of_clean = [verdict for verdict in verdicts if verdict.row in set(clean)]
    alarms = sum(bool(verdict.alarms) for verdict in of_clean)
    ambiguous = sum(bool(verdict.warnings and not verdict.alarms) for verdict in of_clean)
    lines = [f'{silent} of {len(verdicts)} are silently wrong (goal: 0).']
    if of_clean:
        share = 100.0 * alarms / len(of_clean)
        lines.append(
            f'{alarms} false alarms in {len(of_clean)} clean trials, {share:.1f} % '
            f'(goal: at most 2 %); {ambiguous} more have a second solution within the errors.'
        )
    return lines


def _coverage(verdicts: Sequence[Verdict], names: Iterable[str]) -> str:
    """Return the fraction of 95 % intervals that contain the true value."""
    covered = [
        verdict.results[name].is_covered
        for verdict in verdicts
        for name in names
        if name in verdict.results
    ]
    return f'{100.0 * sum(covered) / len(covered):.0f} %' if covered else '-'
