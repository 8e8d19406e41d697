# Copyright 2026 soft_throw_ros developers
#
# Licensed under the Apache License, Version 2.0 (the "License");
# you may not use this file except in compliance with the License.
# You may obtain a copy of the License at
#
#     http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software
# distributed under the License is distributed on an "AS IS" BASIS,
# WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied.
# See the License for the specific language governing permissions and
# limitations under the License.
"""Who may import whom, and what the core may know."""

import ast
from pathlib import Path
import shutil
import subprocess
import sys

import pytest

ROOT = Path(__file__).parents[1]

# Libraries of numbers, and the part of the standard library without a clock, a file or a process.
KNOWN_TO_CORE = {
    '__future__', 'abc', 'bisect', 'cmath', 'collections', 'concurrent', 'dataclasses', 'enum',
    'fractions', 'functools', 'heapq', 'itertools', 'math', 'numba', 'numpy', 'operator', 'scipy',
    'soft_throw_ros', 'types', 'typing',
}


def lint_imports(root):
    """Check the contracts of pyproject.toml on the package in a folder."""
    pytest.importorskip('importlinter', reason='comes with the extra [test]')
    check = 'from importlinter.cli import lint_imports_command as check; check()'
    return subprocess.run(
        [sys.executable, '-c', check, '--no-cache', '--no-logo'],
        cwd=root,
        capture_output=True,
        check=False,
        text=True,
        timeout=60,
    )


def test_contracts_of_import_are_kept():
    checked = lint_imports(ROOT)
    assert checked.returncode == 0, checked.stdout + checked.stderr


@pytest.mark.parametrize(
    ('importer', 'line'),
    [
        ('core/wrong.py', 'import soft_throw_ros.configuration'),
        ('design/wrong.py', 'from rclpy.node import Node'),
        ('twin/wrong.py', 'from sensor_msgs.msg import JointState'),
        ('commands/wrong.py', 'import soft_throw_ros.nodes'),
        ('unknown_room/__init__.py', ''),
    ],
)
def test_contracts_of_import_notice_what_breaks_them(tmp_path, importer, line):
    shutil.copytree(ROOT / 'soft_throw_ros', tmp_path / 'soft_throw_ros')
    shutil.copy(ROOT / 'pyproject.toml', tmp_path)
    wrong = tmp_path / 'soft_throw_ros' / importer
    wrong.parent.mkdir(exist_ok=True)
    (wrong.parent / '__init__.py').touch()
    wrong.write_text(f'{line}\n')
    assert lint_imports(tmp_path).returncode == 1


def test_core_knows_numbers_only():
    core = sorted((ROOT / 'soft_throw_ros/core').rglob('*.py'))
    assert {'rig', 'plate', 'stepper'} <= {path.stem for path in core}
    for path in core:
        tree = list(ast.walk(ast.parse(path.read_text())))
        imported = {
            alias.name for node in tree if isinstance(node, ast.Import) for alias in node.names
        }
        imported_from = {node.module for node in tree if isinstance(node, ast.ImportFrom)}
        names = {node.id for node in tree if isinstance(node, ast.Name)}
        attributes = {ast.unparse(node) for node in tree if isinstance(node, ast.Attribute)}
        assert {module.split('.')[0] for module in imported_from} <= KNOWN_TO_CORE, path
        assert {module.split('.')[0] for module in imported} <= KNOWN_TO_CORE | {'copy', 'os'}, (
            path
        )
        assert {name for name in attributes if name.startswith('os.')} <= {'os.cpu_count'}, path
        assert names.isdisjoint({'input', 'open', 'print'}), path
