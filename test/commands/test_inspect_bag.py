# SPDX-License-Identifier: Apache-2.0
"""The command `inspect`: bags whole and damaged, and streams whose viewers come, go and hang."""

from __future__ import annotations

from collections.abc import Callable, Iterator
import contextlib
import os
from pathlib import Path
import runpy
import signal
import subprocess
import sys
import threading
import time
from typing import Any
import warnings

from hypothesis import given, HealthCheck, settings
from hypothesis import strategies as st
import numpy as np
import pytest
from soft_throw_ros import recording
from soft_throw_ros.commands import inspect_bag
from soft_throw_ros.recording.bag import BagWriter, StreamWriter
from soft_throw_ros.recording.message import Channel, Message
from soft_throw_ros.recording.rerun_canvas import THROW_TIME
from soft_throw_ros.recording.viewer import free_port, NoGraphicsError, url_of, Viewer

pytest.importorskip('rerun')

from rerun.chunk import RrdReader
from rerun.experimental import ViewerClient

ROOT = Path(__file__).parents[2]

TwinMessages: Any = runpy.run_path(str(ROOT / 'test' / 'recording' / 'twin_messages.py'))[
    'TwinMessages'
]

TIMEOUT = 60.0
"""Longest wait for another process; reached only when something is wrong. [s]"""


@pytest.fixture(scope='module')
def twin() -> Any:
    """A throw and a bit."""
    return TwinMessages(throw__period=0.2).go(300)


@pytest.fixture(scope='module')
def two_throws(tmp_path_factory) -> tuple[Any, Path]:
    twin = TwinMessages(throw__period=0.2).go(500)
    return twin, write(tmp_path_factory.mktemp('bags') / 'bag', twin.messages)


@pytest.fixture(scope='module')
def bag(twin, tmp_path_factory) -> Path:
    return write(tmp_path_factory.mktemp('bags') / 'bag', twin.messages)


def write(folder: Path, messages: list[Message]) -> Path:
    with BagWriter(folder, distribution='jazzy') as writer:
        for place, message in enumerate(sorted(messages, key=lambda each: each.log_time)):
            writer.write(message)
            if place % 100 == 0:
                writer.flush()
    return folder


def run(capsys, *args: Any) -> tuple[int, list[str]]:
    """Run the command; return its exit code, and the lines that it says."""
    try:
        code: Any = inspect_bag.main([str(arg) for arg in args])
    except SystemExit as end:
        code = end.code
    out, err = capsys.readouterr()
    assert out == ''
    return code, [line for line in err.splitlines() if 'for compiling' not in line]


def rows(path: Path) -> dict[str, int]:
    """Count the rows of each entity in a recording."""
    counts: dict[str, int] = {}
    with warnings.catch_warnings():
        warnings.filterwarnings('ignore', 'RRD file has no footer')  # of a stream, as it grows
        reader = RrdReader(path)
    for chunk in reader.stream():
        counts[chunk.entity_path] = counts.get(chunk.entity_path, 0) + chunk.num_rows
    return counts


# bags


def test_bag_becomes_a_recording(capsys, bag, tmp_path) -> None:
    path = tmp_path / 'scene.rrd'
    assert run(capsys, bag, '--save', path) == (0, [])
    counts = rows(path)
    assert counts['/twin/position'] == 300 + 1  # and its style
    assert counts['/twin/recommendation'] == 1
    assert RrdReader(path).recordings()[0].application_id == 'soft_throw_ros'


def test_bag_becomes_a_picture_of_the_size_asked_for(capsys, bag, tmp_path) -> None:
    image = pytest.importorskip('PIL.Image')
    path = tmp_path / 'scene.png'
    code, lines = run(capsys, bag, '--screenshot', path, '--size', '800x600')
    if lines and 'mesa-vulkan-drivers' in lines[0]:
        pytest.skip(lines[0])
    assert (code, lines) == (0, [])
    with image.open(path) as picture:
        assert picture.size == (800, 600)
        assert len(np.unique(np.asarray(picture.convert('RGB')).reshape(-1, 3), axis=0)) > 500


def test_picture_without_graphics_says_what_to_install(capsys, bag, tmp_path, monkeypatch) -> None:
    for name in ('VK_DRIVER_FILES', 'VK_ICD_FILENAMES'):
        monkeypatch.setenv(name, '/nowhere')
    code, (line,) = run(capsys, bag, '--screenshot', tmp_path / 'scene.png')
    assert code == 1
    assert 'mesa-vulkan-drivers' in line


def test_bag_is_sent_to_a_viewer_that_is_there_and_shown_at_its_throw(capsys, bag, twin) -> None:
    with viewer_at(free_port()) as viewer:
        code, lines = run(capsys, bag, '--port', viewer.port)
        (shown,) = viewer.client().get_state().recordings
    assert (code, lines) == (0, [])
    assert shown.current_timeline == 'time since throw'
    assert 4_000_000 < (shown.current_time or 0) < 7_000_000


@pytest.mark.parametrize(
    ('options', 'start', 'milliseconds'),
    [([], 400, 5.35), (['--throw', '1'], 200, 5.35), (['--throw=1', '--at=0.002'], 200, 2.0)],
)
def test_throw_and_time_to_show_can_be_chosen(
    capsys, two_throws, tmp_path, options, start, milliseconds
) -> None:
    twin, bag = two_throws
    with viewer_at(free_port()) as viewer:
        assert run(capsys, bag, '--port', viewer.port, *options) == (0, [])
        (shown,) = viewer.client().get_state().recordings
    assert (shown.current_time or 0) / 1e6 == pytest.approx(milliseconds, abs=0.01)
    path = tmp_path / 'scene.rrd'
    assert run(capsys, bag, '--save', path, *options) == (0, [])
    origins = {
        int(stamp) - int(since)
        for chunk in RrdReader(path).stream()
        if chunk.entity_path == '/twin/position' and not chunk.is_static
        for batch in [chunk.to_record_batch()]
        for stamp, since in zip(
            *(batch.column(name).cast('int64').to_pylist() for name in ('stamp', THROW_TIME)),
            strict=True,
        )
    }
    assert max(abs(origin - twin.pace.deadline(start)) for origin in origins) <= 1


def test_throw_that_is_not_there_is_refused(capsys, bag, tmp_path) -> None:
    code, (line,) = run(capsys, bag, '--throw', '7', '--save', tmp_path / 'scene.rrd')
    assert code == 2
    assert 'no throw 7' in line


def test_bag_without_screen_and_viewer_says_what_to_do(capsys, bag, monkeypatch) -> None:
    for name in ('DISPLAY', 'WAYLAND_DISPLAY', 'WAYLAND_SOCKET'):
        monkeypatch.delenv(name, raising=False)
    port = free_port()
    code, (line,) = run(capsys, bag, '--port', port)
    assert code == 1
    assert '--screenshot' in line
    assert str(port) in line


def test_without_rerun_it_says_how_to_get_it(capsys, bag, monkeypatch) -> None:
    monkeypatch.setitem(sys.modules, 'rerun', None)
    for name in ('rerun_canvas', 'rerun_view'):
        monkeypatch.delitem(sys.modules, f'soft_throw_ros.recording.{name}', raising=False)
        monkeypatch.delattr(recording, name, raising=False)
    code, (line,) = run(capsys, bag, '--save', 'scene.rrd')
    assert code == 1
    assert 'soft_throw_ros[rerun]' in line


def test_it_runs_without_ros() -> None:
    code = (
        'import sys; import soft_throw_ros.recording.rerun_view; '
        'import soft_throw_ros.commands.inspect_bag; '
        'print([name for name in sys.modules if name.split(".")[0] in ("rclpy", "std_msgs")])'
    )
    done = subprocess.run(
        [sys.executable, '-c', code], cwd=ROOT, capture_output=True, text=True, check=True
    )
    assert done.stdout == '[]\n'


@pytest.mark.parametrize(
    ('content', 'words'),
    [
        (None, 'no such file'),
        (b'', 'is empty'),
        (b'some text', 'no mcap file'),
        (b'SQLite format 3\0' + bytes(100), 'sqlite3'),
    ],
)
def test_what_is_no_bag_is_refused_in_one_line(capsys, tmp_path, content, words) -> None:
    path = tmp_path / 'bag.mcap'
    if content is not None:
        path.write_bytes(content)
    code, (line,) = run(capsys, path, '--save', tmp_path / 'scene.rrd')
    assert code == 2
    assert line.startswith(f'inspect: {path}')
    assert words in line.lower()
    assert not (tmp_path / 'scene.rrd').exists()


def test_bag_of_something_else_is_refused_with_its_topics(capsys, tmp_path) -> None:
    channel = Channel(topic='/scan', type='sensor_msgs/msg/LaserScan', schema='float32 x')
    path = write(tmp_path / 'bag', [Message(channel, b'\0\1\0\0\0\0\0\0', 5, 5)])
    code, (line,) = run(capsys, path, '--save', tmp_path / 'scene.rrd')
    assert code == 2
    assert '/scan' in line


def test_what_is_there_of_a_bag_is_shown_and_the_rest_is_named(capsys, bag, tmp_path) -> None:
    whole = (bag / 'bag_0.mcap').read_bytes()
    path, scene = tmp_path / 'cut.mcap', tmp_path / 'scene.rrd'
    path.write_bytes(whole[: len(whole) // 2])
    code, (line,) = run(capsys, path, '--save', scene)
    assert code == 0
    assert str(path) in line
    assert line.endswith('what there is is shown')
    assert 0 < rows(scene)['/twin/position'] < 300


def test_messages_that_cannot_be_read_are_counted(capsys, twin, tmp_path) -> None:
    messages = [
        message._replace(data=message.data[:7])
        if message.channel.topic.endswith('phase')
        else message
        for message in twin.messages
    ]
    lost = sum(message.channel.topic.endswith('phase') for message in messages)
    bag = write(tmp_path / 'bag', messages)
    code, (line,) = run(capsys, bag, '--save', tmp_path / 'scene.rrd')
    assert code == 0
    assert f'{lost} messages are left out, /twin/phase: ' in line


@pytest.fixture(scope='module')
def small(twin, tmp_path_factory) -> bytes:
    """A bag with something of everything."""
    some = [message for message in twin.messages if message.channel.topic != '/twin/joint_states']
    some = [*twin.messages[:20], *some[-12:]]
    folder = write(tmp_path_factory.mktemp('bags') / 'small', some)
    return (folder / 'small_0.mcap').read_bytes()


@settings(max_examples=200, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(st.data())
def test_damaged_bags_are_shown_in_part_or_refused(capsys, small, tmp_path, data) -> None:
    damaged = bytearray(small)
    for _ in range(data.draw(st.integers(0, 4))):
        damaged[data.draw(st.integers(0, len(damaged) - 1))] ^= 1 << data.draw(st.integers(0, 7))
    begin = data.draw(st.integers(0, len(damaged)) | st.just(0) | st.just(0))
    end = data.draw(st.integers(begin, len(damaged)) | st.just(len(damaged)))
    path = tmp_path / 'damaged.mcap'
    path.write_bytes(damaged[begin:end])
    code, lines = run(capsys, path, '--save', tmp_path / 'scene.rrd')
    assert code in (0, 2)
    assert len(lines) <= 2
    assert all(line.startswith('inspect: ') for line in lines)
    if damaged[begin:end] == small:
        assert (code, lines) == (0, [])


@pytest.mark.parametrize(
    ('args', 'words'),
    [
        (['--size', '10x10'], '200 to 8000'),
        (['--size', 'large'], "'large'"),
        (['--port', '80'], "'80'"),
        (['--port', 'x'], "'x'"),
        (['--save', '/nowhere/a.rrd'], 'no folder /nowhere'),
        (['--save', 'a.rrd', '--screenshot', 'a.png'], 'not allowed'),
        (['--sink', 'printer'], "'printer'"),
        (['--throw', 'last'], "'last'"),
        (['--at', 'nan'], "'nan'"),
    ],
)
def test_arguments_are_refused_in_words(capsys, bag, args, words) -> None:
    code, lines = run(capsys, bag, *args)
    assert code == 2
    assert words in lines[-1]


@pytest.mark.parametrize('option', ['--screenshot=a.png', '--throw=1', '--at=0.1'])
def test_options_of_bags_are_refused_for_streams(capsys, option) -> None:
    code, lines = run(capsys, '-', option)
    assert code == 2
    assert 'needs a bag' in lines[-1]


def test_file_that_cannot_be_written_is_named(capsys, bag, tmp_path) -> None:
    code, (line,) = run(capsys, bag, '--save', tmp_path)
    assert code == 2
    assert str(tmp_path) in line


def test_port_that_is_taken_is_named(capsys, bag) -> None:
    with viewer_at(free_port()) as viewer:
        code, (line,) = run(capsys, bag, '--sink', 'serve', '--port', viewer.port)
    assert code == 2
    assert f'127.0.0.1:{viewer.port}' in line


# streams


class Process:
    """`inspect -`, what it is fed, and what it says."""

    def __init__(self, *args: Any) -> None:
        code = 'import sys; from soft_throw_ros.commands.inspect_bag import main; sys.exit(main())'
        environment = {
            name: value
            for name, value in os.environ.items()
            if name not in ('DISPLAY', 'WAYLAND_DISPLAY', 'WAYLAND_SOCKET')
        }
        self.process = subprocess.Popen(
            [sys.executable, '-c', code, '-', *map(str, args)],
            cwd=ROOT,
            env=environment,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=False,
        )
        assert self.process.stdin is not None
        self.pipe = self.process.stdin
        self.lines: list[str] = []
        self._writer = StreamWriter()
        self._thread = threading.Thread(target=self._listen, daemon=True)
        self._thread.start()
        self.pipe.write(self._writer.start())

    def _listen(self) -> None:
        assert self.process.stderr is not None
        for line in self.process.stderr:
            self.lines.append(line.decode().rstrip())

    def feed(self, messages: list[Message]) -> None:
        for message in messages:
            self.pipe.write(self._writer.define(message.channel))
            self.pipe.write(self._writer.block([message]))
        self.pipe.flush()

    def wait_for_line(self, words: str, times: int = 1) -> None:
        wait_until(lambda: sum(words in line for line in self.lines) >= times)

    def end(self) -> int:
        """Close its input; return its exit code."""
        with contextlib.suppress(BrokenPipeError):
            self.pipe.close()
        return self.wait()

    def wait(self) -> int:
        code = self.process.wait(TIMEOUT)
        self._thread.join(TIMEOUT)
        assert self.process.stdout is not None
        assert self.process.stdout.read() == b''
        assert all(line.startswith('inspect: ') for line in self.lines), self.lines
        return code


def wait_until(is_so: Callable[[], bool]) -> None:
    deadline = time.monotonic() + TIMEOUT
    while not is_so():
        assert time.monotonic() < deadline
        time.sleep(0.05)


@contextlib.contextmanager
def viewer_at(port: int, *options: str) -> Iterator[Viewer]:
    """Have a viewer without a window, if this machine can."""
    with Viewer(port, '--headless', *options) as viewer:
        try:
            viewer.client()
        except NoGraphicsError as error:
            pytest.skip(str(error))
        yield viewer


@pytest.fixture
def start() -> Iterator[Callable[..., Process]]:
    processes: list[Process] = []

    def start(*args: Any) -> Process:
        processes.append(Process(*args))
        return processes[-1]

    yield start
    for process in processes:
        if process.process.poll() is None:
            process.process.kill()
        process.process.wait()
        with contextlib.suppress(OSError):
            process.pipe.close()
        assert process.process.stdout is not None
        assert process.process.stderr is not None
        process._thread.join(TIMEOUT)
        process.process.stdout.close()
        process.process.stderr.close()


def test_stream_without_a_viewer_is_read_to_its_end(start, twin) -> None:
    process = start('--port', free_port())
    process.wait_for_line('no viewer at')
    process.feed(twin.messages)
    assert process.end() == 0
    assert len(process.lines) == 1


def test_viewer_that_comes_back_gets_what_still_holds(start, twin) -> None:
    port = free_port()
    process = start('--port', port)
    process.wait_for_line('no viewer at')
    half = len(twin.messages) // 2
    process.feed(twin.messages[:half])
    with viewer_at(port) as viewer:
        process.wait_for_line('connected')
        wait_until(lambda: '/twin/phase' in entities(viewer))
    process.wait_for_line('has gone')
    process.feed(twin.messages[half:])
    with viewer_at(port) as viewer:
        process.wait_for_line('connected', times=2)
        # published once, at the very beginning, or while there was no viewer
        wait_until(lambda: {'/twin/recommendation', '/twin/throw_result'} <= entities(viewer))
        wait_until(lambda: len(views(viewer)) == 11)
        assert process.end() == 0


def entities(viewer: Viewer) -> set[str]:
    client = ViewerClient.connect(url_of(viewer.port))
    if not client.get_state().recordings:
        return set()
    return {entity.entity_path for entity in client.get_recording_schema().entities}


def views(viewer: Viewer) -> list[str]:
    client = ViewerClient.connect(url_of(viewer.port))
    return [view.name for view in client.get_state().views]


@pytest.mark.parametrize('how', ['end', signal.SIGINT, signal.SIGTERM])
def test_stopped_viewer_does_not_hold_up_the_end(start, twin, how) -> None:
    """It takes nothing any more, so that Rerun would wait for it for ever."""
    with viewer_at(free_port()) as viewer:
        process = start('--port', viewer.port)
        process.wait_for_line('connected')
        half = len(twin.messages) // 2
        process.feed(twin.messages[:half])
        wait_until(lambda: '/twin/position' in entities(viewer))
        os.killpg(viewer.pid, signal.SIGSTOP)
        process.feed(twin.messages[half:])
        if how == 'end':
            assert process.end() == 0
        else:
            process.process.send_signal(how)
            assert process.wait() == 0


@pytest.mark.parametrize('number', [signal.SIGINT, signal.SIGTERM])
def test_signal_ends_it_quietly(start, twin, number) -> None:
    process = start('--port', free_port())
    process.wait_for_line('no viewer at')
    process.feed(twin.messages[:100])
    process.process.send_signal(number)
    assert process.wait() == 0
    assert len(process.lines) == 1


def test_stream_becomes_a_recording(start, twin, tmp_path) -> None:
    path = tmp_path / 'scene.rrd'
    process = start('--save', path)
    process.feed(twin.messages)
    assert process.end() == 0
    assert rows(path)['/twin/position'] == 300 + 1
    assert process.lines == []


def test_stream_of_a_whole_bag_becomes_a_whole_recording(bag, tmp_path) -> None:
    """The writer is gone long before all is read."""
    path = tmp_path / 'scene.rrd'
    code = 'import sys; from soft_throw_ros.commands.inspect_bag import main; sys.exit(main())'
    command = [sys.executable, '-c', code, '-', '--save', str(path)]
    with subprocess.Popen(['cat', bag / 'bag_0.mcap'], stdout=subprocess.PIPE) as writer:
        done = subprocess.run(command, stdin=writer.stdout, cwd=ROOT, check=False)
    assert done.returncode == 0
    assert rows(path)['/twin/position'] == 300 + 1


def test_stream_is_served_to_viewers_on_this_machine(start, twin) -> None:
    port = free_port()
    process = start('--sink', 'serve', '--port', port)
    process.wait_for_line(url_of(port))
    process.feed(twin.messages)
    listening = Path('/proc/net/tcp').read_text(encoding='ascii')
    assert f' 0100007F:{port:04X} ' in listening
    assert f' 00000000:{port:04X} ' not in listening + Path('/proc/net/tcp6').read_text()
    url = url_of(port)
    with viewer_at(free_port(), '--connect', url) as viewer:
        wait_until(lambda: '/twin/throw_result' in entities(viewer))
    assert process.end() == 0


@pytest.mark.parametrize('garbage', [b'', b'some text', bytes(1000)])
def test_stream_of_something_else_is_refused(start, garbage) -> None:
    process = start('--port', free_port())
    process._writer.start()
    process.wait_for_line('no viewer at')
    process.pipe.write(b'\x05' + garbage)  # where a record should be
    process.end()
    assert process.process.returncode == 2
    assert 'standard input' in process.lines[-1]


def test_stream_that_is_cut_is_shown_up_to_there(start, twin, tmp_path) -> None:
    path = tmp_path / 'scene.rrd'
    process = start('--save', path)
    process.feed(twin.messages[:100])
    process.pipe.write(b'\x05\xff')
    assert process.end() == 0
    assert 'standard input' in process.lines[-1]
    assert rows(path)['/twin/position'] > 10
