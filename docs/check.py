# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
Run the examples of the pages and compare their output: `make docs-check`.

An example is a line `    $ COMMAND` of an indented block, continued after a backslash; the lines
below it, up to the next one, are its output. `...` stands for anything. Line breaks do not count.
The examples of a page run in one folder, in their order; its Python block is `example.py` there,
and its YAML block `my_materials.yaml`. Files to which a page links must exist.
"""

from pathlib import Path
import re
import shlex
import subprocess
import sys
import tempfile

ROOT = Path(__file__).parents[1]
BLOCKS = {'python': 'example.py', 'yaml': 'my_materials.yaml'}
BLOCK = re.compile(r'^```(python|yaml)\n(.*?)^```', re.MULTILINE | re.DOTALL)
LINK = re.compile(r'\]\(((?!http)[^)#]+)\)')
EXAMPLE = re.compile(
    r'^    \$ ((?:.*\\\n)*.*)\n((?:    (?!\$ ).*\n|\n(?=    (?!\$ )))*)', re.MULTILINE
)


def check(page: Path) -> list[str]:
    """Return a message for each missing file and each example whose output differs."""
    text = page.read_text(encoding='utf-8')
    errors = [
        f'{page.name}: no {link}'
        for link in LINK.findall(text) if not (page.parent / link).exists()
    ]
    with tempfile.TemporaryDirectory() as folder:
        for name in ('docs', 'test'):
            (Path(folder) / name).symlink_to(ROOT / name)
        for language, block in BLOCK.findall(text):
            (Path(folder) / BLOCKS[language]).write_text(block, encoding='utf-8')
        for command, expected in EXAMPLE.findall(text):
            words = shlex.split(command.replace('\\\n', ' '))
            done = subprocess.run(words, cwd=folder, capture_output=True, text=True, check=False)
            pattern = r'\s+'.join(re.escape(word) for word in expected.split())
            printed = ' '.join(done.stdout.split())
            if done.returncode or not re.fullmatch(pattern.replace(r'\.\.\.', '.*'), printed):
                errors.append(f'{page.name}: {command}\n{done.stdout}{done.stderr}')
    return errors


def main() -> int:
    """Check all pages; return 1 if an output differs."""
    errors = [
        error for page in (*ROOT.glob('*.md'), *ROOT.glob('docs/*.md')) for error in check(page)
    ]
    print('\n\n'.join(errors))
    return 1 if errors else 0


if __name__ == '__main__':
    sys.exit(main())
