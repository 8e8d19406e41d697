# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Child processes that never outlive this one."""

from __future__ import annotations

from collections.abc import Sequence


def bound_to_parent(command: Sequence[str]) -> list[str]:
    """
    Return a command that runs another one, which Linux kills however this process ends.

    The main thread must start it, since Linux watches the thread that starts a process. The
    program `setpriv` is part of util-linux.
    """
    return ['setpriv', '--pdeathsig', 'KILL', '--', *command]
