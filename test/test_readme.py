# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Examples, links and commands of the README and the pages in docs."""

from pathlib import Path
import re

from soft_throw_ros import __main__ as umbrella
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
        r'^ {4}(?:\$ )?(?:soft-throw|ros2 run soft_throw_ros) (\w+)', text, flags=re.MULTILINE
    )
]


def test_example_of_a_layer_library_is_valid(tmp_path):
    examples = re.findall(r'```yaml\n(.*?)```', PAGES['docs/design.md'], flags=re.DOTALL)
    path = tmp_path / 'mine.yaml'
    path.write_text(''.join(examples), encoding='utf-8')
    names = {'my_silicone_10.0mm', 'my_silicone_20.0mm', 'my_stack'}
    assert names < library(path).layers.keys()


def test_commands_and_links_of_the_pages_exist():
    assert len(COMMANDS) > 10
    assert {command for _, command in COMMANDS} <= umbrella.EXECUTABLES.keys()
    missing = [link for page, link in LINKS if not ((ROOT / page).parent / link).exists()]
    assert LINKS
    assert not missing
