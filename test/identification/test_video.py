# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Videos read from files."""

import struct

import numpy as np
import pytest
from soft_throw_ros.identification.tracks import TrackError
from soft_throw_ros.identification.video import read_pictures

imageio = pytest.importorskip('imageio.v3', reason='comes with the extra [video]')
pytest.importorskip('av', reason='comes with the extra [video]')
STACK = np.random.default_rng(0).integers(0, 4096, size=(5, 12, 16)).astype('<u2')  # of 12 bits


def phantom_file(path, pictures):
    """Write pictures as Phantom cameras do, after Vision Research's description of the format."""
    count, rows, columns = pictures.shape
    size, bits = pictures[0].nbytes, 8 * pictures.itemsize
    setup = bytearray(0x163C + 8)
    setup[140:144] = b'ST' + (0x163C).to_bytes(2, 'little')  # length of the setup block
    struct.pack_into('<I', setup, 892, bits)  # bits that are real
    first = 84 + len(setup) + 8 * count
    header = struct.pack('<2s3H9I', b'CI', 44, 0, 1, 0, count, 0, count, 44, 84, first - 8 * count,
                         0, 0)
    bitmap = struct.pack('<6I16x', 40, columns, rows, 1 + (bits << 16), 0, size)
    places = first + (8 + size) * np.arange(count, dtype='<i8')
    images = (struct.pack('<2I', 8, size) + picture[::-1].tobytes() for picture in pictures)
    path.write_bytes(header + bitmap + bytes(setup) + places.tobytes() + b''.join(images))
    return path


def test_cine_of_a_phantom_is_read_with_all_its_bits(tmp_path):
    path = phantom_file(tmp_path / 'shot.cine', STACK)
    np.testing.assert_array_equal(list(read_pictures(str(path))), STACK)


@pytest.mark.parametrize(
    'files', [{'stack.tif': STACK}, {f'shot_{3 * n}.png': STACK[n] for n in range(len(STACK))}]
)
def test_pictures_are_read_with_all_their_bits(tmp_path, files):
    for name, content in files.items():
        imageio.imwrite(tmp_path / name, content)
    np.testing.assert_array_equal(list(read_pictures(str(tmp_path))), STACK)


@pytest.mark.parametrize(('name', 'content', 'message'), [
    ('none.avi', None, 'No such file'),
    ('text.avi', b'hello', 'cannot be read by'),
    ('empty.mp4', b'', 'cannot be read by'),
    ('bad.png', b'hello', 'cannot be read by'),
    ('tracks.csv', b'1,2', 'must be a video or a folder of pictures'),
    ('bad.cine', b'CI' + bytes(100), 'cannot be read by'),
])
def test_file_that_is_no_video_is_refused(tmp_path, name, content, message):
    path = tmp_path / name
    if content is not None:
        path.write_bytes(content)
    with pytest.raises(TrackError, match=message):
        list(read_pictures(str(path)))


@pytest.mark.parametrize('quarters', [0, 1, 2, 3])
def test_turned_video_is_read_as_players_show_it(tmp_path, quarters):
    path = tmp_path / 'turned.mp4'
    upright = np.zeros((32, 64), dtype=np.uint8)
    upright[4:12, 6:14] = 250
    pictures = np.repeat(np.rot90(upright, quarters)[None, ..., None], 3, axis=3)
    imageio.imwrite(path, np.repeat(pictures, 4, axis=0), plugin='pyav', codec='libx264', fps=30)
    data = bytearray(path.read_bytes())
    cosine, sine = ((1, 0), (0, 1), (-1, 0), (0, -1))[quarters]
    start, one = data.find(b'tkhd') + 44, 1 << 16  # the matrix of the track header
    matrix = (cosine * one, sine * one, 0, -sine * one, cosine * one, 0, 0, 0, 1 << 30)
    data[start:start + 36] = struct.pack('>9i', *matrix)
    path.write_bytes(data)
    picture = next(read_pictures(str(path)))
    np.testing.assert_allclose(picture, upright, atol=40)
