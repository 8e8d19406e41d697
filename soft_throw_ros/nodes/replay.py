# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
Play a bag on its original topics, or check it without ROS.

The check repeats the run of a twin from the journal in its bag, and compares all messages.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
import sys
from typing import Any

from soft_throw_ros.commands.options import number_type, positive
from soft_throw_ros.commands.output import CommandParser, print_lines, print_note
from soft_throw_ros.recording.check import check_bag, CheckError
from soft_throw_ros.storage.bag_reader import BagReader
from soft_throw_ros.storage.message import BagError

_CLOCK_RATE = 40.0  # default rate of `/clock` [Hz]
_MAX_RATE = 1e6  # largest playback speed: a day in 0.1 s [-]

_rate = number_type(f'positive and at most {_MAX_RATE:g}', lambda rate: 0.0 < rate <= _MAX_RATE)


def main(args: list[str] | None = None) -> int:
    """
    Play a bag until its end, or check it.

    The exit code is 1 if some messages cannot be played, or differ from their repetition; 2 if the
    bag cannot be read, or has nothing to play or to check; 130 after Ctrl-C during a check.
    """
    arguments = sys.argv[1:] if args is None else args
    end = arguments.index('--ros-args') if '--ros-args' in arguments else len(arguments)
    options, of_ros = _parse(arguments[:end]), arguments[end:]
    path, is_check = options.pop('bag'), options.pop('check')
    try:
        with BagReader(path) as reader:
            return _check(reader) if is_check else _play(reader, options, of_ros)
    except BagError as error:
        print_note('replay', str(error))
        return 2
    except KeyboardInterrupt:
        return 130


def _parse(arguments: Sequence[str]) -> dict[str, Any]:
    """Return `bag`, `check`, and the given options of playback, keyword arguments of `Player`."""
    parser = CommandParser(
        prog='replay',
        description=__doc__,
        usage='replay [OPTIONS] BAG [--ros-args ...] or replay --check BAG',
        argument_default=argparse.SUPPRESS,
    )
    add = parser.add_argument
    add('bag', metavar='BAG', help='folder of the bag, or one of its files')
    add('--rate', metavar='R', type=_rate,
        help=f'playback speed relative to the recording, at most {_MAX_RATE:g} (default 1)')
    add('--topics', metavar='T', nargs='+', help='play only these topics')
    add('--loop', action='store_true', help='restart after the end')
    add('--paused', action='store_true', help='start paused; ~/resume plays')
    add('--clock', metavar='HZ', nargs='?', type=positive, const=_CLOCK_RATE,
        help=f'publish the time of the bag on /clock (default {_CLOCK_RATE:g} Hz) '
        'instead of a recorded /clock')
    add('--check', action='store_true', default=False,
        help='repeat the run from its journal and compare; exit code 1 if a message differs')
    options = vars(parser.parse_args(arguments))
    if options['check'] and (others := sorted(options.keys() - {'bag', 'check'})):
        parser.error(f'argument --{others[0]}: not allowed with argument --check')
    return options


def _play(reader: BagReader, options: dict[str, Any], arguments: Sequence[str]) -> int:
    topics = {channel.topic for channel in reader.channels}
    unknown = sorted(set(options.get('topics', ())) - topics)
    if unknown:
        raise CheckError(
            f'{reader.path} has no topic {", ".join(unknown)}; its topics are '
            f'{", ".join(sorted(topics)) or "none"}'
        )
    try:
        from soft_throw_ros.nodes.player import Player
        from soft_throw_ros.nodes.process import run
    except ModuleNotFoundError as error:
        print_note('replay', f'playing needs ROS 2, and --check does not: {error}')
        return 1
    # The node has no parameters
    return run('replay', lambda arguments: Player(reader, **options), arguments)  # noqa: ARG005


def _check(reader: BagReader) -> int:
    results = check_bag(reader)
    for result in results:
        for line in result.describe().splitlines():
            if result.exit_code == 2:
                print_note('replay', f'{result.twin}: {line}')
            else:
                print_lines([f'{result.twin}: {line}'])
    codes = {result.exit_code for result in results}
    return 1 if 1 in codes else max(codes)
