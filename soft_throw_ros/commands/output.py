# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Output that commands share: errors, notices, tables and JSON."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterable, Iterator, Mapping
import contextlib
from dataclasses import fields, is_dataclass
import importlib.util
import json
import math
from pathlib import Path
import sys
import threading
from typing import Any, NoReturn

import numpy as np
from soft_throw_ros.recording.rerun_text import UNITS
from soft_throw_ros.storage.regular_file import atomic_file


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
        """Print an error in one line and exit with 2."""
        text = ' '.join(message.splitlines())  # a quoted argument may contain line ends
        self.exit(2, f'{self.prog}: error: {printable(text)}\n')


def run_command(
    parser: CommandParser,
    run: Callable[[argparse.Namespace], int],
    args: list[str] | None = None,
    *,
    compiles: bool = False,
) -> int:
    """
    Parse the arguments of a command and run it; report a ValueError as the parser's own.

    With `compiles`, print a notice if the command takes longer than two seconds.
    """
    arguments = parser.parse_args(args)
    text = 'computing; the first run compiles kernels, which takes half a minute'
    notice = threading.Timer(2.0, print_note, (parser.prog, text))
    notice.daemon = True
    if compiles:
        notice.start()
    try:
        return run(arguments)
    except ValueError as error:
        parser.error(str(error))
    finally:
        notice.cancel()


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


def print_note(command: str, text: str) -> None:
    """Print a note of a command to standard error."""
    print(f'{command}: {printable(text)}', file=sys.stderr, flush=True)


def print_result(data: object, lines: Iterable[str], *, as_json: bool) -> None:
    """Print a result as JSON, or else as lines, which are only then computed."""
    text = [json.dumps(_plain(data), indent=2, allow_nan=False)] if as_json else lines
    print_lines(text)


def print_lines(lines: Iterable[str]) -> None:
    """Print lines."""
    print(printable('\n'.join(lines)), flush=True)


def printable(text: str) -> str:
    """Escape control characters, which names in an untrusted bag may contain."""
    return ''.join(
        letter if letter.isprintable() or letter in '\n\t' else repr(letter)[1:-1]
        for letter in text
    )


def _plain(value: object) -> object:
    """Convert dataclasses, named tuples and arrays for JSON; non-finite numbers become None."""
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


def table(columns: Mapping[str, Mapping[str, Any] | None]) -> Iterator[str]:
    """Yield the lines of a table of the numbers of throws, which are columns with a head."""
    yield table_line('', '', columns)
    names = dict.fromkeys(name for column in columns.values() for name in column or ())
    for name in names:
        unit, scale = UNITS.get(name.rpartition('_')[2], ('', 1.0))
        cells = [_cell((column or {}).get(name), scale) for column in columns.values()]
        if any(cell != '-' for cell in cells):
            yield table_line(name, unit, cells)


def table_line(title: str, unit: str, cells: Iterable[str]) -> str:
    """Return a line of a table."""
    return (f'{title:22}{unit:>6}' + ''.join(f'{cell:>14}' for cell in cells)).rstrip()


def _cell(value: object, scale: float) -> str:
    if isinstance(value, float):
        return f'{scale * value:#.6g}'
    return str(value) if isinstance(value, int) else '-'


def strain_warnings(
    max_strain: float, columns: Mapping[str, Mapping[str, Any] | None]
) -> Iterator[str]:
    """Yield warnings of throws whose strain exceeds a range, or all that a layer can do [-]."""
    peaks = {head: (column or {}).get('peak_strain', 0.0) for head, column in columns.items()}
    if beyond := [head for head, peak in peaks.items() if max_strain < peak < 1.0]:
        yield (
            f'Strain beyond {1e2 * max_strain:.3g} % leaves the linear range '
            f'({", ".join(beyond)}): a real layer will deviate from this prediction.'
        )
    if impossible := [head for head, peak in peaks.items() if peak >= 1.0]:
        yield f'Strain of 100 % or more is impossible ({", ".join(impossible)}).'
