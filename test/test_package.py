# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""The package installed by pip, as editable, by colcon, and used from the checkout."""

import ast
from email.parser import Parser
import os
from pathlib import Path
import re
import shutil
import subprocess
import sys
import sysconfig
from xml.etree import ElementTree as ET
import zipfile

import pytest
import soft_throw_ros
from soft_throw_ros.__main__ import EXECUTABLES
from soft_throw_ros.configuration.interface import (
    RECORDER_TOPICS,
    RIG_TOPICS,
    TWIN_TOPICS,
)

ROOT = Path(__file__).parents[1]


def files_below(folder):
    """Return the contents of all files below a folder by their relative paths."""
    paths = [path for path in folder.rglob('*.*') if path.is_file()]
    return {str(path.relative_to(folder)): path.read_bytes() for path in paths}


CONFIG = files_below(ROOT / 'config')
MANIFEST = ET.parse(ROOT / 'package.xml')
PIP = [sys.executable, '-m', 'pip', '--disable-pip-version-check']
# Imported modules, with their names for pip and rosdep.
ON_PYPI = {
    'mcap': ('mcap>=1.6', 'mcap-ros2-support'),
    'mcap_ros2': ('mcap-ros2-support>=0.5', 'mcap-ros2-support'),
    'numba': ('numba', 'python3-numba'),
    'numpy': ('numpy', 'python3-numpy'),
    'scipy': ('scipy', 'python3-scipy'),
    'yaml': ('pyyaml', 'python3-yaml'),
}
OPTIONAL = {'av', 'dask', 'distributed', 'imageio', 'matplotlib', 'rerun', 'trackpy', 'xarray'}
# Packages that the launch files import or start, without the optional rviz2.
TO_LAUNCH = {'launch', 'launch_ros', 'robot_state_publisher'}
# Build tools and dependencies are already installed, so pip must not download anything.
OFFLINE = ['--no-build-isolation', '--no-deps', '--no-index']
ENVIRONMENT = {name: value for name, value in os.environ.items() if name != 'PYTHONPATH'}

PRINT_PATH_AND_CONFIG = """
from importlib.resources import files
import soft_throw_ros
print(soft_throw_ros.__file__)
config = files('soft_throw_ros') / 'config'
for path in config.rglob('*.*'):
    print(path.relative_to(config), path.read_bytes().hex())
"""


def run(*command, cwd, **environment):
    """Run a command without PYTHONPATH, and return its output."""
    result = subprocess.run(
        list(map(str, command)), cwd=cwd, env=ENVIRONMENT | environment, capture_output=True,
        check=False, text=True, timeout=110,
    )
    assert result.returncode == 0, result.stdout + result.stderr
    return result.stdout


def assert_finds_config(printed, below):
    """Check the output of PRINT_PATH_AND_CONFIG: package below a folder, and its config."""
    path, *lines = printed.splitlines()
    assert Path(path).is_relative_to(below)
    assert dict(line.split() for line in lines) == {
        name: content.hex() for name, content in CONFIG.items()
    }


@pytest.fixture(scope='module')
def source(tmp_path_factory):
    """Return a copy of the sources, because a build creates files."""
    copy = tmp_path_factory.mktemp('source') / 'soft_throw_ros'
    ignore = shutil.ignore_patterns('.*', '__pycache__', '*.egg-info', 'build', 'install', 'log')
    return shutil.copytree(ROOT, copy, symlinks=True, ignore=ignore)


@pytest.fixture(scope='module')
def wheel(source, tmp_path_factory):
    """Build the wheel of the package."""
    folder = tmp_path_factory.mktemp('wheel')
    run(*PIP, 'wheel', *OFFLINE, '--wheel-dir', folder, source, cwd=folder)
    (built,) = folder.glob('*.whl')
    return built


@pytest.fixture
def environment(tmp_path):
    """Create a virtual environment without the package that shares all dependencies."""
    folder = tmp_path / 'environment'
    run(sys.executable, '-m', 'venv', '--without-pip', folder, cwd=tmp_path)
    (site_packages,) = folder.glob('lib/python*/site-packages')
    (site_packages / 'shared.pth').write_text(sysconfig.get_path('purelib'))
    return folder


@pytest.fixture(
    scope='module',
    params=[(), pytest.param(('--symlink-install',), marks=pytest.mark.slow)],
    ids=['copies', 'links'],
)
def colcon_prefix(request, source, tmp_path_factory):
    """Build a colcon workspace, and return the install prefix of the package."""
    colcon = shutil.which('colcon', path=Path(sys.executable).parent) or shutil.which('colcon')
    if colcon is None:
        pytest.skip('colcon comes with the extra [test]')
    workspace = tmp_path_factory.mktemp('workspace')
    (workspace / 'src').mkdir()
    shutil.copytree(source, workspace / 'src/soft_throw_ros', symlinks=True)
    run(
        *(colcon, 'build', '--packages-select', 'soft_throw_ros', *request.param),
        cwd=workspace,
        COLCON_HOME=str(workspace / 'home'),
    )
    return workspace / 'install/soft_throw_ros'


def in_workspace(prefix, *command):
    """Return a command that runs in a shell with the sourced workspace."""
    return ('sh', '-c', f'. {prefix.parent}/setup.sh && exec "$@"', 'sh', *map(str, command))


@pytest.mark.once
def test_versions_agree_and_dependencies_match_the_imports(wheel):
    with zipfile.ZipFile(wheel) as archive:
        (name,) = [name for name in archive.namelist() if name.endswith('/METADATA')]
        metadata = Parser().parsestr(archive.read(name).decode())
    released = re.search(r'^(\S+) \(', (ROOT / 'CHANGELOG.rst').read_text(), re.MULTILINE)[1]
    versions = {metadata['Version'], MANIFEST.findtext('version'), released}
    assert versions == {soft_throw_ros.__version__}

    trees = [ast.parse(path.read_text()) for path in (ROOT / 'soft_throw_ros').rglob('*.py')]
    nodes = [node for tree in trees for node in ast.walk(tree)]
    names = {alias.name for node in nodes if isinstance(node, ast.Import) for alias in node.names}
    names |= {node.module for node in nodes if isinstance(node, ast.ImportFrom)}
    imported = {name.split('.')[0] for name in names} - sys.stdlib_module_names
    of_ros = imported - ON_PYPI.keys() - OPTIONAL - {'soft_throw_ros'}
    tables = (TWIN_TOPICS, RECORDER_TOPICS, RIG_TOPICS)
    of_ros |= {row.type.partition('/')[0] for table in tables for row in table}
    needed = [ON_PYPI[name] for name in imported & ON_PYPI.keys()]

    declared = {element.text for element in MANIFEST.findall('exec_depend')}
    required = metadata.get_all('Requires-Dist')
    assert declared == of_ros | TO_LAUNCH | {key for _, key in needed}
    assert {line for line in required if 'extra' not in line} == {name for name, _ in needed}


@pytest.mark.once
def test_wheel_installs_config_and_one_command_that_runs(wheel, environment, tmp_path):
    with zipfile.ZipFile(wheel) as archive:
        assert all(name.startswith('soft_throw_ros') for name in archive.namelist())
    python = environment / 'bin/python'
    before = set((environment / 'bin').iterdir())
    run(*PIP, '--python', python, 'install', *OFFLINE, wheel, cwd=tmp_path)
    assert set((environment / 'bin').iterdir()) - before == {environment / 'bin/soft-throw'}
    assert_finds_config(run(python, '-c', PRINT_PATH_AND_CONFIG, cwd=tmp_path), environment)
    listed = run(environment / 'bin/soft-throw', cwd=tmp_path)
    assert all(name in listed for name in EXECUTABLES)


def test_colcon_installs_to_the_paths_of_ros_and_finds_config(colcon_prefix, tmp_path):
    share, programs = colcon_prefix / 'share/soft_throw_ros', colcon_prefix / 'lib/soft_throw_ros'
    assert {path.name for path in programs.iterdir()} == set(EXECUTABLES)
    assert (colcon_prefix / 'share/ament_index/resource_index/packages/soft_throw_ros').is_file()
    assert (share / 'package.xml').read_bytes() == (ROOT / 'package.xml').read_bytes()
    assert files_below(share / 'config') == CONFIG
    for folder in ('launch', 'rviz', 'urdf'):
        assert files_below(share / folder) == files_below(ROOT / folder) != {}
    command = in_workspace(colcon_prefix, sys.executable, '-c', PRINT_PATH_AND_CONFIG)
    assert_finds_config(run(*command, cwd=tmp_path), colcon_prefix.parents[1])
    command = in_workspace(colcon_prefix, programs / 'twin', '--help')
    assert run(*command, cwd=tmp_path).startswith('usage: twin ')
