# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
Predict one throw, as a table or as JSON; or many first releases, from a CSV file.

The options are the parameters of the twin, with the same ranges.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterable, Iterator, Mapping
import sys
from typing import TypedDict

import numpy as np
from soft_throw_ros.commands.design_texts import uncertainty_text
from soft_throw_ros.commands.options import (
    add_options,
    add_rig_options,
    number_type,
    option_of,
    positive,
    read_settings,
    UNCERTAINTY_PARAMETERS,
)
from soft_throw_ros.commands.output import (
    CommandParser,
    print_note,
    print_result,
    print_text,
    report_io_errors,
    run_command,
    slow_notice,
    strain_warning,
    write_columns,
)
from soft_throw_ros.configuration import rig_of, Settings, Value
from soft_throw_ros.configuration.csv_rows import read_rows
from soft_throw_ros.configuration.twin import RIG_PARAMETERS
from soft_throw_ros.core import spring_mass
from soft_throw_ros.core.closed_form import first_release, first_releases, ThrowUnresolvedError
from soft_throw_ros.core.rig import Rig
from soft_throw_ros.core.throw import simulate
from soft_throw_ros.design.uncertainty import prediction_uncertainty, Uncertainties
from soft_throw_ros.storage.regular_file import read_regular_file

ModelResult = Mapping[str, float]
"""Predictions by name, in SI units."""


class Prediction(TypedDict):
    """Output of `--json`."""

    parameters: dict[str, Value]
    rig: dict[str, float]
    throw: ModelResult | None
    spring: ModelResult | None
    uncertainty: dict[str, float | bool] | None
    notes: dict[str, str]
    leaves_linear_range: bool


def main(args: list[str] | None = None) -> int:
    """Run the command; return exit code 0."""
    return run_command(_parser(), _run, args)


def _parser() -> CommandParser:
    parser = CommandParser(
        description='Predict one throw, or many first releases from a CSV file.',
        usage='%(prog)s [OPTION ...]',
        argument_default=argparse.SUPPRESS,
    )
    group = parser.add_mutually_exclusive_group()
    group.add_argument(
        '--json', action='store_true', help='print one object: SI units, full precision'
    )
    group.add_argument(
        '--cases', metavar='FILE',
        help='CSV with the columns mu, kappa, zeta (- for standard input); '
        'the columns te_f and alpha are added, computed without gravity',
    )
    add_options(parser, ['max_strain'], title='range of a linear layer')
    add_options(parser, UNCERTAINTY_PARAMETERS, title='uncertainties')
    add_rig_options(parser)
    return parser


def _run(arguments: argparse.Namespace) -> int:
    options = vars(arguments)
    if 'cases' in options:
        for name in sorted(options.keys() - {'cases'}):
            raise ValueError(f'argument {option_of(name)}: not allowed with argument --cases')
        print_text(_compute_cases(options['cases']))
    else:
        settings = read_settings(arguments)
        with slow_notice('throw'):
            prediction = predict(settings)
        print_result(prediction, _table(prediction), as_json='json' in options)
    return 0


def predict(settings: Settings) -> Prediction:
    """
    Predict a throw.

    Parameters
    ----------
    settings : mapping of str to value
        Complete settings of the twin; only rig, uncertainties and `max_strain` matter.

    Returns
    -------
    Prediction
        All values are in SI units. `parameters` are the settings, `rig` has the ratios and times
        that govern a throw, `throw` the whole throw, `spring` the release from a layer without
        mass (App. A), and `uncertainty` the 95 % intervals of the first release. A part that does
        not support this throw is None, and its note contains the reason. `leaves_linear_range` is
        true if the strain is too large for a linear layer.

    """
    rig = rig_of(settings)
    throws: dict[str, ModelResult | None] = {}
    notes: dict[str, str] = {}
    for name, (simulated, note) in _THROWS.items():
        try:
            throws[name], notes[name] = simulated(rig), note
        except (ValueError, RuntimeError) as error:  # this rig is not supported
            throws[name], notes[name] = None, f'none, {error}'
    uncertainty = None
    try:
        intervals = prediction_uncertainty(rig, Uncertainties.from_settings(settings))
        uncertainty = intervals.values()
        notes['uncertainty'] = f'95 % of throws: {uncertainty_text(intervals)}'
    except ValueError as error:
        notes['uncertainty'] = f'none, {error}'
    if throws['throw'] and throws['throw']['ejection_time'] > rig.shock_time:
        notes['shocks'] = (
            f'the layer compresses into shocks after {1e3 * rig.shock_time:.3g} ms, before the '
            'release: ejection time and speed have errors up to 4e-3'
        )
    return {
        'parameters': {
            name: settings[name]
            for name in (*RIG_PARAMETERS, *UNCERTAINTY_PARAMETERS, 'max_strain')
        },
        'rig': {
            'mass_ratio': rig.mass_ratio,
            'speed_ratio': rig.speed_ratio,
            'frequency_ratio': rig.natural_frequency / rig.engine.frequency,
            'natural_frequency': rig.natural_frequency,
            'crossing_time': rig.crossing_time,
            'relaxation_time': rig.relaxation_time,
        },
        'throw': throws['throw'],
        'spring': throws['spring'],
        'uncertainty': uncertainty,
        'notes': notes,
        'leaves_linear_range': (throws['throw'] or {}).get('peak_strain', 0.0)
        > rig.layer.linear_range(settings['max_strain']),
    }


def _spring(rig: Rig) -> ModelResult:
    """Predict the first release from a layer without mass by the formula of App. A."""
    engine = rig.engine
    if engine.motion:
        raise ValueError('this formula is for a harmonic plate, got a file')
    release = spring_mass.first_release(frequency_ratio=rig.natural_frequency / engine.frequency)
    return {
        'ejection_time': float(release.ejection_phase) / engine.frequency,
        'ejection_phase': float(release.ejection_phase),
        'ejection_speed': float(release.speed) * engine.speed_scale,
        'peak_plate_speed': engine.speed_scale,
        'energy_transfer': float(release.energy_transfer),
    }


_OF_THROW = (
    'ejection_time', 'ejection_speed', 'peak_plate_speed', 'energy_transfer', 'recontacts',
    'last_energy_transfer', 'peak_strain',
)
"""Predictions with the name of an attribute of `Throw`."""


def _simulated(rig: Rig) -> ModelResult:
    """Simulate a throw to its end."""
    throw = simulate(rig)
    projectile, release = rig.projectile, throw.first_release
    rise = release.position - throw.rest_height
    energy = projectile.mass * (0.5 * release.velocity**2 + rig.gravity * rise)
    result: dict[str, float] = {name: getattr(throw, name) for name in _OF_THROW}
    result |= {
        'ejection_phase': throw.ejection_time * rig.engine.frequency,
        'last_ejection_time': throw.last_release.time,
        'last_ejection_speed': throw.last_release.velocity,
        'peak_plate_strain': throw.loads.plate_strain,
        'peak_contact_strain': throw.loads.contact_strain,
        'peak_acceleration': throw.loads.acceleration,
        'peak_plate_force': throw.loads.plate_force,
        'plate_work': throw.energies.plate_work,
        'layer_energy': throw.energies.stored - energy,
        'projectile_energy': energy,
    }
    if rig.gravity:
        result['apex_height'] = throw.apex_height
    if throw.energies.heat:
        result['heat'] = throw.energies.heat
    return result


_THROWS: Mapping[str, tuple[Callable[[Rig], ModelResult], str]] = {
    'throw': (_simulated, 'whole throw of a rigid projectile, as the twin computes it'),
    'spring': (_spring, 'layer without mass and loss, harmonic plate, no gravity (App. A)'),
}
"""Columns of the table, each with its function and a note."""


def _table(prediction: Prediction) -> Iterator[str]:
    """Yield the lines of a table with the result of `predict`."""
    rig = prediction['rig']
    yield (
        f'mu {rig["mass_ratio"]:.6g}, kappa {rig["speed_ratio"]:.6g}, '
        f'f0/f {rig["frequency_ratio"]:.6g}, t_s {1e3 * rig["crossing_time"]:.6g} ms'
    )
    yield ''
    yield from write_columns({'throw': prediction['throw'], 'spring': prediction['spring']})
    yield ''
    for name, note in prediction['notes'].items():
        yield f'{name}: {note}'
    if prediction['leaves_linear_range']:
        settings = prediction['parameters']
        max_strain = float(settings['max_strain'])  # type: ignore[arg-type]
        limit = rig_of(settings).layer.linear_range(max_strain)
        yield strain_warning(limit, '--max-strain')


_CASES: Mapping[str, Callable[[str], float]] = {
    'mu': positive,
    'kappa': positive,
    'zeta': number_type('at least 0 and below 1', lambda value: 0.0 <= value < 1.0),
}
"""Columns of a CSV file of cases, each with the function that reads its cells."""

_MAX_BYTES = 1 << 26
"""Size of a CSV file of cases [byte]: a million rows."""


def _compute_cases(path: str) -> str:
    """Compute the first release for every row of a CSV file; return the results as CSV."""
    name = 'standard input' if path == '-' else path
    with report_io_errors(name):
        if path == '-':
            text = sys.stdin.read()
        else:
            text = read_regular_file(path, max_bytes=_MAX_BYTES).decode()
    rows = _read_cases(text.split('\n'), name)
    if not rows:
        print_note('throw', f'{name} has no rows below its header')
    mu, kappa, zeta = np.array(list(rows.values())).reshape(-1, len(_CASES)).T
    with slow_notice('throw'):
        releases = first_releases(mass_ratio=mu, speed_ratio=kappa, damping_ratio=zeta)
    for i in np.flatnonzero(np.isnan(releases.ejection_phase)):
        try:
            first_release(mass_ratio=mu[i], speed_ratio=kappa[i], damping_ratio=zeta[i])
        except ThrowUnresolvedError as error:
            raise ValueError(f'{name}:{list(rows)[i]}: {error}') from None
    columns = np.array([mu, kappa, zeta, releases.ejection_phase, releases.energy_transfer])
    lines = [[*_CASES, 'te_f', 'alpha'], *columns.T.tolist()]
    return ''.join(','.join(map(str, line)) + '\n' for line in lines)


def _read_cases(lines: Iterable[str], name: str) -> dict[int, list[float]]:
    """Return the values of every row by its line number; the first row names the columns."""
    rows = list(read_rows(lines))
    header = rows[0][1] if rows else []
    if any(header.count(column) != 1 for column in _CASES):
        raise ValueError(
            f'{name}: the first row must name the columns {", ".join(_CASES)}, '
            f'got {",".join(header)!r}'
        )
    cases: dict[int, list[float]] = {}
    for number, cells in rows[1:]:
        named_cells = dict(zip(header, cells, strict=False))
        cases[number] = []
        for column, read in _CASES.items():
            try:
                cases[number].append(read(named_cells.get(column, '')))
            except argparse.ArgumentTypeError as error:
                raise ValueError(f'{name}:{number}: {column} {error}') from None
    return cases
