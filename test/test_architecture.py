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
"""The import contracts of pyproject.toml."""

from pathlib import Path
import subprocess
import sys

import pytest


def test_import_contracts_hold():
    pytest.importorskip('importlinter', reason='comes with the extra [test]')
    check = 'from importlinter.cli import lint_imports_command as check; check()'
    result = subprocess.run(
        [sys.executable, '-c', check, '--no-cache', '--no-logo'],
        cwd=Path(__file__).parents[1], capture_output=True, check=False, text=True, timeout=60,
    )
    assert result.returncode == 0, result.stdout + result.stderr
