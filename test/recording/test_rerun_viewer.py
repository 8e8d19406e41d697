# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""The viewer of Rerun as a process."""

from __future__ import annotations

from collections.abc import Iterator
import contextlib
import os
from pathlib import Path
import signal
import subprocess
import sys
import time

from bags import wait_until
import pytest
from soft_throw_ros.recording.rerun_viewer import free_port, listens, Viewer, ViewerError

pytest.importorskip('rerun')

from rrd_files import viewer_at  # noqa: E402, I100


@pytest.fixture(scope='module')
def viewer(tmp_path_factory) -> Iterator[Viewer]:
    """Return a viewer with its own home; skip without graphics, where viewers end at once."""
    home = tmp_path_factory.mktemp('home')
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv('XDG_DATA_HOME', str(home))
        patch.setenv('XDG_CONFIG_HOME', str(home / 'settings'))
        with viewer_at(free_port()) as viewer:
            yield viewer


def test_viewer_listens_on_this_machine_only(viewer) -> None:
    port = f':{viewer.port:04X} 00000000'
    sockets = Path('/proc/net/tcp').read_text(encoding='ascii')
    assert f' 0100007F{port}' in sockets  # 127.0.0.1
    assert f' 00000000{port}' not in sockets
    assert f'0000{port}' not in Path('/proc/net/tcp6').read_text(encoding='ascii')


@pytest.mark.parametrize('stays', [False, True])
def test_viewer_ends_with_its_killed_parent_unless_detached(viewer, stays) -> None:
    port = free_port()
    code = (
        'import os, signal; from soft_throw_ros.recording.rerun_viewer import Viewer; '
        f"viewer = Viewer({port}, '--headless', stays={stays}); viewer.wait(); "
        'print(viewer.pid, flush=True); os.kill(os.getpid(), signal.SIGKILL)'
    )
    done = subprocess.run([sys.executable, '-c', code], stdout=subprocess.PIPE, check=False)
    try:
        time.sleep(0.5)
        wait_until(lambda: listens(port) == stays)
    finally:
        with contextlib.suppress(ProcessLookupError):
            os.killpg(int(done.stdout), signal.SIGKILL)


def test_viewer_without_graphics_names_packages_to_install(monkeypatch) -> None:
    for name in ('VK_DRIVER_FILES', 'VK_ICD_FILENAMES'):
        monkeypatch.setenv(name, '/nowhere')
    with (
        Viewer(free_port(), '--headless') as process,
        pytest.raises(ViewerError, match='mesa-vulkan-drivers'),
    ):
        process.client()


def test_viewer_collects_no_telemetry(viewer) -> None:
    """Rerun would collect its telemetry in a folder before sending it."""
    time.sleep(1.0)
    assert list(Path(os.environ['XDG_DATA_HOME']).iterdir()) == []
