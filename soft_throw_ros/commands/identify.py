# SPDX-License-Identifier: Apache-2.0
"""
Find the parameters of a rig from tracks of its throws, or of layers that ring.

Out come a parameter file for the twin, a table with uncertainties, and a figure.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
import json
import math
from pathlib import Path
import sys
from typing import Any, get_args

from soft_throw_ros.commands import identify_figure
from soft_throw_ros.commands.identify_input import Source
from soft_throw_ros.commands.identify_video import (
    add_video_options,
    check_video_options,
    is_video,
    read_layer,
    read_throw,
)
from soft_throw_ros.commands.identify_watch import watch
from soft_throw_ros.commands.rig_options import add_rig_options, read_settings
from soft_throw_ros.configuration import files, ParameterError, rig_of, Settings, TWIN
from soft_throw_ros.configuration.atomic_file import atomic_file
from soft_throw_ros.core.rig import Rig
from soft_throw_ros.identification.fit import Fit, FitError, Value
from soft_throw_ros.identification.plate_fit import fit_plate
from soft_throw_ros.identification.problem import (
    ENGINE,
    Heights,
    PARAMETERS,
    Reference,
    USUAL,
)
from soft_throw_ros.identification.rig_fit import fit_rig, RigFit
from soft_throw_ros.identification.throw_analysis import analyse_throw, Ejection, ejection_of
from soft_throw_ros.identification.tracks import ThrowTracks, UNITS
from soft_throw_ros.identification.wave_speed import (
    change_of_length,
    fit_ringing,
    fit_wave_speed,
    Ringing,
)

_FIGURES = ('.png', '.pdf', '.svg')

_SHOWN = {'m': ('mm', 1e3), 's': ('ms', 1e3)}
"""Units that tables have in another size."""

_LAST = 10
"""Throws that are fitted at once while a bag is watched: those before may be of an older layer."""

_DOUBT = 1e-4
"""Probability below which chance is no explanation."""

_MOST_COLUMNS = 4
"""Throws that have a column of their own."""

_MOST_ROWS = 6
"""Tracks that have a row of their own if there are more throws than that."""

_EJECTION = (
    ('time', 'ejection time t_e', 's'),
    ('speed', 'ejection speed V_e', 'm/s'),
    ('peak_plate_speed', 'plate speed V_p*', 'm/s'),
    ('energy_transfer', 'energy transfer alpha', ''),
)


@dataclass(frozen=True, kw_only=True)
class Report:
    """
    What was found.

    Parameters
    ----------
    sources : tuple of str
        The throws, or files, it was found in.
    found : mapping of str to Value
        Parameters of the twin.
    held : mapping of str to float
        Those that were taken to be known.
    lines : tuple of str
        More for people.
    data : mapping
        The same for programs.
    warnings : tuple of str
        What there is to doubt.

    """

    sources: tuple[str, ...]
    found: Mapping[str, Value]
    held: Mapping[str, float]
    lines: tuple[str, ...]
    data: Mapping[str, Any]
    warnings: tuple[str, ...]


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
        Exit code 0. What there is to doubt goes to standard error.

    Raises
    ------
    SystemExit
        With exit code 2 if something is refused, after a line that says what.

    """
    parser = _parser()
    arguments = parser.parse_args(args)
    try:
        settings = read_settings(arguments)
        _check(arguments)
        if arguments.watch:
            _watch(arguments, settings)
            return 0
        report = (
            _identify_layers(arguments, settings)
            if arguments.free_layer
            else _identify_throws(_read_throws(arguments), arguments, settings)
        )
        _keep(report, arguments, settings)
    except ValueError as error:  # what is refused, and what tracks do not give
        parser.error(str(error))
    print(_json(report) if arguments.json else table(report), end='')
    for warning in report.warnings:
        print(f'identify: {warning}', file=sys.stderr)
    return 0


def _watch(arguments: argparse.Namespace, settings: Settings) -> None:
    """Say in a line what is found after every throw."""
    start: Rig | None = None

    def refresh(throws: Sequence[ThrowTracks]) -> None:
        nonlocal start
        report = _identify_throws(throws, arguments, settings, start)
        start = rig_of(_keep(report, arguments, settings))
        print(_json(report, indent=None) if arguments.json else _line(report), end='', flush=True)
        for warning in report.warnings:
            print(f'identify: {warning}', file=sys.stderr)

    last = arguments.last or _LAST
    watch(arguments.watch, _source(arguments), refresh, last=last)


def _keep(report: Report, arguments: argparse.Namespace, settings: Settings) -> dict[str, Any]:
    """Write the parameter file, if one is asked for; refuse in any case what is none."""
    identified = with_found(settings, report)
    if arguments.output:
        _write(identified, report, arguments.output)
    return identified


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        description=__doc__.strip().partition('\n')[0],
        usage='%(prog)s [-h] FILE ... [--fit NAME] [--hold NAME] [--output FILE] [--figure FILE] '
        '[--json] [--config FILE] [--thickness M ...]\n'
        '       %(prog)s [-h] --video FILE --rate HZ --scale M PIXELS ...\n'
        '       %(prog)s [-h] --watch BAG ...\n'
        '       %(prog)s [-h] --free-layer M FILE [--free-layer M FILE ...] ...',
        epilog='A CSV file has a time [s] in its first column, and the heights of plate and '
        'projectile (of bottom and top, if it is a free layer) in the next ones; a first line '
        'may name them. Without a projectile only the engine is found.',
        allow_abbrev=False,
    )
    parser.add_argument(
        'files', metavar='FILE', nargs='*', help='tracks of throws: CSV files, or bags'
    )
    parser.add_argument(
        '--watch',
        metavar='BAG',
        help='identify again after every throw in a bag that is being recorded, until it is '
        'complete or Ctrl-C is pressed',
    )
    parser.add_argument(
        '--last',
        metavar='NUMBER',
        type=int,
        help=f'fit the last throws only (default: all, and {_LAST} with --watch)',
    )
    parser.add_argument(
        '--free-layer',
        metavar=('M', 'FILE'),
        nargs=2,
        action='append',
        default=[],
        help='thickness of a layer that rings freely, and a CSV file with tracks of its ends, '
        'or a video; once for each layer',
    )
    parser.add_argument(
        '--thickness-error',
        metavar='M',
        type=float,
        default=1e-4,
        help='standard error of those thicknesses (default %(default)g)',
    )
    for option, verb in (('--fit', 'fit this too'), ('--hold', 'do not fit this, it is known')):
        parser.add_argument(
            option,
            metavar='NAME',
            action='append',
            choices=PARAMETERS,
            default=[],
            help=f'{verb}: one of {", ".join(PARAMETERS)} (default: to fit '
            f'{", ".join(USUAL)}); may be repeated',
        )
    parser.add_argument(
        '--unit', choices=UNITS, default='m', help='of heights in CSV files (default %(default)s)'
    )
    parser.add_argument(
        '--heights',
        choices=get_args(Heights),
        default='own',
        help='from where heights count: each track from a zero of its own, both from a common '
        "one, or from the plate's position at rest (default %(default)s)",
    )
    parser.add_argument(
        '--reference',
        choices=get_args(Reference),
        default='face',
        help='point of the projectile whose heights they are; matters unless each track has a '
        'zero of its own (default %(default)s, the lower one)',
    )
    parser.add_argument(
        '--noise', metavar='M', type=float, help='standard deviation of heights, if it is known'
    )
    parser.add_argument(
        '--from', dest='start', metavar='S', type=float, default=-math.inf, help='leave out before'
    )
    parser.add_argument(
        '--to', dest='end', metavar='S', type=float, default=math.inf, help='leave out after'
    )
    parser.add_argument('--topic', help='to read from bags, if several have a plate')
    parser.add_argument(
        '--output', metavar='FILE', type=Path, help='parameter file of the twin to write'
    )
    parser.add_argument(
        '--figure', metavar='FILE', type=Path, help='picture of data, fit and residuals to draw'
    )
    parser.add_argument('--json', action='store_true', help='print one object: SI units')
    add_video_options(parser)
    add_rig_options(parser)
    return parser


def _check(arguments: argparse.Namespace) -> None:
    """Refuse before the work what would be no use after it."""
    kinds = (arguments.files or arguments.video, arguments.watch, arguments.free_layer)
    if sum(map(bool, kinds)) != 1:
        raise ValueError(
            'either FILE or --video, or --watch, or --free-layer must be given, and no two'
        )
    if arguments.last is not None and arguments.last < 1:
        raise ValueError(f'argument --last: must be at least 1, got {arguments.last}')
    if arguments.noise is not None and not 0.0 < arguments.noise < math.inf:
        raise ValueError(f'argument --noise: must be finite and positive, got {arguments.noise:g}')
    if not 0.0 <= arguments.thickness_error < math.inf:
        raise ValueError(
            'argument --thickness-error: must be finite and not negative, '
            f'got {arguments.thickness_error:g}'
        )
    both = sorted(set(arguments.fit) & set(arguments.hold))
    if both:
        raise ValueError(f'argument --hold: {both[0]} cannot be both fitted and held')
    check_video_options(arguments)
    for name in ('output', 'figure', 'tracks', 'space_time'):
        path = getattr(arguments, name)
        if path is not None and not path.parent.is_dir():
            option = name.replace('_', '-')
            raise ValueError(f'argument --{option}: there is no folder {path.parent}')
    for option, path in (('figure', arguments.figure), ('space-time', arguments.space_time)):
        if path is not None and path.suffix not in _FIGURES:
            raise ValueError(
                f'argument --{option}: must end on {", ".join(_FIGURES)}, got {str(path)!r}'
            )


def _source(arguments: argparse.Namespace) -> Source:
    return Source(
        unit=arguments.unit,
        topic=arguments.topic,
        noise=arguments.noise,
        start=arguments.start,
        end=arguments.end,
    )


def _read_throws(arguments: argparse.Namespace) -> list[ThrowTracks]:
    """Read all throws, but for those of a record of several that are none."""
    source = _source(arguments)
    throws: list[ThrowTracks] = []
    read = [
        *(source.throws(path) for path in arguments.files),
        *(source.cut(read_throw(path, arguments), path) for path in arguments.video),
    ]
    for found in read:
        good = []
        for throw in found if len(found) > 1 else ():
            try:
                fit_plate(throw.plate)
            except FitError as error:
                print(f'identify: {throw.name} is left out: {error}', file=sys.stderr)
            else:
                good.append(throw)
        throws += good or found
    return throws[-arguments.last :] if arguments.last else throws


def _identify_throws(
    throws: Sequence[ThrowTracks],
    arguments: argparse.Namespace,
    settings: Settings,
    start: Rig | None = None,
) -> Report:
    has_projectile = any(throw.projectile is not None for throw in throws)
    usual = USUAL if has_projectile else ENGINE
    free = {*usual, *arguments.fit} - set(arguments.hold)
    rig = rig_of(settings)
    fit = partial(
        fit_rig, throws, rig, free=free, heights=arguments.heights, reference=arguments.reference
    )
    found = fit(start=start)
    if start is not None and found.fit.is_misfit:  # it may be another layer
        found = fit()
    ejection = ejection_of(found) if has_projectile else None
    warnings = found.fit.warnings()
    if ejection is not None and ejection.is_near_jump:
        warnings.append(
            'within the errors the projectile may leave one echo of the wave earlier or later: '
            'ejection time and energy transfer jump there'
        )
    averaged: dict[int, Ejection] = {}
    refused: list[str] = []
    for number, throw in enumerate(found.throws):
        if throw.projectile is not None and (arguments.json or not arguments.watch):
            try:
                averaged[number] = analyse_throw(throw, gravity=rig.gravity)
            except FitError as error:
                refused.append(str(error))
    relevant = PARAMETERS if has_projectile else ENGINE
    values = {name: found.fit[name] for name in relevant if name in found.fit}
    if arguments.figure:
        summary = [_shown(name, value) for name, value in values.items()]
        _draw(arguments.figure, identify_figure.draw_throws, found, ejection, summary)
    return Report(
        sources=tuple(throw.name for throw in found.throws),
        found=values,
        held={name: _held(settings, name) for name in relevant if name not in values},
        lines=(*_throw_lines(found), *_ejection_lines(ejection, averaged, refused)),
        data={
            'fit': _fit_data(found.fit),
            'throws': [
                {
                    'name': throw.name,
                    'start_time': found.start_time(number),
                    'running_averages': _ejection_data(averaged.get(number)),
                }
                for number, throw in enumerate(found.throws)
            ],
            'ejection': _ejection_data(ejection),
        },
        warnings=tuple(warnings),
    )


def _identify_layers(arguments: argparse.Namespace, settings: Settings) -> Report:
    source = _source(arguments)
    layers: list[tuple[float, Ringing]] = []
    warnings: list[str] = []
    for text, path in arguments.free_layer:
        thickness = _thickness(text)
        line = None
        if is_video(path):
            read, line = read_layer(path, arguments)
            ends = source.cut_layer(read, path)
        else:
            ends = source.free_layer(path)
        try:
            ringing = fit_ringing(change_of_length(*ends))
        except FitError as error:
            raise FitError(f'{path}: {error}') from None
        layers.append((thickness, ringing))
        if line is not None and arguments.space_time:
            _draw(arguments.space_time, identify_figure.draw_space_time, line, ends, ringing)
        warnings += [f'{path}: {warning}' for warning in ringing.fit.warnings()]
    speed = fit_wave_speed(
        [thickness for thickness, _ in layers],
        [ringing.period for _, ringing in layers],
        thickness_error=arguments.thickness_error,
    )
    if speed.agreement < _DOUBT:
        warnings.append(
            f'the periods are not proportional to the thicknesses (chi squared {speed.chi2:.3g} '
            f'for {speed.dof} degrees of freedom): is it one material?'
        )
    frequency = settings['engine.frequency']
    losses = [ringing.loss_tangent_at(frequency) for _, ringing in layers]
    loss = _mean(losses)
    found = {'layer.wave_speed': speed.value}
    if 'layer.loss_tangent' in arguments.fit:
        found['layer.loss_tangent'] = loss
    if arguments.figure:
        _draw(
            arguments.figure, identify_figure.draw_layers, layers, speed, arguments.thickness_error
        )
    lines = [f'{"thickness":>12} {"period T_0":>22} {"loss tangent there":>22}']
    lines += [
        f'{1e3 * thickness:9.4g} mm {_scaled(ringing.period, "s"):>22} '
        f'{ringing.loss_tangent!s:>22}'
        for thickness, ringing in layers
    ]
    lines.append(f'loss tangent at {frequency:g} Hz: {loss}')
    return Report(
        sources=tuple(path for _, path in arguments.free_layer),
        found=found,
        held={},
        lines=tuple(lines),
        data={
            'layers': [
                {
                    'thickness': thickness,
                    'period': ringing.period._asdict(),
                    'loss_tangent': ringing.loss_tangent._asdict(),
                    'fit': _fit_data(ringing.fit),
                }
                for thickness, ringing in layers
            ],
            'wave_speed': {
                **speed.value._asdict(), 'chi2': speed.chi2, 'degrees_of_freedom': speed.dof
            },
            'loss_tangent_at_engine_frequency': loss._asdict(),
        },
        warnings=tuple(warnings),
    )  # fmt: skip


def _thickness(text: str) -> float:
    try:
        thickness = float(text)
    except ValueError:
        thickness = math.nan
    entry = TWIN.by_name['layer.thickness']
    if not entry.allows(thickness):
        raise ValueError(f'argument --free-layer: M must be {entry.rule}, got {text!r}')
    return thickness


def _mean(values: Sequence[Value]) -> Value:
    """Weighted mean."""
    weights = [1.0 / max(value.error, 1e-12) ** 2 for value in values]
    mean = sum(weight * value.value for weight, value in zip(weights, values, strict=True))
    return Value(mean / sum(weights), 1.0 / math.sqrt(sum(weights)))


def with_found(settings: Settings, report: Report) -> dict[str, Any]:
    """
    Put what was found into settings of the twin.

    Raises
    ------
    ParameterError
        If the twin does not take it.

    """
    request = {name: float(f'{value.value:.8g}') for name, value in report.found.items()}
    try:
        return {**settings, **TWIN.change(settings, request)}
    except ParameterError as error:
        hint = ''
        if error.names and error.names[0] in ('engine.amplitude', 'layer.thickness'):
            hint = '; is the unit of heights right (--unit)?'
        raise ParameterError(f'found, but not for the twin: {error}{hint}', *error.names) from None


def _write(settings: Settings, report: Report, path: Path) -> None:
    """Write what describes the rig, and whatever else is not as it is by default."""
    kept = {
        entry.name: settings[entry.name]
        for entry in TWIN.entries
        if entry.name in settings and (entry.is_of_rig or settings[entry.name] != entry.default)
    }
    names = [Path(source).name for source in report.sources]
    if len(names) > _MOST_COLUMNS:
        names = [names[0], '...', names[-1]]
    title = [f'Identified from {", ".join(names)}:']
    title += [f'{name} {_scaled(value, _unit(name))}' for name, value in report.found.items()]
    title += [f'Doubtful: {warning}' for warning in report.warnings]
    try:
        with atomic_file(path) as unfinished:  # whoever reads it meanwhile finds the one before
            files.write(unfinished, kept, title='\n'.join(title))
    except OSError as error:
        raise ValueError(f'{path}: {error.strerror}') from None


def _draw(path: Path, draw: Callable[..., None], *what: Any) -> None:
    try:
        draw(*what, path)
    except OSError as error:
        raise ValueError(f'{path}: {error.strerror}') from None


def _held(settings: Settings, name: str) -> float:
    return float(settings[name])


def table(report: Report) -> str:
    """Write a report for people to read."""
    width = max(map(len, PARAMETERS))
    lines = [f'{name:{width}}  {_scaled(value, _unit(name))}' for name, value in
             report.found.items()]  # fmt: skip
    lines += [
        f'{name:{width}}  {_scaled_number(value, _unit(name))}, taken as known'
        for name, value in report.held.items()
    ]
    return '\n'.join([*lines, '', *report.lines]) + '\n'


def _line(report: Report) -> str:
    """Write the most important of a report in a line."""
    values = [_shown(name, value) for name, value in report.found.items()]
    if report.data['ejection']:
        alpha = Value(**report.data['ejection']['energy_transfer'])
        values.append(f'alpha {alpha}')
    return f'{report.sources[-1]}: {", ".join(values)}\n'


def _throw_lines(found: RigFit) -> Iterator[str]:
    fit = found.fit
    yield (
        f'chi squared {fit.chi2:.1f} for {fit.dof} degrees of freedom '
        f'({fit.reduced_chi2:.3f} each)'
    )
    yield f'{"":24} {"samples":>8} {"noise":>10} {"residual":>10} {"neighbours":>11}'
    shown = fit.residuals
    if len(found.throws) > _MOST_COLUMNS:
        shown = tuple(sorted(shown, key=lambda residual: residual.reduced_chi2)[-_MOST_ROWS:])
    for residual in shown:
        track = residual.track
        yield (
            f'{_short(residual.name):24} {track.time.size:8} {1e6 * track.noise:7.3g} um '
            f'{1e6 * residual.rms:7.3g} um {residual.autocorrelation:11.2f}'
        )
    if len(shown) < len(fit.residuals):
        yield f'and {len(fit.residuals) - len(shown)} tracks that are fitted better'


def _short(name: str) -> str:
    """Keep the end of a long name."""
    return name if len(name) <= 24 else f'...{name[-21:]}'


def _ejection_lines(
    ejection: Ejection | None, averaged: Mapping[int, Ejection], refused: Sequence[str]
) -> Iterator[str]:
    if ejection is None:
        return
    columns = {'model': ejection}
    several = len(averaged) > 1
    columns |= {
        f'averages, throw {number + 1}' if several else 'running averages': each
        for number, each in list(averaged.items())[:_MOST_COLUMNS]
    }
    yield ''
    yield ' ' * 22 + ''.join(f'{name:>26}' for name in columns)
    for key, label, unit in _EJECTION:
        cells = (_scaled(getattr(each, key), unit) for each in columns.values())
        yield f'{label:22}' + ''.join(f'{cell:>26}' for cell in cells)
    if refused:
        more = f'; nor of {len(refused) - 1} more throws' if len(refused) > 1 else ''
        yield f'no running averages: {refused[0]}{more}'


def _unit(name: str) -> str:
    return TWIN.by_name[name].unit


def _scaled(value: Value, unit: str) -> str:
    """Write a value with its error, in a unit of handy size."""
    shown, factor = _SHOWN.get(unit, (unit, 1.0))
    return f'{Value(factor * value.value, factor * value.error)} {shown}'.rstrip()


def _scaled_number(value: float, unit: str) -> str:
    shown, factor = _SHOWN.get(unit, (unit, 1.0))
    return f'{factor * value:.6g} {shown}'.rstrip()


def _shown(name: str, value: Value) -> str:
    """Write a parameter for the title of a picture."""
    return f'{name.rpartition(".")[2].replace("_", " ")} {_scaled(value, _unit(name))}'


def _json(report: Report, *, indent: int | None = 2) -> str:
    data = {
        'sources': report.sources,
        'found': {
            name: {**value._asdict(), 'unit': _unit(name)} for name, value in report.found.items()
        },
        'held': report.held,
        **report.data,
        'warnings': report.warnings,
    }
    return json.dumps(_finite(data), indent=indent, allow_nan=False) + '\n'


def _finite(data: Any) -> Any:
    """Replace what JSON has no number for."""
    if isinstance(data, Mapping):
        return {name: _finite(value) for name, value in data.items()}
    if isinstance(data, (list, tuple)):
        return [_finite(value) for value in data]
    return None if isinstance(data, float) and not math.isfinite(data) else data


def _fit_data(fit: Fit) -> dict[str, Any]:
    return {
        'names': fit.names,
        'values': fit.values.tolist(),
        'covariance': fit.covariance.tolist(),
        'chi2': fit.chi2,
        'degrees_of_freedom': fit.dof,
        'residuals': [
            {
                'track': residual.name,
                'samples': residual.track.time.size,
                'noise': residual.track.noise,
                'rms': residual.rms,
                'autocorrelation': residual.autocorrelation,
                'whiteness': residual.whiteness,
            }
            for residual in fit.residuals
        ],
    }


def _ejection_data(ejection: Ejection | None) -> dict[str, Any] | None:
    if ejection is None:
        return None
    return {key: getattr(ejection, key)._asdict() for key, _, _ in _EJECTION}
