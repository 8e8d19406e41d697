# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Options that commands share: parameters of a rig, a cluster, file names."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import CancelledError
import contextlib
from dataclasses import replace
import math
from pathlib import Path
from typing import Any

from soft_throw_ros.commands.output import require
from soft_throw_ros.configuration import files, ParameterError, TWIN, Value
from soft_throw_ros.configuration.layers import CUSTOM
from soft_throw_ros.configuration.table import float_of, value_text
import yaml


def option_of(name: str) -> str:
    """Return the option of a parameter: the last part of its name."""
    last = 'layer' if name == 'layer.name' else name.rpartition('.')[2]
    return f'--{last.replace("_", "-")}'


MAIN_PARAMETERS = (
    'engine.motion', 'engine.frequency', 'engine.amplitude', 'layer.name', 'layer.stack',
    'layer.thickness', 'layer.wave_speed', 'projectile.mass',
)
"""Parameters of a rig that are options of `throw` and `design`; `-p` sets the others."""

MEASURED_PARAMETERS = (
    'layer.thickness', 'layer.density', 'layer.diameter', 'projectile.mass',
)
"""Parameters of a rig that are measured before an identification, whose options they are."""

_MOTION = replace(
    TWIN.by_name['engine.motion'],
    meaning='Motion of the plate: a damped step (D2), A (1 - cos wt) without damping (Eq. 1), or '
    'a recorded motion from a file (CSV of time and height)',
    choices=(),
    kind="'underdamped', 'harmonic' or the path of a file",
)
"""The option `--motion`, whose value may be a file."""

_NAMED = 'named'  # attribute of the arguments with the names of the parameters that `-p` sets
_FIGURES = ('.png', '.pdf', '.svg')  # suffixes of files that Matplotlib writes


class _SetParameter(argparse.Action):
    """The option `-p NAME:=VALUE`, which stores a value as an option of the parameter would."""

    def __call__(self, _parser: object, namespace: Any, text: Any, _option: object = None) -> None:
        """Store the value, which is YAML, and the name of the parameter."""
        name, sign, value = text.partition(':=')
        if not sign or name not in TWIN.by_name:
            raise argparse.ArgumentError(
                self, f'must be NAME:=VALUE with a parameter of the twin, got {text!r}'
            )
        try:
            setattr(namespace, name, yaml.safe_load(value))
        except (yaml.YAMLError, ValueError):  # the latter for impossible dates
            raise argparse.ArgumentError(self, f'{name} must be YAML, got {value!r}') from None
        setattr(namespace, self.dest, [*getattr(namespace, self.dest, []), name])


def add_rig_options(
    parser: argparse.ArgumentParser, names: Iterable[str] = MAIN_PARAMETERS
) -> None:
    """Add `--config`, `-p` and options for some parameters; `read_settings` reads them."""
    parser.add_argument(
        '--config', metavar='FILE', default=argparse.SUPPRESS, help='parameter file of the twin'
    )
    parser.add_argument(
        '-p', dest=_NAMED, metavar='NAME:=VALUE', action=_SetParameter, default=argparse.SUPPRESS,
        help='set any parameter of the twin (docs/parameters.md); may be repeated',
    )
    title, text = 'parameters of the rig', 'as for the twin; options override the file'
    add_options(parser, names, title=title, description=text)


def _number_or_text(text: str) -> float | str:
    """Parse a number; return any other text unchanged, for the table of parameters to refuse."""
    value = float_of(text)
    return text if value is None else value


def add_options(
    parser: argparse.ArgumentParser,
    names: Iterable[str],
    *,
    title: str,
    description: str = '',
) -> None:
    """Add a group with one option per parameter; `read_settings` reads them."""
    group = parser.add_argument_group(title, description)
    for name in names:
        entry = _MOTION if name == _MOTION.name else TWIN.by_name[name]
        text = f'{entry.meaning}; {entry.rule}'
        if entry.default != '':
            text += f' (default {value_text(entry.default)})'
        group.add_argument(
            option_of(name),
            dest=name,
            metavar=entry.unit.upper() or ('NAME' if isinstance(entry.default, str) else 'NUMBER'),
            type=str if isinstance(entry.default, str) else _number_or_text,
            choices=entry.choices or None,
            default=argparse.SUPPRESS,
            help=text.replace('`', '').replace('%', '%%'),
        )


def read_settings(arguments: argparse.Namespace) -> dict[str, Value]:
    """Return complete settings: the defaults, overridden by the file and then by the options."""
    values = vars(arguments)
    request = {name: values[name] for name in TWIN.by_name if name in values}
    motion = request.get('engine.motion', 'harmonic')
    if motion not in TWIN.by_name['engine.motion'].choices:
        request |= {'engine.motion': 'file', 'engine.motion_file': motion}
    settings = files.read(values['config']) if 'config' in values else TWIN.defaults()
    try:
        settings.update(TWIN.change(settings, request))
    except ParameterError as error:
        options = (
            f'{argument_of(arguments, name)}: ' for name in error.names if name in request
        )
        raise ParameterError(f'{next(options, "")}{error}', *error.names) from None
    return settings


def argument_of(arguments: argparse.Namespace, name: str) -> str:
    """Return the argument that has set a parameter, for messages."""
    named = name in getattr(arguments, _NAMED, ())
    option = '-p' if named else option_of(name.removesuffix('_file'))  # of --motion FILE
    return f'argument {option}'


def stated_parameters(arguments: argparse.Namespace) -> set[str]:
    """Return the parameters that the options or the file state; the others have defaults."""
    values = {name: value for name, value in vars(arguments).items() if name in TWIN.by_name}
    if 'config' in arguments:
        items = files.select(files.read_file(arguments.config), '/twin').items()
        values = {name: source.value for name, source in items} | values
    if values.get('layer.name', CUSTOM) != CUSTOM or values.get('layer.stack'):
        values |= dict.fromkeys(TWIN.names_in('layer'))
    return set(values)


def add_dask_option(parser: argparse.ArgumentParser) -> None:
    """Add `--dask`; `open_map` reads it."""
    parser.add_argument(
        '--dask', metavar='ADDRESS',
        help='use the workers of a Dask scheduler, such as tcp://10.0.0.1:8786',
    )


@contextlib.contextmanager
def open_map(address: str | None) -> Iterator[Callable[..., Iterable[Any]]]:
    """Yield `map`, or that of the executor of a Dask scheduler."""
    if address is None:
        yield map
        return
    require('--dask', 'dask', 'distributed')
    from distributed import Client
    from distributed.scheduler import KilledWorker

    try:
        client = Client(address, timeout='10s', set_as_default=False)
    except (OSError, ValueError) as error:
        raise ValueError(f'--dask {address}: no scheduler answers there ({error})') from None
    try:
        with client, client.get_executor() as executor:
            yield executor.map
    except (KilledWorker, CancelledError):
        raise ValueError(f'--dask {address}: the scheduler or a worker is lost') from None


def number_type(rule: str, allows: Callable[[float], bool]) -> Callable[[str], float]:
    """Return an argparse type for the numbers that a function allows."""

    def read(text: str) -> float:
        value = float_of(text)
        if value is None or not allows(value):
            raise argparse.ArgumentTypeError(f'must be {rule}, got {text!r}')
        return value

    return read


any_number = number_type('a number', lambda value: not math.isnan(value))
positive = number_type('finite and positive', lambda value: 0.0 < value < math.inf)
not_negative = number_type('finite and not negative', lambda value: 0.0 <= value < math.inf)


def new_file(*endings: str) -> Callable[[str], Path]:
    """Return an argparse type for the names of writable files."""

    def read(text: str) -> Path:
        path = Path(text)
        if endings and path.suffix not in endings:
            raise argparse.ArgumentTypeError(f'must end with {", ".join(endings)}, got {text!r}')
        if not path.absolute().parent.is_dir():
            raise argparse.ArgumentTypeError(f'{text}: folder {path.parent} not found')
        if endings and path.suffix in _FIGURES:
            try:
                require(text, 'plot', 'matplotlib')
            except ValueError as error:
                raise argparse.ArgumentTypeError(str(error)) from None
        return path

    return read
