# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""The node `viewer` as a process, with Rerun viewers that come late and hang."""

from functools import partial
import os
from pathlib import Path
import signal
import socket
import sys
from typing import Any

import pytest
from rclpy.duration import Duration
from soft_throw_ros.configuration import ParameterError
from soft_throw_ros.configuration.interface import TWIN_TOPICS, VIEWER_DIAGNOSTICS
from soft_throw_ros.nodes.conversions import msg_to_values
from soft_throw_ros.nodes.viewer import Viewer
from soft_throw_ros.recording.rerun_viewer import free_port, url_of

pytest.importorskip('rerun')

from rerun.experimental import ViewerClient  # noqa: E402, I100
from rrd_files import RrdFile, viewer_at  # noqa: E402
from soft_throw_ros.recording.rerun_view import is_drawn  # noqa: E402

pytestmark = pytest.mark.timeout(180)


def throw(ros: Any, twin: Any, count: int) -> None:
    """Throw for a quarter of a second, for a number of subscribers that have all of it."""
    topics = [topic.at('/twin') for topic in TWIN_TOPICS]
    drawn = {topic.name for topic in topics if is_drawn(topic.name, topic.type)} - {'/diagnostics'}
    publishers = [item for item in twin.publishers if item.topic_name in drawn]
    counts = [item.get_subscription_count for item in publishers]
    ros.spin_until(lambda: min(count_of() for count_of in counts) >= count, 'the viewer')
    twin.go(250)
    assert all(item.wait_for_all_acked(Duration(seconds=60.0)) for item in publishers)


def show(start_node: Any, port: int) -> Any:
    """Start the node without a screen, and wait until it is ready."""
    screens = ('DISPLAY', 'WAYLAND')
    environment = {name: os.environ[name] for name in os.environ if not name.startswith(screens)}
    process = start_node('viewer', f'port:={port}', env=environment)
    process.wait_for('ready')
    return process


@pytest.mark.slow
def test_late_viewer_on_this_machine_gets_all_and_a_stopped_one_delays_nothing(ros, start_node):
    port = free_port()
    node = show(start_node, port)  # without a screen it serves
    node.wait_for(url_of(port))
    listening = Path('/proc/net/tcp').read_text(encoding='ascii')
    assert f' 0100007F:{port:04X} ' in listening
    assert f' 00000000:{port:04X} ' not in listening + Path('/proc/net/tcp6').read_text()
    twin = ros.start_twin(throw__period=0.2)
    throw(ros, twin, 1)
    # published once, at the very beginning
    kept = {'/twin/recommendation', '/twin/throw_result', '/twin/phase', '/twin/position'}
    with viewer_at(free_port(), '--connect', url_of(port)) as viewer:
        client = ViewerClient.connect(url_of(viewer.port))
        ros.spin_until(lambda: client.get_state().recordings, 'the recording')
        ros.spin_until(
            lambda: kept <= {e.entity_path for e in client.get_recording_schema().entities},
            'earlier messages',
        )
        ros.spin_until(lambda: len(client.get_state().views) >= 10, 'the layout')
        os.killpg(viewer.pid, signal.SIGSTOP)
        throw(ros, twin, 1)
        node.end_well(signal.SIGTERM)


def test_node_without_a_viewer_ends_well(start_node):
    with socket.create_server(('127.0.0.1', 0)) as other:  # a viewer of something else
        node = show(start_node, other.getsockname()[1])
        node.end_well()
    assert node.lines[-1].endswith('messages, 0 not shown')


@pytest.mark.slow
def test_file_beside_a_bag_has_every_message_that_came_before_the_end(ros, record, tmp_path):
    recorder = record('bag', 'topics:=[twin]', 'rerun.sink:=file')
    throw(ros, ros.start_twin(throw__period=0.2), 2)  # to recorder and viewer
    listener = ros.listen_to('/viewer')
    listener.listen(VIEWER_DIAGNOSTICS)
    report = partial(listener.statuses, VIEWER_DIAGNOSTICS, 'display')
    ros.spin_until(lambda: len(report()) >= 2, 'two reports, between which all messages arrive')
    assert msg_to_values(report()[-1]) == {'lost': 0, 'damaged': 0}
    recorder.end_well()
    assert RrdFile(tmp_path / 'bag.rrd').rows['/twin/position'] == 250


def test_without_rerun_the_node_names_the_command_that_installs_it(ros, monkeypatch):
    monkeypatch.setitem(sys.modules, 'rerun', None)
    for name in ('rerun_view', 'rerun_layout'):
        monkeypatch.delitem(sys.modules, f'soft_throw_ros.recording.{name}', raising=False)
    with pytest.raises(ParameterError, match=r'soft_throw_ros\[rerun\]'):
        ros.node(Viewer)
