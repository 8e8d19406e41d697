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
"""What an identification found: as a table, as JSON, and as a parameter file of the twin."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
import math
from pathlib import Path

from soft_throw_ros.commands.output import to_json
from soft_throw_ros.configuration import files, ParameterError, Settings, TWIN, Value
from soft_throw_ros.configuration.atomic_file import atomic_file
from soft_throw_ros.identification.fit_description import PARAMETERS
from soft_throw_ros.identification.least_squares import Estimate, Fit
from soft_throw_ros.identification.model_choice import LayerModel
from soft_throw_ros.identification.rig_fit import RigFit
from soft_throw_ros.identification.throw_analysis import Ejection

_UNITS_IN_TABLES = {'m': ('mm', 1e3), 's': ('ms', 1e3)}
_MAX_NAMES = 4  # of sources in a parameter file
_MAX_OUTLIERS = 4  # of a track that are listed one by one
_MAX_TRACKS = 8  # that have a row of their own; if there are more, the worst of them
_NAME_WIDTH = 24
_NOISY = 0.7  # of an error that is noise, from which on nothing else is said of it
_LARGE_PART = 0.3  # of an error, from which on it is said what it comes from
_UNITS_OF_TERMS = {'projectile.delay': 's', 'projectile.sticking': 's'}

EJECTION_ROWS = (
    ('time', 'ejection time t_e', 's'),
    ('speed', 'ejection speed V_e', 'm/s'),
    ('peak_plate_speed', 'plate speed V_p*', 'm/s'),
    ('energy_transfer', 'energy transfer alpha', ''),
)


@dataclass(frozen=True, kw_only=True)
class IdentificationReport:
    """
    What was found.

    Parameters
    ----------
    sources : tuple of str
        The throws, or files, it was found in.
    found : mapping of str to Estimate
        Parameters of the twin.
    held : mapping of str to float
        Those that were taken to be known.
    chosen : mapping of str to str
        Those that are no numbers, and are otherwise than somebody said.
    lines : tuple of str
        More for people.
    data : mapping
        The same for programs: whatever JSON has a form for.
    warnings : tuple of str
        What there is to doubt.

    """

    sources: tuple[str, ...]
    found: Mapping[str, Estimate]
    held: Mapping[str, float] = field(default_factory=dict)
    chosen: Mapping[str, str] = field(default_factory=dict)
    lines: tuple[str, ...]
    data: Mapping[str, object]
    warnings: tuple[str, ...]

    def table(self) -> str:
        """Write it for people to read."""
        width = max(map(len, PARAMETERS))
        lines = [f'{name:{width}}  {text}' for name, text in self._estimates()]
        for name, value in self.held.items():
            unit, factor = _handy_unit(unit_of(name))
            text = f'{factor * value:.6g} {unit}'.rstrip()
            lines.append(f'{name:{width}}  {text}, taken as known')
        lines += [f'{name:{width}}  {value}' for name, value in self.chosen.items()]
        return '\n'.join([*lines, '', *self.lines]) + '\n'

    def json(self) -> str:
        """Write it for programs to read, in SI units."""
        found = {
            name: {**value._asdict(), 'unit': unit_of(name)} for name, value in self.found.items()
        }
        parts = {'sources': self.sources, 'found': found, 'held': self.held}
        return to_json({**parts, 'chosen': self.chosen, **self.data, 'warnings': self.warnings})

    def _estimates(self) -> Iterator[tuple[str, str]]:
        for name, value in self.found.items():
            yield name, with_unit(value, unit_of(name))

    def put_into(self, settings: Settings) -> Settings:
        """Put what was found into settings of the twin, or raise ParameterError."""
        request: dict[str, Value] = {
            name: float(f'{value.value:.8g}') for name, value in self.found.items()
        }
        request |= self.chosen
        try:
            return {**settings, **TWIN.change(settings, request)}
        except ParameterError as error:
            hint = ''
            if error.names and error.names[0] in ('engine.amplitude', 'layer.thickness'):
                hint = '; is the unit of heights right (--unit)?'
            raise ParameterError(
                f'found, but not for the twin: {error}{hint}', *error.names
            ) from None

    def write(self, settings: Settings, path: Path) -> None:
        """Write what describes the rig, and whatever else is not as it is by default."""
        kept = {
            entry.name: settings[entry.name]
            for entry in TWIN.entries
            if entry.name in settings
            and (entry.is_of_rig or settings[entry.name] != entry.default)
        }
        names = [Path(source).name for source in self.sources]
        if len(names) > _MAX_NAMES:
            names = [names[0], '...', names[-1]]
        title = [f'Identified from {", ".join(names)}:']
        title += [f'{name} {text}' for name, text in self._estimates()]
        title += [f'Doubtful: {warning}' for warning in self.warnings]
        with atomic_file(path) as unfinished:  # whoever reads it meanwhile finds the one before
            files.write(unfinished, kept, title='\n'.join(title))


def unit_of(name: str) -> str:
    """Return the unit of a parameter of the twin, or of a term of the fit."""
    return TWIN.by_name[name].unit if name in TWIN.by_name else _UNITS_OF_TERMS.get(name, '')


def _handy_unit(unit: str) -> tuple[str, float]:
    """Return the unit in which tables have what is in a unit of SI, and SI times what it is."""
    return _UNITS_IN_TABLES.get(unit, (unit, 1.0))


def with_unit(value: Estimate, unit: str) -> str:
    """Write a value with its error, in a unit of handy size."""
    shown, factor = _handy_unit(unit)
    return f'{Estimate(factor * value.value, factor * value.error)} {shown}'.rstrip()


def budget_lines(found: RigFit) -> Iterator[str]:
    """Say what else the fit has found, and of what an error is made that is not mere noise."""
    for name, value in found.terms().items():
        yield f'{name:{_NAME_WIDTH}} {with_unit(value, unit_of(name))}'
    for name, ends in found.intervals.items():
        shown, factor = _handy_unit(unit_of(name))
        low, high = (f'{factor * end:.4g}' for end in ends)
        yield f'{name} is from {low} to {high} {shown}'.rstrip() + ' with 95 % (profile)'
    for name in found.estimates():
        if name not in found.fit or found.fit.names.index(name) in found.fit.known:
            continue
        parts = found.fit.budget(name)
        total = math.sqrt(sum(part**2 for part in parts.values()))
        large = {n: part for n, part in parts.items() if part > _LARGE_PART * total}
        if parts['noise'] < _NOISY * total:
            shown, factor = _handy_unit(unit_of(name))
            listed = ', '.join(
                f'{n} {factor * part:.2g}'
                for n, part in sorted(large.items(), key=lambda item: -item[1])
            )
            yield f'error of {name}: {factor * total:.2g} {shown}'.rstrip() + f', by {listed}'


def layer_lines(layers: Sequence[LayerModel]) -> Iterator[str]:
    """Write a table of how well kinds of layers explain the throws."""
    if layers:
        yield f'{"layer":{_NAME_WIDTH}} {"chi squared":>12} {"each":>8} {"BIC":>8}'
    for each in layers:
        note = '' if each.is_fitted else '  to first order'
        yield (
            f'{each.name:{_NAME_WIDTH}} {each.chi2:12.1f} {each.chi2 / each.dof:8.3f} '
            f'{each.criterion:+8.1f}{note}'
        )


def fit_lines(fit: Fit) -> Iterator[str]:
    """Say how well tracks are fitted, and what was left out."""
    yield (
        f'chi squared {fit.chi2:.1f} for {fit.dof} degrees of freedom '
        f'({fit.reduced_chi2:.3f} each)'
    )
    yield f'{"":{_NAME_WIDTH}} {"samples":>8} {"noise":>10} {"residual":>10} {"neighbours":>11}'
    shown = list(fit.residuals)
    if len(shown) > _MAX_TRACKS:
        shown = sorted(shown, key=lambda residual: residual.reduced_chi2)[-_MAX_TRACKS:]
    for residual in shown:
        name, track = residual.name, residual.track
        short = name if len(name) <= _NAME_WIDTH else f'...{name[3 - _NAME_WIDTH :]}'
        yield (
            f'{short:{_NAME_WIDTH}} {track.time.size:8} {1e6 * residual.rms_noise:7.3g} um '
            f'{1e6 * residual.rms:7.3g} um {residual.autocorrelation:11.2f}'
        )
    if len(shown) < len(fit.residuals):
        yield f'and {len(fit.residuals) - len(shown)} tracks that are fitted better'
    for residual in fit.residuals:
        if residual.outliers:
            listed = [
                f'{each.time:.6g} s ({1e3 * each.deviation:+.3g} mm)'
                for each in residual.outliers[:_MAX_OUTLIERS]
            ]
            more = len(residual.outliers) - len(listed)
            yield (
                f'left out as outliers of {residual.name}: {", ".join(listed)}'
                + (f' and {more} more' if more else '')
            )


def fit_data(fit: Fit) -> dict[str, object]:
    """Name what JSON tells of a fit."""
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
                'noise': residual.rms_noise,
                'rms': residual.rms,
                'autocorrelation': residual.autocorrelation,
                'whiteness': residual.whiteness,
                'outliers': residual.outliers,
            }
            for residual in fit.residuals
        ],
    }


def ejection_lines(columns: Mapping[str, Ejection]) -> Iterator[str]:
    """Write ejections side by side."""
    yield ''
    yield ' ' * 22 + ''.join(f'{name:>26}' for name in columns)
    for key, label, unit in EJECTION_ROWS:
        cells = (with_unit(getattr(each, key), unit) for each in columns.values())
        yield f'{label:22}' + ''.join(f'{cell:>26}' for cell in cells)


def ejection_data(ejection: Ejection | None) -> dict[str, Estimate] | None:
    """Name what JSON tells of an ejection."""
    if ejection is None:
        return None
    return {key: getattr(ejection, key) for key, _, _ in EJECTION_ROWS}
