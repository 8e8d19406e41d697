# SPDX-License-Identifier: Apache-2.0
"""
Predict one throw by every model, as a table or as JSON; or many first releases, from a CSV file.

Values are given like the parameters of the twin, and the same table says what is allowed.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterable, Mapping, Sequence
import csv
from functools import partial
import io
import itertools
import json
import math
import os
from pathlib import Path
import sys
from typing import Any

import numpy as np
from soft_throw_ros.commands.columns import Row, write_columns
from soft_throw_ros.commands.patience import patience
from soft_throw_ros.commands.rig_options import (
    add_options,
    add_rig_options,
    number_or_text,
    OPTIONS,
    read_settings,
    UNCERTAINTY_OPTIONS,
)
from soft_throw_ros.configuration import ParameterError, rig_of, Settings, TWIN
from soft_throw_ros.configuration.twin_config import model_of
from soft_throw_ros.core import method_of_steps, spring_mass, stepping
from soft_throw_ros.core.plate import Underdamped
from soft_throw_ros.core.rig import Rig, STANDARD_GRAVITY
from soft_throw_ros.core.throw import simulate
from soft_throw_ros.core.travelling_wave import (
    first_release,
    first_releases,
    ThrowUnresolvedError,
)
from soft_throw_ros.design.requests import uncertainties_of
from soft_throw_ros.design.uncertainty import prediction_uncertainty
from soft_throw_ros.twin.core_adapter import make_stepper

Prediction = Mapping[str, float]
"""What a model says, by name and in SI units; what it does not know is left out."""

_LONGEST = 10.0  # the stepper is not followed any longer [s]


_ROWS = (
    Row('ejection_time', 'ejection time t_e', 'ms', 1e3),
    Row('ejection_phase', '  t_e f'),
    Row('ejection_speed', 'ejection speed V_e', 'm/s'),
    Row('peak_plate_speed', 'plate speed V_p*', 'm/s'),
    Row('energy_transfer', 'energy transfer alpha'),
    Row('recontacts', 're-contacts'),
    Row('last_ejection_time', 'last release', 'ms', 1e3),
    Row('last_ejection_speed', '  its speed', 'm/s'),
    Row('last_energy_transfer', '  its alpha'),
    Row('apex_height', 'apex', 'mm', 1e3),
    Row('peak_strain', 'peak strain', '%', 1e2),
    Row('peak_strain_depth', '  at y', 'mm', 1e3),
    Row('peak_plate_strain', '  at the plate', '%', 1e2),
    Row('peak_contact_strain', '  at the projectile', '%', 1e2),
    Row('peak_acceleration', 'peak acceleration', 'm/s2'),
    Row('peak_acceleration', '  in g', 'g', 1.0 / STANDARD_GRAVITY),
    Row('peak_plate_force', 'peak force on plate', 'N'),
    Row('plate_work', 'work of the plate', 'mJ', 1e3),
    Row('layer_energy', '  to the layer', 'mJ', 1e3),
    Row('projectile_energy', '  to the projectile', 'mJ', 1e3),
    Row('heat', '  to heat', 'mJ', 1e3),
)


class InputError(ValueError):
    """A file is not what it should be; the message says where, and what was found there."""


def main(args: list[str] | None = None) -> int:
    """
    Run the command.

    Parameters
    ----------
    args : list of str, optional
        Its arguments; those of the process by default.

    Returns
    -------
    int
        Exit code 0.

    Raises
    ------
    SystemExit
        With exit code 2 if something is refused, after a line that says what.

    """
    parser = _parser()
    arguments = parser.parse_args(args)
    given = vars(arguments)
    try:
        if 'cases' in given:
            other = sorted(given.keys() - {'cases', 'output'})
            if other:
                options = {**OPTIONS, **UNCERTAINTY_OPTIONS}
                option = options.get(other[0], '--' + other[0].replace('_', '-'))
                parser.error(f'argument {option}: not allowed with argument --cases')
            text = _release_cases_of(given['cases'])
        else:
            settings = read_settings(arguments)
            if 'max_strain' in given:
                settings['max_strain'] = TWIN.check_value('max_strain', given['max_strain'])
            with patience('throw'):
                throw = predict(settings, given.get('model', MODELS))
            text = (
                json.dumps(throw, indent=2, allow_nan=False) + '\n'
                if 'json' in given
                else table(throw)
            )
        _write(text, given.get('output'))
    except (ParameterError, InputError) as error:
        parser.error(str(error))
    return 0


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        description='Predict one throw by every model, or many first releases from a CSV file.',
        usage='%(prog)s [-h] [--config FILE] [--thickness M ...] [--model NAME ...] '
        '[--json | --cases FILE] [--output FILE]',
        argument_default=argparse.SUPPRESS,
        allow_abbrev=False,
    )
    parser.add_argument(
        '--model',
        metavar='NAME',
        action='append',
        choices=tuple(MODELS),
        help=f'only this model; may be repeated: {", ".join(MODELS)} (default all)',
    )
    most = TWIN.by_name['max_strain']
    parser.add_argument(
        '--max-strain',
        metavar='NUMBER',
        type=number_or_text,
        help=f'{most.meaning}; {most.rule} (default {most.default:g})',
    )
    how = parser.add_mutually_exclusive_group()
    how.add_argument(
        '--json', action='store_true', help='print one object: SI units, full precision'
    )
    how.add_argument(
        '--cases',
        metavar='FILE',
        help='CSV with the columns mu, kappa, zeta (- for standard input); '
        'te_f and alpha are added to them, without gravity',
    )
    parser.add_argument('--output', metavar='FILE', help='write there, not to standard output')
    add_options(parser, UNCERTAINTY_OPTIONS, title='uncertainties')
    add_rig_options(parser)
    return parser


def _write(text: str, output: str | None) -> None:
    if output is not None:
        try:
            Path(output).write_text(text, encoding='utf-8')
        except OSError as error:
            raise InputError(f'{output}: {error.strerror}') from None
        return
    try:
        sys.stdout.write(text)
        sys.stdout.flush()
    except BrokenPipeError:
        # The reader has seen enough. Python would complain once more when it exits.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


def predict(settings: Settings, names: Iterable[str]) -> dict[str, Any]:
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
    dict
        What `--json` prints, in SI units: `parameters`; the numbers that decide a throw, as
        `rig`; what each of the `models` says; how far the first release may be off, as
        `uncertainty`; `notes` about both; and whether the throw `leaves_linear_range`. A model
        that cannot do this throw is None, and its note says why.

    """
    rig = rig_of(settings)
    models: dict[str, Prediction | None] = {}
    notes: dict[str, str] = {}
    for name in dict.fromkeys(names):
        model, note = MODELS[name]
        try:
            models[name], notes[name] = model(settings), note
        except (ValueError, RuntimeError) as error:  # what the core raises for such a rig
            models[name], notes[name] = None, f'none, {error}'
    uncertainty = None
    try:
        found = prediction_uncertainty(rig, uncertainties_of(settings))
        uncertainty, notes['uncertainty'] = found.values(), found.sentence()
    except ValueError as error:
        notes['uncertainty'] = f'none, {error}'
    strains = [
        value
        for prediction in models.values()
        for key, value in (prediction or {}).items()
        if key in ('peak_strain', 'peak_plate_strain')
    ]
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
        'leaves_linear_range': max(strains, default=0.0) > settings['max_strain'],
    }


def _simulated(model: str, settings: Settings) -> Prediction:
    throw = simulate(rig_of(settings), model=model)
    rig = throw.rig
    prediction = {
        **_first(rig, throw.ejection_time, throw.ejection_speed, throw.peak_plate_speed),
        **_last(rig, throw.ejections, throw.last_release.position, throw.peak_plate_speed),
        'peak_strain': throw.peak_strain.value,
        'peak_strain_depth': throw.peak_strain.depth,
        'peak_plate_strain': throw.peak_plate_strain,
        'peak_contact_strain': throw.peak_contact_strain,
        'peak_acceleration': throw.peak_acceleration,
        'peak_plate_force': throw.peak_plate_force,
        'plate_work': throw.energies.plate_work,
        'layer_energy': throw.energies.layer,
        'projectile_energy': throw.energies.projectile,
    }
    return _with_heat(prediction, throw.heat)


def _stepped(settings: Settings) -> Prediction:
    rig = rig_of(settings)
    model = make_stepper(rig, model_of(settings), None, field_points=2).inner
    ejections = _follow(model)
    first = ejections[0]
    plate_speed = Underdamped.of(rig.engine).peak_velocity
    model.reset()
    model.advance_to(first.time)
    rise = model.state[stepping.PROJECTILE_POSITION] - model.rest_position
    projectile_energy = rig.projectile.mass * (0.5 * first.velocity**2 + rig.gravity * rise)
    prediction = {
        **_first(rig, first.time, first.velocity, plate_speed),
        'peak_plate_strain': model.first_peaks.plate_strain,
        'peak_contact_strain': model.first_peaks.contact_strain,
        'peak_acceleration': model.first_peaks.acceleration,
        'peak_plate_force': model.first_peaks.plate_force,
        'plate_work': model.work,
        'layer_energy': model.stored_energy() - projectile_energy,
        'projectile_energy': float(projectile_energy),
    }
    heat = model.dissipated
    model.advance_to(ejections[-1].time)
    height = float(model.state[stepping.PROJECTILE_POSITION])
    return _with_heat({**prediction, **_last(rig, ejections, height, plate_speed)}, heat)


def _by_spring_mass(settings: Settings) -> Prediction:
    rig = rig_of(settings)
    release = spring_mass.first_release(
        frequency_ratio=rig.natural_frequency / rig.engine.frequency
    )
    return _first(
        rig,
        float(release.ejection_phase) / rig.engine.frequency,
        float(release.speed) * rig.engine.speed_scale,
        rig.engine.speed_scale,
    )


MODELS: Mapping[str, tuple[Callable[[Settings], Prediction], str]] = {
    'travelling_wave': (
        partial(_simulated, 'travelling_wave'),
        'exact for a rigid projectile on a lossless layer',
    ),
    'stepper': (_stepped, 'as the twin follows it in real time'),
    'finite_difference': (
        partial(_simulated, 'finite_difference'),
        'to about 1e-4, with internal loss',
    ),
    'finite_difference_elastic': (
        partial(_simulated, 'finite_difference_elastic'),
        'the same with an elastic projectile, whose centre of mass it is',
    ),
    'finite_difference_glued': (
        partial(_simulated, 'finite_difference_glued'),
        'layer glued to the projectile, thrown along; speeds of both together',
    ),
    'spring_mass': (
        _by_spring_mass,
        'layer without mass and loss, harmonic plate, no gravity (App. A)',
    ),
}
"""How each of the models predicts, and what is to be known about it."""


def _with_heat(prediction: Prediction, heat: float) -> Prediction:
    return {**prediction, 'heat': heat} if heat else prediction


def _first(rig: Rig, time: float, speed: float, plate_speed: float) -> dict[str, float]:
    """Describe the first release."""
    return {
        'ejection_time': time,
        'ejection_phase': time * rig.engine.frequency,
        'ejection_speed': speed,
        'peak_plate_speed': plate_speed,
        'energy_transfer': (speed / plate_speed) ** 2,
    }


def _last(
    rig: Rig,
    ejections: Sequence[method_of_steps.Event | stepping.Event],
    height: float,
    plate_speed: float,
) -> dict[str, float]:
    """Describe the last of the releases, at which the projectile was at a height."""
    speed = ejections[-1].velocity
    description = {
        'recontacts': len(ejections) - 1,
        'last_ejection_time': ejections[-1].time,
        'last_ejection_speed': speed,
        'last_energy_transfer': (speed / plate_speed) ** 2,
    }
    if rig.gravity:
        description['apex_height'] = height + max(speed, 0.0) ** 2 / (2.0 * rig.gravity)
    return description


def _follow(model: stepping.ThrowStepper) -> list[stepping.Event]:
    """Step until the projectile falls back on the layer, and return the releases before."""
    ejections: list[stepping.Event] = []
    for time in np.linspace(0.0, _LONGEST, 101)[1:]:
        model.advance_to(time)
        before_fall = list(
            itertools.takewhile(
                lambda event: event.kind == 'release' or event.velocity > 0.0, model.events()
            )
        )
        ejections = [event for event in before_fall if event.kind == 'release']
        if len(before_fall) < model.event_count:
            break
    if not ejections:
        raise ValueError(f'the projectile is not released within {_LONGEST:g} s')
    return ejections


def table(throw: Mapping[str, Any]) -> str:
    """Write what `predict` returns for people to read."""
    rig, models = throw['rig'], throw['models']
    numbers = (
        f'mu {rig["mass_ratio"]:.6g}, kappa {rig["speed_ratio"]:.6g}, '
        f'f0/f {rig["frequency_ratio"]:.6g}, t_s {1e3 * rig["crossing_time"]:.6g} ms'
    )
    lines = [numbers, '', *write_columns(_ROWS, models)]
    lines.append('')
    lines += [f'{name.replace("_", " ")}: {note}' for name, note in throw['notes'].items()]
    if throw['leaves_linear_range']:
        lines.append(
            f'Strain beyond {1e2 * throw["parameters"]["max_strain"]:.3g} % leaves the linear '
            'range (--max-strain): a real layer will do otherwise.'
        )
    return '\n'.join(lines) + '\n'


_CASES = {
    'mu': ('finite and positive', lambda value: 0.0 < value < math.inf),
    'kappa': ('finite and positive', lambda value: 0.0 < value < math.inf),
    'zeta': ('at least 0 and below 1', lambda value: 0.0 <= value < 1.0),
}
"""The columns of a file of cases, and what may stand in them."""


def _release_cases_of(path: str) -> str:
    """Open the file for `release_cases`."""
    if path == '-':
        return release_cases(sys.stdin, 'standard input')
    try:
        with Path(path).open(encoding='utf-8-sig', newline='') as file:
            return release_cases(file, path)
    except OSError as error:
        raise InputError(f'{path}: {error.strerror}') from None


def release_cases(file: Iterable[str], name: str) -> str:
    """
    Compute the first release for every row of a CSV file.

    Parameters
    ----------
    file : iterable of str
        Its lines, of which the first names the columns: `mu`, `kappa` and `zeta`, in any order
        and among others.
    name : str
        What to call it if something is wrong.

    Returns
    -------
    str
        CSV with the columns `mu`, `kappa`, `zeta`, `te_f` and `alpha`, row for row.

    Raises
    ------
    InputError
        Naming file, line and value.

    """
    lines, rows = _read_cases(file, name)
    mu, kappa, zeta = np.array(rows).reshape(-1, len(_CASES)).T
    with patience('throw'):
        releases = first_releases(
            mass_ratio=mu, speed_ratio=kappa, damping_ratio=zeta, unresolved='nan'
        )
    for i in np.flatnonzero(np.isnan(releases.ejection_phase)):
        try:
            first_release(mass_ratio=mu[i], speed_ratio=kappa[i], damping_ratio=zeta[i])
        except ThrowUnresolvedError as error:
            raise InputError(f'{name}:{lines[i]}: {error}') from None
    text = io.StringIO()
    writer = csv.writer(text, lineterminator='\n')
    writer.writerow([*_CASES, 'te_f', 'alpha'])
    columns = np.array([mu, kappa, zeta, releases.ejection_phase, releases.energy_transfer])
    writer.writerows(columns.T.tolist())
    return text.getvalue()


def _read_cases(file: Iterable[str], name: str) -> tuple[list[int], list[list[float]]]:
    """Return the line and the values of every row."""
    reader = csv.reader(file)
    lines: list[int] = []
    rows: list[list[float]] = []
    try:
        header = [column.strip() for column in next(reader, [])]
        if any(header.count(column) != 1 for column in _CASES):
            raise InputError(
                f'{name}:1: must name the columns {", ".join(_CASES)}, got {",".join(header)!r}'
            )
        places = [header.index(column) for column in _CASES]
        for row in reader:
            if row:  # the line is not empty
                where = f'{name}:{reader.line_num}'
                try:
                    texts = [row[place] for place in places]
                except IndexError:
                    raise InputError(
                        f'{where}: must have {len(header)} values, got {row}'
                    ) from None
                rows.append(
                    [_case_value(*pair, where) for pair in zip(_CASES, texts, strict=True)]
                )
                lines.append(reader.line_num)
    except csv.Error as error:
        raise InputError(f'{name}:{reader.line_num}: {error}') from None
    except UnicodeDecodeError:
        raise InputError(f'{name}: is no UTF-8 text') from None
    return lines, rows


def _case_value(column: str, text: str, where: str) -> float:
    rule, allows = _CASES[column]
    value = number_or_text(text)
    if not isinstance(value, float) or not allows(value):
        raise InputError(f'{where}: {column} must be a number, {rule}, got {text!r}')
    return value
