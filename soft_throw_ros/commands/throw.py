# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
Predict one throw by every model, as a table or as JSON.

The options are the parameters of the twin, with the same ranges.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterable, Iterator, Mapping
from typing import TypedDict

from soft_throw_ros.commands.design_texts import uncertainty_text
from soft_throw_ros.commands.options import (
    add_rig_options,
    MAIN_PARAMETERS,
    read_settings,
    UNCERTAINTY_PARAMETERS,
)
from soft_throw_ros.commands.output import (
    CommandParser,
    print_result,
    run_command,
    slow_notice,
    strain_warning,
    write_columns,
)
from soft_throw_ros.configuration import rig_of, Settings, Value
from soft_throw_ros.configuration.twin import RIG_PARAMETERS
from soft_throw_ros.core import spring_mass
from soft_throw_ros.core.closed_form import first_release
from soft_throw_ros.core.models import MODELS
from soft_throw_ros.core.plate import Underdamped
from soft_throw_ros.core.rig import Engine, Rig
from soft_throw_ros.core.throw import simulate
from soft_throw_ros.design.uncertainty import prediction_uncertainty, Uncertainties

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
        description='Predict one throw by every model.',
        usage='%(prog)s [OPTION ...]',
    )
    parser.add_argument(
        '--model', dest='models', metavar='NAME', action='append', choices=tuple(MODEL_NOTES),
        help=f'only this model; may be repeated: {", ".join(MODEL_NOTES)} (default all)',
    )
    parser.add_json_option()
    add_rig_options(parser, MAIN_PARAMETERS)
    return parser


def _run(arguments: argparse.Namespace) -> int:
    settings = read_settings(arguments)
    with slow_notice('throw'):
        prediction = predict(settings, arguments.models or MODEL_NOTES)
    print_result(prediction, _table(prediction), as_json=arguments.json)
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
        yield strain_warning(limit, 'max_strain')
