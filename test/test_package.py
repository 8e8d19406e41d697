# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""The package installed by pip and by colcon."""

import ast
from email.parser import Parser
import itertools
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
from soft_throw_ros.configuration.interface import INTERFACES

pytestmark = pytest.mark.timeout(300)
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

LOCATE = "from importlib.resources import files; print(files('soft_throw_ros') / 'config')"


def run(*command, cwd, **environment):
    """Run a command without PYTHONPATH, and return its output."""
    variables = {name: os.environ[name] for name in os.environ if name != 'PYTHONPATH'}
    result = subprocess.run(
        list(map(str, command)), cwd=cwd, env=variables | environment, capture_output=True,
        check=False, text=True, timeout=250,
    )
    assert result.returncode == 0, result.stdout + result.stderr
    return result.stdout


def assert_finds_config(printed, below):
    """Check the output of LOCATE: a folder below another one, and its files."""
    folder = Path(printed.strip())
    assert folder.is_relative_to(below)
    assert files_below(folder) == CONFIG


@pytest.fixture(scope='module')
def source(tmp_path_factory):
    """Return a copy of the sources, because a build creates files."""
    copy = tmp_path_factory.mktemp('source') / 'soft_throw_ros'
    ignore = shutil.ignore_patterns('.*', '__pycache__', '*.egg-info', 'build', 'install', 'log')
    return shutil.copytree(ROOT, copy, symlinks=True, ignore=ignore)


@pytest.mark.once
def test_wheel_has_the_declared_dependencies_config_and_one_command_that_runs(source, tmp_path):
    run(*PIP, 'wheel', *OFFLINE, '--wheel-dir', tmp_path, source, cwd=tmp_path)
    (wheel,) = tmp_path.glob('*.whl')
    with zipfile.ZipFile(wheel) as archive:
        names = archive.namelist()
        (name,) = [name for name in names if name.endswith('/METADATA')]
        metadata = Parser().parsestr(archive.read(name).decode())
    assert all(name.startswith('soft_throw_ros') for name in names)
    released = re.search(r'^(\S+) \(', (ROOT / 'CHANGELOG.rst').read_text(), re.MULTILINE)[1]
    versions = {metadata['Version'], MANIFEST.findtext('version'), released}
    assert versions == {soft_throw_ros.__version__}

    trees = [ast.parse(path.read_text()) for path in (ROOT / 'soft_throw_ros').rglob('*.py')]
    nodes = [node for tree in trees for node in ast.walk(tree)]
    names = {alias.name for node in nodes if isinstance(node, ast.Import) for alias in node.names}
    names |= {node.module for node in nodes if isinstance(node, ast.ImportFrom)}
    imported = {name.split('.')[0] for name in names} - sys.stdlib_module_names
    of_ros = imported - ON_PYPI.keys() - OPTIONAL - {'soft_throw_ros'}
    topics = itertools.chain(*(topics for topics, _ in INTERFACES.values()))
    of_ros |= {topic.type.partition('/')[0] for topic in topics}
    needed = [ON_PYPI[name] for name in imported & ON_PYPI.keys()]
    declared = {element.text for element in MANIFEST.findall('exec_depend')}
    required = metadata.get_all('Requires-Dist')
    assert declared == of_ros | TO_LAUNCH | {key for _, key in needed}
    assert {line for line in required if 'extra' not in line} == {name for name, _ in needed}

    # An environment without the package that shares all dependencies
    environment = tmp_path / 'environment'
    run(sys.executable, '-m', 'venv', '--without-pip', environment, cwd=tmp_path)
    (site_packages,) = environment.glob('lib/python*/site-packages')
    (site_packages / 'shared.pth').write_text(sysconfig.get_path('purelib'))
    python, before = environment / 'bin/python', set((environment / 'bin').iterdir())
    run(*PIP, '--python', python, 'install', *OFFLINE, wheel, cwd=tmp_path)
    assert set((environment / 'bin').iterdir()) - before == {environment / 'bin/soft-throw'}
    assert_finds_config(run(python, '-c', LOCATE, cwd=tmp_path), environment)
    listed = run(environment / 'bin/soft-throw', cwd=tmp_path)
    assert all(name in listed for name in EXECUTABLES)


@pytest.mark.parametrize(
    'options', [(), pytest.param(('--symlink-install',), marks=pytest.mark.slow)],
    ids=['copies', 'links'],
)
def test_colcon_installs_to_the_paths_of_ros_and_finds_config(source, tmp_path, options):
    colcon = shutil.which('colcon', path=Path(sys.executable).parent) or shutil.which('colcon')
    if colcon is None:
        pytest.skip('colcon comes with the extra [test]')
    shutil.copytree(source, tmp_path / 'src/soft_throw_ros', symlinks=True)
    build = (colcon, 'build', '--packages-select', 'soft_throw_ros', *options)
    run(*build, cwd=tmp_path, COLCON_HOME=str(tmp_path / 'home'))
    prefix = tmp_path / 'install/soft_throw_ros'
    share, programs = prefix / 'share/soft_throw_ros', prefix / 'lib/soft_throw_ros'
    assert {path.name for path in programs.iterdir()} == set(EXECUTABLES)
    assert (prefix / 'share/ament_index/resource_index/packages/soft_throw_ros').is_file()
    assert (share / 'package.xml').read_bytes() == (ROOT / 'package.xml').read_bytes()
    assert files_below(share / 'config') == CONFIG
    for folder in ('launch', 'rviz', 'urdf'):
        assert files_below(share / folder) == files_below(ROOT / folder) != {}
    sourced = ('sh', '-c', f'. {prefix.parent}/setup.sh && exec "$@"', 'sh')
    printed = run(*sourced, sys.executable, '-c', LOCATE, cwd=tmp_path)
    assert_finds_config(printed, tmp_path)
    assert run(*sourced, programs / 'twin', '--help', cwd=tmp_path).startswith('usage: twin ')
