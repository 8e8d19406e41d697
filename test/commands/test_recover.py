# SPDX-License-Identifier: Apache-2.0
"""The command `recover`."""

from pathlib import Path
import subprocess
import sys

from mcap.reader import make_reader
import pytest
from soft_throw_ros.commands import recover
from soft_throw_ros.recording.bag_reader import BagReader
from soft_throw_ros.recording.bag_writer import BagWriter
from soft_throw_ros.recording.message import Channel, Message

ROOT = Path(__file__).parents[2]
CHANNELS = [
    Channel(topic=topic, type='std_msgs/msg/String', schema='string data')
    for topic in ('/a', '/longer')
]


@pytest.fixture
def bag(tmp_path):
    """Write a bag of three chunks."""
    with BagWriter(tmp_path / 'run', distribution='jazzy', compression='none') as writer:
        for number in range(300):
            writer.write(Message(CHANNELS[number % 3 == 2], b'x' * 50, number, number, number))
            if number % 100 == 99:
                writer.flush()
    return tmp_path / 'run'


def run(capsys, *args):
    """Run the command; return its exit code and what it printed."""
    code = recover.main([str(arg) for arg in args])
    out, err = capsys.readouterr()
    assert err == ''
    return code, out


def refused(capsys, *args):
    """Run the command, which refuses something; return what it says."""
    with pytest.raises(SystemExit) as end:
        recover.main([str(arg) for arg in args])
    assert end.value.code == 2
    out, err = capsys.readouterr()
    assert out == ''
    usage, message = err.splitlines()
    assert usage.startswith('usage: ')
    return message.partition('error: ')[2]


def all_of(target):
    """Return what is said of such a bag when nothing is lost."""
    return f'{target}: 300 messages recovered\n  /a               200\n  /longer          100\n'


def damage(bag, chunk):
    """Damage a chunk of a bag; return where it is, and how long."""
    (path,) = bag.glob('*.mcap')
    with path.open('rb') as file:
        index = make_reader(file).get_summary().chunk_indexes[chunk]
    data = bytearray(path.read_bytes())
    data[index.chunk_start_offset + index.chunk_length - 1] ^= 1
    path.write_bytes(data)
    return index.chunk_start_offset, index.chunk_length


def test_bag_that_lacks_only_its_end_is_recovered_as_a_whole(capsys, bag):
    (path,) = bag.glob('*.mcap')
    path.write_bytes(path.read_bytes()[:-37])  # footer
    code, out = run(capsys, bag)
    assert code == 0
    assert out == all_of(f'{bag}_recovered')
    with BagReader(f'{bag}_recovered') as recovered:
        assert recovered.message_count == 300
        assert recovered.damage == ''


def test_what_is_lost_is_told_by_place_number_and_exit_code(capsys, bag, tmp_path):
    offset, size = damage(bag, 1)
    code, out = run(capsys, bag, '--to', tmp_path / 'out/whole')
    assert code == 1
    first, *_, skipped, gap = out.splitlines()
    assert first == f'{tmp_path}/out/whole: 200 messages recovered'
    assert skipped == f'{size} bytes skipped, in 1 place:'
    assert gap == (
        f'  {bag}/run_0.mcap: {size} bytes at {offset}: the checksum of the chunk there is wrong '
        '(100 messages)'
    )


def test_many_places_are_summed_up(capsys, tmp_path):
    with BagWriter(tmp_path / 'run', distribution='', compression='none') as writer:
        for number in range(30):
            writer.write(Message(CHANNELS[0], b'x' * 50, number, number, number))
            writer.flush()
    sizes = [damage(tmp_path / 'run', chunk)[1] for chunk in range(0, 30, 2)]
    code, out = run(capsys, tmp_path / 'run')
    assert code == 1
    assert '15 messages recovered' in out
    assert f'{sum(sizes)} bytes skipped, in 15 places:' in out
    assert out.count('checksum') == 10
    assert out.endswith('  and 5 more\n')


def test_single_file_is_recovered_beside_itself(capsys, bag, tmp_path):
    path = (bag / 'run_0.mcap').rename(tmp_path / 'alone.mcap')
    code, out = run(capsys, path)
    assert code == 0
    assert out.startswith(f'{tmp_path}/alone_recovered: 300 messages')


def test_folder_may_be_the_one_we_are_in(capsys, bag, monkeypatch):
    monkeypatch.chdir(bag)
    assert run(capsys, '.') == (0, all_of(f'{bag}_recovered'))


def test_what_cannot_be_done_is_one_line(capsys, bag, tmp_path):
    assert refused(capsys, tmp_path / 'missing') == (
        f'{tmp_path}/missing: No such file or directory'
    )
    (tmp_path / 'text').write_text('hello')
    assert 'text' in refused(capsys, tmp_path / 'text')
    assert refused(capsys, bag, '--to', tmp_path) == (
        f'{tmp_path} exists, and a bag is never overwritten'
    )
    for chunk in range(3):
        damage(bag, chunk)
    assert refused(capsys, bag).endswith('; there is no message to recover')
    assert not Path(f'{bag}_recovered').exists()
    with BagWriter(tmp_path / 'live', distribution=''):
        assert 'live is being written' in refused(capsys, tmp_path / 'live')
    with BagWriter(tmp_path / 'empty', distribution=''):
        pass
    assert refused(capsys, tmp_path / 'empty') == (
        f'{tmp_path}/empty; there is no message to recover'
    )


def test_it_runs_as_a_program(bag):
    program = 'from soft_throw_ros.commands.recover import main; import sys; sys.exit(main())'
    done = subprocess.run(
        [sys.executable, '-c', program, str(bag)],
        capture_output=True,
        check=False,
        cwd=ROOT,
        text=True,
        timeout=60,
    )
    assert (done.returncode, done.stdout) == (0, all_of(f'{bag}_recovered'))
