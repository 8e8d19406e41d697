# Copyright 2026 soft_throw_ros developers
#
# Licensed under the Apache License, Version 2.0 (the "License");
# you may not use this file except in compliance with the License.
# You may obtain a copy of the License at
#
#     http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software
# distributed under the License is distributed on an "AS IS" BASIS,
# WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied.
# See the License for the specific language governing permissions and
# limitations under the License.
"""
Predict one throw by every model, as a table or as JSON; or many first releases, from a CSV file.

Values are given like the parameters of the twin, and the same table says what is allowed.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterable, Mapping
import csv
import io
import math
from pathlib import Path
import sys
from typing import TypedDict

import numpy as np
from soft_throw_ros.commands.options import (
    add_options,
    add_rig_options,
    number_or_text,
    OPTIONS,
    read_settings,
    UNCERTAINTY_OPTIONS,
)
from soft_throw_ros.commands.output import (
    naming,
    print_text,
    run_command,
    slow_notice,
    strain_warning,
    to_json,
    write_columns,
)
from soft_throw_ros.configuration import rig_of, Settings, TWIN, Value
from soft_throw_ros.core import spring_mass
from soft_throw_ros.core.closed_form import first_release, first_releases, ThrowUnresolvedError
from soft_throw_ros.core.plate import Underdamped
from soft_throw_ros.core.rig import Engine, Rig
from soft_throw_ros.core.throw import simulate
from soft_throw_ros.design.requests import uncertainties_of
from soft_throw_ros.design.uncertainty import prediction_uncertainty

ModelResult = Mapping[str, float]
"""What a model predicts, by name and in SI units; what it does not know is left out."""


class Prediction(TypedDict):
    """What `--json` prints."""

    parameters: dict[str, Value]
    rig: dict[str, float]
    models: dict[str, ModelResult | None]
    uncertainty: dict[str, float | bool] | None
    notes: dict[str, str]
    leaves_linear_range: bool


def main(args: list[str] | None = None) -> int:
    """Run the command; return exit code 0."""
    return run_command(_parser(), _run, args)


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        description='Predict one throw by every model, or many first releases from a CSV file.',
        usage='%(prog)s [-h] [--config FILE] [--thickness M ...] [--model NAME ...] '
        '[--json | --cases FILE]',
        argument_default=argparse.SUPPRESS,
        allow_abbrev=False,
    )
    parser.add_argument(
        '--model', metavar='NAME', action='append', choices=tuple(MODELS),
        help=f'only this model; may be repeated: {", ".join(MODELS)} (default all)',
    )
    most = TWIN.by_name['max_strain']
    parser.add_argument(
        '--max-strain', metavar='NUMBER', type=number_or_text,
        help=f'{most.meaning}; {most.rule} (default {most.default:g})',
    )
    how = parser.add_mutually_exclusive_group()
    how.add_argument(
        '--json', action='store_true', help='print one object: SI units, full precision'
    )
    how.add_argument(
        '--cases', metavar='FILE',
        help='CSV with the columns mu, kappa, zeta, separated by commas (- for standard input); '
        'te_f and alpha are added to them, without gravity',
    )
    add_options(parser, UNCERTAINTY_OPTIONS, title='uncertainties')
    add_rig_options(parser)
    return parser


def _run(arguments: argparse.Namespace) -> int:
    given = vars(arguments)
    if 'cases' in given:
        text = _compute_cases(given)
    else:
        settings = read_settings(arguments)
        if 'max_strain' in given:
            settings['max_strain'] = TWIN.check_value('max_strain', given['max_strain'])
        with slow_notice('throw'):
            prediction = predict(settings, given.get('model', MODELS))
        text = to_json(prediction) if 'json' in given else table(prediction)
    print_text(text)
    return 0


MODELS: Mapping[str, str] = {
    'closed_form': 'first release of a rigid projectile on a lossless layer, exact',
    'travelling_wave': (
        'rigid projectile, lossless layer, the whole throw as the twin computes it'
    ),
    'finite_difference': 'rigid projectile, layer of cells with internal loss, to about 1e-4',
    'finite_difference_elastic': 'cells of the projectile, too; speeds of its centre of mass',
    'finite_difference_glued': (
        'layer glued to the projectile and thrown with it; speeds of both together'
    ),
    'spring_mass': 'layer without mass and loss, harmonic plate, no gravity (App. A)',
}
"""The models, and what is to be known about them."""


def predict(settings: Settings, names: Iterable[str]) -> Prediction:
    """
    Predict a throw by several models.

    Parameters
    ----------
    settings : mapping of str to value
        Complete settings; those of the twin itself do not matter.
    names : iterable of str
        Some of `MODELS`.

    Returns
    -------
    Prediction
        In SI units: `parameters`; the numbers that decide a throw, as `rig`; what each of the
        `models` says; the 95 % intervals of the first release, as `uncertainty`; `notes` about
        both; and whether the throw `leaves_linear_range`. A model that cannot do this throw is
        None, and its note says why.

    """
    rig = rig_of(settings)
    models: dict[str, ModelResult | None] = {}
    notes: dict[str, str] = {}
    for name in dict.fromkeys(names):
        try:
            models[name], notes[name] = _predict_by(name, rig), MODELS[name]
        except (ValueError, RuntimeError) as error:  # what the core raises for such a rig
            models[name], notes[name] = None, f'none, {error}'
    uncertainty = None
    try:
        found = prediction_uncertainty(rig, uncertainties_of(settings))
        uncertainty, notes['uncertainty'] = found.values(), f'95 % of throws: {found.describe()}'
    except ValueError as error:
        notes['uncertainty'] = f'none, {error}'
    strains = [(result or {}).get('peak_strain', 0.0) for result in models.values()]
    return {
        'parameters': {
            name: settings[name] for name in (*OPTIONS, *UNCERTAINTY_OPTIONS, 'max_strain')
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
    """Predict a throw by one model: its first release alone, or all of it."""
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
        # The formula of App. A knows neither damping nor gravity
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
    'last_energy_transfer', 'peak_strain', 'peak_plate_strain', 'peak_contact_strain',
    'peak_acceleration', 'peak_plate_force',
)
"""What is called as in `Throw`."""


def _simulated(model: str, rig: Rig) -> ModelResult:
    """Run a throw to its end."""
    throw = simulate(rig, model=model)
    result: dict[str, float] = {name: getattr(throw, name) for name in _OF_THROW}
    result |= {
        'ejection_phase': throw.ejection_time * rig.engine.frequency,
        'last_ejection_time': throw.last_release.time,
        'last_ejection_speed': throw.last_release.velocity,
        'plate_work': throw.energies.plate_work,
    }
    if model != 'finite_difference_glued':  # where the layer is thrown, too
        projectile, release = rig.projectile, throw.first_release
        rise = release.position - (rig.layer.thickness - rig.static_sag)
        energy = projectile.mass * (0.5 * release.velocity**2 + rig.gravity * rise)
        result |= {
            'layer_energy': throw.energies.stored - energy,
            'projectile_energy': energy,
        }
    if rig.gravity:
        result['apex_height'] = throw.apex_height
    if throw.heat:
        result['heat'] = throw.heat
    return result


def table(prediction: Prediction) -> str:
    """Write what `predict` returns for people to read."""
    rig = prediction['rig']
    numbers = (
        f'mu {rig["mass_ratio"]:.6g}, kappa {rig["speed_ratio"]:.6g}, '
        f'f0/f {rig["frequency_ratio"]:.6g}, t_s {1e3 * rig["crossing_time"]:.6g} ms'
    )
    lines = [numbers, '', *write_columns(prediction['models']), '']
    lines += [f'{name.replace("_", " ")}: {note}' for name, note in prediction['notes'].items()]
    if prediction['leaves_linear_range']:
        settings = prediction['parameters']
        largest = float(settings['max_strain'])  # type: ignore[arg-type]
        most = rig_of(settings).layer.linear_range(largest)
        lines.append(strain_warning(most, '--max-strain'))
    return '\n'.join(lines) + '\n'


_CASES = {
    'mu': ('finite and positive', lambda value: 0.0 < value < math.inf),
    'kappa': ('finite and positive', lambda value: 0.0 < value < math.inf),
    'zeta': ('at least 0 and below 1', lambda value: 0.0 <= value < 1.0),
}
"""The columns of a file of cases, and what may stand in them."""


def _compute_cases(given: Mapping[str, str]) -> str:
    """Compute the first release for every row of a CSV file, and write them as one."""
    other = sorted(given.keys() - {'cases'})
    if other:
        options = {**OPTIONS, **UNCERTAINTY_OPTIONS}
        option = options.get(other[0], '--' + other[0].replace('_', '-'))
        raise ValueError(f'argument {option}: not allowed with argument --cases')
    path = given['cases']
    name = 'standard input' if path == '-' else path
    with naming(name):
        if path == '-':
            rows = _read_cases(sys.stdin, name)
        else:
            with Path(path).open(encoding='utf-8-sig', newline='') as file:
                rows = _read_cases(file, name)
    if not rows:
        print(f'throw: {name} has no rows below its header', file=sys.stderr)
    mu, kappa, zeta = np.array(list(rows.values())).reshape(-1, len(_CASES)).T
    with slow_notice('throw'):
        found = first_releases(
            mass_ratio=mu, speed_ratio=kappa, damping_ratio=zeta, unresolved='nan'
        )
    for i in np.flatnonzero(np.isnan(found.ejection_phase)):
        try:
            first_release(mass_ratio=mu[i], speed_ratio=kappa[i], damping_ratio=zeta[i])
        except ThrowUnresolvedError as error:
            raise ValueError(f'{name}:{list(rows)[i]}: {error}') from None
    text = io.StringIO()
    writer = csv.writer(text, lineterminator='\n')
    writer.writerow([*_CASES, 'te_f', 'alpha'])
    columns = np.array([mu, kappa, zeta, found.ejection_phase, found.energy_transfer])
    writer.writerows(columns.T.tolist())
    return text.getvalue()


def _read_cases(file: Iterable[str], name: str) -> dict[int, list[float]]:
    """Return the values of every row by its line; the first line names the columns."""
    reader = csv.DictReader(file)
    rows: dict[int, list[float]] = {}
    try:
        header = [column.strip() for column in reader.fieldnames or ()]
        if any(header.count(column) != 1 for column in _CASES):
            raise ValueError(
                f'{name}:1: must name the columns {", ".join(_CASES)}, got {",".join(header)!r}'
                + ('; columns are separated by commas' if ';' in ''.join(header) else '')
            )
        reader.fieldnames = header
        for row in reader:
            where = f'{name}:{reader.line_num}'
            rows[reader.line_num] = [_case_value(column, row[column], where) for column in _CASES]
    except csv.Error as error:
        raise ValueError(f'{name}:{reader.line_num}: {error}') from None
    return rows


def _case_value(column: str, text: str | None, where: str) -> float:
    rule, allows = _CASES[column]
    if text is None:
        raise ValueError(f'{where}: the row ends before its value of {column}')
    value = number_or_text(text)
    if not isinstance(value, float) or not allows(value):
        raise ValueError(f'{where}: {column} must be a number, {rule}, got {text!r}')
    return value
