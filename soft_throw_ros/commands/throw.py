# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
Predict one throw by every model, as a table or as JSON; or many first releases, from a CSV file.

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
from soft_throw_ros.core.models import MODELS
from soft_throw_ros.core.plate import Underdamped
from soft_throw_ros.core.rig import Engine, Rig
from soft_throw_ros.core.throw import simulate
from soft_throw_ros.design.uncertainty import prediction_uncertainty, Uncertainties
from soft_throw_ros.storage.regular_file import read_regular_file

ModelResult = Mapping[str, float]
"""Predictions of a model by name, in SI units; predictions that it cannot make are absent."""


class Prediction(TypedDict):
    """Output of `--json`."""

    parameters: dict[str, Value]
    rig: dict[str, float]
    models: dict[str, ModelResult | None]
    uncertainty: dict[str, float | bool] | None
    notes: dict[str, str]
    leaves_linear_range: bool


def main(args: list[str] | None = None) -> int:
    """Run the command; return exit code 0."""
    return run_command(_parser(), _run, args)


def _parser() -> CommandParser:
    parser = CommandParser(
        description='Predict one throw by every model, or many first releases from a CSV file.',
        usage='%(prog)s [OPTION ...]',
        argument_default=argparse.SUPPRESS,
    )
    parser.add_argument(
        '--model', metavar='NAME', action='append', choices=tuple(MODEL_NOTES),
        help=f'only this model; may be repeated: {", ".join(MODEL_NOTES)} (default all)',
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
    add_options(parser, ['max_strain'], title='range of the linear models')
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
            prediction = predict(settings, options.get('model', MODEL_NOTES))
        print_result(prediction, _table(prediction), as_json='json' in options)
    return 0


MODEL_NOTES: Mapping[str, str] = {
    'closed_form': 'first release of a rigid projectile on a lossless layer, exact',
    'travelling_wave': (
        'rigid projectile, lossless layer, whole throw, as computed by the twin'
    ),
    'cells': 'rigid projectile, layer of cells with internal loss, to about 1e-4',
    'cells_elastic': "cells of layer and projectile; speeds of the projectile's centre of mass",
    'cells_glued': (
        'layer glued to the projectile and released together; speeds of both together'
    ),
    'spring_mass': 'layer without mass and loss, harmonic plate, no gravity (App. A)',
}
"""Models of the command (those of the twin and the closed form), each with a note."""


def predict(settings: Settings, names: Iterable[str]) -> Prediction:
    """
    Predict a throw by several models.

    Parameters
    ----------
    settings : mapping of str to value
        Complete settings of the twin; only rig, uncertainties and `max_strain` matter.
    names : iterable of str
        Names of models, keys of `MODEL_NOTES`.

    Returns
    -------
    Prediction
        All values are in SI units. `parameters` are the settings, `rig` has the ratios and times
        that govern a throw, `models` the predictions, and `uncertainty` the 95 % intervals of
        the first release. `notes` explain models and uncertainty; a note `shocks` warns of
        shocks in a neo-Hookean layer. A model that does not support this throw is None, and its
        note contains the reason. `leaves_linear_range` is true if the strain is too large for
        the linear models.

    """
    rig = rig_of(settings)
    models: dict[str, ModelResult | None] = {}
    notes: dict[str, str] = {}
    for name in dict.fromkeys(names):
        try:
            models[name], notes[name] = _predict_by(name, rig), MODEL_NOTES[name]
        except (ValueError, RuntimeError) as error:  # the model does not support this rig
            models[name], notes[name] = None, f'none, {error}'
    uncertainty = None
    try:
        intervals = prediction_uncertainty(rig, Uncertainties.from_settings(settings))
        uncertainty = intervals.values()
        notes['uncertainty'] = f'95 % of throws: {uncertainty_text(intervals)}'
    except ValueError as error:
        notes['uncertainty'] = f'none, {error}'
    times = [
        result['ejection_time']
        for name, result in models.items()
        if result and name in MODELS and MODELS[name].batch == 'cells'
    ]
    if max(times, default=0.0) > rig.shock_time:
        notes['shocks'] = (
            f'the layer compresses into shocks after {1e3 * rig.shock_time:.3g} ms, before the '
            'release: ejection time and speed of models with cells have errors up to 4e-3'
        )
    strains = [(result or {}).get('peak_strain', 0.0) for result in models.values()]
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
        'models': models,
        'uncertainty': uncertainty,
        'notes': notes,
        'leaves_linear_range': max(strains, default=0.0)
        > rig.layer.linear_range(settings['max_strain']),
    }


def _predict_by(model: str, rig: Rig) -> ModelResult:
    """Predict the first release, or the whole throw, with one model."""
    engine = rig.engine
    if engine.motion and model in ('closed_form', 'spring_mass'):
        raise ValueError('this formula is for underdamped and harmonic plates, got a file')
    if model == 'closed_form':
        rig.check_for_waves()
        first = first_release(
            mass_ratio=rig.mass_ratio,
            speed_ratio=rig.speed_ratio,
            damping_ratio=engine.damping_ratio,
            gravity_ratio=rig.gravity_ratio,
        )
        fastest = Underdamped.of(engine).peak_velocity
        return _release(engine, float(first.ejection_phase), float(first.speed), fastest)
    if model == 'spring_mass':
        # The formula of App. A neglects damping and gravity
        spring = spring_mass.first_release(
            frequency_ratio=rig.natural_frequency / engine.frequency
        )
        return _release(
            engine, float(spring.ejection_phase), float(spring.speed), engine.speed_scale
        )
    return _simulated(model, rig)


def _release(engine: Engine, phase: float, speed_ratio: float, fastest: float) -> dict[str, float]:
    """Describe a first release at a phase t_e f with a speed V_e / (A w)."""
    speed = speed_ratio * engine.speed_scale
    return {
        'ejection_time': phase / engine.frequency,
        'ejection_phase': phase,
        'ejection_speed': speed,
        'peak_plate_speed': fastest,
        'energy_transfer': (speed / fastest) ** 2,
    }


_OF_THROW = (
    'ejection_time', 'ejection_speed', 'peak_plate_speed', 'energy_transfer', 'recontacts',
    'last_energy_transfer', 'peak_strain',
)
"""Predictions with the name of an attribute of `Throw`."""


def _simulated(model: str, rig: Rig) -> ModelResult:
    """Simulate a throw to its end."""
    throw = simulate(rig, model=model)
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
    }
    if not MODELS[model].is_on_projectile:  # where the layer is thrown, too
        projectile, release = rig.projectile, throw.first_release
        rise = release.position - throw.rest_height
        energy = projectile.mass * (0.5 * release.velocity**2 + rig.gravity * rise)
        result |= {
            'layer_energy': throw.energies.stored - energy,
            'projectile_energy': energy,
        }
    if rig.gravity:
        result['apex_height'] = throw.apex_height
    if throw.energies.heat:
        result['heat'] = throw.energies.heat
    return result


def _table(prediction: Prediction) -> Iterator[str]:
    """Yield the lines of a table with the result of `predict`."""
    rig = prediction['rig']
    yield (
        f'mu {rig["mass_ratio"]:.6g}, kappa {rig["speed_ratio"]:.6g}, '
        f'f0/f {rig["frequency_ratio"]:.6g}, t_s {1e3 * rig["crossing_time"]:.6g} ms'
    )
    yield ''
    yield from write_columns(prediction['models'])
    yield ''
    for name, note in prediction['notes'].items():
        yield f'{name.replace("_", " ")}: {note}'
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
