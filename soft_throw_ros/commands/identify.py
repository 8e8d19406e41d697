# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
Find the parameters of a rig from tracks of its throws.

Out come a parameter file for the twin, a table with uncertainties, and a figure.
"""

from __future__ import annotations

import argparse
import sys

from soft_throw_ros.commands import identify_figure
from soft_throw_ros.commands.identify_input import add_track_options, read_throws
from soft_throw_ros.commands.identify_report import (
    add_report_options,
    ejection_rows,
    fit_data,
    fit_lines,
    fit_rows,
    held_rows,
    IdentificationReport,
    Row,
)
from soft_throw_ros.commands.options import (
    add_rig_options,
    argument_of,
    MEASURED_PARAMETERS,
    read_settings,
    stated_parameters,
)
from soft_throw_ros.commands.output import CommandParser, print_note, run_command
from soft_throw_ros.configuration import rig_of, Settings
from soft_throw_ros.identification.ejection import ejection_of, judge
from soft_throw_ros.identification.fit_description import (
    ENGINE,
    FitDescription,
    FIXED,
    PARAMETERS,
    parse_error,
    Treatment,
    values_of,
)
from soft_throw_ros.identification.fit_warnings import fit_warnings
from soft_throw_ros.identification.least_squares import FitError
from soft_throw_ros.identification.plate_fit import fit_plate
from soft_throw_ros.identification.rig_fit import fit_rig
from soft_throw_ros.identification.systematics import FLOORS
from soft_throw_ros.identification.tracks import ThrowTracks

_OF_TWO_SENSORS = ('projectile.scale', 'projectile.delay')  # between which they may differ
_NOISE = 'measured.position_noise'  # noise of all heights, if it is stated
_STAMP_ERROR = 'measured.stamp_error'  # standard deviation of all times


def main(args: list[str] | None = None) -> int:
    """Run the command; return exit code 0. Notes and warnings go to standard error."""
    return run_command(_parser(), _run, args)


def _run(arguments: argparse.Namespace) -> int:
    description = describe_fit(arguments)
    settings = read_settings(arguments)
    report = _identify(arguments, settings, description)
    report.finish(settings, arguments, 'identify')
    return 0


def _parser() -> CommandParser:
    parser = CommandParser(
        description=__doc__.strip().partition('\n')[0],
        usage='%(prog)s [OPTION ...] FILE ...',
        epilog='A CSV file has a time [s] in its first column, and the heights of plate and '
        'projectile in the next ones; a first line may name them. Without a projectile only the '
        'engine is found. soft-throw track makes such files of videos. A parameter of the rig may '
        "have an error, as in '--mass 0.0012+-1%%'; the fit then finds it, too.",
    )
    parser.add_argument(
        'files', metavar='FILE', nargs='+', help='tracks of throws: CSV files, or bags'
    )
    add_fit_options(parser)
    add_track_options(parser)
    add_report_options(parser)
    add_rig_options(parser, MEASURED_PARAMETERS)
    return parser


def add_fit_options(parser: CommandParser) -> None:
    """Add the options that describe a fit; `describe_fit` reads them."""
    add = parser.add_argument
    add(
        '--hold', metavar='NAME', action='append', default=[],
        help='do not fit this parameter, which is known; may be repeated',
    )
    add(
        '--one-camera', action='store_true',
        help='one camera has seen plate and projectile: hold ' + ' and '.join(_OF_TWO_SENSORS),
    )
    add(
        '--fit-file', metavar='FILE',
        help='YAML file of the fit (docs/identify.md): `free`, `fixed`, `prior`, `per_throw`, '
        'and the `topic` of bags',
    )


def describe_fit(arguments: argparse.Namespace) -> FitDescription:
    """Read the description of a fit from file and options, before `read_settings`."""
    known = _split_known(arguments)
    description = FitDescription()
    if arguments.one_camera:
        description = description.change(dict.fromkeys(_OF_TWO_SENSORS, FIXED))
    if arguments.fit_file:
        description = FitDescription.from_file(arguments.fit_file, description)
    try:
        description = description.change(dict.fromkeys(arguments.hold, FIXED))
    except ValueError as error:
        raise ValueError(f'argument --hold: {error}') from None
    return description.change(known)


def _split_known(arguments: argparse.Namespace) -> dict[str, Treatment]:
    """Split the errors off options of the rig, as in `--mass 0.0012+-1%`."""
    known = {}
    for name in PARAMETERS:
        value, sign, error = str(getattr(arguments, name, '')).partition('+-')
        if sign:
            setattr(arguments, name, value.strip())
            try:
                known[name] = parse_error(error, value)
            except ValueError as refusal:
                raise ValueError(f'{argument_of(arguments, name)}: {name} {refusal}') from None
    return known


def read_all(
    arguments: argparse.Namespace, *, noise: float | None = None, stamp_error: float = 0.0,
    topic: str | None = None,
) -> tuple[list[ThrowTracks], list[str]]:
    """Return all throws, without false detections in a long record, and notes on defects."""
    throws: list[ThrowTracks] = []
    notes: list[str] = []
    for path in arguments.files:
        result = read_throws(
            path, arguments, notes, noise=noise, stamp_error=stamp_error, topic=topic
        )
        good = []
        for throw in result if len(result) > 1 else ():
            try:
                fit_plate(throw.plate)
            except FitError as error:
                notes.append(f'{throw.name} is left out: {error}')
            else:
                good.append(throw)
        throws += good or result
    return throws, notes


def _identify(
    arguments: argparse.Namespace, settings: Settings, description: FitDescription
) -> IdentificationReport:
    """Fit a rig to throws."""
    stated = stated_parameters(arguments)
    noise = float(settings[_NOISE]) if _NOISE in stated else None
    throws, notes = read_all(
        arguments, noise=noise, stamp_error=float(settings[_STAMP_ERROR]), topic=description.topic
    )
    has_projectile = any(throw.projectile is not None for throw in throws)
    if not has_projectile and 'layer.wave_speed' not in description.parameters:
        description = description.change({'layer.wave_speed': FIXED})
    description = description.assume(stated)
    result = fit_rig(throws, rig_of(settings), description, on_progress=_show_progress)
    warnings = fit_warnings(result.fit)
    if not result.is_complete:
        notes.append('the search for a loss and for other minima took too long, and is incomplete')
    ejection = None
    if has_projectile:
        try:
            ejection = ejection_of(result)
        except FitError as error:
            warnings.append(f'no release is predicted: {error}')
    relevant = PARAMETERS if has_projectile else ENGINE
    rows = [
        row for row in fit_rows(result)
        if row.name in ENGINE or (has_projectile and row.name not in description.assumed)
    ]
    found = {row.name for row in rows}
    held = values_of(result.model.rig, [name for name in relevant if name not in found])
    rows += held_rows(held, description.assumed)
    rows += ejection_rows(ejection) if ejection else ()
    rows += [Row.of(name, value) for name, value in result.terms().items()]
    assumed = ', '.join(name for name in description.assumed if name in held)
    head = [f'assumed, because nobody stated them (-p NAME:=VALUE): {assumed}'] * bool(assumed)
    answer = None
    if has_projectile and 'layer.wave_speed' in result.model.layout:
        verdict = judge(result, ejection)
        answer = {**verdict._asdict(), 'rest_wave_speed': result.rest_wave_speed()}
        head.append(
            'good enough to choose a layer' if verdict.is_good_enough
            else f'not good enough to choose a layer: {verdict.reason}'
        )
    if arguments.figure:
        summary = [f'{row.name.rpartition(".")[2]} {row}' for row in rows if row.name in found]
        identify_figure.draw_throws(result, ejection, summary, arguments.figure)
    return IdentificationReport(
        sources=tuple(throw.name for throw in throws),
        rows=tuple(rows),
        head=tuple(head),
        lines=tuple(fit_lines(result)),
        data={
            'answer': answer,
            'fit': fit_data(result.fit),
            'systematic_errors': {name: floor._asdict() for name, floor in FLOORS.items()},
            'throws': [
                {'name': throw.name, 'start_time': result.start_time(number).value}
                for number, throw in enumerate(throws)
            ],
            'ejection': ejection and {
                **ejection.first._asdict(), 'alternatives': ejection.alternatives
            },
        },
        notes=tuple(notes),
        warnings=tuple(warnings),
    )


def _show_progress(text: str) -> None:
    """Print the present step of the computation if standard error is a terminal."""
    if sys.stderr.isatty():
        print_note('identify', f'{text} ...')
