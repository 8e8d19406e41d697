# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Only regular files of bounded size are read."""

import os
from pathlib import Path

import pytest
from soft_throw_ros.commands.identify_input import _read_csv
from soft_throw_ros.configuration import files, motions
from soft_throw_ros.configuration.layers import library
from soft_throw_ros.identification.fit_description import FitDescription
from soft_throw_ros.identification.video import read_pictures
from soft_throw_ros.storage.regular_file import open_regular_file, read_regular_file

READERS = {
    'library': library,
    'parameters': files.read,
    'motion': motions.read,
    'fit': FitDescription.from_file,
    'tracks': lambda path: _read_csv(str(path), ('plate',), None, []),
    'video': lambda path: list(read_pictures(str(path))),
}


@pytest.mark.parametrize('kind', READERS)
def test_files_that_block_or_never_end_are_refused_at_once(kind: str, tmp_path: Path) -> None:
    os.mkfifo(tmp_path / 'fifo')
    for target in (tmp_path / 'fifo', Path('/dev/zero')):
        path = tmp_path / f'to_{target.name}.{"mp4" if kind == "video" else "csv"}'
        path.symlink_to(target)
        with pytest.raises(ValueError, match=r'^[^\n]*is not a regular file[^\n]*$'):
            READERS[kind](path)


def test_file_is_read_up_to_its_largest_size(tmp_path: Path) -> None:
    path = tmp_path / 'file'
    path.write_bytes(b'12345678')
    assert read_regular_file(path, max_bytes=8) == b'12345678'
    for read in (read_regular_file, open_regular_file):
        with pytest.raises(OSError, match='larger than 7 bytes'):
            read(path, max_bytes=7)
    with pytest.raises(OSError, match='larger than 3 bytes'):
        read_regular_file('/proc/self/status', max_bytes=3)  # its reported size is 0
