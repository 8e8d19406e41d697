# SPDX-License-Identifier: Apache-2.0
"""Options that say who does the work of a sweep, the same for every command that has one."""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from concurrent.futures import BrokenExecutor, CancelledError, Executor, ProcessPoolExecutor
import contextlib
import multiprocessing
import signal


class WorkersLostError(RuntimeError):
    """Those who do the work are gone."""


def add_executor_options(parser: argparse.ArgumentParser) -> None:
    """Add `--workers` and `--dask`; `open_executor` reads them."""
    who = parser.add_mutually_exclusive_group()
    who.add_argument(
        '--workers',
        metavar='N',
        type=_count,
        default=1,
        help='share the work out among N processes (default 1: this one)',
    )
    who.add_argument(
        '--dask',
        metavar='ADDRESS',
        help='have the workers of a Dask scheduler do it, such as tcp://10.0.0.1:8786',
    )


@contextlib.contextmanager
def open_executor(arguments: argparse.Namespace) -> Iterator[Executor | None]:
    """
    Give what does the work, as the options say: an executor, or None for this very process.

    Raises
    ------
    ValueError
        If there is no such scheduler, or Dask is not installed.
    WorkersLostError
        If the work cannot go on: a process was killed, or the scheduler is gone.

    """
    if arguments.dask is not None:
        with _dask(arguments.dask) as executor:
            yield executor
    elif arguments.workers == 1:
        yield None
    else:
        # Started anew, since threads do not survive a fork, and all at once, with Ctrl-C blocked:
        # they inherit that, and so it is answered here alone. They finish the block they are at.
        spawn = multiprocessing.get_context('spawn')
        with ProcessPoolExecutor(arguments.workers, mp_context=spawn) as executor:
            before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
            for _ in range(arguments.workers):
                executor.submit(int)
            signal.pthread_sigmask(signal.SIG_SETMASK, before)
            try:
                yield executor
            except BrokenExecutor:
                raise WorkersLostError(
                    'a worker process was killed, perhaps for want of memory'
                ) from None


@contextlib.contextmanager
def _dask(address: str) -> Iterator[Executor]:
    """Connect to a Dask scheduler."""
    try:
        from distributed import Client
        from distributed.scheduler import KilledWorker
    except ModuleNotFoundError as error:
        raise ValueError(
            f"--dask needs what pip installs with 'soft_throw_ros[dask]': {error}"
        ) from None
    try:
        client = Client(address, timeout='10s', set_as_default=False)
    except (OSError, ValueError) as error:
        raise ValueError(f'--dask {address}: no scheduler answers there ({error})') from None
    with client, client.get_executor() as executor:
        try:
            yield executor
        except KilledWorker:
            raise WorkersLostError(
                'the same work has killed several Dask workers, perhaps for want of memory'
            ) from None
        except CancelledError:
            raise WorkersLostError(f'the Dask scheduler at {address} is gone') from None


def _count(text: str) -> int:
    """Read a whole number above 0."""
    if not text.isdecimal() or int(text) < 1:
        raise argparse.ArgumentTypeError(f'must be a whole number of 1 or more, got {text!r}')
    return int(text)
