# SPDX-License-Identifier: Apache-2.0
"""
Draw the paper's figures, and write its numbers beside ours.

Into a folder: `paper.md`, which shows all, the figures in `paper`, and the README's picture.
"""

from __future__ import annotations

import argparse
import importlib.util
from pathlib import Path
import sys

from soft_throw_ros.commands.paper.catalogue import DRAWINGS
from soft_throw_ros.commands.paper.page import write_page
from soft_throw_ros.configuration.atomic_file import atomic_file

FORMATS = ('png', 'pdf', 'svg')

PAGE = 'page'
"""What is chosen for `paper.md`."""


class OutputError(ValueError):
    """Something cannot be drawn or written."""


def main(args: list[str] | None = None) -> int:
    """
    Run the command.

    Parameters
    ----------
    args : list of str, optional
        Its arguments; those of the process by default.

    Returns
    -------
    int
        0, or 130 after Ctrl-C; what is written is complete.

    Raises
    ------
    SystemExit
        With exit code 2 if something is refused, after a line that says what.

    """
    parser = _parser()
    arguments = parser.parse_args(args)
    try:
        for name in _choose(arguments.only):
            print(_write(name, arguments.output, arguments.format), flush=True)
    except OutputError as error:
        parser.error(str(error))
    except KeyboardInterrupt:
        print('figures: stopped', file=sys.stderr)
        return 130
    return 0


def _parser() -> argparse.ArgumentParser:
    names = ', '.join([*DRAWINGS, PAGE])
    parser = argparse.ArgumentParser(
        description="Draw the paper's figures, and write its numbers beside ours.",
        epilog=f'There are: {names}.',
        allow_abbrev=False,
    )
    parser.add_argument(
        '--output',
        metavar='DIR',
        type=Path,
        default=Path('figures'),
        help='folder, made if it is not there (default figures)',
    )
    parser.add_argument('--only', metavar='NAME,...', help='some of them (default all)')
    parser.add_argument(
        '--format', choices=FORMATS, default='png', help='of the figures (default png)'
    )
    return parser


def _choose(only: str | None) -> list[str]:
    """Read what is to be written, and put it in our order."""
    known = [*DRAWINGS, PAGE]
    wanted = known if only is None else [name.strip() for name in only.split(',')]
    for name in wanted:
        if name not in known:
            raise OutputError(f'--only: nothing is named {name!r}; there are: {", ".join(known)}')
    if wanted != [PAGE] and importlib.util.find_spec('matplotlib') is None:
        raise OutputError(
            "figures need matplotlib, which pip installs with 'soft_throw_ros[plot]'; "
            f'--only {PAGE} does without'
        )
    return [name for name in known if name in wanted]


def _write(name: str, folder: Path, kind: str) -> Path:
    """Write one of them, and return where it is."""
    path = folder / ('paper.md' if name == PAGE else DRAWINGS[name].path(kind))
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        if name == PAGE:
            with atomic_file(path) as unfinished:
                unfinished.write_text(write_page(kind), encoding='utf-8')
        else:
            DRAWINGS[name].write(path)
    except OSError as error:
        raise OutputError(f'{path}: {error.strerror}') from None
    return path
