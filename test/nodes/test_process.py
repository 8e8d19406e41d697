# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Nodes as processes: how they start, refuse and end."""

from __future__ import annotations

import os
import re
import signal
import sys
import threading

import pytest
from soft_throw_ros.nodes import calibrator, recorder, rig, twin, viewer

pytestmark = pytest.mark.timeout(300)

INT, TERM, HUP = signal.SIGINT, signal.SIGTERM, signal.SIGHUP


def test_twin_that_throws_ends_well_by_a_signal(start_node) -> None:
    twin = start_node('twin', 'throw.period:=0.05')
    twin.wait_for('throw 1: released')
    twin.end_well(INT)


def test_twin_that_is_still_compiling_ends_well_by_a_signal(start_node, tmp_path) -> None:
    node = start_node('twin', env=os.environ | {'NUMBA_CACHE_DIR': str(tmp_path)})
    node.wait_for('compiling')
    node.end_well(INT)


def test_twin_that_is_still_being_imported_ends_well_by_a_signal(start) -> None:
    # The first import prints a line and then takes a minute
    telling = (
        'import builtins, sys, time, types; import soft_throw_ros.__main__ as umbrella\n'
        'class Slow:\n'
        '    def find_spec(self, name, *_):\n'
        "        print('importing', flush=True); time.sleep(60)\n"
        'sys.meta_path.insert(0, Slow())\n'
        "sys.exit(umbrella.main(['twin']))"
    )
    twins = {number: start(sys.executable, '-c', telling) for number in (INT, TERM, HUP)}
    for number, process in twins.items():
        process.wait_for('importing')
        assert process.end(number) == 0
        assert process.lines == ['importing']


NODE = """
import sys, threading
import numpy
from soft_throw_ros.nodes import process
from std_msgs.msg import String

state = sys.argv[1]
is_computing = threading.Event()

def compute():  # mostly without the lock of the interpreter, in C++
    from scipy.optimize import linprog
    while True:
        rows = numpy.random.rand(120, 120)
        linprog(-numpy.ones(120), rows, numpy.ones(120))
        is_computing.set()

class Ending(process.RunnableNode):
    def __init__(self, **_):
        super().__init__('ending')
        self.publisher = self.create_publisher(String, '/talk', 1)
        for name in ('first', 'second'):
            self.add_cleanup(self.note, name)

    def note(self, name):
        self.publisher.publish(String())  # an error without the publisher
        print(name, flush=True)

    def start(self):
        if state == 'computing':
            threading.Thread(target=compute, daemon=True).start()
            is_computing.wait()
        print('started', flush=True)
        if state == 'dying':
            thread = threading.Thread(target=lambda: 1 / 0, name='heart')
            thread.start()
            thread.join()

    def close(self):
        self.note('close')

    def destroy_node(self):
        super().destroy_node()
        if state == 'hanging':
            threading.Event().wait()
        late = threading.Thread(target=lambda: self.create_publisher(None, '', 0))
        late.start()  # it fails without a word
        late.join()

sys.exit(process.run('ending', Ending, []))
"""


@pytest.mark.parametrize(('state', 'number'), [
    ('working', HUP), ('computing', INT), ('hanging', TERM), ('dying', 0),
])
def test_node_ends_in_the_documented_order_although_threads_die_and_the_middleware_hangs(
    start, state, number
) -> None:
    node = start(sys.executable, '-c', NODE, state)
    node.wait_for('started')
    code = node.end(number) if number else node.wait()
    assert code == (state == 'dying')
    ends = [line for line in node.lines if line in ('close', 'first', 'second')]
    assert ends == ['close', 'second', 'first']
    assert sum('discovery range LOCALHOST' in line for line in node.lines) == 1
    deaths = [line for line in node.lines if 'the node ends' in line]
    assert len(deaths) == (state == 'dying')
    assert all("'heart'" in line and 'ZeroDivisionError' in line for line in deaths)


BAD_FILE = """/**:
  ros__parameters:
    layer:
      thickness: 16.8
"""


@pytest.fixture
def in_process(monkeypatch):
    """Restore the handlers of signals and exceptions that a node leaves."""
    handlers = {number: signal.getsignal(number) for number in (INT, TERM, HUP)}
    monkeypatch.setattr(threading, 'excepthook', threading.excepthook)
    yield
    for number, handler in handlers.items():
        signal.signal(number, handler)


@pytest.mark.usefixtures('in_process')
@pytest.mark.parametrize(
    ('node', 'arguments', 'words'),
    [
        (twin, '-p foo', '-p foo'),
        (twin, '--params-file {file}', 'bad.yaml: layer.thickness .* got 16.8'),
        (twin, '--params-file {file}.missing', 'bad.yaml.missing'),
        (twin, '-r __node:=no-name', 'no-name'),
        (twin, '-- --thickness 3', 'no such argument: --thickness 3; usage: twin'),
        (twin, '-p use_sim_time:=maybe', 'maybe'),
        (twin, '-p layer.thickness:=nan', '-p layer.thickness:=nan: .* got nan'),
        (twin, '-p layer.thickness:=soft', "got 'soft'"),
        (twin, '-p layer.thicknes:=0.01', "no parameter of the twin is named 'layer.thicknes'"),
        (twin, '-p recommended.thickness:=0.01', 'set by the twin'),
        (twin, '-p engine.command:=true', "engine.command .* got 'underdamped'"),
        (rig, '-p noise:=-1.0', 'got -1.0'),
        (calibrator, '-p throws:=0', 'got 0'),
        (rig, '-p layer.thickness:=0.1 -p layer.wave_speed:=1. -p engine.frequency:=1e3', '1000'),
        (recorder, '-p compression:=gzip', "got 'gzip'"),
        (recorder, '-p name:=../bag', "got '../bag'"),
        (recorder, '-p name:=/tmp/bag', "got '/tmp/bag'"),
        (recorder, '-p name:=..', r"got '\.\.'"),
        (recorder, '-p folder:={folder} -p name:=there', "there exists, .* got name 'there'"),
        (viewer, '-p sink:=file', 'file is empty'),
        (viewer, '-p sink:=file -p file:=/nowhere/a.rrd', '/nowhere'),
        (viewer, '-p sink:=printer', "got 'printer'"),
    ],
)
def test_refused_argument_is_one_line_and_exit_code_2(
    capfd, tmp_path, monkeypatch, node, arguments, words
) -> None:
    monkeypatch.setattr(viewer, 'exit_after', lambda *_: None)
    file = tmp_path / 'bad.yaml'
    file.write_text(BAD_FILE)
    (tmp_path / 'there').mkdir()
    given = arguments.format(file=file, folder=tmp_path).split()
    assert node.main(['--ros-args', *given]) == 2
    assert {path.name for path in tmp_path.iterdir()} == {'bad.yaml', 'there'}
    (line,) = capfd.readouterr().err.splitlines()
    assert line.startswith(f'{node.__name__.rpartition(".")[2]}: ')
    assert re.search(words, line), line
