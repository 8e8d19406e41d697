# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Texts and tables (Markdown) about a throw, the recommended layer and the measured track."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
import math
from typing import Any, NamedTuple

from soft_throw_ros.core.rig import STANDARD_GRAVITY

Values = Mapping[str, float | str]
"""Named values of a message DiagnosticArray."""

NO_VALUES: Values = {}

NO_RECOMMENDATION = 'There is no recommendation for this rig yet.'


class _Row(NamedTuple):
    """A row of a table: the key of its values, its title, and the factor from SI units."""

    key: str
    title: str
    factor: float = 1.0
    error: str = ''  # key of the standard error, which is written beside the value


_THROW_ROWS = (
    _Row('ejection_time', 'ejection time tₑ (ms)', 1e3, 'accuracy.release_time_error'),
    _Row('ejection_speed', 'ejection speed Vₑ (m/s)', 1.0, 'accuracy.ejection_speed_error'),
    _Row('energy_transfer', 'energy transfer α', 1.0, 'accuracy.energy_transfer_error'),
    _Row('last_energy_transfer', 'α at the last release'),
    _Row('peak_plate_speed', 'plate speed Vₚ* (m/s)'),
    _Row('peak_strain', 'peak strain (%)', 1e2),
    _Row('peak_acceleration', 'peak acceleration (g)', 1.0 / STANDARD_GRAVITY),
    _Row('peak_plate_force', 'peak force on plate (N)'),
    _Row('plate_work', 'work of the plate (mJ)', 1e3),
    _Row('apex_height', 'apex (mm)', 1e3),
    _Row('lead', 'release known before (ms)', 1e3),
    _Row('residual.position_rms', 'model off by, rms (µm)', 1e6),
    _Row('residual.ejection_time_error', 'and tₑ by (µs)', 1e6),
    _Row('residual.ejection_speed_error', 'and Vₑ by (m/s)'),
)

_LAYER_ROWS = (
    _Row('thickness', 'thickness Lₛ (mm)', 1e3),
    _Row('wave_speed', 'wave speed cₛ (m/s)'),
    _Row('youngs_modulus', 'modulus Eₛ (kPa)', 1e-3),
    _THROW_ROWS[2],
    *_THROW_ROWS[:2],
    *_THROW_ROWS[5:7],
)

TRACK_TASKS = ('measurement', 'model', 'identification')
"""Tasks in /diagnostics about a measured track, in the order of display."""

_STAGES = {'final': 'in all', 'predicted': 'as it will be'}

_VARIED = {'thickness': 'other thickness', 'wave_speed': 'other wave speed'}
"""Titles of the layers that vary one quantity."""


def throw_text(values: Values) -> str:
    """Return the results of a throw with their errors."""
    if not values.get('recontacts'):
        values = {key: value for key, value in values.items() if not key.startswith('last_')}
    number, strain, limit = (values.get(key) for key in ('throw', 'peak_strain', 'max_strain'))
    text = f'**Throw {f"{number:.0f}" if isinstance(number, float) else "?"}**, '
    text += _STAGES.get(str(values.get('stage')), 'up to the release')
    text += '\n\n' + _table(values, _THROW_ROWS, {'twin': ''})
    if isinstance(strain, float) and isinstance(limit, float) and strain > limit:
        text += f'\nStrain beyond {100.0 * limit:.3g} %: a real layer is no longer linear.\n'
    samples, out = (values.get(f'accuracy.{key}') for key in ('samples', 'samples_left_out'))
    if samples is not None:
        text += f'\n± by {samples:g} samples of the plate'
        text += f'; {out:g} were left out.\n' if out else '.\n'
    return text


def recommendation_text(message: str, values: Values) -> str:
    """Return a table of the present and the recommended layers."""
    if 'now.thickness' not in values:
        return f'{message}\n'
    vary = values.get('vary')
    columns = {'now': 'now.'}
    for key, head in _VARIED.items():
        columns[f'**{head}**' if key == vary else head] = f'by_{key}.'
    if vary not in _VARIED:
        columns[f'**{values.get("layer") if vary == "library" else vary}**'] = ''
    return _table(values, _LAYER_ROWS, columns)


def track_text(task: str, status: Any, values: Values) -> str:  # a DiagnosticStatus
    """Return a line with the status of the measured track and its warnings."""
    text = f'**{task.capitalize()}**: {status.message}'.replace('+-', '±')
    outliers = values.get('samples_jumped') or values.get('outliers')
    if outliers:
        text += f'; {outliers:g} samples left out'
    warnings = [str(value) for key, value in values.items() if key.startswith('warning')]
    return '; '.join([text, *warnings])


def _table(values: Values, rows: Sequence[_Row], columns: Mapping[str, str]) -> str:
    """Return a table of the rows that are not empty; columns are prefixes of keys."""
    lines = ['| | ' + ' | '.join(columns) + ' |', '|:--|' + '--:|' * len(columns)]
    for row in rows:
        cells = [
            _cell(values.get(prefix + row.key), row.factor, values.get(prefix + row.error))
            for prefix in columns.values()
        ]
        if any(cells):
            lines.append(f'| {row.title} | ' + ' | '.join(cells) + ' |')
    return '\n'.join(lines) + '\n'


def _cell(value: float | str | None, factor: float = 1.0, error: float | str | None = None) -> str:
    """Return a number as text, with its error if that is known."""
    if not isinstance(value, float):
        return value or ''
    if not isinstance(error, float) or not 0.0 < error < math.inf:
        return f'{factor * value:.4g}'
    digits = max(1 - math.floor(math.log10(factor * error)), 0)
    return f'{factor * value:.{digits}f} ± {factor * error:.{digits}f}'
