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
"""The lock files, as SECURITY.md describes them; ruff's rules S scan the sources (`make lint`)."""

import ast
import itertools
from pathlib import Path
import re

ROOT = Path(__file__).parents[1]
LOCKS = sorted((ROOT / 'requirements').glob('*.lock'))


def pins(path):
    """Yield the name, version and number of checksums of every pinned package."""
    blocks = re.split(r'\n(?=\S)', path.read_text('ascii').strip())
    for block in blocks:
        match = re.match(r'([a-z0-9][\w.-]*)==([^\s;\\]+)', block)
        assert match, block
        yield match[1], match[2], len(re.findall(r'\\\n +--hash=sha256:[0-9a-f]{64}\b', block))


def test_every_pinned_package_has_a_checksum_and_names_no_server():
    assert LOCKS
    for path in LOCKS:
        assert all(count > 0 for _, _, count in pins(path))
        assert not re.search(r'://|^-', path.read_text('ascii'), re.MULTILINE)


def test_locks_contain_the_requested_versions_and_all_dependencies():
    for name in ('jazzy', 'kilted'):
        text = (ROOT / 'requirements' / f'{name}.txt').read_text('ascii')
        requested = set(re.findall(r'^([\w-]+)(?:\[\w+\])?==(\S+)', text, re.MULTILINE))
        locked = {pin[:2] for pin in pins(LOCKS[0].with_name(f'{name}.lock'))}
        assert requested
        assert requested <= locked
    (call,) = (
        node for node in ast.walk(ast.parse((ROOT / 'setup.py').read_text('utf-8')))
        if isinstance(node, ast.Call) and ast.unparse(node.func) == 'setup'
    )
    arguments = {item.arg: item.value for item in call.keywords}
    needed = ast.literal_eval(arguments['install_requires'])
    extras = ast.literal_eval(arguments['extras_require'])
    names = {
        re.match(r'[\w.-]+', text)[0].lower().replace('_', '-')
        for text in itertools.chain(needed, *extras.values())
    }
    assert names <= {package for path in LOCKS for package, _, _ in pins(path)}
