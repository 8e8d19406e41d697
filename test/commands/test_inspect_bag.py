# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""The command `inspect`: bags whole and damaged."""

import re

from bags import write
import numpy as np
import pytest
from soft_throw_ros.commands import inspect_bag
from soft_throw_ros.recording.rerun_viewer import find_viewer, free_port
from soft_throw_ros.storage.message import Channel, Message

pytest.importorskip('rerun')

from rrd_files import RrdFile, viewer_at  # noqa: E402, I100
from soft_throw_ros.recording.rerun_layout import STAMP, THROW_TIME  # noqa: E402

COMMAND = (inspect_bag.main,)


@pytest.fixture(scope='module')
def twin(module_ros):
    """Return a twin with a complete throw, and one in flight."""
    return module_ros.start_twin(throw__period=0.2).go(499)


@pytest.fixture(scope='module')
def bag(twin, tmp_path_factory):
    return write(tmp_path_factory.mktemp('bags') / 'bag', twin.messages, chunk=100)


def test_picture_shows_the_rig(capsys, bag, tmp_path):
    image, path = pytest.importorskip('PIL.Image'), tmp_path / 'scene.png'
    code = inspect_bag.main([str(bag), '--screenshot', str(path)])
    printed = capsys.readouterr().err
    if 'mesa-vulkan-drivers' in printed:
        pytest.skip(printed)
    assert code == 0, printed
    with image.open(path) as opened:
        picture = np.asarray(opened.convert('RGB')).astype(int)
    assert picture.shape == (1000, 1600, 3)
    assert picture.std(axis=(0, 1)).min() > 10.0  # colours


def test_throw_and_time_to_show_can_be_chosen(command, twin, bag, tmp_path):
    with viewer_at(free_port()) as viewer:
        assert command.run(bag, '--port', viewer.port, '--throw=1', '--at=0.002') == ''
        (shown,) = viewer.client().get_state().recordings
    assert shown.current_timeline == THROW_TIME
    assert (shown.current_time or 0) / 1e6 == pytest.approx(2.0, abs=0.01)
    path = tmp_path / 'scene.rrd'
    for options, start in (([], 200), (['--throw=2'], 400)):
        assert command.run(bag, '--save', path, *options) == ''
        stamps, times = (
            RrdFile(path).series('/twin/position', 'Scalars:scalars', name)[0]
            for name in (STAMP, THROW_TIME)
        )
        assert abs(stamps - times - twin.session.due_ns(start)).max() <= 1


def test_bag_without_screen_and_viewer_names_a_remedy(command, bag, monkeypatch):
    for name in ('DISPLAY', 'WAYLAND_DISPLAY', 'WAYLAND_SOCKET'):
        monkeypatch.delenv(name, raising=False)
    port = free_port()
    command.run(bag, '--port', port, code=1)
    start = f'{find_viewer()} --bind 127.0.0.1 --port {port}'
    assert all(part in command.err for part in ('no screen', '--screenshot', start))


def test_damaged_messages_are_named_and_damaged_bags_refused(command, twin, tmp_path):
    messages = [
        each._replace(data=each.data[: 7 if 'phase_change' in each.channel.topic else None])
        for each in twin.messages
    ]
    path, scene = write(tmp_path / 'bag', messages, chunk=100) / 'bag_0.mcap', tmp_path / 'a.rrd'
    command.run(path, '--save', scene)
    assert 'messages are left out, /twin/phase_change' in command.err
    assert RrdFile(scene).rows['/twin/position'] == 500
    scene.unlink()
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])
    assert re.match(f'{path}: .*soft-throw recover', command.refused(path, '--save', scene))
    topic, printed = '/scan\x1b[2J', r'/scan\x1b[2J'  # which would clear a terminal
    channel = Channel(topic=topic, type='sensor_msgs/msg/LaserScan', schema='float32 x')
    write(tmp_path / 'other', [Message(channel, b'\0\1\0\0\0\0\0\0', 5, 5)])
    assert printed in command.refused(tmp_path / 'other', '--save', scene)
    assert not scene.exists()
