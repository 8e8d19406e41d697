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
"""What SECURITY.md promises of the sources: nothing is run, unpickled or loaded unsafely."""

import ast
import itertools
from pathlib import Path
import re

import pytest

ROOT = Path(__file__).parents[1]
SOURCES = sorted((ROOT / 'soft_throw_ros').rglob('*.py'))
MODULES = {'pickle', 'cPickle', 'dill', 'shelve', 'marshal', 'joblib', 'cloudpickle'}
CALLS = {'eval', 'exec', 'compile', '__import__', 'os.system', 'os.popen', 'yaml.load',
         'yaml.full_load', 'yaml.unsafe_load', 'yaml.load_all', 'np.load', 'numpy.load',
         'tempfile.mktemp', 'subprocess.getoutput', 'subprocess.getstatusoutput'}


def nodes_of(path):
    return ast.walk(ast.parse(path.read_text('utf-8'), str(path)))


def dangers(nodes):
    """List what could run or load what a file says."""
    for node in nodes:
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names if alias.name in MODULES)
        elif isinstance(node, ast.ImportFrom) and node.module in MODULES:
            yield node.module
        elif isinstance(node, ast.Call):
            called = ast.unparse(node.func)
            if called in CALLS:
                yield called
            for keyword in node.keywords:
                if (
                    keyword.arg in {'shell', 'allow_pickle'}
                    and ast.unparse(keyword.value) != 'False'
                ):
                    yield f'{called}({keyword.arg}=...)'
        elif isinstance(node, ast.Attribute) and ast.unparse(node) in {
            'yaml.Loader', 'yaml.UnsafeLoader', 'yaml.FullLoader', 'yaml.CLoader',
        }:
            yield ast.unparse(node)


def test_sources_run_and_unpickle_nothing():
    assert {path.name: found for path in SOURCES if (found := list(dangers(nodes_of(path))))} == {}


@pytest.mark.parametrize(
    'text',
    [
        'import pickle', 'from marshal import loads', 'eval("1")', 'yaml.load(text)',
        'yaml.load(text, Loader=yaml.Loader)', 'subprocess.run("ls", shell=True)',
        'np.load(path, allow_pickle=True)',
    ],
)
def test_what_is_dangerous_is_noticed(text):
    assert list(dangers(ast.walk(ast.parse(text))))


def test_addresses_in_the_sources_are_of_this_machine():
    found = {
        (path.name, address)
        for path in SOURCES
        for node in nodes_of(path)
        if isinstance(node, ast.Constant) and isinstance(node.value, str)
        for address in re.findall(r'\b\d{1,3}(?:\.\d{1,3}){3}\b', node.value)
    }
    # the address of a scheduler stands in a help text as an example
    assert {address for _, address in found} <= {'127.0.0.1', '10.0.0.1'}
    assert {name for name, address in found if address == '10.0.0.1'} <= {'options.py'}


LOCKS = sorted((ROOT / 'requirements').glob('*.lock'))


def pins(path):
    """Read what versions a list of requirements has, and how many checksums each of them."""
    blocks = re.split(r'\n(?=\S)', path.read_text('ascii').strip())
    for block in blocks:
        match = re.match(r'([a-z0-9][\w.-]*)==([^\s;\\]+)', block)
        assert match, block
        yield match[1], match[2], len(re.findall(r'\\\n +--hash=sha256:[0-9a-f]{64}\b', block))


def test_all_that_make_installs_has_a_checksum_and_names_no_server():
    assert LOCKS
    for path in LOCKS:
        assert all(count > 0 for _, _, count in pins(path))
        assert not re.search(r'://|^-', path.read_text('ascii'), re.MULTILINE)


def test_locks_have_what_is_asked_for_and_what_the_package_depends_on():
    for name in ('jazzy', 'kilted'):
        text = (ROOT / 'requirements' / f'{name}.txt').read_text('ascii')
        asked = set(re.findall(r'^([\w-]+)(?:\[\w+\])?==(\S+)', text, re.MULTILINE))
        locked = {pin[:2] for pin in pins(LOCKS[0].with_name(f'{name}.lock'))}
        assert asked
        assert asked <= locked
    (call,) = (
        node for node in nodes_of(ROOT / 'setup.py')
        if isinstance(node, ast.Call) and ast.unparse(node.func) == 'setup'
    )
    given = {item.arg: item.value for item in call.keywords}
    needed = ast.literal_eval(given['install_requires'])
    extras = ast.literal_eval(given['extras_require'])
    names = {
        re.match(r'[\w.-]+', text)[0].lower().replace('_', '-')
        for text in itertools.chain(needed, *extras.values())
    }
    assert names <= {package for path in LOCKS for package, _, _ in pins(path)}
