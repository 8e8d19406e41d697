# SPDX-License-Identifier: Apache-2.0
"""The command `design`, and the options of a rig."""

import argparse
import re
import sys
import types

import pytest
from soft_throw_ros.commands import design
from soft_throw_ros.commands.options import add_rig_options, OPTIONS, read_settings
from soft_throw_ros.configuration import LAYERS, ParameterError, TWIN


@pytest.fixture
def echo(monkeypatch):
    """Offer a task `echo` that adds an option and returns it as its exit code."""

    def add_arguments(parser):
        parser.add_argument('--code', type=int, default=0)

    def run(arguments):
        if arguments.code < 0:
            raise ValueError(f'code must not be negative, got {arguments.code}')
        return arguments.code

    task = types.SimpleNamespace(add_arguments=add_arguments, run=run)
    monkeypatch.setitem(sys.modules, 'echo_task', task)
    monkeypatch.setitem(design.TASKS, 'echo', ('echo_task', 'say it again'))


def refused(capsys, *args):
    with pytest.raises(SystemExit) as end:
        design.main(list(args))
    assert end.value.code == 2
    return capsys.readouterr().err.splitlines()[-1]


def read(*args):
    parser = argparse.ArgumentParser()
    add_rig_options(parser)
    return read_settings(parser.parse_args(list(args)))


def test_task_gets_its_options_and_gives_the_exit_code(echo):
    assert design.main(['echo', '--code', '5']) == 5
    assert design.main(['echo']) == 0


def test_refusals_are_one_line(capsys, echo):
    assert refused(capsys, 'echo', '--code', '-1').endswith('code must not be negative, got -1')
    assert "'mop'" in refused(capsys, 'mop')
    assert 'TASK' in refused(capsys)
    assert 'unrecognized arguments: --cod' in refused(capsys, 'echo', '--cod', '1')


def test_help_lists_every_task(capsys):
    with pytest.raises(SystemExit) as end:
        design.main(['--help'])
    assert end.value.code == 0
    shown = capsys.readouterr().out
    assert all(re.search(rf'^ +{name}\b', shown, re.MULTILINE) for name in design.TASKS)


def test_every_parameter_of_the_rig_is_an_option(capsys):
    of_rig = {entry.name for entry in TWIN.entries if entry.is_of_rig} - {'model'}
    assert OPTIONS.keys() == of_rig
    assert len(set(OPTIONS.values())) == len(OPTIONS)
    assert read() == TWIN.defaults()


def test_options_replace_what_the_file_says(tmp_path):
    path = tmp_path / 'rig.yaml'
    path.write_text('twin: {ros__parameters: {gravity: 0.0, layer.name: gelatin_2.0mm}}')
    settings = read('--config', str(path), '--frequency', '31.1')
    assert settings['gravity'] == 0.0
    assert settings['engine.frequency'] == 31.1
    assert settings['layer.thickness'] == LAYERS['gelatin_2.0mm']['layer.thickness']


@pytest.mark.parametrize(
    ('args', 'message'),
    [
        (['--thickness', '16.8'], 'argument --thickness: layer.thickness .* m, got 16.8'),
        (['--mass', 'heavy'], "argument --mass: .* got 'heavy'"),
        (['--layer', 'jelly'], "argument --layer: .* got 'jelly'"),
        (['--config', 'no_such.yaml'], 'no_such.yaml: No such file'),
    ],
)
def test_bad_option_is_named_and_quoted(args, message):
    with pytest.raises(ParameterError, match=message):
        read(*args)
