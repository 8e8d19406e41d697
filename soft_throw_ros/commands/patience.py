# SPDX-License-Identifier: Apache-2.0
"""Say why a command takes so long, if it does."""

from __future__ import annotations

from collections.abc import Iterator
import contextlib
import sys
import threading

_PATIENCE = 2.0  # [s]


@contextlib.contextmanager
def patience(command: str) -> Iterator[None]:
    """
    Have it said that something is compiled if that is not over soon.

    Parameters
    ----------
    command : str
        Who says it.

    """
    text = f'{command}: computing; what has to be compiled first takes half a minute, once'
    notice = threading.Timer(_PATIENCE, print, (text,), {'file': sys.stderr})
    notice.start()
    try:
        yield
    finally:
        notice.cancel()
