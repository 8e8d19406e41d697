# SPDX-License-Identifier: Apache-2.0
"""Bring README.md and the files of config/, given as arguments, up to date with the tables."""

from pathlib import Path
import sys

from soft_throw_ros.configuration.document import insert_markdown, parameter_file, TABLES


def main(paths: list[str]) -> None:
    """Rewrite each file: a parameter file of the node it is named for, or the README's tables."""
    for path in map(Path, paths):
        table = TABLES.get(path.stem)
        text = parameter_file(table) if table else insert_markdown(path.read_text('utf-8'))
        path.write_text(text, 'utf-8')


if __name__ == '__main__':
    main(sys.argv[1:])
