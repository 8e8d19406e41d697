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
"""What commands have in common on their way out: refusals, notices, tables and JSON."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterable, Iterator, Mapping
import contextlib
from dataclasses import fields, is_dataclass
import importlib.util
import itertools
import json
import math
import os
import sys
import threading
from typing import NamedTuple, NoReturn

import numpy as np
from soft_throw_ros.core.rig import STANDARD_GRAVITY

_WIDTH = 12  # of a column of numbers


def run_command(
    parser: argparse.ArgumentParser,
    run: Callable[[argparse.Namespace], int],
    args: list[str] | None = None,
) -> int:
    """
    Parse arguments and run a command with them.

    Parameters
    ----------
    parser : ArgumentParser
        Of the command.
    run : callable
        Returns the exit code; a ValueError is a refusal.
    args : list of str, optional
        Those of the process by default.

    Raises
    ------
    SystemExit
        With exit code 2 if something is refused, after a line that says what.

    """
    error_of = parser.error

    def refuse(text: str) -> NoReturn:
        error_of(
            ' '.join(text.splitlines())
        )  # an argument that is quoted may have line ends in it

    parser.error = refuse  # type: ignore[assignment, method-assign]
    arguments = parser.parse_args(args)
    try:
        exit_code = run(arguments)
    except ValueError as error:
        parser.error(str(error))
    return exit_code


@contextlib.contextmanager
def naming(path: object) -> Iterator[None]:
    """Refuse in one line that names it a file that cannot be read or written."""
    try:
        yield
    except UnicodeDecodeError:
        raise ValueError(f'{path}: is no UTF-8 text') from None
    except OSError as error:
        raise ValueError(f'{path}: {error.strerror or error}') from None


def require(what: str, extra: str, *modules: str) -> None:
    """Refuse what needs modules that are not installed; an extra of the package has them."""
    for name in modules:
        if importlib.util.find_spec(name) is None:
            raise ValueError(
                f"{what} needs what pip installs with 'soft_throw_ros[{extra}]': "
                f'there is no module {name}'
            )


@contextlib.contextmanager
def slow_notice(command: str, *, after: float = 2.0) -> Iterator[None]:
    """Say on standard error what a command is waiting for, if it takes longer than that [s]."""
    text = f'{command}: computing; the first run compiles, which takes half a minute'
    timer = threading.Timer(after, print, (text,), {'file': sys.stderr, 'flush': True})
    timer.daemon = True
    timer.start()
    try:
        yield
    finally:
        timer.cancel()


def print_text(text: str) -> None:
    """Print it; a reader that has closed the pipe, as `| head` does, has seen enough."""
    try:
        sys.stdout.write(text)
        sys.stdout.flush()
    except BrokenPipeError:
        # Python would complain once more when it exits.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


def to_json(data: object) -> str:
    """Write dataclasses, named tuples and arrays as JSON; what is not finite becomes null."""
    return json.dumps(_plain(data), indent=2, allow_nan=False) + '\n'


def _plain(value: object) -> object:
    if is_dataclass(value):
        names = [field.name for field in fields(value) if not field.name.startswith('_')]
        return {name: _plain(getattr(value, name)) for name in names}
    if hasattr(value, '_asdict'):
        value = value._asdict()
    if isinstance(value, Mapping):
        return {key: _plain(part) for key, part in value.items()}
    if isinstance(value, np.ndarray):
        value = value.tolist()
    if isinstance(value, (list, tuple)):
        return [_plain(part) for part in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value


class _Row(NamedTuple):
    """A line of a table: the key of its numbers, its title, its unit, and SI times what it is."""

    key: str
    title: str
    unit: str = ''
    scale: float = 1.0


_ROWS = (
    _Row('amplitude', 'amplitude A', 'mm', 1e3),
    _Row('thickness', 'thickness L_s', 'mm', 1e3),
    _Row('wave_speed', 'wave speed c_s', 'm/s'),
    _Row('density', 'density', 'kg/m3'),
    _Row('youngs_modulus', 'modulus', 'kPa', 1e-3),
    _Row('loss_tangent', 'loss tangent'),
    _Row('mass_ratio', 'mu'),
    _Row('speed_ratio', 'kappa'),
    _Row('plate_speed', 'plate speed', 'm/s'),
    _Row('plate_acceleration', 'plate acceleration', 'm/s2'),
    _Row('plate_travel', 'plate travel', 'mm', 1e3),
    _Row('ejection_time', 'ejection time t_e', 'ms', 1e3),
    _Row('ejection_phase', '  t_e f'),
    _Row('ejection_speed', 'ejection speed V_e', 'm/s'),
    _Row('peak_plate_speed', 'plate speed V_p*', 'm/s'),
    _Row('energy_transfer', 'energy transfer alpha'),
    _Row('recontacts', 're-contacts'),
    _Row('last_ejection_time', 'last release', 'ms', 1e3),
    _Row('last_ejection_speed', '  its speed', 'm/s'),
    _Row('last_energy_transfer', '  its alpha'),
    _Row('speed', 'speed of last release', 'm/s'),
    _Row('height', 'rise above the layer', 'mm', 1e3),
    _Row('apex_height', 'apex above the plate', 'mm', 1e3),
    _Row('peak_strain', 'peak strain', '%', 1e2),
    _Row('peak_plate_strain', '  at the plate', '%', 1e2),
    _Row('peak_contact_strain', '  at the projectile', '%', 1e2),
    _Row('peak_acceleration', 'peak acceleration', 'm/s2'),
    _Row('peak_acceleration', '  in g', 'g', 1.0 / STANDARD_GRAVITY),
    _Row('peak_plate_force', 'peak force on plate', 'N'),
    _Row('peak_force', 'peak force on plate', 'N'),
    _Row('plate_work', 'work of the plate', 'mJ', 1e3),
    _Row('layer_energy', '  to the layer', 'mJ', 1e3),
    _Row('projectile_energy', '  to the projectile', 'mJ', 1e3),
    _Row('heat', '  to heat', 'mJ', 1e3),
    _Row('kinetic_energy', 'kinetic energy at t_e', 'mJ', 1e3),
)
"""All that is said of throws in tables."""


def write_columns(columns: Mapping[str, Mapping[str, float] | None]) -> Iterator[str]:
    """
    Write a table for people, line by line: what is known of each of some throws.

    Parameters
    ----------
    columns : mapping of str to mapping or None
        The numbers by their keys, under heads whose words, joined by `_`, stand one below the
        other.

    """
    words = [head.split('_') for head in columns]
    for heads in itertools.zip_longest(*words, fillvalue=''):
        yield _line('', '', heads)
    for row in _ROWS:
        cells = [_cell((numbers or {}).get(row.key), row.scale) for numbers in columns.values()]
        if any(cell != '-' for cell in cells):
            yield _line(row.title, row.unit, cells)


def strain_warning(max_strain: float, where: str) -> str:
    """Say that a throw is beyond the strain up to which a layer is linear [-]."""
    return (
        f'Strain beyond {1e2 * max_strain:.3g} % leaves the linear range ({where}): a real layer '
        'will do otherwise.'
    )


def _line(title: str, unit: str, cells: Iterable[str]) -> str:
    line = f'{title:22}{unit:>6}' + ''.join(f'{cell:>{_WIDTH}}' for cell in cells)
    return line.rstrip()


def _cell(value: float | None, scale: float) -> str:
    if value is None:
        return '-'
    return str(value) if isinstance(value, int) else f'{scale * value:#.6g}'
