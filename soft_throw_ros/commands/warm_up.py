# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Compile all kernels in advance, so that nodes and commands start quickly."""

from __future__ import annotations

import argparse
from functools import partial
import os
import signal
import time

from soft_throw_ros.commands.kernels import load_kernels, PARTS
from soft_throw_ros.commands.output import CommandParser, print_lines, run_command


def main(args: list[str] | None = None) -> int:
    """Run the command; the exit code is 0."""
    parser = CommandParser(
        description='Compile all kernels, once for this installation, so that nodes and commands '
        'start quickly. Kernels that are already compiled are only loaded.',
    )
    parser.add_argument(
        'parts',
        metavar='PART',
        nargs='*',
        help=f'parts to compile, from {", ".join(PARTS)} (default: all)',
    )
    return run_command(parser, _run, args)


def _run(arguments: argparse.Namespace) -> int:
    for signal_number in (signal.SIGINT, signal.SIGTERM):
        # Exit at once, because numba would print a long traceback; files on the disk are complete.
        signal.signal(signal_number, lambda number, _: os._exit(128 + number))
    parts = arguments.parts or list(PARTS)
    for part in parts:
        if part not in PARTS:
            raise ValueError(f'PART must be one of {", ".join(PARTS)}, got {part!r}')
    for number, part in enumerate(parts, 1):
        title, begin = f'{number}/{len(parts)} {part}', time.monotonic()
        load_kernels([part], say=partial(_print_line, title))
        _print_line(title, f'ready, {time.monotonic() - begin:.1f} s')
    return 0


def _print_line(title: str, text: str) -> None:
    print_lines([f'{title}: {text}'])
