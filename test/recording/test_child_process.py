# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Child processes that never outlive this one."""

from __future__ import annotations

import os
import subprocess
import sys

from soft_throw_ros.recording.child_process import bound_to_parent


def test_child_of_another_process_does_not_start() -> None:
    command = bound_to_parent([sys.executable, '-c', 'print("started")'])
    command[command.index(str(os.getpid()))] = '1'
    assert subprocess.run(command, capture_output=True, check=True).stdout == b''
