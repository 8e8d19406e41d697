# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Live display of messages, also while Rerun blocks the drawing thread."""

from __future__ import annotations

from pathlib import Path
from test.recording.conftest import plain, TIMEOUT
import threading
import time
from typing import Any

import pytest

pytest.importorskip('rerun')

from soft_throw_ros.recording import live_display  # noqa: E402, I100
from soft_throw_ros.recording.live_display import LiveDisplay  # noqa: E402
from soft_throw_ros.recording.rerun_view import Scene  # noqa: E402
from soft_throw_ros.recording.rerun_viewer import free_port, url_of  # noqa: E402


def test_messages_beyond_the_limit_are_dropped_and_counted_while_rerun_hangs(monkeypatch) -> None:
    is_drawing, goes_on = threading.Event(), threading.Event()

    def hang(*_: Any) -> None:
        is_drawing.set()
        goes_on.wait(TIMEOUT)

    monkeypatch.setattr(Scene, 'show', hang)
    monkeypatch.setattr(live_display, 'MAX_WAITING', 10)
    lines: list[str] = []
    port = free_port()
    display = LiveDisplay('serve', port, Path(), lines.append)
    assert is_drawing.wait(TIMEOUT)
    display.put(plain(number) for number in range(30))
    assert display.dropped == 20
    begin = time.monotonic()
    display.close()
    assert time.monotonic() - begin < 10.0
    goes_on.set()
    assert url_of(port) in lines[0]
