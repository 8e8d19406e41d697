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
"""docs/measured.md: pictures are current, and messages and options exist."""

import ast
from pathlib import Path
import re
import runpy

import numpy as np
import pytest

pytest.importorskip('matplotlib', reason='the extra [plot]')
pytest.importorskip('av', reason='the extra [video]')
pytest.importorskip('skimage', reason='the extra [video]')

from matplotlib import image  # noqa: E402, I100
from soft_throw_ros.commands import free_layers, identify, plan, track  # noqa: E402

ROOT = Path(__file__).parents[1]
PAGE = (ROOT / 'docs' / 'measured.md').read_text(encoding='utf-8')
SCRIPT = ROOT / 'docs' / 'measured' / 'draw.py'


def strings():
    """Yield the constant strings of the package."""
    for path in (ROOT / 'soft_throw_ros').rglob('*.py'):
        for node in ast.walk(ast.parse(path.read_text(encoding='utf-8'))):
            if isinstance(node, ast.Constant) and isinstance(node.value, str):
                yield node.value


def test_every_message_of_the_page_is_in_the_sources():
    texts = list(strings())
    messages = re.findall(r'^\| `([^`]+)` \|', PAGE, re.MULTILINE)
    assert len(messages) > 12
    for message in messages:
        assert any(message in text for text in texts), message


@pytest.mark.slow
def test_pictures_of_the_page_are_current_and_small(tmp_path, capsys):
    draw = runpy.run_path(str(SCRIPT))
    assert draw['main'](['--output', str(tmp_path)]) == 0
    assert 'is not seen as a whole' in capsys.readouterr().err
    names = re.findall(r'!\[.*\]\(measured/(\w+)\.png\)', PAGE)
    assert names == list(draw['PICTURES'])
    for name in names:
        path = SCRIPT.with_name(f'{name}.png')
        assert path.stat().st_size < 100_000
        stored, drawing = (image.imread(file)[..., :3] for file in (path, tmp_path / path.name))
        assert stored.shape == drawing.shape
        # Text and edges may differ slightly between versions of matplotlib
        assert np.abs(stored - drawing).mean() < 0.01


def test_options_of_the_page_are_those_of_the_command(capsys):
    for command in (track, identify, free_layers, plan):
        with pytest.raises(SystemExit):
            command.main(['--help'])
    known = capsys.readouterr().out
    text = PAGE[: PAGE.index('## 5.')]
    for option in set(re.findall(r'(?<![\w-])--[a-z][a-z-]+', text)) - {'--keep', '--objective'}:
        assert re.search(rf'{option}\b', known), option
