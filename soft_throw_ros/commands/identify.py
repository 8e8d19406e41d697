# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
Find the parameters of a rig from tracks of its throws.

Out come a parameter file for the twin, a table with uncertainties, and a figure.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from soft_throw_ros.commands.identify_input import add_track_options, read_throws
from soft_throw_ros.commands.identify_report import (
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
    new_file,
    read_settings,
    stated_parameters,
)
from soft_throw_ros.commands.output import CommandParser, run_command, written_file
from soft_throw_ros.configuration import rig_of, Settings
from soft_throw_ros.identification.ejection import doubt, Release, releases_of
from soft_throw_ros.identification.fit_description import (
    ENGINE,
    FitDescription,
    FIXED,
    PARAMETERS,
    parse_error,
    Treatment,
    values_of,
)
from soft_throw_ros.identification.least_squares import fit_warnings, FitError
from soft_throw_ros.identification.rig_fit import fit_rig, RigFit

_OF_TWO_SENSORS = ('projectile.scale', 'projectile.delay')  # between which they may differ
_NOISE = 'measured.position_noise'  # noise of all heights, if it is stated
_STAMP_ERROR = 'measured.stamp_error'  # standard deviation of all times

# Colours of Okabe and Ito, which colour-blind readers can distinguish
_COLOURS = {'plate': '#000000', 'projectile': '#0072b2'}
_PERIODS = 2.5  # length of the upper panel [plate periods]
_RISES = 2.2  # height of the upper panel over the rise of the plate [-]
_MAX_THROWS = 6  # largest number of throws in one figure


def main(args: list[str] | None = None) -> int:
    """Run the command; return exit code 0. Notes and warnings go to standard error."""
    parser = CommandParser(
        description=__doc__.strip().partition('\n')[0],
        usage='%(prog)s [OPTION ...] FILE ...',
        epilog='A CSV file has a time [s] in its first column, and the heights of plate and '
        'projectile in the next ones; a first line may name them. Without a projectile only the '
        'engine is found. soft-throw track makes such files of videos. A parameter of the rig may '
        "have an error, as in '--mass 0.0012+-1%'; the fit then finds it, too.",
    )
    add = parser.add_argument
    add('files', metavar='FILE', nargs='+', help='tracks of throws: CSV files, or bags')
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
    add_track_options(parser)
    add('--output', metavar='FILE', type=new_file(), help='parameter file of the twin to write')
    add(
        '--figure', metavar='FILE', type=new_file('.png', '.pdf', '.svg'),
        help='picture of data, fit and residuals to draw',
    )
    parser.add_json_option()
    add_rig_options(parser, MEASURED_PARAMETERS)
    return run_command(parser, _run, args)


def _run(arguments: argparse.Namespace) -> int:
    description = _describe_fit(arguments)
    settings: Settings = read_settings(arguments)
    stated = stated_parameters(arguments)
    throws, notes = read_throws(
        arguments,
        noise=float(settings[_NOISE]) if _NOISE in stated else None,
        stamp_error=float(settings[_STAMP_ERROR]),
        topic=description.topic,
    )
    is_thrown = any(throw.projectile is not None for throw in throws)
    if not is_thrown and 'layer.wave_speed' not in description.parameters:
        description = description.change({'layer.wave_speed': FIXED})
    description = description.assume(stated)
    result = fit_rig(throws, rig_of(settings), description)
    if not result.is_complete:
        notes.append('the search for a loss and for other minima took too long, and is incomplete')
    warnings, releases = fit_warnings(result.fit), []
    if is_thrown:
        try:
            releases = releases_of(result)
        except FitError as error:
            warnings.append(f'no release is predicted: {error}')
    rows = list(fit_rows(result))
    if arguments.figure:
        _draw_throws(result, releases, rows, arguments.figure)
    names = PARAMETERS if is_thrown else ENGINE
    held = [name for name in names if name not in result.model.indices]
    rows += held_rows(values_of(result.model.rig, held), description.assumed)
    rows += ejection_rows(releases)
    rows += [Row.of(name, value) for name, value in result.terms().items()]
    assumed = ', '.join(name for name in description.assumed if name in held)
    head = [f'assumed, because nobody stated them (-p NAME:=VALUE): {assumed}'] * bool(assumed)
    verdict = None
    if is_thrown and 'layer.wave_speed' in result.model.indices:
        reason = doubt(result, releases)
        verdict = {'is_good_enough': not reason, 'reason': reason}
        head.append(
            f'not good enough to choose a layer: {reason}' if reason
            else 'good enough to choose a layer'
        )
    IdentificationReport(
        sources=tuple(throw.name for throw in throws),
        rows=tuple(rows),
        head=tuple(head),
        lines=tuple(fit_lines(result)),
        data={'verdict': verdict, 'fit': fit_data(result.fit)},
        notes=tuple(notes),
        warnings=tuple(warnings),
    ).finish(settings, arguments, 'identify')
    return 0


def _describe_fit(arguments: argparse.Namespace) -> FitDescription:
    """Read the description of a fit from file and options, before `read_settings`."""
    known = _split_known(arguments)
    file = arguments.fit_file
    description = FitDescription.from_file(file) if file else FitDescription()
    if arguments.one_camera:
        held = dict.fromkeys(_OF_TWO_SENSORS, FIXED)
        description = description.change({**held, **description.parameters})
    try:
        description = description.change(dict.fromkeys(arguments.hold, FIXED))
    except ValueError as error:
        raise ValueError(f'argument --hold: {error}') from None
    if both := known.keys() & arguments.hold:
        raise ValueError(f'argument --hold: {min(both)} is certain, and must have no error')
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


def _draw_throws(
    result: RigFit, releases: Sequence[Release], rows: Sequence[Row], path: Path
) -> None:
    """Draw the contact in tracks and model of some throws, all residuals, and a summary."""
    from matplotlib.figure import Figure

    model, bodies = result.model, ['plate', 'projectile'][: 1 + bool(result.model.projectiles)]
    figure = Figure(figsize=(9.6, 3.6 + 1.5 * len(bodies)), layout='constrained')
    above, *below = figure.subplots(1 + len(bodies), 1, height_ratios=[2.6, *[1.0] * len(bodies)])
    below[-1].sharex(below[0])
    highest = 0.0
    for (throw, body, _), residual in zip(model.series, result.fit.residuals, strict=True):
        if throw >= _MAX_THROWS:
            continue
        track, colour, start = residual.track, _COLOURS[body], result.start_time(throw).value
        fine = np.linspace(track.time[0], track.time[-1], 2000)
        times = np.concatenate([[start], fine])
        heights = model.trajectory(result.fit.values, throw, body, times).height
        rest = heights[0]
        if body == 'plate':
            highest = max(highest, 1e3 * float(np.ptp(track.position)))
        since = 1e3 * (track.time - start)
        label = body if throw == 0 else None
        above.plot(since, 1e3 * (track.position - rest), '.', color=colour, alpha=0.5)
        above.plot(1e3 * (fine - start), 1e3 * (heights[1:] - rest), color=colour, label=label)
        panel = below[bodies.index(body)]
        panel.axhspan(-2e6 * track.noise, 2e6 * track.noise, color='0.9', zorder=0)
        panel.plot(since, 1e6 * residual.values, '.', color=colour, alpha=0.5)
        panel.set(ylabel=f'{body},\ndata - model (µm)')
    period = 1e3 / result.rig.engine.frequency
    above.set(
        xlim=(-0.3 * period, _PERIODS * period), ylim=(-0.3 * highest, _RISES * highest),
        ylabel='height above rest (mm)',
    )
    above.legend(loc='upper right')
    below[-1].set_xlabel('time since the plate began to move (ms); dotted: release')
    if releases:
        for panel in (above, *below):
            panel.axvline(1e3 * releases[0].time.value, color='0.4', ls=':')
    texts = [f'{row.name.rpartition(".")[2]} {row._replace(note="")}' for row in rows]
    lines = [', '.join(texts[k:k + 3]) for k in range(0, len(texts), 3)]
    figure.suptitle('\n'.join(lines).replace('+-', '±'), fontsize='medium')
    with written_file(path) as unfinished:
        figure.savefig(unfinished, format=path.suffix[1:], dpi=150)
