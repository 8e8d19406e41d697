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
    kernels = list(_PACKAGE.glob(f'*/__pycache__/{KERNELS}'))
    given_kernels = list(Path(given).glob(f'*/{KERNELS}')) if given else []
    if _is_usable(Path(given) if given else _PACKAGE / 'core/__pycache__'):
        _delete_damaged(given_kernels if given else kernels)
        return
    user = Path(os.environ.get('XDG_CACHE_HOME') or os.path.expanduser('~/.cache'))  # noqa: PTH111
    # Without a home directory the path stays relative.
    cache = user / 'soft_throw_ros' if user.is_absolute() and _is_usable(user) else _temporary()
    os.environ['NUMBA_CACHE_DIR'] = str(cache)
    _delete_damaged(list(cache.glob(f'*/{KERNELS}')))
    _link([*given_kernels, *kernels], cache)


def _is_usable(folder: Path) -> bool:
    """Return whether files fit into a folder, or could after creating it."""
    existing = next(path for path in (folder, *folder.parents) if path.exists())
    space = os.statvfs(existing)
    is_writable = existing.is_dir() and os.access(existing, os.W_OK | os.X_OK)
    return is_writable and space.f_bavail * space.f_frsize >= _LEAST_SPACE


def _temporary() -> Path:
    """Create a folder that lasts as long as the process, and print how to avoid it."""
    cache = Path(tempfile.mkdtemp(prefix='soft_throw_ros_'))
    atexit.register(shutil.rmtree, cache, ignore_errors=True)
    print(
        'soft-throw: no folder for compiled kernels is writable, so every start compiles missing '
        'ones again; set NUMBA_CACHE_DIR to a writable folder',
        file=sys.stderr,
    )
    return cache


def _is_damaged(path: Path) -> bool:
    """Return whether a pickle is cut off (a complete one ends with a stop) or not readable."""
    try:
        return not path.read_bytes().endswith(b'.')
    except OSError:
        return True


def _delete_damaged(paths: list[Path]) -> None:
    for path in filter(_is_damaged, paths):
        print(f'soft-throw: a damaged kernel is compiled again: {path}', file=sys.stderr)
        path.unlink(missing_ok=True)


def _link(paths: list[Path], cache: Path) -> None:
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
