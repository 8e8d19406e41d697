# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""The lock files, as SECURITY.md describes them; ruff's rules S scan the sources (`make lint`)."""

from importlib.metadata import requires
from pathlib import Path
import re

LOCKS = Path(__file__).parents[1] / 'requirements'


def pins(path):
    """Return the names and versions of the pinned packages, each of which has a checksum."""
    text = path.read_text('ascii').strip()
    assert not re.search(r'://|^-', text, re.MULTILINE), f'{path} names a server'
    blocks = re.split(r'\n(?=\S)', text)
    for block in blocks:
        assert re.search(r'\\\n +--hash=sha256:[0-9a-f]{64}\b', block), block
    return {tuple(re.match(r'([\w.-]+)==([^\s;\\]+)', block).groups()) for block in blocks}


def test_locks_have_checksums_the_requested_versions_and_all_dependencies():
    locked = {path.stem: pins(path) for path in LOCKS.glob('*.lock')}
    for name in ('jazzy', 'kilted'):
        text = (LOCKS / f'{name}.txt').read_text('ascii')
        requested = set(re.findall(r'^([\w-]+)(?:\[\w+\])?==(\S+)', text, re.MULTILINE))
        assert requested
        assert requested <= locked[name]
    needed = {re.match(r'[\w.-]+', text)[0].lower() for text in requires('soft_throw_ros')}
    assert {name.replace('_', '-') for name in needed} <= {
        name for pinned in locked.values() for name, _ in pinned
    }
