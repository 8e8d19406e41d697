# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""The command `soft-throw NAME ...`."""

import re
import subprocess
import sys
import types

import pytest
from soft_throw_ros import __main__ as umbrella


@pytest.fixture
def echo(monkeypatch):
    """Add an executable `echo` with exit code 5, and return the list of its calls."""
    calls = []

    def main(args):
        calls.append((list(sys.argv), args))
        return 5

    monkeypatch.setitem(sys.modules, 'echo_executable', types.SimpleNamespace(main=main))
    monkeypatch.setitem(umbrella.EXECUTABLES, 'echo', ('echo_executable', 'repeats its arguments'))
    monkeypatch.setattr(sys, 'argv', ['soft-throw', 'echo', 'from', 'process'])
    return calls


def test_umbrella_lists_every_executable_on_one_line(capsys):
    assert not umbrella.main(['--help'])
    lines = capsys.readouterr().out.splitlines()
    for name, (_, purpose) in umbrella.EXECUTABLES.items():
        assert [line.split(maxsplit=1) for line in lines].count([name, purpose]) == 1


@pytest.mark.parametrize(
    ('args', 'expected'), [(['echo', '-h'], ['-h']), (None, ['from', 'process'])]
)
def test_umbrella_forwards_arguments_and_exit_code(echo, args, expected):
    assert umbrella.main(args) == 5
    assert echo == [(['soft-throw echo', *expected], expected)]


@pytest.mark.parametrize(
    ('name', 'module', 'code', 'text'),
    [('trow', 'no_such_module', 2, 'choose from'), ('lost', 'no_such_module', 1, 'no_such_module'),
     ('lost', 'no_such_package.nodes.lost', 1, 'ROS 2')],
)
def test_umbrella_names_a_missing_executable_in_one_line(
    capsys, monkeypatch, name, module, code, text
):
    monkeypatch.setitem(umbrella.EXECUTABLES, 'lost', (module, ''))
    assert umbrella.main([name]) == code
    out, err = capsys.readouterr()
    assert (out, err.count('\n')) == ('', 1)
    assert name in err
    assert text in err


@pytest.mark.parametrize(('module', 'code'), [('package.nodes.echo', 0), ('echo', 130)])
def test_early_signal_ends_the_executable_without_a_traceback(
    capsys, monkeypatch, module, code
):
    def main(_args):
        raise KeyboardInterrupt

    for name in ('package', 'package.nodes'):
        monkeypatch.setitem(sys.modules, name, types.ModuleType(name))
    monkeypatch.setitem(sys.modules, module, types.SimpleNamespace(main=main))
    monkeypatch.setitem(umbrella.EXECUTABLES, 'echo', (module, 'repeats its arguments'))
    assert umbrella.main(['echo']) == code
    assert capsys.readouterr() == ('', '')


def test_recovery_starts_without_numba():
    code = 'import sys, soft_throw_ros.commands.recover; sys.exit("numba" in sys.modules)'
    subprocess.run([sys.executable, '-c', code], check=True)


def test_umbrella_imports_little_before_it_handles_signals():
    importing = (
        'import sys; import _collections_abc, importlib, os, signal; '
        'before = set(sys.modules); import soft_throw_ros.__main__; '
        'print(*sorted(set(sys.modules) - before))'
    )
    result = subprocess.run(
        [sys.executable, '-c', importing], capture_output=True, text=True, check=True, timeout=60
    )
    ours = {'soft_throw_ros', 'soft_throw_ros.__main__'}
    assert set(result.stdout.split()) - {'collections.abc'} == ours


@pytest.mark.parametrize('words', [['--help'], ['throw', '--verbose']])
def test_reader_that_leaves_early_is_no_error(words):
    command = [sys.executable, '-m', 'soft_throw_ros', *words]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE) as process:
        process.stdout.close()
        errors = process.stderr.read().decode()
    assert not re.search('BrokenPipe|Traceback', errors)
    assert process.returncode == 0
