# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Texts and tables (Markdown) about a throw and the recommended layer."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
import math

Values = Mapping[str, float | str]
"""Named values of a message DiagnosticArray."""

UNITS = {
    **dict.fromkeys(('amplitude', 'thickness', 'travel', 'height'), ('mm', 1e3)),
    **dict.fromkeys(('work', 'energy', 'heat'), ('mJ', 1e3)),
    **dict.fromkeys(('time', 'lead'), ('ms', 1e3)),
    'speed': ('m/s', 1.0),
    'acceleration': ('m/s2', 1.0),
    'strain': ('%', 1e2),
    'force': ('N', 1.0),
    'modulus': ('kPa', 1e-3),
    'density': ('kg/m3', 1.0),
}
"""Units of quantities in tables, and factors from SI, by the last word of their names."""

_THROW_ROWS = (
    'ejection_time', 'ejection_speed', 'energy_transfer', 'last_energy_transfer',
    'peak_plate_speed', 'peak_strain', 'peak_acceleration', 'peak_plate_force', 'plate_work',
    'apex_height', 'lead',
)

_LAYER_ROWS = (
    'thickness', 'wave_speed', 'youngs_modulus', 'energy_transfer', 'ejection_time',
    'ejection_speed', 'peak_strain', 'peak_acceleration',
)

_STAGES = {'final': 'in all', 'predicted': 'as it will be'}


def throw_text(values: Values) -> str:
    """Return the results of a throw with their errors."""
    stage = _STAGES.get(str(values.get('stage')), 'up to the release')
    rows = [name for name in _THROW_ROWS if values.get('recontacts') or name[:5] != 'last_']
    text = f'**Throw {float(values.get("throw", math.nan)):.0f}**, {stage}\n\n'
    text += _table(values, rows, {'twin': ''})
    match values.get('peak_strain'), values.get('max_strain'):
        case float(strain), float(limit) if strain > limit:
            text += f'\nStrain beyond {100.0 * limit:.3g} %: a real layer is no longer linear.\n'
    return text


def recommendation_text(message: str, values: Values) -> str:
    """Return a table of the present and the recommended layers."""
    if 'now.thickness' not in values:
        return f'{message}\n'
    vary = values.get('vary')
    others = {'other thickness': 'by_thickness.', 'other wave speed': 'by_wave_speed.'}
    others.pop(f'other {vary}'.replace('_', ' '), None)
    best = values.get('layer') or vary
    return _table(values, _LAYER_ROWS, {'now': 'now.', **others, f'**{best}**': ''})


def _table(values: Values, rows: Sequence[str], columns: Mapping[str, str]) -> str:
    """Return a table of the rows that are not empty; columns are prefixes of keys."""
    lines = ['| | ' + ' | '.join(columns) + ' |', '|:--|' + '--:|' * len(columns)]
    for name in rows:
        unit, factor = UNITS.get(name.rpartition('_')[2], ('', 1.0))
        errors = values.get(f'accuracy.{name.replace("ejection_time", "release_time")}_error')
        cells = [_cell(values.get(prefix + name), factor, errors) for prefix in columns.values()]
        if any(cells):
            title = name.replace('_', ' ') + (f' ({unit})' if unit else '')
            lines.append(f'| {title} | ' + ' | '.join(cells) + ' |')
    return '\n'.join(lines) + '\n'


def _cell(value: float | str | None, factor: float, error: float | str | None) -> str:
    """Return a number as text, with its error if that is known."""
    if not isinstance(value, float):
        return value or ''
    if not isinstance(error, float) or not 0.0 < error < math.inf:
        return f'{factor * value:.4g}'
    digits = max(1 - math.floor(math.log10(factor * error)), 0)
    return f'{factor * value:.{digits}f} ± {factor * error:.{digits}f}'
