# SPDX-License-Identifier: Apache-2.0
"""Write the files of config/ and docs/ that follow from the tables: run it where those are."""

from pathlib import Path

from soft_throw_ros.configuration.document import documents


def main(folder: Path) -> None:
    """Write every document below a folder."""
    for path, text in documents().items():
        (folder / path).write_text(text, 'utf-8')


if __name__ == '__main__':
    main(Path())
