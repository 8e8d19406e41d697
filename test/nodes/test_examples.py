# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""The programs in docs/examples, as processes beside real nodes."""

from pathlib import Path
import re
import shutil
import subprocess
import sys
from typing import Any

import pytest

EXAMPLES = Path(__file__).parents[2] / 'docs/examples'


def command(name: str, *arguments: str) -> tuple[str, ...]:
    return sys.executable, str(EXAMPLES / name), *arguments


@pytest.mark.parametrize(('name', 'line'), [
    ('own_motion.py', r'1\.4\d+ m/s, alpha 3\.\d+'),
    *(pytest.param(*case, marks=pytest.mark.slow) for case in (
        ('map_of_layers.py', r'41\.\d mm, 22\.\d m/s: alpha 4\.14'),
        ('sweep_of_loss.py', r'loss tangent 0\.05: alpha 3\.256'),
    )),
])
def test_throws_are_computed(name: str, line: str) -> None:
    done = subprocess.run(command(name), capture_output=True, text=True, check=True)
    assert re.search(line, done.stdout)
    assert done.stderr == ''


@pytest.mark.slow
def test_results_of_fed_samples_are_read_and_a_layer_chosen(start: Any, start_node: Any) -> None:
    start_node('twin', 'engine.motion:=measured').wait_for('ready')
    reader = start(*command('read_results.py'))
    start(*command('feed_samples.py'))
    reader.wait_for('thickness 0.04')  # the recommendation comes after some throws
    (speed,) = re.findall(r'([\d.]+) m/s', reader.lines[-1])
    assert float(speed) == pytest.approx(1.375, rel=0.02)
    chooser = start(*command('choose_layer.py'))
    assert chooser.wait() == 0
    assert chooser.lines[0] == 'set'
    assert chooser.lines[-1] in chooser.lines[-2]


@pytest.mark.slow
def test_a_bag_is_plotted(
    ros: Any, start: Any, start_node: Any, record: Any, tmp_path: Path
) -> None:
    start_node('twin', 'throw.period:=0.3').wait_for('throw 1')
    recorder, file = record('bag'), tmp_path / 'bag/bag_0.mcap'
    ros.spin_until(lambda: file.stat().st_size > 400_000, 'a second of states in the bag')
    recorder.end_well()
    picture = tmp_path / 'heights.png'
    plotter = start(*command('read_bag.py', str(tmp_path / 'bag'), str(picture)))
    assert plotter.wait() == 0, plotter.lines
    assert picture.read_bytes().startswith(b'\x89PNG')


@pytest.mark.slow
def test_the_test_of_a_twin_passes(start: Any, tmp_path: Path) -> None:
    copy = shutil.copy(EXAMPLES / 'test_my_twin.py', tmp_path)  # away from our settings
    process = start(sys.executable, '-m', 'pytest', copy, cwd=tmp_path)
    assert process.wait() == 0, process.lines
