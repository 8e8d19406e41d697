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
"""Options that commands share: the parameters of a rig, and who does the work of a sweep."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import BrokenExecutor, CancelledError, Executor, ProcessPoolExecutor
import contextlib
from dataclasses import replace
import math
import multiprocessing
from pathlib import Path
import signal

from soft_throw_ros.commands.output import require
from soft_throw_ros.configuration import Entry, files, ParameterError, TWIN, Value


class WorkersLostError(RuntimeError):
    """Those who do the work are gone."""


def _option(name: str) -> str:
    """Name the option of a parameter by its last part."""
    group, _, last = name.rpartition('.')
    if name == 'layer.name':
        return '--layer'
    return ('--uncertain-' if group == 'uncertainty' else '--') + last.replace('_', '-')


def _group(group: str) -> dict[str, str]:
    return {entry.name: _option(entry.name) for entry in TWIN.entries if entry.group == group}


OPTIONS = {
    entry.name: _option(entry.name)
    for entry in TWIN.entries
    if entry.is_of_rig and entry.name != 'model'
}
"""The parameters that describe a rig, and what their options are called."""

RECOMMENDATION_OPTIONS = _group('recommendation')
"""Those that say what is asked of a layer."""

UNCERTAINTY_OPTIONS = _group('uncertainty')
"""Those that say how far a rig may be off."""

_MOTION = replace(
    TWIN.by_name['engine.motion'],
    meaning='How the plate moves: a damped step (D2), A (1 - cos wt) without damping (Eq. 1), or '
    'as a file tells, CSV of time and height or a bag',
    choices=(),
    kind="'underdamped', 'harmonic' or the path of a file",
)
"""As an option: nobody measures a plate while a command runs."""

_NEEDED = {
    '.rrd': ('rerun', 'rerun'),
    **dict.fromkeys(('.png', '.pdf', '.svg'), ('plot', 'matplotlib')),
}
"""What is needed for files of some endings: an extra of the package, and a module."""

_ALL_OPTIONS = {**OPTIONS, **RECOMMENDATION_OPTIONS, **UNCERTAINTY_OPTIONS}


def add_rig_options(parser: argparse.ArgumentParser) -> None:
    """Add `--config` and an option for each parameter of a rig; `read_settings` reads them."""
    parser.add_argument(
        '--config', metavar='FILE', default=argparse.SUPPRESS, help='parameter file of the twin'
    )
    title, text = 'parameters of the rig', 'as those of the twin; each replaces what the file says'
    add_options(parser, OPTIONS, title=title, description=text)


def add_options(
    parser: argparse.ArgumentParser,
    names: Iterable[str],
    *,
    title: str,
    description: str = '',
    entries: Iterable[Entry] = (),
) -> None:
    """
    Add a group with an option for each of some parameters; `read_settings` reads them.

    `entries` stand for rows of the table of parameters where a command takes less than these.

    """
    special = {entry.name: entry for entry in (_MOTION, *entries)}
    group = parser.add_argument_group(title, description)
    for name in names:
        entry = special.get(name, TWIN.by_name[name])
        is_text = isinstance(entry.default, str)
        text = f'{entry.meaning}; {entry.rule}'
        if entry.default != '':
            values = entry.default if isinstance(entry.default, tuple) else (entry.default,)
            text += f' (default {" ".join(map(_shortly, values))})'
        group.add_argument(
            _ALL_OPTIONS[name],
            dest=name,
            metavar=entry.unit.upper() or ('NAME' if is_text else 'NUMBER'),
            nargs='+' if isinstance(entry.default, tuple) else None,
            type=str if is_text else number_or_text,
            choices=entry.choices or None,
            default=argparse.SUPPRESS,
            help=text.replace('`', '').replace('%', '%%'),
        )


def read_settings(arguments: argparse.Namespace) -> dict[str, Value]:
    """
    Return complete settings: the defaults, what the file says, what the options say.

    A file may say that the plate is measured; then the motion by `engine.*` is taken.

    Raises
    ------
    ParameterError
        Naming the option, or file and line, of a value that is refused.

    """
    given = vars(arguments)
    request = {name: given[name] for name in _ALL_OPTIONS if name in given}
    motion = request.get('engine.motion', 'harmonic')
    if motion in TWIN.by_name['engine.motion'].choices[2:]:
        raise ParameterError(f'argument --motion: must be {_MOTION.kind}, got {motion!r}')
    if motion not in TWIN.by_name['engine.motion'].choices:
        request |= {'engine.motion': 'file', 'engine.motion_file': motion}
    settings = files.read(given['config']) if 'config' in given else TWIN.defaults()
    try:
        settings.update(TWIN.change(settings, request))
    except ParameterError as error:
        options = (f'argument {_ALL_OPTIONS[name]}: ' for name in error.names if name in request)
        raise ParameterError(f'{next(options, "")}{error}', *error.names) from None
    return settings


def _shortly(value: Value) -> str:
    return f'{value:g}' if isinstance(value, float) else str(value)


def add_executor_options(parser: argparse.ArgumentParser) -> None:
    """Add `--workers` and `--dask`; `open_executor` reads them."""
    who = parser.add_mutually_exclusive_group()
    who.add_argument(
        '--workers', metavar='N', type=count, default=1,
        help='share the work out among N processes (default 1: this one)',
    )
    who.add_argument(
        '--dask', metavar='ADDRESS',
        help='have the workers of a Dask scheduler do it, such as tcp://10.0.0.1:8786',
    )


@contextlib.contextmanager
def open_executor(arguments: argparse.Namespace) -> Iterator[Executor | None]:
    """
    Give what does the work, as the options say: an executor, or None for this very process.

    Raises
    ------
    ValueError
        If there is no such scheduler, or Dask is not installed.
    WorkersLostError
        If the work cannot go on: a process was killed, or the scheduler is gone.

    """
    if arguments.dask is not None:
        with _open_dask(arguments.dask) as executor:
            yield executor
    elif arguments.workers == 1:
        yield None
    else:
        # Started anew, since threads do not survive a fork, and all at once, with Ctrl-C blocked:
        # they inherit that, and so it is answered here alone. They finish the block they are at.
        spawn = multiprocessing.get_context('spawn')
        with ProcessPoolExecutor(arguments.workers, mp_context=spawn) as executor:
            before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
            for _ in range(arguments.workers):
                executor.submit(int)
            signal.pthread_sigmask(signal.SIG_SETMASK, before)
            try:
                yield executor
            except BrokenExecutor:
                raise WorkersLostError(
                    'a worker process was killed, perhaps for want of memory'
                ) from None


def number_or_text(text: str) -> float | str:
    """Read a number if it is one; what it may be is for the table of parameters to say."""
    try:
        return float(text)
    except ValueError:
        return text


def count(text: str) -> int:
    """Read a whole number above 0, as argparse has it."""
    if not text.isdecimal() or int(text) < 1:
        raise argparse.ArgumentTypeError(f'must be a whole number of 1 or more, got {text!r}')
    return int(text)


def positive(text: str) -> float:
    """Read a number above 0, as argparse has it."""
    value = number_or_text(text)
    if not isinstance(value, float) or not 0.0 < value < math.inf:
        raise argparse.ArgumentTypeError(f'must be finite and positive, got {text}')
    return value


def new_file(*endings: str) -> Callable[[str], Path]:
    """Return what reads the name of a file, and refuses one that could not be written."""

    def read(text: str) -> Path:
        path = Path(text)
        if endings and path.suffix not in endings:
            raise argparse.ArgumentTypeError(f'must end on {", ".join(endings)}, got {text!r}')
        if not path.absolute().parent.is_dir():
            raise argparse.ArgumentTypeError(f'{text}: there is no folder {path.parent}')
        if endings and path.suffix in _NEEDED:
            try:
                require(text, *_NEEDED[path.suffix])
            except ValueError as error:
                raise argparse.ArgumentTypeError(str(error)) from None
        return path

    return read


@contextlib.contextmanager
def _open_dask(address: str) -> Iterator[Executor]:
    """Connect to a Dask scheduler."""
    require('--dask', 'dask', 'distributed')
    from distributed import Client
    from distributed.scheduler import KilledWorker

    try:
        client = Client(address, timeout='10s', set_as_default=False)
    except (OSError, ValueError) as error:
        raise ValueError(f'--dask {address}: no scheduler answers there ({error})') from None
    with client, client.get_executor() as executor:
        try:
            yield executor
        except KilledWorker:
            raise WorkersLostError(
                'the same work has killed several Dask workers, perhaps for want of memory'
            ) from None
        except CancelledError:
            raise WorkersLostError(f'the Dask scheduler at {address} is gone') from None
