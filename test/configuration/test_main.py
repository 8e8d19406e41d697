# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
from pathlib import Path

import pytest
from soft_throw_ros.configuration.__main__ import documents

ROOT = Path(__file__).parents[2]


@pytest.mark.parametrize(('path', 'text'), documents().items())
def test_document_is_current(path: str, text: str) -> None:
    """The command `python -m soft_throw_ros.configuration` updates the document."""
    assert (ROOT / path).read_text('utf-8') == text
