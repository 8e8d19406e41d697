# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""The import contracts of pyproject.toml."""

from pathlib import Path
import subprocess
import sys

import pytest

ROOT = Path(__file__).parents[1]


def test_import_contracts_hold():
    pytest.importorskip('importlinter', reason='comes with the extra [test]')
    check = 'from importlinter.cli import lint_imports_command as check; check()'
    result = subprocess.run(
        [sys.executable, '-c', check, '--no-cache', '--no-logo'],
        cwd=ROOT, capture_output=True, check=False, text=True, timeout=60,
    )
    assert result.returncode == 0, result.stdout + result.stderr
