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
Find the parameters of a rig from tracks of its throws, or of layers that ring.

Out come a parameter file for the twin, a table with uncertainties, and a figure.
"""

from __future__ import annotations

import argparse
from collections.abc import Mapping
import math
import sys

from soft_throw_ros.commands import identify_figure
from soft_throw_ros.commands.identify_input import read_layer, read_throws
from soft_throw_ros.commands.identify_plan import add_plan_options, LISTS, plan_throws
from soft_throw_ros.commands.identify_report import (
    budget_lines,
    ejection_data,
    ejection_lines,
    fit_data,
    fit_lines,
    IdentificationReport,
    layer_lines,
    unit_of,
    with_unit,
)
from soft_throw_ros.commands.identify_video import add_video_options, check_video_options
from soft_throw_ros.commands.options import (
    add_rig_options,
    new_file,
    number_or_text,
    OPTIONS,
    positive,
    read_settings,
)
from soft_throw_ros.commands.output import naming, print_text, run_command
from soft_throw_ros.configuration import rig_of, Settings, TWIN
from soft_throw_ros.identification.fit_description import (
    DEFAULTS,
    ENGINE,
    FitDescription,
    PARAMETERS,
    TREATMENTS,
    USUAL,
)
from soft_throw_ros.identification.least_squares import FitError
from soft_throw_ros.identification.plate_fit import fit_plate
from soft_throw_ros.identification.rig_fit import fit_rig, RigFit
from soft_throw_ros.identification.ringing import (
    change_of_length,
    fit_loss_tangent,
    fit_ringing,
    fit_wave_speed,
    Ringing,
)
from soft_throw_ros.identification.throw_analysis import (
    analyse_throw,
    Ejection,
    ejection_of,
    SeenPlate,
)
from soft_throw_ros.identification.track_csv import UNITS
from soft_throw_ros.identification.tracks import ThrowTracks

_SIGNIFICANCE = 1e-4  # probability below which chance is no explanation
_OF_TWO_SENSORS = ('projectile.scale', 'projectile.delay')  # between which they may differ
_MAX_COLUMNS = 4  # of running averages in the table


def main(args: list[str] | None = None) -> int:
    """Run the command; return exit code 0. What there is to doubt goes to standard error."""
    return run_command(_parser(), _run, args)


def _run(arguments: argparse.Namespace) -> int:
    known = _split_known(arguments)
    settings = read_settings(arguments)
    description = _describe_fit(arguments, known)
    _check(arguments)
    if arguments.plan:
        return plan_throws(arguments, settings, description, _read_all(arguments))
    identify = _identify_layers if arguments.free_layer else _identify_throws
    report = identify(arguments, settings, description)
    identified = report.put_into(settings)
    if arguments.output:
        with naming(arguments.output):
            report.write(identified, arguments.output)
    print_text(report.json() if arguments.json else report.table())
    for warning in report.warnings:
        print(f'identify: {warning}', file=sys.stderr)
    return 0


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        description=__doc__.strip().partition('\n')[0],
        usage='%(prog)s [-h] FILE ... [--fit NAME] [--hold NAME] [--output FILE] [--figure FILE] '
        '[--json] [--config FILE] [--thickness M ...]\n'
        '       %(prog)s [-h] --video FILE --rate HZ --scale M PIXELS ...\n'
        '       %(prog)s [-h] --free-layer M FILE [--free-layer M FILE ...] ...',
        epilog='A CSV file has a time [s] in its first column, and the heights of plate and '
        'projectile (of bottom and top, if it is a free layer) in the next ones; a first line '
        'may name them. Without a projectile only the engine is found.',
        allow_abbrev=False,
    )
    add = parser.add_argument
    add('files', metavar='FILE', nargs='*', help='tracks of throws: CSV files, or bags')
    add(
        '--free-layer', metavar=('M', 'FILE'), nargs=2, action='append', default=[],
        help='thickness of a layer that rings freely, and a CSV file with tracks of its ends, '
        'or a video; once for each layer',
    )
    add(
        '--thickness-error', metavar='M', type=float, default=1e-4,
        help='standard error of those thicknesses (default %(default)g)',
    )
    add(
        '--fit', metavar='NAME[=HOW]', action='append', default=[],
        help=f'fit this too: one of {", ".join(DEFAULTS)} (default: to fit {", ".join(USUAL)}, '
        'and what else is known with an error). HOW is '
        f'{TREATMENTS.replace("%", "%%")}, as in '
        "'projectile.mass=0.0012 +- 1 %%', or shorter '--mass 0.0012+-1%%'. May be repeated",
    )
    add(
        '--hold', metavar='NAME', action='append', default=[],
        help='do not fit this, it is known; may be repeated',
    )
    add(
        '--fit-file', metavar='FILE',
        help='YAML file that says the same: `parameters` (NAME: HOW), `heights`, `reference`, and '
        '`throws` (names of files, or patterns, to parameters and names of `layer` and '
        '`projectile` that are otherwise there)',
    )
    add('--unit', choices=UNITS, default='m', help='of heights in CSV files (default %(default)s)')
    add(
        '--noise', metavar='M', type=positive, help='standard deviation of heights, if it is known'
    )
    add(
        '--from', dest='start', metavar='S', type=float, default=-math.inf, help='leave out before'
    )
    add('--to', dest='end', metavar='S', type=float, default=math.inf, help='leave out after')
    add('--topic', help='to read from bags, if several have a plate')
    add('--output', metavar='FILE', type=new_file(), help='parameter file of the twin to write')
    add(
        '--figure', metavar='FILE', type=new_file('.png', '.pdf', '.svg'),
        help='picture of data, fit and residuals to draw',
    )
    add('--json', action='store_true', help='print one object: SI units')
    add_video_options(parser)
    add_plan_options(parser)
    add_rig_options(parser)
    return parser


def _check(arguments: argparse.Namespace) -> None:
    """Refuse before the work options that do not go together."""
    is_alone = arguments.plan and not arguments.free_layer  # needs no tracks
    if not is_alone and bool(arguments.files or arguments.video) == bool(arguments.free_layer):
        raise ValueError('either FILE or --video, or --free-layer must be given, and not both')
    if not 0.0 <= arguments.thickness_error < math.inf:
        raise ValueError(
            'argument --thickness-error: must be finite and not negative, '
            f'got {arguments.thickness_error:g}'
        )
    check_video_options(arguments)
    for name in LISTS:
        if getattr(arguments, name) is not None and not arguments.plan:
            raise ValueError(f'argument --{name}: is for --plan')


def _split_known(arguments: argparse.Namespace) -> dict[str, str]:
    """Take errors off options of the rig, as in `--mass 0.0012+-1%`."""
    known = {}
    for name in PARAMETERS:
        value, sign, error = str(getattr(arguments, name, '')).partition('+-')
        if sign:
            setattr(arguments, name, number_or_text(value))
            known[name] = f'+- {error}'
    return known


def _describe_fit(arguments: argparse.Namespace, known: Mapping[str, str]) -> FitDescription:
    """Read what is fitted from file and options."""
    description = FitDescription()
    if arguments.video and not arguments.files:  # the same pictures show both bodies
        description = description.change(dict.fromkeys(_OF_TWO_SENSORS, 'held'))
    if arguments.fit_file:
        description = FitDescription.from_file(arguments.fit_file, description)
    fitted = {}
    for text in arguments.fit:
        name, _, treatment = text.partition('=')
        fitted[name.strip()] = treatment or 'free'
    both = sorted(set(fitted) & set(arguments.hold))
    if both:
        raise ValueError(f'argument --hold: {both[0]} cannot be both fitted and held')
    options = {OPTIONS[name].removeprefix('--'): {name: text} for name, text in known.items()}
    options |= {'fit': fitted, 'hold': dict.fromkeys(arguments.hold, 'held')}
    for option, changes in options.items():
        try:
            description = description.change(changes)
        except ValueError as error:
            raise ValueError(f'argument --{option}: {error}') from None
    return description


def _read_all(arguments: argparse.Namespace) -> list[ThrowTracks]:
    """Read all throws, but for those of a record of several that are none."""
    throws: list[ThrowTracks] = []
    for path in (*arguments.files, *arguments.video):
        found = read_throws(path, arguments)
        good = []
        for throw in found if len(found) > 1 else ():
            try:
                fit_plate(throw.plate)
            except FitError as error:
                print(f'identify: {throw.name} is left out: {error}', file=sys.stderr)
            else:
                good.append(throw)
        throws += good or found
    return throws


def _identify_throws(
    arguments: argparse.Namespace, settings: Settings, description: FitDescription
) -> IdentificationReport:
    """Fit a rig to throws."""
    throws = _read_all(arguments)
    has_projectile = any(throw.projectile is not None for throw in throws)
    if not has_projectile and 'layer.wave_speed' not in description.parameters:
        description = description.change({'layer.wave_speed': 'held'})
    rig = rig_of(settings)
    found = fit_rig(throws, rig, description, tell=_show_progress)
    warnings = found.warnings()
    lines = [*budget_lines(found), '', *found.remarks, *layer_lines(found.layers)]
    lines += fit_lines(found.fit)
    ejection, averages = None, dict[int, Ejection]()
    if has_projectile:
        ejection = ejection_of(found)
        if ejection.is_near_jump:
            warnings.append(
                'within the errors the projectile may leave one echo of the wave earlier or '
                'later: ejection time and energy transfer jump there'
            )
        averages, more = _running_averages(found, rig.gravity)
        several = len(averages) > 1
        columns = {'model': ejection} | {
            f'averages, throw {number + 1}' if several else 'running averages': each
            for number, each in list(averages.items())[:_MAX_COLUMNS]
        }
        lines += [*ejection_lines(columns), *more]
    relevant = PARAMETERS if has_projectile else ENGINE
    elasticity = found.rig.layer.elasticity
    values = {name: value for name, value in found.estimates().items() if name in relevant}
    if arguments.figure:
        summary = [
            f'{name.rpartition(".")[2].replace("_", " ")} {with_unit(value, unit_of(name))}'
            for name, value in values.items()
        ]
        with naming(arguments.figure):
            identify_figure.draw_throws(found, ejection, summary, arguments.figure)
    return IdentificationReport(
        sources=tuple(throw.name for throw in found.throws),
        found=values,
        held={name: value for name, value in found.held_values().items() if name in relevant},
        chosen={'layer.elasticity': elasticity} if elasticity != rig.layer.elasticity else {},
        lines=tuple(lines),
        data={
            'fit': fit_data(found.fit),
            'terms': found.terms(),
            'remarks': found.remarks,
            'layers': found.layers,
            'intervals': found.intervals,
            'throws': [
                {
                    'name': throw.name,
                    'start_time': found.start_time(number).value,
                    'running_averages': ejection_data(averages.get(number)),
                }
                for number, throw in enumerate(found.throws)
            ],
            'ejection': ejection_data(ejection),
        },
        warnings=tuple(warnings),
    )


def _show_progress(text: str) -> None:
    """Say what is being done, to somebody who waits at a terminal."""
    if sys.stderr.isatty():
        print(f'identify: {text} ...', file=sys.stderr, flush=True)


def _running_averages(found: RigFit, gravity: float) -> tuple[dict[int, Ejection], list[str]]:
    """Analyse throws without a model of the layer, and say of which that cannot be done."""
    averages: dict[int, Ejection] = {}
    refused: list[str] = []
    for number, throw in enumerate(found.throws):
        if throw.projectile is not None:
            plate = SeenPlate.of(found, number)
            try:
                averages[number] = analyse_throw(
                    found.without_drift(number), gravity=gravity, plate=plate
                )
            except FitError as error:
                refused.append(str(error))
    if not refused:
        return averages, []
    more = f'; nor of {len(refused) - 1} more throws' if len(refused) > 1 else ''
    return averages, [f'no running averages: {refused[0]}{more}']


def _identify_layers(
    arguments: argparse.Namespace, settings: Settings, description: FitDescription
) -> IdentificationReport:
    """Fit wave speed and loss to layers that ring."""
    layers: list[tuple[float, Ringing]] = []
    warnings: list[str] = []
    for text, path in arguments.free_layer:
        layers.append((_thickness(text), _ringing(path, arguments)))
        warnings += [f'{path}: {warning}' for warning in layers[-1][1].fit.warnings()]
    speed = fit_wave_speed(
        [thickness for thickness, _ in layers],
        [ringing.period for _, ringing in layers],
        thickness_error=arguments.thickness_error,
    )
    if speed.agreement < _SIGNIFICANCE:
        warnings.append(
            f'the periods are not proportional to the thicknesses (chi squared {speed.chi2:.3g} '
            f'for {speed.dof} degrees of freedom): is it one material?'
        )
    frequency = settings['engine.frequency']
    loss = fit_loss_tangent([ringing for _, ringing in layers], frequency=frequency)
    if loss.agreement < _SIGNIFICANCE:
        warnings.append(
            f'the layers do not agree in their loss (chi squared {loss.chi2:.3g} for {loss.dof} '
            'degrees of freedom): is it one material, whose loss grows with frequency?'
        )
    found = {'layer.wave_speed': speed.value}
    if description.is_free('layer.loss_tangent'):
        found['layer.loss_tangent'] = loss.value
    if arguments.figure:
        with naming(arguments.figure):
            identify_figure.draw_layers(layers, speed, arguments.thickness_error, arguments.figure)
    lines = [f'{"thickness":>12} {"period T_0":>22} {"loss tangent there":>22}']
    lines += [
        f'{1e3 * thickness:9.4g} mm {with_unit(ringing.period, "s"):>22} '
        f'{ringing.loss_tangent!s:>22}'
        for thickness, ringing in layers
    ]
    lines.append(f'loss tangent at {frequency:g} Hz: {loss.value}')
    lines += [line for _, each in layers for line in fit_lines(each.fit) if 'outliers' in line]
    return IdentificationReport(
        sources=tuple(path for _, path in arguments.free_layer),
        found=found,
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


def _ringing(path: str, arguments: argparse.Namespace) -> Ringing:
    """Read how a free layer rings, and draw it if that is asked for."""
    ends, line = read_layer(path, arguments)
    try:
        ringing = fit_ringing(change_of_length(*ends))
    except FitError as error:
        raise FitError(f'{path}: {error}') from None
    if line is not None and arguments.space_time:
        with naming(arguments.space_time):
            identify_figure.draw_space_time(line, ends, ringing, arguments.space_time)
    return ringing


def _thickness(text: str) -> float:
    try:
        thickness = float(text)
    except ValueError:
        thickness = math.nan
    entry = TWIN.by_name['layer.thickness']
    if not entry.allows(thickness):
        raise ValueError(f'argument --free-layer: M must be {entry.rule}, got {text!r}')
    return thickness
