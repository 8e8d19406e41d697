# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
Predict one throw: the answer in a line, all of it with `--verbose`, or as JSON.

The options are the parameters of the twin, with the same ranges.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterator, Mapping
from typing import Any

from soft_throw_ros.commands.design_texts import uncertainty_text
from soft_throw_ros.commands.options import (
    add_rig_options,
    read_settings,
    UNCERTAINTY_PARAMETERS,
)
from soft_throw_ros.commands.output import (
    CommandParser,
    print_result,
    run_command,
    slow_notice,
    strain_warnings,
    write_columns,
)
from soft_throw_ros.configuration import rig_of, Settings
from soft_throw_ros.configuration.twin import RIG_PARAMETERS
from soft_throw_ros.core import spring_mass
from soft_throw_ros.core.rig import Rig
from soft_throw_ros.core.throw import simulate
from soft_throw_ros.design.uncertainty import prediction_uncertainty, Uncertainties

ModelResult = Mapping[str, float]
"""Predictions by name, in SI units."""

Prediction = dict[str, Any]
"""Output of `--json`, see `predict`."""


def main(args: list[str] | None = None) -> int:
    """Run the command; return exit code 0, or 1 without a throw."""
    parser = CommandParser(description='Predict one throw.', usage='%(prog)s [OPTION ...]')
    parser.add_json_option()
    parser.add_argument('--verbose', action='store_true', help='print all predictions')
    add_rig_options(parser)
    return run_command(parser, _run, args)


def _run(arguments: argparse.Namespace) -> int:
    settings = read_settings(arguments)
    with slow_notice('throw'):
        prediction = predict(settings)
    lines = _lines(prediction, arguments.verbose)
    print_result(prediction, lines, as_json=arguments.json)
    return 0 if prediction['throw'] else 1


def predict(settings: Settings) -> Prediction:
    """
    Predict a throw.

    Parameters
    ----------
    settings : mapping of str to value
        Complete settings of the twin; only rig and uncertainties matter.

    Returns
    -------
    dict
        All values are in SI units. `parameters` are the settings, `rig` has the ratios and times
        that govern a throw, `throw` the whole throw, `spring` the release from a layer without
        mass (App. A), and `uncertainty` the 95 % intervals of the first release. A part that does
        not support this throw is None, and its note in `notes` contains the reason.
        `leaves_linear_range` is true if the strain is too large for a linear layer.

    """
    rig = rig_of(settings)
    parts: dict[str, Mapping[str, float] | None] = {}
    notes: dict[str, str] = {}
    for name, (compute, note) in _PARTS.items():
        try:
            parts[name], notes[name] = compute(rig, settings), note
        except (ValueError, RuntimeError) as error:  # this rig is not supported
            parts[name], notes[name] = None, f'none, {error}'
    return {
        'parameters': {
            name: settings[name]
            for name in (*RIG_PARAMETERS, *UNCERTAINTY_PARAMETERS)
        },
        'rig': {
            'mass_ratio': rig.mass_ratio,
            'speed_ratio': rig.speed_ratio,
            'frequency_ratio': rig.natural_frequency / rig.engine.frequency,
            'natural_frequency': rig.natural_frequency,
            'crossing_time': rig.crossing_time,
            'relaxation_time': rig.relaxation_time,
        },
        **parts,
        'notes': notes,
        'leaves_linear_range': (parts['throw'] or {}).get('peak_strain', 0.0)
        > rig.layer.linear_range,
    }


def _spring(rig: Rig, _settings: Settings) -> ModelResult:
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


def _simulated(rig: Rig, _settings: Settings) -> ModelResult:
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


def _uncertainty(rig: Rig, settings: Settings) -> ModelResult:
    """Compute the intervals of the first release."""
    return prediction_uncertainty(rig, Uncertainties.from_settings(settings)).values()


_PARTS: Mapping[str, tuple[Callable[[Rig, Settings], ModelResult], str]] = {
    'throw': (_simulated, 'whole throw of a rigid projectile, as the twin computes it'),
    'spring': (_spring, 'layer without mass and loss, harmonic plate, no gravity (App. A)'),
    'uncertainty': (_uncertainty, '95 % of all throws within uncertainty.*'),
}
"""Parts of a prediction, each with its function and a note."""


def _lines(prediction: Prediction, is_verbose: bool) -> Iterator[str]:
    """Yield the answer, its uncertainty and warnings, and everything else if asked for."""
    throw, uncertainty = prediction['throw'], prediction['uncertainty']
    if throw:
        yield (
            f'released at {1e3 * throw["ejection_time"]:.4g} ms, '
            f'{throw["ejection_speed"]:.5g} m/s, alpha {throw["energy_transfer"]:.4g}'
        )
    else:
        yield f'no throw: {prediction["notes"]["throw"].removeprefix("none, ")}'
    if uncertainty:
        yield f'With the uncertainties (uncertainty.*): {uncertainty_text(uncertainty)}'
    limit = rig_of(prediction['parameters']).layer.linear_range
    yield from strain_warnings(limit, {'throw': throw})
    if is_verbose:
        rig = prediction['rig']
        yield ''
        yield (
            f'mu {rig["mass_ratio"]:.6g}, kappa {rig["speed_ratio"]:.6g}, '
            f'f0/f {rig["frequency_ratio"]:.6g}, t_s {1e3 * rig["crossing_time"]:.6g} ms'
        )
        yield from write_columns({'throw': throw, 'spring': prediction['spring']})
        yield from (f'{name}: {note}' for name, note in prediction['notes'].items())
