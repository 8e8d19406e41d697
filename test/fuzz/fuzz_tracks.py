# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Tracks, cases, descriptions of fits and videos that are wrong, or nearly right."""

from __future__ import annotations

import io
from pathlib import Path
from typing import Any

from fuzzing import accepted, bounded, datas, fuzzed, NUMBERS, run_on, texts
from hypothesis import example, given
from hypothesis import strategies as st
import numpy as np
import pytest
from soft_throw_ros.commands import free_layers, identify, throw
from soft_throw_ros.commands.track import main as track_video
from soft_throw_ros.identification.fit_description import DEFAULTS, FitDescription
from soft_throw_ros.identification.track_csv import read_csv, UNITS

DATA = Path(__file__).parents[1] / 'data'
THROW = ''.join((DATA / 'reference_tracks.csv').read_text('utf-8').splitlines(True)[:150])
SHORT = ''.join(THROW.splitlines(True)[:16])
GERMAN = SHORT.replace(',', ';').replace('.', ',')
MILLIMETRES = 't [s],plate [mm],projectile [mm]\n' + SHORT.partition('\n')[2]
BARE = SHORT.partition('\n')[2].replace(',', '\t')
TIMES = 2e-4 * np.arange(40)
RINGING = 't,bottom,top\n' + ''.join(
    f'{t:.4f},{1e-4 * np.cos(2000 * t):.7f},{0.012 - 1e-4 * np.cos(2000 * t):.7f}\n' for t in TIMES
)


@fuzzed(0.12)
@given(
    text=texts(SHORT, GERMAN, MILLIMETRES, BARE),
    unit=st.sampled_from(list(UNITS)),
    bodies=st.sampled_from([('plate', 'projectile'), ('bottom', 'top')]),
)
def test_tracks_are_read_or_refused(
    tmp_path: Path, text: str, unit: str, bodies: tuple[str, str]
) -> None:
    with bounded(tmp_path):
        tracks = accepted(
            lambda: read_csv(io.StringIO(text), 'tracks.csv', bodies, unit=unit), 'tracks.csv'
        )
        for track in (tracks or {}).values():
            assert np.isfinite(track.position).all()
            assert (np.diff(track.time) > 0.0).all()
            assert 0.0 < track.noise < np.inf


OPTIONS = ('--from=0.01', '--to=0.02', '--noise=1e-5', '--hold=layer.wave_speed',
           '--mass=0.0012+-1%', '--fit=layer.loss_tangent')


@fuzzed(0.008)
@given(text=texts(THROW), options=st.lists(st.sampled_from(OPTIONS), max_size=1))
@example(text=THROW[:231] + THROW[2854:], options=[])  # has no information about the engine
def test_identify_finds_a_rig_or_refuses(tmp_path: Path, text: str, options: list[str]) -> None:
    path, output = tmp_path / 'throw.csv', tmp_path / 'rig.yaml'
    run_on(path, text, identify.main, str(path), '--output', str(output), *options)


@fuzzed(0.02)
@given(text=texts(RINGING), thickness=st.sampled_from([*NUMBERS, '0.012', '0.012', 'x']))
def test_free_layer_is_fitted_or_refused(tmp_path: Path, text: str, thickness: str) -> None:
    path = tmp_path / 'layer.csv'
    run_on(path, text, free_layers.main, thickness, str(path))


@fuzzed(0.06)
@given(text=texts('mu,kappa,zeta\n0.3,8,0\n2,60,0.064\n', 'zeta,x,kappa,mu\n0,a,10,1\n'))
def test_cases_are_computed_or_refused(tmp_path: Path, text: str) -> None:
    path = tmp_path / 'cases.csv'
    code, out, printed = run_on(path, text, throw.main, '--cases', str(path))
    if code == 2:
        assert 'cases.csv' in printed
    else:
        rows = [line.split(',') for line in out.splitlines()[1:]]
        assert all(np.isfinite([float(cell) for cell in row]).all() for row in rows)


FIT_FILE = """\
parameters:
  projectile.mass: 0.0012 +- 1 %
  layer.thickness: 12e-3 +- 1e-4
  layer.loss_tangent: free if seen
heights: common
reference: centre
throws:
  throw_?.csv: {engine.amplitude: 1.8e-3 +- 5 % per throw, layer: soft}
  'last.csv': {plate.drift: held}
"""


@fuzzed(0.08)
@given(text=texts(FIT_FILE))
def test_description_of_a_fit_is_read_or_refused(tmp_path: Path, text: str) -> None:
    path = tmp_path / 'fit.yaml'
    path.write_bytes(text.encode('utf-8', 'replace'))
    with bounded(tmp_path):
        description = accepted(lambda: FitDescription.from_file(path), str(path))
        for name in DEFAULTS if description else ():
            for throw_name in (None, 'throw_1.csv', 'last.csv'):
                treatment = description.treatment(name, throw_name)
                numbers = [treatment.value or 0.0, treatment.error or 0.0]
                assert np.isfinite(numbers).all()


@pytest.fixture(scope='module')
def videos() -> dict[str, bytes]:
    """Return a small video and pictures, by file extension."""
    for module in ('av', 'trackpy'):
        pytest.importorskip(module, reason='comes with the extra [video]')
    from imageio import v3 as imageio

    levels = np.full((14, 48, 32), 220, np.uint8)
    rows, columns = np.mgrid[:48, :32]
    for number, picture in enumerate(levels):
        for row in (12 - number // 3, 36 - number // 2):
            picture[(rows - row) ** 2 + (columns - 16) ** 2 < 16] = 20
    return {
        '.png': imageio.imwrite('<bytes>', levels[0], extension='.png'),
        '.tif': imageio.imwrite('<bytes>', levels, extension='.tif'),
        '.gif': imageio.imwrite('<bytes>', levels, extension='.gif'),
        '.mp4': imageio.imwrite(
            '<bytes>', np.repeat(levels[..., None], 3, -1), extension='.mp4', plugin='pyav',
            codec='mpeg4', fps=30),
        '.y4m': b'YUV4MPEG2 W32 H48 F30:1 Ip A1:1 Cmono\n'
        + b''.join(b'FRAME\n' + picture.tobytes() for picture in levels),
    }


# Pillow may leave a damaged file open until it is collected
@pytest.mark.filterwarnings('ignore::ResourceWarning')
@pytest.mark.filterwarnings('ignore::pytest.PytestUnraisableExceptionWarning')
@fuzzed(0.01)
@given(data=st.data())
def test_video_is_followed_or_refused(tmp_path: Path, videos: dict[str, bytes], data: Any) -> None:
    ending = data.draw(st.sampled_from(sorted(videos)))
    path = tmp_path / f'video{ending}'
    content, options = data.draw(datas(videos[ending])), ('--rate=2000', '--scale', '0.01', '30')
    run_on(path, content, track_video, str(path), *options)
