# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
Predict one throw: the answer in a line, all of it with `--verbose`, or as JSON.

The options are the parameters of the twin, with the same ranges.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from typing import Any

from soft_throw_ros.commands import options, output
from soft_throw_ros.configuration import rig_of, Settings, TWIN
from soft_throw_ros.configuration.twin import RIG_PARAMETERS
from soft_throw_ros.core.closed_form import spring_release
from soft_throw_ros.core.rig import Rig
from soft_throw_ros.core.throw import simulate
from soft_throw_ros.design.prediction import prediction_uncertainty, Uncertainties

_OF_RIG = (
    'natural_frequency', 'mass_ratio', 'speed_ratio', 'crossing_time', 'relaxation_time',
)
_OF_THROW = (
    'ejection_time', 'ejection_speed', 'peak_plate_speed', 'energy_transfer', 'apex_height',
    'plate_work', 'heat',
)
_NOTES = {
    'throw': 'whole throw of a rigid projectile, as the twin computes it',
    'spring': 'layer without mass and loss, harmonic plate, no gravity (App. A)',
    'uncertainty': '95 % of all throws within uncertainty.*',
}
"""Parts of a prediction."""


def main(args: list[str] | None = None) -> int:
    """Run the command; return exit code 0, or 1 without a throw."""
    parser = output.CommandParser(description='Predict one throw.', usage='%(prog)s [OPTION ...]')
    parser.add_json_option()
    parser.add_argument('--verbose', action='store_true', help='print all predictions')
    options.add_rig_options(parser)
    return output.run_command(parser, _run, args, compiles=True)


def _run(arguments: argparse.Namespace) -> int:
    settings = options.read_settings(arguments)
    prediction = predict(settings)
    lines = _lines(prediction, rig_of(settings), arguments.verbose)
    uncertainty = prediction['uncertainty']
    data = {**prediction, 'uncertainty': uncertainty and uncertainty.values()}
    output.print_result(data, lines, as_json=arguments.json)
    return 0 if prediction['throw'] else 1


def predict(settings: Settings) -> dict[str, Any]:
    """
    Predict a throw from the complete settings of the twin, in SI units.

    A part of the prediction that is impossible for this throw is None; its note has the reason.
    """
    rig, uncertainties = rig_of(settings), Uncertainties.from_settings(settings)
    parts: dict[str, Any] = {}
    notes = dict(_NOTES)
    for name, compute in (
        ('throw', lambda: _simulated(rig)),
        ('spring', lambda: _spring(rig)),
        ('uncertainty', lambda: prediction_uncertainty(rig, uncertainties)),
    ):
        try:
            parts[name] = compute()
        except (ValueError, RuntimeError) as error:  # this rig is not supported
            parts[name], notes[name] = None, f'none, {error}'
    throw = parts['throw']
    return {
        'parameters': {
            name: settings[name] for name in (*RIG_PARAMETERS, *TWIN.names_in('uncertainty'))
        },
        'rig': {
            'frequency_ratio': rig.natural_frequency / rig.engine.frequency,
            **{name: getattr(rig, name) for name in _OF_RIG},
        },
        **parts,
        'notes': notes,
        'leaves_linear_range': bool(throw) and throw['peak_strain'] > rig.layer.linear_range,
    }


def _spring(rig: Rig) -> dict[str, float]:
    """Predict the first release from a layer without mass by the formula of App. A."""
    engine = rig.engine
    if engine.motion:
        raise ValueError('this formula is for a harmonic plate, got a file')
    release = spring_release(frequency_ratio=rig.natural_frequency / engine.frequency)
    phase = float(release.ejection_phase)
    return {
        'ejection_time': phase / engine.frequency,
        'ejection_phase': phase,
        'ejection_speed': float(release.speed) * engine.speed_scale,
        'peak_plate_speed': engine.speed_scale,
        'energy_transfer': float(release.energy_transfer),
    }


def _simulated(rig: Rig) -> dict[str, float]:
    """Simulate a throw to its end."""
    throw = simulate(rig)
    mass, release, loads = rig.projectile.mass, throw.events[0], throw.loads
    rise = release.position - rig.rest_height
    projectile_energy = mass * (0.5 * release.velocity**2 + rig.gravity * rise)
    return {
        **{name: getattr(throw, name) for name in _OF_THROW},
        'ejection_phase': throw.ejection_time * rig.engine.frequency,
        'recontacts': len(throw.ejections) - 1,
        'last_ejection_time': throw.last_release.time,
        'last_ejection_speed': throw.last_release.velocity,
        'last_energy_transfer': (throw.last_release.velocity / throw.peak_plate_speed) ** 2,
        **{f'peak_{name}': value for name, value in loads._asdict().items()},
        'layer_energy': throw.plate_work - throw.heat - projectile_energy,
        'projectile_energy': projectile_energy,
    }


def _lines(prediction: dict[str, Any], rig: Rig, is_verbose: bool) -> Iterator[str]:
    """Yield the answer, its uncertainty and warnings, and everything else if asked for."""
    throw, uncertainty, notes = (prediction[name] for name in ('throw', 'uncertainty', 'notes'))
    if throw:
        yield (
            f'released at {1e3 * throw["ejection_time"]:.4g} ms, '
            f'{throw["ejection_speed"]:.5g} m/s, alpha {throw["energy_transfer"]:.4g}'
        )
    else:
        yield f'no throw: {notes["throw"].removeprefix("none, ")}'
    if uncertainty:
        yield f'With the uncertainties (uncertainty.*): {uncertainty}'
    yield from output.strain_warnings(rig.layer.linear_range, {'throw': throw})
    if is_verbose:
        yield ''
        for columns in (('rig',), ('throw', 'spring')):
            yield from output.table({name: prediction[name] for name in columns})
        yield from (f'{name}: {note}' for name, note in notes.items())
