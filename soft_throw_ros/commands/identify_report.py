# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Results of an identification: as a table, as JSON, and as a parameter file of the twin."""

from __future__ import annotations

import argparse
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
import math
from pathlib import Path

from soft_throw_ros.commands.options import new_file
from soft_throw_ros.commands.output import (
    CommandParser,
    print_note,
    print_result,
    written_file,
)
from soft_throw_ros.configuration import files, ParameterError, Settings, TWIN, Value
from soft_throw_ros.configuration.layers import CUSTOM
from soft_throw_ros.configuration.twin_config import BOUND_PER_DEVIATION
from soft_throw_ros.identification.ejection import Answer, Ejection, GOOD_ENOUGH
from soft_throw_ros.identification.fit_description import PARAMETERS
from soft_throw_ros.identification.fit_warnings import (
    Ambiguity,
    Contradiction,
    fit_warnings,
    FitWarning,
    InseparablePair,
    Mismatch,
    NotConverged,
)
from soft_throw_ros.identification.least_squares import Estimate, Fit
from soft_throw_ros.identification.rig_fit import RigFit
from soft_throw_ros.identification.systematics import FLOORS

_UNITS_IN_TABLES = {'m': ('mm', 1e3), 's': ('ms', 1e3)}
_MAX_NAMES = 4  # largest number of sources listed in a parameter file
_MAX_OUTLIERS = 4  # largest number of outliers of a track that are listed individually
_MAX_TRACKS = 8  # largest number of tracks in the table; the worst ones come first
_NAME_WIDTH = 24
_NOISY = 0.7  # share of noise and systematic errors, above which no other source is listed
_LARGE_SHARE = 0.3  # share of an error, above which its source is listed
_UNITS_OF_TERMS = {'projectile.delay': 's'}

EJECTION_ROWS = (
    ('time', 'ejection time t_e', 's'),
    ('speed', 'ejection speed V_e', 'm/s'),
    ('peak_plate_speed', 'plate speed V_p*', 'm/s'),
    ('energy_transfer', 'energy transfer alpha', ''),
)


@dataclass(frozen=True, kw_only=True)
class IdentificationReport:
    """Result of an identification."""

    sources: tuple[str, ...]
    """Names of the throws or files."""
    result: Mapping[str, Estimate]
    """Fitted parameters of the twin."""
    held: Mapping[str, float] = field(default_factory=dict)
    """Parameters that the fit held."""
    assumed: tuple[str, ...] = ()
    """Parameters with default values, because nobody stated them."""
    answer: tuple[str, ...] = ()
    """Lines that come first."""
    lines: tuple[str, ...]
    """Further lines of the printed report."""
    data: Mapping[str, object]
    """Content of `lines` for programs, in types that JSON can represent."""
    notes: tuple[str, ...] = ()
    """Defects of the tracks, such as missing samples or messages."""
    warnings: tuple[str, ...]
    """Reasons to doubt the result."""

    def table(self) -> Iterator[str]:
        """Yield the lines of the report."""
        width = max(map(len, PARAMETERS))
        assumed = ', '.join(name for name in self.assumed if name in self.held)
        head = [f'assumed, because nobody stated them (-p NAME:=VALUE): {assumed}'] * bool(assumed)
        if head or self.answer:
            yield from (*head, *self.answer, '')
        for name, text in self._estimates():
            yield f'{name:{width}}  {text}'
        for name, value in self.held.items():
            source = 'assumed' if name in self.assumed else 'taken as known'
            yield f'{name:{width}}  {_in_handy_unit(name, value)}, {source}'
        yield from ('', *self.lines)

    def values(self) -> dict[str, object]:
        """Return the report for programs, in SI units."""
        result = {
            name: {**value._asdict(), 'unit': unit_of(name)} for name, value in self.result.items()
        }
        return {
            'sources': self.sources,
            'found': result,
            'held': self.held,
            'assumed': self.assumed,
            **self.data,
            'notes': self.notes,
            'warnings': self.warnings,
        }

    def _estimates(self) -> Iterator[tuple[str, str]]:
        for name, value in self.result.items():
            yield name, with_unit(value, unit_of(name))

    def put_into(self, settings: Settings) -> Settings:
        """Return settings with the values and errors of the fit; may raise ParameterError."""
        known = {name: Estimate(value, 0.0) for name, value in self.held.items()
                 if name not in self.assumed}
        request: dict[str, Value] = {}
        for name, (value, error) in {**known, **self.result}.items():
            if not math.isclose(value, settings[name]):  # any request would end a stack
                request[name] = float(f'{value:.8g}')
            bound = TWIN.by_name.get(f'uncertainty.{name.rpartition(".")[2]}')
            if bound is not None:
                scale = value if name == 'projectile.mass' else 1.0  # its error is relative
                largest = BOUND_PER_DEVIATION * error / scale
                request[bound.name] = float(f'{min(largest, bound.high):.3g}')
        try:
            return {**settings, **TWIN.change(settings, request)}
        except ParameterError as error:
            hint = ''
            if error.names and error.names[0] in ('engine.amplitude', 'layer.thickness'):
                hint = '; is the unit of heights right (--unit)?'
            raise ParameterError(
                f'found, but not for the twin: {error}{hint}', *error.names
            ) from None

    def finish(self, settings: Settings, arguments: argparse.Namespace, command: str) -> None:
        """Write the parameter file on request, and print the report, notes and warnings."""
        identified = self.put_into(settings)
        if arguments.output:
            self.write(identified, arguments.output)
        print_result(self.values(), self.table(), as_json=arguments.json)
        for message in (*self.notes, *self.warnings):
            print_note(command, message)

    def write(self, settings: Settings, path: Path) -> None:
        """Write the parameters of the rig, and all others that differ from their defaults."""
        kept = {
            entry.name: settings[entry.name]
            for entry in TWIN.entries
            if entry.name in settings
            and (entry.is_of_rig or settings[entry.name] != entry.default)
        }
        if any(name.startswith('layer.') for name in self.assumed):
            kept['layer.name'] = CUSTOM  # a name would state the whole layer
        names = [Path(source).name for source in self.sources]
        if len(names) > _MAX_NAMES:
            names = [names[0], '...', names[-1]]
        title = [f'Identified from {", ".join(names)}:']
        title += [f'{name} {text}' for name, text in self._estimates()]
        title += [
            f'{name} {_in_handy_unit(name, settings[name])}, assumed' for name in self.assumed
        ]
        title += [f'Doubtful: {warning}' for warning in self.warnings]
        with written_file(path) as unfinished:
            text = files.render(kept, title='\n'.join(title), assumed=self.assumed)
            unfinished.write_text(text, 'utf-8')


def add_report_options(parser: CommandParser) -> None:
    """Add the options for the output of a report; `IdentificationReport.finish` reads them."""
    add = parser.add_argument
    add('--output', metavar='FILE', type=new_file(), help='parameter file of the twin to write')
    add(
        '--figure', metavar='FILE', type=new_file('.png', '.pdf', '.svg'),
        help='picture of data, fit and residuals to draw',
    )
    parser.add_json_option()


def unit_of(name: str) -> str:
    """Return the unit of a parameter of the twin, or of a term of the fit."""
    return TWIN.by_name[name].unit if name in TWIN.by_name else _UNITS_OF_TERMS.get(name, '')


def _handy_unit(unit: str) -> tuple[str, float]:
    """Return the unit of tables for an SI unit, and the factor from SI."""
    return _UNITS_IN_TABLES.get(unit, (unit, 1.0))


def _in_handy_unit(name: str, value: float) -> str:
    """Write a value of a parameter without an error."""
    unit, factor = _handy_unit(unit_of(name))
    return f'{factor * value:.6g} {unit}'.rstrip()


def with_unit(value: Estimate, unit: str) -> str:
    """Write a value with its error, in a unit of handy size."""
    shown, factor = _handy_unit(unit)
    return f'{Estimate(factor * value.value, factor * value.error)} {shown}'.rstrip()


def warning_lines(fit: Fit) -> list[str]:
    """Return a sentence for each reason to doubt a fit."""
    return [warning_text(warning) for warning in fit_warnings(fit)]


def warning_text(warning: FitWarning) -> str:
    """Return a sentence about a reason to doubt a fit."""
    match warning:
        case Ambiguity(name, value, excess):
            return (
                f'{name} may as well be {value:.5g} (chi squared is larger by {excess:.1f} '
                'there); the errors span both'
            )
        case InseparablePair((first, second), correlation):
            return (
                f'{first} and {second} are hardly separated by these tracks (correlation '
                f'{correlation:.4f}): the error of each is {warning.error_ratio:.0f} times '
                'larger than with the other known; hold one'
            )
        case Contradiction(name, deviation, prior):
            return (
                f'{name} is found {deviation:.1f} errors from the expected {prior}: a '
                'given value may be wrong'
            )
        case Mismatch(ratio, track, start, end):
            return (
                f'the residuals are {ratio:.2g} times the noise: the model leaves out something '
                f'that these tracks show, most of {track} from {start:.4g} s to {end:.4g} s; '
                'the errors are larger by as much'
            )
        case NotConverged():
            return 'the solver stopped at its limit before it converged: the values may be wrong'


def remark_lines(result: RigFit) -> Iterator[str]:
    """Yield sentences about added terms and omissions of a fit."""
    if not result.is_complete:
        yield 'the search for a loss and for other minima is incomplete: the fit takes too long'


def budget_lines(result: RigFit) -> Iterator[str]:
    """Yield the systematic errors, the nuisance parameters, and all other large errors."""
    floors = [f'{name} {floor}' for name, floor in FLOORS.items()]
    yield f'systematic errors, part of all errors here: {", ".join(floors)}'
    for name, value in result.terms().items():
        yield f'{name:{_NAME_WIDTH}} {with_unit(value, unit_of(name))}'
    for name in result.estimates():
        if name not in result.fit or result.fit.names.index(name) in result.fit.known:
            continue
        budget = result.budget(name)
        expected = math.hypot(budget['noise'], budget.get('systematic', 0.0))
        if expected < _NOISY * math.hypot(*budget.values()):
            yield _budget_line(name, math.hypot(*budget.values()), unit_of(name), budget)


def _budget_line(name: str, error: float, unit: str, budget: Mapping[str, float]) -> str:
    """Return a line with the largest contributions to an error, all in SI units."""
    shown, factor = _handy_unit(unit)
    listed = ', '.join(
        f'{source} {factor * contribution:.2g}'
        for source, contribution in sorted(budget.items(), key=lambda item: -item[1])
        if contribution > _LARGE_SHARE * math.hypot(*budget.values())
    )
    return f'error of {name}: {factor * error:.2g} {shown}'.rstrip() + f', by {listed}'


def answer_lines(
    answer: Answer, result: RigFit, ejection: Ejection | None
) -> Iterator[str]:
    """Yield the wave speeds and the verdict."""
    speed, at_rest = answer.effective_wave_speed, answer.rest_wave_speed
    amplitude = 1e3 * result.rig.engine.amplitude
    yield (
        f'{"effective wave speed":{_NAME_WIDTH}} {with_unit(speed, "m/s")} '
        f'({100.0 * speed.error / speed.value:.2g} %), at the amplitude of {amplitude:.3g} mm'
    )
    reason = f', limited by {answer.limited_by}' if answer.limited_by else ''
    if answer.limited_by == 'layer.stiffening':
        reason = (
            ', limited by the unknown stiffening; fit a throw at half the amplitude as well '
            'to narrow it'
        )
    yield f'{"wave speed at rest":{_NAME_WIDTH}} {with_unit(at_rest, "m/s")}{reason}'
    if ejection is None or answer.energy_transfer_error is None:
        yield f'{"energy transfer":{_NAME_WIDTH}} none, because no release is predicted, see below'
        return
    verdict = (
        'good enough to choose a layer' if answer.is_good_enough
        else 'not good enough to choose a layer'
    )
    if result.fit.is_mismatch:
        verdict += ', because the model leaves out something'
    elif assumed := result.model.description.assumed:
        verdict += f', because nobody stated {", ".join(assumed)}'
    elif not result.fit.is_converged:
        verdict += ', because the solver stopped at its limit'
    elif ejection.alternatives:
        verdict += '; another number of echoes is possible, see below'
    elif not answer.is_good_enough:
        verdict += f' ({100.0 * GOOD_ENOUGH:g} %)'
    yield (
        f'{"energy transfer":{_NAME_WIDTH}} {ejection.energy_transfer} '
        f'(known to {100.0 * answer.energy_transfer_error:.2g} %): {verdict}'
    )


def fit_lines(fit: Fit) -> Iterator[str]:
    """Yield the quality of the fit of each track, and its outliers."""
    yield (
        f'chi squared {fit.chi2:.1f} for {fit.dof} degrees of freedom '
        f'({fit.reduced_chi2:.3f} each)'
    )
    yield f'{"":{_NAME_WIDTH}} {"samples":>8} {"noise":>10} {"residual":>10} {"neighbours":>11}'
    shown = list(fit.residuals)
    if len(shown) > _MAX_TRACKS:
        shown.sort(key=lambda residual: residual.rms / residual.track.noise)
        shown = shown[-_MAX_TRACKS:]
    for residual in shown:
        name, track = residual.name, residual.track
        short = name if len(name) <= _NAME_WIDTH else f'...{name[3 - _NAME_WIDTH :]}'
        yield (
            f'{short:{_NAME_WIDTH}} {track.time.size:8} {1e6 * track.noise:7.3g} um '
            f'{1e6 * residual.rms:7.3g} um {residual.autocorrelation:11.2f}'
        )
    if len(shown) < len(fit.residuals):
        yield f'and {len(fit.residuals) - len(shown)} tracks that are fitted better'
    for residual in fit.residuals:
        if residual.outliers:
            listed = [
                f'{outlier.time:.6g} s ({1e3 * outlier.deviation:+.3g} mm)'
                for outlier in residual.outliers[:_MAX_OUTLIERS]
            ]
            more = len(residual.outliers) - len(listed)
            yield (
                f'outliers of {residual.name}: {", ".join(listed)}'
                + (f' and {more} more' if more else '')
            )


def fit_data(fit: Fit) -> dict[str, object]:
    """Return the JSON data of a fit."""
    return {
        'names': fit.names,
        'values': fit.values,
        'covariance': fit.covariance,
        'chi2': fit.chi2,
        'degrees_of_freedom': fit.dof,
        'alternatives': fit.alternatives,
        'residuals': [
            {
                'track': residual.name,
                'samples': residual.track.time.size,
                'noise': residual.track.noise,
                'rms': residual.rms,
                'autocorrelation': residual.autocorrelation,
                'outliers': residual.outliers,
            }
            for residual in fit.residuals
        ],
    }


def ejection_lines(ejection: Ejection) -> Iterator[str]:
    """Yield a table of the first release, and its alternatives beyond a jump."""
    yield ''
    for key, label, unit in EJECTION_ROWS:
        yield f'{label:{_NAME_WIDTH}} {with_unit(getattr(ejection, key), unit)}'
    for other in ejection.alternatives:
        count = 'one echo' if abs(other.echoes) == 1 else f'{abs(other.echoes)} echoes'
        yield (
            f'or, with {100.0 * other.probability:.0f} %, {count} '
            f'{"later" if other.echoes > 0 else "earlier"}: t_e {with_unit(other.time, "s")}, '
            f'V_e {with_unit(other.speed, "m/s")}, alpha {other.energy_transfer}'
        )


def ejection_data(ejection: Ejection | None) -> dict[str, object] | None:
    """Return the JSON data of an ejection."""
    if ejection is None:
        return None
    data: dict[str, object] = {key: getattr(ejection, key) for key, _, _ in EJECTION_ROWS}
    return {**data, 'alternatives': ejection.alternatives}
