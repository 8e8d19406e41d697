# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Examples, links and commands of the README and the pages in docs."""

import ast
from pathlib import Path
import re
import runpy
import shlex

import numpy as np
import pytest
from soft_throw_ros import __main__ as umbrella
from soft_throw_ros.commands import design, free_layers, identify, throw, track
from soft_throw_ros.configuration.layers import library

ROOT = Path(__file__).parents[1]
PAGES = {
    str(path.relative_to(ROOT)): path.read_text(encoding='utf-8')
    for path in (ROOT / 'README.md', ROOT / 'CONTRIBUTING.md', *(ROOT / 'docs').glob('*.md'))
}
LINKS = [
    (page, link) for page in PAGES for link in re.findall(r'\]\(((?!http)[^)#]+)\)', PAGES[page])
]
COMMANDS = [
    (page, command)
    for page, text in PAGES.items()
    for command in re.findall(
        r'^ {4}(?:soft-throw|ros2 run soft_throw_ros) (\w+)', text, flags=re.MULTILINE
    )
]


MEASURED = PAGES['docs/measured.md']
SCRIPT = ROOT / 'docs' / 'measured' / 'draw.py'


def test_python_example_prints_an_ejection_time(capsys):
    (example,) = re.findall(r'```python\n(.*?)```', PAGES['README.md'], flags=re.DOTALL)
    exec(compile(example, 'README.md', 'exec'), {})
    printed = capsys.readouterr().out.strip()
    assert re.fullmatch(r'released at 7\.647 ms, alpha 3\.637', printed)
    assert f'prints `{printed}`' in PAGES['README.md']


def test_example_of_a_layer_library_is_valid(tmp_path):
    examples = re.findall(r'```yaml\n(.*?)```', PAGES['docs/design.md'], flags=re.DOTALL)
    path = tmp_path / 'mine.yaml'
    path.write_text(''.join(examples), encoding='utf-8')
    names = {'my_silicone_10.0mm', 'my_silicone_20.0mm', 'my_stack'}
    assert names < library(path).layers.keys()


@pytest.mark.parametrize(
    'args',
    ['recommend --vary thickness --objective robust', 'aim --target-height 0.15'],
)
def test_design_results_agree_with_the_page(capsys, args):
    assert design.main(args.split()) == 0
    assert capsys.readouterr().out.partition('\n')[0] in PAGES['docs/design.md']


def test_example_of_throw_prints_a_result(capsys):
    (example,) = re.findall(r'soft-throw throw (--thickness [^#]+) #', PAGES['README.md'])
    assert throw.main(shlex.split(example)) == 0
    assert 'alpha 3.637' in capsys.readouterr().out


def test_commands_and_links_of_the_pages_exist():
    assert len(COMMANDS) > 10
    assert {command for _, command in COMMANDS} <= umbrella.EXECUTABLES.keys()
    missing = [link for page, link in LINKS if not ((ROOT / page).parent / link).exists()]
    assert LINKS
    assert not missing


# docs/measured.md


def strings():
    """Yield the constant strings of the package."""
    for path in (ROOT / 'soft_throw_ros').rglob('*.py'):
        for node in ast.walk(ast.parse(path.read_text(encoding='utf-8'))):
            if isinstance(node, ast.Constant) and isinstance(node.value, str):
                yield node.value


def test_every_message_of_the_page_is_in_the_sources():
    texts = list(strings())
    messages = re.findall(r'^\| `([^`]+)` \|', MEASURED, re.MULTILINE)
    assert len(messages) > 12
    for message in messages:
        assert any(message in text for text in texts), message


@pytest.mark.slow
def test_pictures_of_the_page_are_current_and_small(tmp_path):
    for module in ('matplotlib', 'av', 'trackpy'):
        pytest.importorskip(module, reason='the extras [plot] and [video]')
    from matplotlib import image

    draw = runpy.run_path(str(SCRIPT))
    assert draw['main'](['--output', str(tmp_path)]) == 0
    names = re.findall(r'!\[.*\]\(measured/(\w+)\.png\)', MEASURED)
    assert names == list(draw['PICTURES'])
    for name in names:
        path = SCRIPT.with_name(f'{name}.png')
        assert path.stat().st_size < 100_000
        stored, drawing = (image.imread(file)[..., :3] for file in (path, tmp_path / path.name))
        assert stored.shape == drawing.shape
        # Text and edges may differ slightly between versions of matplotlib
        assert np.abs(stored - drawing).mean() < 0.01


def test_options_of_the_page_are_those_of_the_command(capsys):
    for command in (track, identify, free_layers):
        with pytest.raises(SystemExit):
            command.main(['--help'])
    known = capsys.readouterr().out
    text = MEASURED[: MEASURED.index('## 5.')]
    for option in set(re.findall(r'(?<![\w-])--[a-z][a-z-]+', text)) - {'--keep', '--objective'}:
        assert re.search(rf'{option}\b', known), option
