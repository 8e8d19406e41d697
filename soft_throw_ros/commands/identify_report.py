# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
The report of an identification: one list of rows, and its renderings.

They are a table, JSON, the parameter file of the twin, and the head of a figure.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
import math
from pathlib import Path
from typing import NamedTuple

from soft_throw_ros.commands.output import print_note, print_result, written_file
from soft_throw_ros.configuration import files, ParameterError, Settings, TWIN, Value
from soft_throw_ros.configuration.layers import CUSTOM
from soft_throw_ros.configuration.twin_config import BOUND_PER_DEVIATION
from soft_throw_ros.identification.ejection import Release
from soft_throw_ros.identification.least_squares import Estimate, Fit
from soft_throw_ros.identification.rig_fit import RigFit
from soft_throw_ros.identification.systematics import FLOORS

REST_WAVE_SPEED = 'layer.rest_wave_speed'
ASSUMED = 'assumed'
"""Note of a parameter that nobody stated."""

_UNITS_IN_TABLES = {'m': ('mm', 1e3), 's': ('ms', 1e3)}
_OTHER_UNITS = {
    'projectile.delay': 's', 'ejection.time': 's', 'ejection.speed': 'm/s',
    'ejection.peak_plate_speed': 'm/s', REST_WAVE_SPEED: 'm/s',
}
_MAX_OUTLIERS = 4  # largest number of outliers of a track that are listed
_NAME_WIDTH = 26


class Row(NamedTuple):
    """A quantity of the report."""

    name: str
    value: float  # [SI]
    error: float | None = None  # standard error; None if the fit held the value [SI]
    note: str = ''

    @classmethod
    def of(cls, name: str, estimate: Estimate, note: str = '') -> Row:
        """Return the row of an estimate."""
        return cls(name, *estimate, note)

    @property
    def unit(self) -> str:
        """SI unit."""
        return TWIN.by_name[self.name].unit if self.name in TWIN.by_name else (
            _OTHER_UNITS.get(self.name, '')
        )

    def __str__(self) -> str:
        unit, factor = _UNITS_IN_TABLES.get(self.unit, (self.unit, 1.0))
        if self.error is None:
            number = f'{factor * self.value:.6g}'
        else:
            number = str(Estimate(factor * self.value, factor * self.error))
        return f'{number} {unit}'.rstrip() + (f', {self.note}' if self.note else '')


@dataclass(frozen=True, kw_only=True)
class IdentificationReport:
    """Result of an identification."""

    sources: tuple[str, ...]  # names of the throws or files
    rows: tuple[Row, ...]  # all quantities, parameters of the twin first
    head: tuple[str, ...] = ()  # lines that come first: assumptions and the verdict
    lines: tuple[str, ...] = ()  # lines after the rows
    data: Mapping[str, object] = field(default_factory=dict)  # further content of the JSON output
    notes: tuple[str, ...] = ()  # defects of the tracks, such as missing samples
    warnings: tuple[str, ...] = ()  # reasons to doubt the result

    @property
    def assumed(self) -> list[str]:
        """Held parameters that nobody stated."""
        return [row.name for row in self.rows if row.note == ASSUMED]

    def _table(self) -> Iterator[str]:
        """Yield the lines of the report."""
        if self.head:
            yield from (*self.head, '')
        for row in self.rows:
            yield f'{row.name:{_NAME_WIDTH}} {row}'
        if self.lines:
            yield from ('', *self.lines)

    def _put_into(self, settings: Settings) -> Settings:
        """Return settings with the values and errors of the fit; may raise ParameterError."""
        request: dict[str, Value] = {}
        for row in self.rows:
            if row.name not in TWIN.by_name or row.note == ASSUMED:
                continue
            if not math.isclose(row.value, settings[row.name]):  # any request would end a stack
                request[row.name] = float(f'{row.value:.8g}')
            bound = TWIN.by_name.get(f'uncertainty.{row.name.rpartition(".")[2]}')
            if bound is not None:
                scale = row.value if row.name == 'projectile.mass' else 1.0  # relative
                largest = BOUND_PER_DEVIATION * (row.error or 0.0) / scale
                request[bound.name] = float(f'{min(largest, bound.high):.3g}')
        try:
            return {**settings, **TWIN.change(settings, request)}
        except ParameterError as error:
            is_length = {'engine.amplitude', 'layer.thickness'} & set(error.names[:1])
            hint = '; is the unit of heights right (--unit)?' if is_length else ''
            raise ParameterError(
                f'found, but not for the twin: {error}{hint}', *error.names
            ) from None

    def finish(self, settings: Settings, arguments: argparse.Namespace, command: str) -> None:
        """Write the parameter file on request, and print the report, notes and warnings."""
        identified = self._put_into(settings)
        if arguments.output:
            self._write(identified, arguments.output)
        data = {
            'sources': self.sources,
            'rows': [{**row._asdict(), 'unit': row.unit} for row in self.rows],
            'assumed': self.assumed,
            **self.data,
            'notes': self.notes,
            'warnings': self.warnings,
        }
        print_result(data, self._table(), as_json=arguments.json)
        for message in (*self.notes, *self.warnings):
            print_note(command, message)

    def _write(self, settings: Settings, path: Path) -> None:
        """Write the parameters of the rig, and all others that differ from their defaults."""
        kept = {
            entry.name: settings[entry.name]
            for entry in TWIN.entries
            if entry.name in settings
            and (entry.is_of_rig or settings[entry.name] != entry.default)
        }
        if any(name.startswith('layer.') for name in self.assumed):
            kept['layer.name'] = CUSTOM  # a name would state the whole layer
        first, last = (Path(self.sources[index]).name for index in (0, -1))
        title = [f'Identified from {" to ".join(dict.fromkeys((first, last)))}:']
        title += [f'{row.name} {row}' for row in self.rows if row.name in TWIN.by_name]
        title += [f'Doubtful: {warning}' for warning in self.warnings]
        with written_file(path) as unfinished:
            text = files.render(kept, title='\n'.join(title), assumed=self.assumed)
            unfinished.write_text(text, 'utf-8')


def held_rows(values: Mapping[str, float], assumed: Sequence[str]) -> Iterator[Row]:
    """Yield the rows of parameters that were held."""
    for name, value in values.items():
        yield Row(name, value, note=ASSUMED if name in assumed else 'taken as known')


def fit_rows(result: RigFit) -> Iterator[Row]:
    """Yield the fitted parameters, and the wave speed at rest."""
    amplitude = 1e3 * result.rig.engine.amplitude
    for name, estimate in result.estimates().items():
        if name == 'layer.wave_speed':
            yield Row.of(name, estimate, f'at the amplitude of {amplitude:.3g} mm')
            note = 'lower if the layer stiffens; identify a throw of half the amplitude alone'
            yield Row.of(REST_WAVE_SPEED, result.rest_wave_speed(), note)
        else:
            yield Row.of(name, estimate)


def ejection_rows(releases: Sequence[Release]) -> Iterator[Row]:
    """Yield the first release, and its alternatives beyond a jump."""
    for release in releases:
        note = ''
        if release.echoes:
            count = 'one echo' if abs(release.echoes) == 1 else f'{abs(release.echoes)} echoes'
            order = 'later' if release.echoes > 0 else 'earlier'
            note = f'or {count} {order}, with {100.0 * release.probability:.0f} %'
        for name in ('time', 'speed', 'peak_plate_speed', 'energy_transfer'):
            yield Row.of(f'ejection.{name}', getattr(release, name), note)


def fit_lines(result: RigFit) -> Iterator[str]:
    """Yield the systematic errors, the quality of the fit of each track, and its outliers."""
    fit = result.fit
    floors = ', '.join(f'{name} {floor}' for name, floor in FLOORS.items())
    yield f'systematic errors, part of all errors here, all times {result.growth:.2g}: {floors}'
    yield (
        f'chi squared {fit.chi2:.1f} for {fit.dof} degrees of freedom '
        f'({fit.reduced_chi2:.3f} each)'
    )
    yield f'{"":{_NAME_WIDTH}} {"samples":>8} {"noise":>10} {"residual":>10}'
    for residual in fit.residuals:
        track = residual.track
        yield (
            f'{residual.name:{_NAME_WIDTH}} {track.time.size:8} {1e6 * track.noise:7.3g} um '
            f'{1e6 * residual.rms:7.3g} um'
        )
    for residual in fit.residuals:
        listed = ', '.join(
            f'{outlier.time:.6g} s ({1e3 * outlier.deviation:+.3g} mm)'
            for outlier in residual.outliers[:_MAX_OUTLIERS]
        )
        if listed:
            yield f'{len(residual.outliers)} outliers of {residual.name}: {listed}'


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
                'outliers': residual.outliers,
            }
            for residual in fit.residuals
        ],
    }
