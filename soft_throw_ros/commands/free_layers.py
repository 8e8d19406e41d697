# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Find the wave speed and loss of a material from tracks of layers that ring freely."""

from __future__ import annotations

import argparse
from collections.abc import Iterator

from soft_throw_ros.commands import identify_figure
from soft_throw_ros.commands.identify_input import add_track_options, read_layer
from soft_throw_ros.commands.identify_report import (
    add_report_options,
    fit_data,
    fit_lines,
    IdentificationReport,
    warning_lines,
    with_unit,
)
from soft_throw_ros.commands.options import (
    add_rig_options,
    not_negative,
    parameter_type,
    read_settings,
    stated_parameters,
)
from soft_throw_ros.commands.output import CommandParser, report_io_errors, run_command
from soft_throw_ros.configuration import Settings
from soft_throw_ros.identification.fit_description import DEFAULT_IS_ANOTHER_RIG
from soft_throw_ros.identification.least_squares import FitError
from soft_throw_ros.identification.ringing import (
    change_of_length,
    CommonValue,
    fit_loss_tangent,
    fit_ringing,
    fit_wave_speed,
    Ringing,
)

_SIGNIFICANCE = 1e-4
"""Probability of disagreement by chance, below which a warning says so. [-]"""


def main(args: list[str] | None = None) -> int:
    """Run the command; return exit code 0. Warnings go to standard error."""
    return run_command(_parser(), _run, args)


def _parser() -> CommandParser:
    parser = CommandParser(
        description=__doc__,
        usage='%(prog)s [OPTION ...] M FILE [M FILE ...]',
        epilog='A CSV file has a time [s] in its first column, and the heights of bottom and top '
        'in the next ones; a first line may name them. soft-throw track makes such files of '
        'videos.',
    )
    add = parser.add_argument
    add(
        'layers', metavar='M FILE', nargs='+',
        help='thickness of a layer, and a CSV file with tracks of its ends',
    )
    add(
        '--thickness-error', metavar='M', type=not_negative, default=1e-4,
        help='standard error of the thicknesses (default %(default)g)',
    )
    add(
        '--with-loss', action='store_true',
        help='put the loss tangent into the parameter file, too',
    )
    add_track_options(parser)
    add_report_options(parser)
    add_rig_options(parser)
    return parser


def _run(arguments: argparse.Namespace) -> int:
    settings = read_settings(arguments)
    _identify(arguments, settings).finish(settings, arguments, 'free_layers')
    return 0


def _identify(arguments: argparse.Namespace, settings: Settings) -> IdentificationReport:
    """Fit wave speed and loss to layers that ring."""
    words = arguments.layers
    if len(words) % 2:
        raise ValueError(f'argument M FILE: must be pairs, got {words[-1]!r} alone')
    thicknesses, paths = [_thickness(text) for text in words[::2]], words[1::2]
    ringings = [_ringing(path, arguments) for path in paths]
    layers = list(zip(thicknesses, ringings, strict=True))
    speed = fit_wave_speed(
        thicknesses,
        [ringing.period for ringing in ringings],
        thickness_error=arguments.thickness_error,
    )
    frequency = settings['engine.frequency']
    loss = fit_loss_tangent(ringings, frequency=frequency)
    warnings = [
        *(
            f'{path}: {warning}'
            for path, ringing in zip(paths, ringings, strict=True)
            for warning in warning_lines(ringing.fit)
        ),
        *_disagreement(
            speed, 'the periods are not proportional to the thicknesses', 'is it one material?'
        ),
        *_disagreement(
            loss,
            'the layers do not agree in their loss',
            'is it one material, whose loss grows with frequency?',
        ),
    ]
    result = {'layer.wave_speed': speed.value}
    if arguments.with_loss:
        result['layer.loss_tangent'] = loss.value
    known = stated_parameters(arguments) | result.keys()
    if arguments.figure:
        identify_figure.draw_layers(layers, speed, arguments.thickness_error, arguments.figure)
    lines = [f'{"thickness":>12} {"period T_0":>22} {"loss tangent there":>22}']
    lines += [
        f'{1e3 * thickness:9.4g} mm {with_unit(ringing.period, "s"):>22} '
        f'{ringing.loss_tangent!s:>22}'
        for thickness, ringing in layers
    ]
    lines.append(f'loss tangent at {frequency:g} Hz: {loss.value}')
    lines += [
        line for ringing in ringings for line in fit_lines(ringing.fit) if 'outliers' in line
    ]
    return IdentificationReport(
        sources=tuple(paths),
        result=result,
        assumed=tuple(name for name in DEFAULT_IS_ANOTHER_RIG if name not in known),
        lines=tuple(lines),
        data={
            'layers': [
                {
                    'thickness': thickness,
                    'period': ringing.period,
                    'loss_tangent': ringing.loss_tangent,
                    'fit': fit_data(ringing.fit),
                }
                for thickness, ringing in layers
            ],
            'wave_speed': {
                **speed.value._asdict(),
                'chi2': speed.chi2,
                'degrees_of_freedom': speed.dof,
            },
            'loss_tangent_at_engine_frequency': loss.value,
        },
        warnings=tuple(warnings),
    )


def _disagreement(common: CommonValue, claim: str, question: str) -> Iterator[str]:
    """Yield a warning if the values of the layers disagree by more than chance."""
    if common.agreement < _SIGNIFICANCE:
        yield (
            f'{claim} (chi squared {common.chi2:.3g} for {common.dof} degrees of freedom): '
            f'{question}'
        )


def _ringing(path: str, arguments: argparse.Namespace) -> Ringing:
    """Fit the oscillation of a free layer."""
    ends = read_layer(path, arguments)
    with report_io_errors(path, FitError):
        return fit_ringing(change_of_length(*ends))


def _thickness(text: str) -> float:
    try:
        return float(parameter_type('layer.thickness')(text))  # type: ignore[arg-type]
    except argparse.ArgumentTypeError as error:
        raise ValueError(f'argument M FILE: {error}') from None
