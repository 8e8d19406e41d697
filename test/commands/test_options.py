# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Options of a rig, and the executors of a sweep: this process, workers, a Dask cluster."""

import argparse
import os
from pathlib import Path
import re
import signal
import subprocess
import sys

import pytest
from soft_throw_ros.commands import (
    design,
    free_layers,
    identify,
    options,
    output,
    throw,
    track,
)
from soft_throw_ros.commands.options import (
    add_executor_options,
    add_rig_options,
    open_executor,
    read_settings,
    stated_parameters,
)
from soft_throw_ros.configuration import TWIN

COMMAND = (design.main,)

ROOT = Path(__file__).parents[2]

CLUSTER = """
import filecmp
import sys

from distributed import LocalCluster
from soft_throw_ros.commands.design import main

if __name__ == '__main__':
    with LocalCluster(
        n_workers=2, threads_per_worker=1, host='127.0.0.1', dashboard_address=None
    ) as cluster:
        words = ['map', 'x=0.6:0.9:40', 'C=2:8:40', '--release', 'last', '--output']
        assert main([*words, 'here.nc']) == 0
        assert main([*words, 'there.nc', '--dask', cluster.scheduler_address]) == 0
    assert filecmp.cmp('here.nc', 'there.nc', shallow=False)
"""


def open_with(*args):
    parser = argparse.ArgumentParser()
    add_executor_options(parser)
    return open_executor(parser.parse_args(args))


@pytest.mark.parametrize(
    ('main', 'words'),
    [
        *((design.main, [task]) for task in design.TASKS),
        *((main, []) for main in (throw.main, identify.main, free_layers.main, track.main)),
    ],
)
def test_commands_have_few_options(capsys, main, words):
    with pytest.raises(SystemExit):
        main([*words, '--help'])
    shown = re.findall(r'^  (-\S+)', capsys.readouterr().out, re.MULTILINE)
    assert '-h,' in shown
    assert len(shown) - 1 <= 16


def test_named_parameter_is_set_like_an_option():
    parser = argparse.ArgumentParser()
    add_rig_options(parser, ['layer.thickness'])
    words = ['--thickness=0.01', '-p', 'layer.density:=1.1e3', '-p',
             'recommendation.frequencies:=[50, 7e1]', '-p', 'layer.thickness:=0.012']
    settings = read_settings(parser.parse_args(words))
    assert settings['layer.thickness'] == 0.012
    assert settings['layer.density'] == 1100.0
    assert settings['recommendation.frequencies'] == (50.0, 70.0)


LAYER = set(TWIN.names_in('layer'))


@pytest.mark.parametrize(
    ('words', 'text', 'stated'),
    [
        ((), '', set()),
        (('-p', 'layer.density:=900'), '', {'layer.density'}),
        (('--mass', '0.002'), '', {'projectile.mass'}),
        (('--layer', 'gelatin_16.8mm'), '', LAYER),
        (('--stack', '8e-3 7 1000'), '', LAYER),
        (('--layer', 'custom'), '', {'layer.name'}),
        ((), 'layer: {name: gelatin_16.8mm}', LAYER),
        (('-p', 'gravity:=0'), 'projectile: {mass: 0.002}', {'projectile.mass', 'gravity'}),
    ],
)
def test_options_and_file_state_parameters(write, words, text, stated):
    parser = argparse.ArgumentParser()
    add_rig_options(parser)
    if text:
        words += ('--config', str(write(f'twin: {{ros__parameters: {{{text}}}}}')))
    assert stated_parameters(parser.parse_args(words)) == stated


def test_design_without_a_known_task_names_all_tasks_in_one_line(command):
    assert "'mop'" in command.refused('mop')
    assert 'TASK' in command.refused()
    assert command.refused('recommend', '--bogus=1\n2').endswith('--bogus=1 2')


def test_error_is_one_line_with_a_hint_to_the_help_but_without_the_usage(capsys):
    parser = output.CommandParser(prog='throw')
    parser.add_argument('--mass', type=options.positive)

    def run(_):
        raise ValueError('a.csv:3: is bad\nindeed')

    for args, lines in (
        (['--mass', '0'], ['argument --mass: ', '--help']),
        (['--bogus=1\n2'], ['unrecognized arguments: --bogus=1 2', '--help']),
        ([], ['a.csv:3: is bad indeed']),
    ):
        with pytest.raises(SystemExit) as end:
            output.run_command(parser, run, args)
        assert end.value.code == 2
        error, *hint = capsys.readouterr().err.splitlines()
        assert error.startswith(f'throw: error: {lines[0]}')
        assert len(hint) == len(lines) - 1
        assert all(text in line for text, line in zip(lines[1:], hint, strict=True))


@pytest.mark.parametrize(
    ('text', 'value'),
    [('1', 1.0), ('2e-3', 2e-3), ('1_000', None), ('\u0661', None), ('x', None)],
)
def test_numbers_are_those_of_the_parameter_table(text, value):
    if value is None:
        with pytest.raises(argparse.ArgumentTypeError, match=text):
            options.any_number(text)
    else:
        assert options.any_number(text) == options.positive(text) == value


def test_workers_are_processes_that_ignore_ctrl_c():
    with open_with() as executor:
        assert executor is None
    with open_with('--workers', '2') as executor:
        blocked = executor.submit(signal.pthread_sigmask, signal.SIG_BLOCK, []).result()
    assert signal.SIGINT in blocked
    assert signal.SIGINT not in signal.pthread_sigmask(signal.SIG_BLOCK, [])


@pytest.mark.parametrize('count', ['0', '1.5', 'many', '\u0665'])
def test_bad_number_of_workers_is_quoted(capsys, count):
    with pytest.raises(SystemExit):
        open_with(f'--workers={count}')
    assert f'a whole number of 1 or more, got {count!r}' in capsys.readouterr().err


@pytest.mark.slow
def test_map_by_a_dask_cluster_is_equal(tmp_path):
    # A separate process, because a cluster leaves threads and warnings behind
    pytest.importorskip('distributed', reason='comes with the extra [dask]')
    script = tmp_path / 'cluster.py'
    script.write_text(CLUSTER)
    done = subprocess.run(
        [sys.executable, str(script)],
        env=os.environ | {'PYTHONPATH': str(ROOT)},
        cwd=tmp_path,
        capture_output=True,
        check=False,
        text=True,
        timeout=100,
    )
    assert done.returncode == 0, done.stdout + done.stderr
