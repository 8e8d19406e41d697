# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Output that commands share: errors, notices, tables and JSON."""

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
from pathlib import Path
import re
import sys
import threading
from typing import Any, NamedTuple, NoReturn

import numpy as np
from soft_throw_ros.core.rig import STANDARD_GRAVITY
from soft_throw_ros.storage.atomic_file import atomic_file

_WIDTH = 12  # width of a column of numbers [characters]


class CommandParser(argparse.ArgumentParser):
    """A parser of command lines that prints errors without the usage, which may fill a screen."""

    def __init__(self, **kwargs: Any) -> None:
        super().__init__(allow_abbrev=False, **kwargs)

    def add_json_option(self) -> None:
        """Add the option `--json`."""
        self.add_argument(
            '--json', action='store_true', help='print one object: SI units, full precision'
        )

    def error(self, message: str) -> NoReturn:
        """Print an error of usage and exit with 2."""
        self.refuse(message, is_usage=True)

    def refuse(self, message: str, *, is_usage: bool) -> NoReturn:
        """Print an error in one line, after an error of usage a hint to --help; exit with 2."""
        text = ' '.join(message.splitlines())  # a quoted argument may contain line ends
        hint = f'{self.prog}: see --help for all options\n' if is_usage else ''
        self.exit(2, f'{self.prog}: error: {text}\n{hint}')


def run_command(
    parser: CommandParser,
    run: Callable[[argparse.Namespace], int],
    args: list[str] | None = None,
) -> int:
    """Parse the arguments of a command and run it; a ValueError is reported as one of usage."""
    arguments = parser.parse_args(args)
    try:
        return run(arguments)
    except ValueError as error:
        parser.refuse(str(error), is_usage=str(error).startswith('argument '))


@contextlib.contextmanager
def report_io_errors(path: object, *kinds: type[ValueError]) -> Iterator[None]:
    """Convert errors of a file, and those of the given kinds, into ValueErrors that name it."""
    try:
        yield
    except UnicodeDecodeError:
        raise ValueError(f'{path}: not a UTF-8 text') from None
    except OSError as error:
        reason = error.strerror or str(error).partition('\n')[0]
        raise ValueError(f'{path}: {reason}') from None
    except kinds as error:
        raise ValueError(f'{path}: {error}') from None


@contextlib.contextmanager
def written_file(path: Path) -> Iterator[Path]:
    """Yield a temporary name for the content of a file; raise ValueError that names the file."""
    with report_io_errors(path), atomic_file(path) as unfinished:
        yield unfinished


def require(feature: str, extra: str, *modules: str) -> None:
    """Raise ValueError if a feature needs modules that are not installed; name their extra."""
    for name in modules:
        if importlib.util.find_spec(name) is None:
            raise ValueError(
                f'{feature} needs the module {name}, which pip installs with '
                f"'soft_throw_ros[{extra}]'"
            )


@contextlib.contextmanager
def slow_notice(command: str, *, after: float = 2.0) -> Iterator[None]:
    """Print a notice to standard error if a command computes for longer than `after` [s]."""
    text = 'computing; the first run compiles kernels, which takes half a minute'
    timer = threading.Timer(after, print_note, (command, text))
    timer.daemon = True
    timer.start()
    try:
        yield
    finally:
        timer.cancel()


_CONTROL = re.compile(r'[\x00-\x08\x0b-\x1f\x7f-\x9f\u2028-\u202e\u2066-\u2069]')
"""Control characters of a terminal, except line ends and tabs."""


def printable(text: str) -> str:
    r"""
    Escape control characters, which names in an untrusted bag may contain.

    Examples
    --------
    >>> print(printable('/a\x1b[2J'))
    /a\x1b[2J

    """
    return _CONTROL.sub(lambda match: repr(match[0])[1:-1], text)


def print_note(command: str, text: str) -> None:
    """Print a note of a command to standard error."""
    print(f'{command}: {text}', file=sys.stderr, flush=True)


def print_result(data: object, lines: Iterable[str], *, as_json: bool) -> None:
    """Print a result as JSON, or else as lines, which are only then computed."""
    if as_json:
        print_text(to_json(data))
    else:
        print_lines(lines)


def print_lines(lines: Iterable[str]) -> None:
    """Print lines as `print_text` does."""
    print_text('\n'.join(lines) + '\n')


def print_text(text: str) -> None:
    """Print a text without control characters; a closed pipe, such as `| head`, is no error."""
    try:
        sys.stdout.write(printable(text))
        sys.stdout.flush()
    except BrokenPipeError:
        # Otherwise Python reports the closed pipe again when it exits.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


def to_json(data: object) -> str:
    """Format dataclasses, named tuples and arrays as JSON; non-finite numbers become null."""
    return json.dumps(_plain(data), indent=2, allow_nan=False) + '\n'


def _plain(value: object) -> object:
    if is_dataclass(value):
        names = [field.name for field in fields(value) if not field.name.startswith('_')]
        return {name: _plain(getattr(value, name)) for name in names}
    if hasattr(value, '_asdict'):
        value = value._asdict()
    if isinstance(value, Mapping):
        return {key: _plain(item) for key, item in value.items()}
    if isinstance(value, np.ndarray):
        value = value.tolist()
    if isinstance(value, (list, tuple)):
        return [_plain(item) for item in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value


class _Row(NamedTuple):
    """A line of a table: key of its numbers, title, unit, and factor from SI to the unit."""

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
    _Row('plate_work', 'work of the plate', 'mJ', 1e3),
    _Row('layer_energy', '  to the layer', 'mJ', 1e3),
    _Row('projectile_energy', '  to the projectile', 'mJ', 1e3),
    _Row('heat', '  to heat', 'mJ', 1e3),
    _Row('kinetic_energy', 'kinetic energy at t_e', 'mJ', 1e3),
)
"""Quantities of a throw, in the order of the tables."""


def write_columns(columns: Mapping[str, Mapping[str, float] | None]) -> Iterator[str]:
    """
    Yield the lines of a table of throws by their heads; rows without numbers are omitted.

    Words of a head that are joined by `_` are written below each other.
    """
    words = [head.split('_') for head in columns]
    for heads in itertools.zip_longest(*words, fillvalue=''):
        yield table_line('', '', heads)
    for row in _ROWS:
        cells = [_cell((numbers or {}).get(row.key), row.scale) for numbers in columns.values()]
        if any(cell != '-' for cell in cells):
            yield table_line(row.title, row.unit, cells)


def strain_warnings(
    max_strain: float, columns: Mapping[str, Mapping[str, float] | None]
) -> Iterator[str]:
    """Yield warnings of throws whose strain exceeds a range, or all that a layer can do [-]."""
    peaks = {
        head.replace('_', ' '): (numbers or {}).get('peak_strain', 0.0)
        for head, numbers in columns.items()
    }
    if beyond := [head for head, peak in peaks.items() if max_strain < peak < 1.0]:
        yield (
            f'Strain beyond {1e2 * max_strain:.3g} % leaves the linear range '
            f'({", ".join(beyond)}): a real layer will deviate from this prediction.'
        )
    if impossible := [head for head, peak in peaks.items() if peak >= 1.0]:
        yield (
            f'Strain of 100 % or more is impossible ({", ".join(impossible)}): a layer cannot be '
            'compressed by its whole thickness.'
        )


def table_line(title: str, unit: str, cells: Iterable[str]) -> str:
    """Return a line of a table."""
    line = f'{title:22}{unit:>6}' + ''.join(f'{cell:>{_WIDTH}}' for cell in cells)
    return line.rstrip()


def _cell(value: float | None, scale: float) -> str:
    if value is None:
        return '-'
    return str(value) if isinstance(value, int) else f'{scale * value:#.6g}'
