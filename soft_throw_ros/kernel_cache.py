# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
The folder of the kernels that numba has compiled, chosen before anything imports numba.

numba keeps kernels beside their sources, or in NUMBA_CACHE_DIR. It raises an exception for a
damaged file, for a full disk, and if no folder is writable; and it does not read kernels beside
the sources if it cannot write there.
"""

from __future__ import annotations

import atexit
from collections.abc import Iterator
import os
from pathlib import Path
import shutil
import sys
import tempfile

KERNELS = '*.nb[ic]'
"""Names of the files of kernels."""

_LEAST_SPACE = 2**23
"""Free space that a folder must have [bytes]; all kernels need 3 MB."""

_PACKAGE = Path(__file__).parent


def use_kernel_cache() -> None:
    """
    Let numba write kernels where it can, and read those that are there.

    If the present folder cannot be written, NUMBA_CACHE_DIR becomes a folder of the user, or else
    a temporary one, with links to the kernels. Child processes inherit it. Damaged files are
    deleted, or not linked, so that numba compiles them again.
    """
    given = os.environ.get('NUMBA_CACHE_DIR')
    if _is_usable(Path(given) if given else _PACKAGE / 'core/__pycache__'):
        present = Path(given).glob(f'*/{KERNELS}') if given else _kernels_of_package()
        _delete_damaged(present)
        return
    cache = _cache_of_user() or _temporary_cache()
    os.environ['NUMBA_CACHE_DIR'] = str(cache)
    _delete_damaged(cache.glob(f'*/{KERNELS}'))
    if given:
        _link(Path(given).glob(f'*/{KERNELS}'), cache)
    _link(_kernels_of_package(), cache)


def _kernels_of_package() -> Iterator[Path]:
    return _PACKAGE.glob(f'*/__pycache__/{KERNELS}')


def _is_usable(folder: Path) -> bool:
    """Return whether files fit into a folder, or could after creating it."""
    existing = next(path for path in (folder, *folder.parents) if path.exists())
    if not (existing.is_dir() and os.access(existing, os.W_OK | os.X_OK)):
        return False
    space = os.statvfs(existing)
    return space.f_bavail * space.f_frsize >= _LEAST_SPACE


def _cache_of_user() -> Path | None:
    try:
        base = Path(os.environ.get('XDG_CACHE_HOME') or Path.home() / '.cache')
    except RuntimeError:  # there is no home directory
        return None
    return base / 'soft_throw_ros' if _is_usable(base) else None


def _temporary_cache() -> Path:
    cache = Path(tempfile.mkdtemp(prefix='soft_throw_ros_'))
    atexit.register(shutil.rmtree, cache, ignore_errors=True)
    print(
        'soft-throw: no folder for compiled kernels is writable, so every start compiles missing '
        'ones again; set NUMBA_CACHE_DIR to a writable folder',
        file=sys.stderr,
    )
    return cache


def _is_damaged(path: Path) -> bool:
    """Return whether a pickle is cut off: one that is complete ends with a stop."""
    try:
        with path.open('rb') as file:
            file.seek(-1, os.SEEK_END)
            return file.read() != b'.'
    except OSError:  # it is empty, or cannot be read
        return True


def _delete_damaged(paths: Iterator[Path]) -> None:
    for path in paths:
        if _is_damaged(path):
            print(f'soft-throw: a damaged kernel is compiled again: {path}', file=sys.stderr)
            path.unlink(missing_ok=True)


def _link(paths: Iterator[Path], cache: Path) -> None:
    """Link kernels to where numba looks for them in a cache, unless it has newer ones there."""
    from numba.core.caching import _CacheLocator  # there is no public function for the name

    for path in paths:
        folder = path.parent.name
        if folder == '__pycache__':
            folder = _CacheLocator.get_suitable_cache_subpath(str(path.parents[1] / 'any.py'))
        link = cache / folder / path.name
        if not _is_damaged(path) and not link.exists():
            link.parent.mkdir(parents=True, exist_ok=True)
            link.unlink(missing_ok=True)  # a link to a file that is gone
            link.symlink_to(path)
