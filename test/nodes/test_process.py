# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Nodes as processes: how they start, refuse, are reached and end."""

import os
from pathlib import Path
import re
import signal
import sys
import threading

import pytest
from soft_throw_ros.nodes import calibrator, process, recorder, rig, twin, viewer

pytestmark = pytest.mark.timeout(300)

INT, TERM, HUP = signal.SIGINT, signal.SIGTERM, signal.SIGHUP
TRANSPORTS = (
    'FASTDDS_BUILTIN_TRANSPORTS',
    'FASTDDS_DEFAULT_PROFILES_FILE',
    'FASTRTPS_DEFAULT_PROFILES_FILE',
)


@pytest.mark.parametrize('line', ['compiling', 'throw 1: released'])
def test_twin_ends_well_by_a_signal_while_it_compiles_and_throws(
    start_node, tmp_path, line
) -> None:
    empty = {'NUMBA_CACHE_DIR': str(tmp_path)} if line == 'compiling' else {}
    node = start_node('twin', 'throw.period:=0.05', env=os.environ | empty)
    node.wait_for(line)
    node.end_well(INT)


def test_twin_that_is_still_being_imported_ends_well_by_a_signal(start) -> None:
    # The first import prints a line and then takes a minute
    telling = (
        'import sys, time, types; import soft_throw_ros.__main__ as umbrella\n'
        "wait = lambda *_: print('importing', flush=True) or time.sleep(60)\n"
        'sys.meta_path.insert(0, types.SimpleNamespace(find_spec=wait))\n'
        "sys.exit(umbrella.main(['twin']))"
    )
    twins = {number: start(sys.executable, '-c', telling) for number in (INT, TERM, HUP)}
    for number, node in twins.items():
        node.wait_for('importing')
        assert node.end(number) == 0
        assert node.lines == ['importing']


NODE = """
import sys, threading
from soft_throw_ros.nodes import process
from std_msgs.msg import String

state = sys.argv[1]
is_computing = threading.Event()

def work():
    if state == 'dying':
        1 / 0
    if state == 'computing':
        import numpy
        from scipy.optimize import linprog
    while state == 'computing':  # mostly without the lock of the interpreter, in C++
        linprog(-numpy.ones(120), numpy.random.rand(120, 120), numpy.ones(120))
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
        threading.Thread(target=work, name='heart', daemon=True).start()
        if state == 'computing':
            is_computing.wait()
        print('started', flush=True)

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


def hosts(pid: int, domain_id: int) -> set[str]:
    """Return the addresses at which a process listens for DDS; senders use other ports."""
    folder, first = Path(f'/proc/{pid}'), 7400 + 250 * domain_id
    inodes = {path.resolve().name[8:-1] for path in (folder / 'fd').iterdir()}  # socket:[1234]
    rows = [line.split() for line in (folder / 'net/udp').read_text().splitlines()[1:]]
    sockets = [row[1].split(':') for row in rows if row[9] in inodes]
    return {host for host, port in sockets if first <= int(port, 16) < first + 250}


@pytest.mark.parametrize(('state', 'number', 'reach', 'host'), [
    ('working', HUP, 'OFF', '0100007F'), ('computing', INT, '', '00000000'),
    ('hanging', TERM, 'LOCALHOST', '0100007F'), ('dying', 0, 'LOCALHOST', ''),
])
def test_node_ends_in_the_documented_order_although_threads_die_and_the_middleware_hangs(
    start, domain_id, state, number, reach, host
) -> None:
    environment = {name: os.environ[name] for name in os.environ if name not in TRANSPORTS}
    environment['ROS_AUTOMATIC_DISCOVERY_RANGE'] = reach
    node = start(sys.executable, '-c', NODE, state, env=environment)
    node.wait_for('started')
    if number:  # 239.255.0.1 is the group for discovery
        assert {host} <= hosts(node.process.pid, domain_id) <= {host, '0100FFEF'}
    assert (node.end(number) if number else node.wait()) == (state == 'dying')
    ends = [line for line in node.lines if line in ('close', 'first', 'second')]
    assert ends == ['close', 'second', 'first']
    assert sum(f'discovery range {reach or "SUBNET"}' in line for line in node.lines) == 1
    deaths = [line for line in node.lines if 'the node ends' in line]
    causes = [re.search("'heart': ZeroDivisionError", line) is not None for line in deaths]
    assert causes == [True] * (state == 'dying')


@pytest.mark.parametrize('chosen', TRANSPORTS)
def test_transport_of_the_user_is_not_changed(monkeypatch, chosen) -> None:
    monkeypatch.setattr(os, 'environ', {chosen: 'theirs'})
    process.use_transport_profile()
    assert os.environ == {chosen: 'theirs'}


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
        (twin, '-p layer.thicknes:=0.01', "no parameter of the twin is named 'layer.thicknes'"),
        (twin, '-p engine.command:=true', "engine.command .* got 'underdamped'"),
        (calibrator, '-p throws:=0', 'got 0'),
        (rig, '-p layer.thickness:=0.0005 -p layer.loss_tangent:=0.1', 'needs 64 cells'),
        (recorder, '-p compression:=gzip', "got 'gzip'"),
        (recorder, '-p name:=../bag', "got '../bag'"),
        (recorder, '-p name:=..', r"got '\.\.'"),
        (recorder, '-p folder:={folder} -p name:=there', "there exists, .* got name 'there'"),
        (viewer, '-p sink:=file', 'file is empty'),
        (viewer, '-p sink:=file -p file:=/nowhere/a.rrd', '/nowhere'),
    ],
)
def test_refused_argument_is_one_line_and_exit_code_2(
    capfd, tmp_path, monkeypatch, node, arguments, words
) -> None:
    monkeypatch.setattr(viewer, 'exit_after', lambda *_: None)
    monkeypatch.setattr(process, '_on_signals', lambda _handler: None)
    monkeypatch.setattr(threading, 'excepthook', threading.excepthook)  # which a node replaces
    file = tmp_path / 'bad.yaml'
    file.write_text('/**: {ros__parameters: {layer: {thickness: 16.8}}}')
    (tmp_path / 'there').mkdir()
    given = arguments.format(file=file, folder=tmp_path).split()
    assert node.main(['--ros-args', *given]) == 2
    assert {path.name for path in tmp_path.iterdir()} == {'bad.yaml', 'there'}
    (line,) = capfd.readouterr().err.splitlines()
    assert line.startswith(f'{node.__name__.rpartition(".")[2]}: ')
    assert re.search(words, line), line
