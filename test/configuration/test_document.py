# SPDX-License-Identifier: Apache-2.0
from pathlib import Path

import pytest
from soft_throw_ros.configuration import document, files

ROOT = Path(__file__).parents[2]


@pytest.mark.parametrize(('path', 'text'), document.documents().items())
def test_document_is_current(path: str, text: str) -> None:
    """Bring it up to date with `python -m soft_throw_ros.configuration`."""
    assert (ROOT / path).read_text('utf-8') == text


@pytest.mark.parametrize('name', ['twin', 'recorder', 'layers'])
def test_installed_file_is_the_one_in_config(name) -> None:
    installed = files.default_file().with_name(f'{name}.yaml')
    assert installed.read_bytes() == (ROOT / f'config/{name}.yaml').read_bytes()
