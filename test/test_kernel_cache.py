# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""The folder of compiled kernels, with files in place of kernels."""

import os
from pathlib import Path
import stat

import pytest
from soft_throw_ros import kernel_cache

INTACT, DAMAGED = b'kernel.', b'kern'


@pytest.fixture
def package(tmp_path, monkeypatch):
    """Return the core of a package with an intact and two damaged kernels."""
    core = tmp_path / 'package/core/__pycache__'
    core.mkdir(parents=True)
    for name, data in (('good.nbi', INTACT), ('cut.nbc', DAMAGED), ('empty.nbi', b'')):
        (core / name).write_bytes(data)
    monkeypatch.setattr(kernel_cache, '_PACKAGE', tmp_path / 'package')
    monkeypatch.setenv('NUMBA_CACHE_DIR', '')
    monkeypatch.setenv('XDG_CACHE_HOME', str(tmp_path / 'home'))
    return core


def refuse(monkeypatch, *folders: Path) -> None:
    """Let folders be read-only, which they are not for root."""
    may = os.access
    monkeypatch.setattr(os, 'access', lambda path, mode: path not in folders and may(path, mode))


def kernels_of(folder: Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in folder.rglob(kernel_cache.KERNELS)}


@pytest.mark.parametrize('is_given', [False, True])
def test_damaged_kernels_are_deleted(package, monkeypatch, capsys, is_given) -> None:
    if is_given:
        monkeypatch.setenv('NUMBA_CACHE_DIR', str(package.parent))
    kernel_cache.use_kernel_cache()
    assert kernels_of(package) == {'good.nbi': INTACT}
    lines = capsys.readouterr().err
    assert all(name in lines for name in ('cut.nbc', 'empty.nbi'))
    assert os.environ['NUMBA_CACHE_DIR'] == (str(package.parent) if is_given else '')


def test_kernels_of_a_read_only_package_are_linked(package, monkeypatch, capsys) -> None:
    refuse(monkeypatch, package)
    kernel_cache.use_kernel_cache()
    cache = Path(os.environ['NUMBA_CACHE_DIR'])
    assert cache == package.parents[2] / 'home/soft_throw_ros'
    assert kernels_of(cache) == {'good.nbi': INTACT}
    (link,) = cache.rglob('*.nbi')
    link.unlink()
    link.write_bytes(b'newer.')
    kernel_cache.use_kernel_cache()
    assert kernels_of(cache) == {'good.nbi': b'newer.'}
    assert capsys.readouterr().err == ''


def test_last_resort_is_a_private_folder(package, monkeypatch, capsys) -> None:
    given = package.parents[2] / 'given/core_of_another'
    given.mkdir(parents=True)
    (given / 'old.nbc').write_bytes(INTACT)
    monkeypatch.setenv('NUMBA_CACHE_DIR', str(given.parent))
    monkeypatch.delenv('XDG_CACHE_HOME')
    monkeypatch.setattr(os.path, 'expanduser', lambda path: path)  # as without a home directory
    refuse(monkeypatch, package, given.parent)
    kernel_cache.use_kernel_cache()
    cache = Path(os.environ['NUMBA_CACHE_DIR'])
    assert stat.S_IMODE(cache.stat().st_mode) == stat.S_IRWXU
    assert kernels_of(cache) == {'good.nbi': INTACT, 'old.nbc': INTACT}
    (line,) = capsys.readouterr().err.splitlines()
    assert 'NUMBA_CACHE_DIR' in line
