# SPDX-License-Identifier: Apache-2.0
"""Options that stand for parameters of the twin: those of a rig, the same for every command."""

from __future__ import annotations

import argparse
from collections.abc import Iterable
from dataclasses import replace

from soft_throw_ros.configuration import Entry, files, ParameterError, TWIN, Value


def _option(name: str) -> str:
    """Call a parameter by its last name."""
    group, _, last = name.rpartition('.')
    if name == 'layer.name':
        return '--layer'
    return ('--uncertain-' if group == 'uncertainty' else '--') + last.replace('_', '-')


OPTIONS = {
    entry.name: _option(entry.name)
    for entry in TWIN.entries
    if entry.is_of_rig and entry.name != 'model'
}
"""The parameters that describe a rig, and what their options are called."""

RECOMMENDATION_OPTIONS = {
    entry.name: _option(entry.name) for entry in TWIN.entries if entry.group == 'recommendation'
}
"""The parameters that say what is asked of a layer, and what their options are called."""

UNCERTAINTY_OPTIONS = {
    entry.name: _option(entry.name) for entry in TWIN.entries if entry.group == 'uncertainty'
}
"""The parameters that say how far a rig may be off, and what their options are called."""

_MOTION = replace(
    TWIN.by_name['engine.motion'],
    meaning='How the plate moves: a damped step (D2), or A (1 - cos wt) without damping (Eq. 1)',
    choices=('underdamped', 'harmonic'),
)
"""As an option: nobody measures a plate while a command runs."""

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

    `entries` say of some what they are here, where that is less than in the table.

    """
    special = {entry.name: entry for entry in (_MOTION, *entries)}
    group = parser.add_argument_group(title, description)
    for name in names:
        entry = special.get(name, TWIN.by_name[name])
        is_text = isinstance(entry.default, str)
        text = f'{entry.meaning}; {entry.rule}'
        if entry.default != '':
            text += f' (default {_shown(entry.default)})'
        group.add_argument(
            _ALL_OPTIONS[name],
            dest=name,
            metavar=entry.unit.upper() or ('NAME' if is_text else 'NUMBER'),
            nargs='+' if isinstance(entry.default, tuple) else None,
            type=str if is_text else number_or_text,
            default=argparse.SUPPRESS,
            help=text.replace('`', '').replace('%', '%%'),
        )


def read_settings(arguments: argparse.Namespace) -> dict[str, Value]:
    """
    Return complete settings: the defaults, what the file says, what the options say.

    Of a plate that is measured, by the file, counts what `engine.*` say of it.

    Raises
    ------
    ParameterError
        Naming the option, or file and line, of a value that is refused.

    """
    given = vars(arguments)
    request = {name: given[name] for name in _ALL_OPTIONS if name in given}
    settings = files.read(given['config']) if 'config' in given else TWIN.defaults()
    try:
        _check_motion(request.get(_MOTION.name, _MOTION.default))
        settings.update(TWIN.change(settings, request))
    except ParameterError as error:
        options = (f'argument {_ALL_OPTIONS[name]}: ' for name in error.names if name in request)
        raise ParameterError(f'{next(options, "")}{error}', *error.names) from None
    return settings


def number_or_text(text: str) -> float | str:
    """Read a number if it is one; what it may be is for the table to say."""
    try:
        return float(text)
    except ValueError:
        return text


def _check_motion(motion: Value) -> None:
    if not _MOTION.allows(motion):
        raise ParameterError(
            f'{_MOTION.name} must be {_MOTION.rule}, got {motion!r}; '
            'what is measured is for the twin',
            _MOTION.name,
        )


def _shown(value: Value) -> str:
    if isinstance(value, tuple):
        return ' '.join(map(_shown, value))
    return f'{value:g}' if isinstance(value, float) else str(value)
