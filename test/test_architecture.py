# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""The import contracts of pyproject.toml, and the modules that the core may import."""

import ast
from pathlib import Path
import subprocess
import sys

import pytest

ROOT = Path(__file__).parents[1]

# Numerical libraries, and standard modules without access to clocks, files or processes.
ALLOWED_IN_CORE = {
    '__future__', 'abc', 'bisect', 'cmath', 'collections', 'concurrent', 'dataclasses', 'enum',
    'fractions', 'functools', 'heapq', 'itertools', 'math', 'numba', 'numpy', 'operator', 'scipy',
    'soft_throw_ros', 'types', 'typing',
}

# Further imports of core/batch.py, the only module of core that asks the operating system.
OF_BATCH = {'contextlib', 'contextvars', 'os'}


def test_import_contracts_hold():
    pytest.importorskip('importlinter', reason='comes with the extra [test]')
    check = 'from importlinter.cli import lint_imports_command as check; check()'
    result = subprocess.run(
        [sys.executable, '-c', check, '--no-cache', '--no-logo'],
        cwd=ROOT, capture_output=True, check=False, text=True, timeout=60,
    )
    assert result.returncode == 0, result.stdout + result.stderr


def test_core_imports_only_numerical_modules():
    core = sorted((ROOT / 'soft_throw_ros/core').rglob('*.py'))
    assert {'rig', 'plate', 'stepper'} <= {path.stem for path in core}
    for path in core:
        tree = list(ast.walk(ast.parse(path.read_text())))
        imported = {
            alias.name for node in tree if isinstance(node, ast.Import) for alias in node.names
        }
        imported_from = {node.module for node in tree if isinstance(node, ast.ImportFrom)}
        names = {node.id for node in tree if isinstance(node, ast.Name)}
        allowed = ALLOWED_IN_CORE | (OF_BATCH if path.stem == 'batch' else {'copy'})
        assert {module.split('.')[0] for module in imported | imported_from} <= allowed, path
        assert names.isdisjoint({'input', 'open', 'print'}), path
