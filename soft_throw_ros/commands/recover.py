# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Repair a bag after a crash or disk error: copy all before the first damage to a new bag."""

from __future__ import annotations

import argparse
from pathlib import Path

from soft_throw_ros.commands.output import CommandParser, print_lines, run_command
from soft_throw_ros.recording.recovery import recover


def main(args: list[str] | None = None) -> int:
    """Run the command; exit code 0 if all messages were recovered, 1 if not, 2 if none were."""
    parser = CommandParser(
        description=__doc__,
        epilog='The old bag is not changed. Exit code: 0 if all messages were recovered, 1 if '
        'some were lost, 2 if all were.',
    )
    parser.add_argument('bag', metavar='BAG', help='folder of the bag, or one of its files')
    parser.add_argument('--to', metavar='OUT', help='the new bag (default: BAG_recovered)')
    return run_command(parser, _run, args)


def _run(arguments: argparse.Namespace) -> int:
    source = Path(arguments.bag)
    path = source.resolve()  # so that `.` has a name
    name = path.name if path.is_dir() else path.name.partition('.')[0]
    recovery = recover(source, arguments.to or path.with_name(f'{name}_recovered'))
    width = max(map(len, recovery.saved))
    print_lines([
        f'{recovery.target}: {recovery.saved.total()} messages recovered',
        *(f'  {topic:{width}} {count:12}' for topic, count in recovery.saved.items()),
        *(f'omitted: {part}' for part in recovery.omitted),
    ])
    return 1 if recovery.omitted else 0
