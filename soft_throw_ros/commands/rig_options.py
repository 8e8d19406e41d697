# SPDX-License-Identifier: Apache-2.0
"""Options that describe a rig, the same for every command: a parameter file and the table's."""

from __future__ import annotations

import argparse

from soft_throw_ros.configuration import files, ParameterError, TWIN, Value

OPTIONS = {
    entry.name: '--layer'
    if entry.name == 'layer.name'
    else '--' + entry.name.rpartition('.')[2].replace('_', '-')
    for entry in TWIN.entries
    if entry.is_of_rig and entry.name != 'model'
}
"""The parameters that describe a rig, and what their options are called."""


def add_rig_options(parser: argparse.ArgumentParser) -> None:
    """Add `--config` and an option for each parameter of a rig; `read_settings` reads them."""
    parser.add_argument(
        '--config', metavar='FILE', default=argparse.SUPPRESS, help='parameter file of the twin'
    )
    group = parser.add_argument_group(
        'parameters of the rig', 'as those of the twin; each replaces what the file says'
    )
    for name, option in OPTIONS.items():
        entry = TWIN.by_name[name]
        default = f'{entry.default:g}' if isinstance(entry.default, float) else entry.default
        text = f'{entry.meaning}; {entry.rule} (default {default})'
        group.add_argument(
            option,
            dest=name,
            metavar=entry.unit.upper() or ('NAME' if entry.choices else 'NUMBER'),
            type=number_or_text,
            default=argparse.SUPPRESS,
            help=text.replace('`', '').replace('%', '%%'),
        )


def read_settings(arguments: argparse.Namespace) -> dict[str, Value]:
    """
    Return complete settings: the defaults, what the file says, what the options say.

    Raises
    ------
    ParameterError
        Naming the option, or file and line, of a value that is refused.

    """
    given = vars(arguments)
    request = {name: given[name] for name in OPTIONS if name in given}
    settings = files.read(given['config']) if 'config' in given else TWIN.defaults()
    try:
        settings.update(TWIN.change(settings, request))
    except ParameterError as error:
        options = (f'argument {OPTIONS[name]}: ' for name in error.names if name in request)
        raise ParameterError(f'{next(options, "")}{error}', *error.names) from None
    return settings


def number_or_text(text: str) -> float | str:
    """Read a number if it is one; what it may be is for the table to say."""
    try:
        return float(text)
    except ValueError:
        return text
