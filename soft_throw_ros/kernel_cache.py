# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
The folder of the kernels that numba has compiled, chosen before anything imports numba.

numba keeps kernels beside their sources, or in NUMBA_CACHE_DIR. It fails at a damaged file, at a
full disk and without a writable folder, and reads no kernels where it cannot write.
"""

from __future__ import annotations

import atexit
import os
from pathlib import Path
import shutil
import sys
import tempfile

KERNELS = '*.nb[ic]'  # names of the files of kernels
_LEAST_SPACE = 2**23  # free space that a folder must have; all kernels need 3 MB [bytes]
_PACKAGE = Path(__file__).parent


def use_kernel_cache() -> None:
    """
    Let numba write kernels where it can, and read those that are there.

    If the present folder cannot be written, NUMBA_CACHE_DIR becomes a folder of the user, or else
    a temporary one, with links to the kernels. Damaged files are deleted, or not linked.
    """
    given = os.environ.get('NUMBA_CACHE_DIR')
    installed = list(_PACKAGE.glob(f'*/__pycache__/{KERNELS}'))
    kernels = list(Path(given).glob(f'*/{KERNELS}')) if given else installed
    if not _is_usable(Path(given) if given else _PACKAGE / 'core/__pycache__'):
        home = os.path.expanduser('~/.cache')  # noqa: PTH111 stays relative without a home
        user = Path(os.environ.get('XDG_CACHE_HOME') or home)
        is_usable = user.is_absolute() and _is_usable(user)
        cache = user / 'soft_throw_ros' if is_usable else _temporary()
        os.environ['NUMBA_CACHE_DIR'] = str(cache)
        _link([*kernels, *installed], cache)
        kernels = list(cache.glob(f'*/{KERNELS}'))
    for path in filter(_is_damaged, kernels):
        print(f'soft-throw: a damaged kernel is compiled again: {path}', file=sys.stderr)
        path.unlink(missing_ok=True)


def _is_usable(folder: Path) -> bool:
    """Return whether files fit into a folder, or could after creating it."""
    existing = next(path for path in (folder, *folder.parents) if path.exists())
    is_writable = existing.is_dir() and os.access(existing, os.W_OK | os.X_OK)
    return is_writable and shutil.disk_usage(existing).free >= _LEAST_SPACE


def _temporary() -> Path:
    """Create a folder that lasts as long as the process, and print how to avoid it."""
    cache = tempfile.mkdtemp(prefix='soft_throw_ros_')
    atexit.register(shutil.rmtree, cache, ignore_errors=True)
    reason = 'no folder for compiled kernels is writable, so every start compiles missing ones'
    print(f'soft-throw: {reason}; set NUMBA_CACHE_DIR to a writable folder', file=sys.stderr)
    return Path(cache)


def _is_damaged(path: Path) -> bool:
    """Return whether a pickle is cut off (a complete one ends with a stop) or not readable."""
    try:
        return not path.read_bytes().endswith(b'.')
    except OSError:
        return True


def _link(paths: list[Path], cache: Path) -> None:
    """Link kernels to where numba looks for them in a cache, unless it has intact ones there."""
    from numba.core.caching import _CacheLocator  # there is no public function for the name

    for path in paths:
        folder = path.parent.name
        if folder == '__pycache__':
            folder = _CacheLocator.get_suitable_cache_subpath(str(path.parents[1] / 'any.py'))
        link = cache / folder / path.name
        if _is_damaged(link) and not _is_damaged(path):
            link.parent.mkdir(parents=True, exist_ok=True)
            link.unlink(missing_ok=True)  # cut off, or to a file that is gone
            link.symlink_to(path)
