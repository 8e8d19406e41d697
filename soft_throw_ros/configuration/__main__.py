# SPDX-License-Identifier: Apache-2.0
"""Bring README.md and twin.yaml, given as arguments, up to date with the table."""

from pathlib import Path
import sys

from soft_throw_ros.configuration.document import insert_markdown, markdown, twin_yaml


def main(paths: list[str]) -> None:
    """Rewrite each file, by its suffix; print the table in Markdown if there is none."""
    if not paths:
        print(markdown(), end='')
    for path in map(Path, paths):
        text = twin_yaml() if path.suffix == '.yaml' else insert_markdown(path.read_text('utf-8'))
        path.write_text(text, 'utf-8')


if __name__ == '__main__':
    main(sys.argv[1:])
