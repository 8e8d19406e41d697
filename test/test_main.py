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
"""The command `soft-throw NAME ...`."""

import subprocess
import sys
import types

import pytest
from soft_throw_ros import __main__ as umbrella


@pytest.fixture
def echo(monkeypatch):
    """Offer an executable `echo`, whose exit code is 5; give what it was called with."""
    calls = []

    def main(args):
        calls.append((list(sys.argv), args))
        return 5

    monkeypatch.setitem(sys.modules, 'echo_executable', types.SimpleNamespace(main=main))
    monkeypatch.setitem(umbrella.EXECUTABLES, 'echo', ('echo_executable', 'say it again'))
    monkeypatch.setattr(sys, 'argv', ['soft-throw', 'echo', 'from', 'process'])
    return calls


def test_umbrella_lists_every_executable_on_one_line(capsys):
    assert umbrella.main(['--help']) == 0
    lines = capsys.readouterr().out.splitlines()
    for name, (_, purpose) in umbrella.EXECUTABLES.items():
        assert [line.split(maxsplit=1) for line in lines].count([name, purpose]) == 1


@pytest.mark.parametrize(
    ('args', 'expected'), [(['echo', '-h'], ['-h']), (None, ['from', 'process'])]
)
def test_umbrella_hands_on_arguments_and_exit_code(echo, args, expected):
    assert umbrella.main(args) == 5
    assert echo == [(['soft-throw echo', *expected], expected)]


@pytest.mark.parametrize(('name', 'code'), [('trow', 2), ('lost', 1)])
def test_umbrella_names_in_one_line_what_is_not_there(capsys, monkeypatch, name, code):
    monkeypatch.setitem(umbrella.EXECUTABLES, 'lost', ('no_such_module', ''))
    assert umbrella.main([name]) == code
    out, err = capsys.readouterr()
    assert out == ''
    assert err.count('\n') == 1
    assert name in err


def test_throw_needs_no_ros():
    without_ros = (
        "import sys; sys.modules['rclpy'] = None; from soft_throw_ros.__main__ import main; "
        "main(['throw', '--help'])"
    )
    shown = subprocess.run(
        [sys.executable, '-c', without_ros], capture_output=True, text=True, check=True, timeout=60
    )
    assert shown.stdout.startswith('usage: soft-throw throw')
