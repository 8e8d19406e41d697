# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Find the wave speed of a material from tracks of layers that ring freely."""

from __future__ import annotations

import argparse

from soft_throw_ros.commands import options, output
from soft_throw_ros.commands.identify_input import add_track_options, read_layer
from soft_throw_ros.commands.identify_report import held_rows, IdentificationReport, Row
from soft_throw_ros.configuration import rig_of, TWIN
from soft_throw_ros.identification.fit_description import DEFAULT_IS_ANOTHER_RIG, values_of
from soft_throw_ros.identification.ringing import fit_period, fit_wave_speed

_SIGNIFICANCE = 1e-4  # probability of a disagreement by chance, below which a warning says so


def main(args: list[str] | None = None) -> int:
    """Run the command; return exit code 0. Warnings go to standard error."""
    usage = '%(prog)s [OPTION ...] M FILE [M FILE ...]'
    parser = output.CommandParser(description=__doc__, usage=usage)
    add = parser.add_argument
    add('layers', metavar='M FILE', nargs='+',
        help='thickness of a layer, and a CSV file with a time [s] and heights of bottom and top')
    add('--thickness-error', metavar='M', type=options.not_negative, default=1e-4,
        help='standard error of the thicknesses (default %(default)g)')
    add('--output', metavar='FILE', type=options.new_file(), help='parameter file of the twin')
    parser.add_json_option()
    add_track_options(parser)
    options.add_rig_options(parser, options.MEASURED_PARAMETERS[1:])  # not the thickness
    return output.run_command(parser, _run, args)


def _run(arguments: argparse.Namespace) -> int:
    settings = options.read_settings(arguments)
    words = arguments.layers
    if len(words) % 2:
        raise ValueError(f'argument M FILE: must be pairs, got {words[-1]!r} alone')
    paths, entry = words[1::2], TWIN.by_name['layer.thickness']
    thicknesses = [float(entry.check(text)) for text in words[::2]]  # type: ignore[arg-type]
    periods = []
    for path in paths:
        ends = read_layer(path, arguments)
        with output.report_io_errors(path, ValueError):
            periods.append(fit_period(*ends))
    speed, probability = fit_wave_speed(
        thicknesses, periods, thickness_error=arguments.thickness_error
    )
    layers = list(zip(thicknesses, periods, strict=True))
    lines = [
        f'{1e3 * size:.4g} mm: period {1e3 * period.value:.5g} +- {1e3 * period.error:.2g} ms'
        for size, period in layers
    ]
    warning = (
        'the periods are not proportional to the thicknesses (probability '
        f'{probability:.1g}): is it one material?'
    )
    known = options.stated_parameters(arguments) | {'layer.wave_speed'}
    assumed = [name for name in DEFAULT_IS_ANOTHER_RIG if name not in known]
    values = values_of(rig_of(settings), assumed)
    IdentificationReport(
        sources=tuple(paths),
        rows=(Row.of('layer.wave_speed', speed), *held_rows(values, assumed)),
        lines=tuple(lines),
        data={'layers': [{'thickness': size, 'period': period} for size, period in layers]},
        warnings=(warning,) * (probability < _SIGNIFICANCE),
    ).finish(settings, arguments, 'free_layers')
    return 0
