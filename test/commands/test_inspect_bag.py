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
from test.recording.conftest import TIMEOUT, wait_until
import threading
from typing import Any

from bags import write
import pytest
from soft_throw_ros import recording
from soft_throw_ros.commands import inspect_bag
from soft_throw_ros.recording.live_stream import StreamWriter
from soft_throw_ros.recording.message import Channel, Message
from soft_throw_ros.recording.viewer import find_viewer, free_port, NoGraphicsError, url_of, Viewer

pytest.importorskip('rerun')

from test.recording.recordings import Recording  # noqa: E402, I100

from rerun.experimental import ViewerClient  # noqa: E402
from soft_throw_ros.recording.rerun_canvas import STAMP, THROW_TIME  # noqa: E402

ROOT = Path(__file__).parents[2]

TwinMessages: Any = runpy.run_path(str(ROOT / 'test' / 'recording' / 'twin_messages.py'))[
    'TwinMessages'
]

INSPECT = 'import sys; from soft_throw_ros.commands.inspect_bag import main; sys.exit(main())'


@pytest.fixture(scope='module')
def twin() -> Any:
    """Two throws and a bit."""
    return TwinMessages(throw__period=0.2).go(500)


@pytest.fixture(scope='module')
def bag(twin, tmp_path_factory) -> Path:
    messages = sorted(twin.messages, key=lambda each: each.log_time)
    return write(tmp_path_factory.mktemp('bags') / 'bag', messages, chunk=100)


def run(capsys, *args: Any) -> tuple[int, list[str]]:
    """Run the command; return its exit code, and the lines that it says."""
    try:
        code: Any = inspect_bag.main([str(arg) for arg in args])
    except SystemExit as end:
        code = end.code
    out, err = capsys.readouterr()
    assert out == ''
    return code, [line for line in err.splitlines() if 'compiles' not in line]


def rows(path: Path) -> dict[str, int]:
    """Count the rows of each entity in a recording, less those of its style."""
    return Recording(path).rows


@contextlib.contextmanager
def viewer_at(port: int, *options: str) -> Iterator[Viewer]:
    """Have a viewer without a window, if this machine can."""
    with Viewer(port, '--headless', *options) as viewer:
        try:
            viewer.client()
        except NoGraphicsError as error:
            pytest.skip(str(error))
        yield viewer


def entities(viewer: Viewer) -> set[str]:
    client = ViewerClient.connect(url_of(viewer.port))
    if not client.get_state().recordings:
        return set()
    return {entity.entity_path for entity in client.get_recording_schema().entities}


# bags


def test_bag_becomes_a_picture_of_the_size_asked_for(capsys, bag, tmp_path) -> None:
    image = pytest.importorskip('PIL.Image')
    path = tmp_path / 'scene.png'
    code, lines = run(capsys, bag, '--screenshot', path, '--size', '800x600')
    if lines and 'mesa-vulkan-drivers' in lines[0]:
        pytest.skip(lines[0])
    assert (code, lines) == (0, [])
    with image.open(path) as picture:
        assert picture.size == (800, 600)


@pytest.mark.parametrize('how', ['SIGINT', 'SIGHUP', 'SIGKILL'])
def test_killed_screenshot_leaves_no_viewer_behind(bag, tmp_path, how) -> None:
    command = [sys.executable, '-c', INSPECT, bag, '--screenshot', tmp_path / 'scene.png']
    with subprocess.Popen(command, cwd=ROOT, stderr=subprocess.DEVNULL) as process:
        try:
            wait_until(lambda: viewers_of(process.pid) != [])
            (viewer,) = viewers_of(process.pid)
        finally:
            process.send_signal(getattr(signal, how))
    wait_until(lambda: not Path(f'/proc/{viewer}').exists())
    assert not (tmp_path / 'scene.png').exists()


def viewers_of(pid: int) -> list[int]:
    """Return the children of a process that are the program of Rerun."""
    children = Path(f'/proc/{pid}/task').glob('*/children')
    found = [int(child) for path in children for child in path.read_text().split()]
    return [each for each in found if Path(f'/proc/{each}/comm').read_text().strip() == 'rerun']


@pytest.mark.parametrize(
    ('options', 'start', 'milliseconds'),
    [([], 400, 5.353), (['--throw=1', '--at=0.002'], 200, 2.0)],
)
def test_throw_and_time_to_show_can_be_chosen(
    capsys, twin, bag, tmp_path, options, start, milliseconds
) -> None:
    with viewer_at(free_port()) as viewer:
        assert run(capsys, bag, '--port', viewer.port, *options) == (0, [])
        (shown,) = viewer.client().get_state().recordings
    assert shown.current_timeline == THROW_TIME
    assert (shown.current_time or 0) / 1e6 == pytest.approx(milliseconds, abs=0.01)
    path = tmp_path / 'scene.rrd'
    assert run(capsys, bag, '--save', path, *options) == (0, [])
    entity = '/twin/position', 'Scalars:scalars'
    (stamps, _), (times, _) = (
        Recording(path).series(*entity, name) for name in (STAMP, THROW_TIME)
    )
    assert abs(stamps - times - twin.pace.deadline(start)).max() <= 1


def test_bag_without_screen_and_viewer_says_what_to_do(capsys, bag, monkeypatch) -> None:
    for name in ('DISPLAY', 'WAYLAND_DISPLAY', 'WAYLAND_SOCKET'):
        monkeypatch.delenv(name, raising=False)
    port = free_port()
    code, (line,) = run(capsys, bag, '--port', port)
    assert code == 1
    assert 'no screen' in line
    assert '--screenshot' in line
    assert f'{find_viewer()} --bind 127.0.0.1 --port {port}' in line


def test_without_rerun_it_says_how_to_get_it(capsys, bag, monkeypatch) -> None:
    monkeypatch.setitem(sys.modules, 'rerun', None)
    for name in ('rerun_canvas', 'rerun_layout', 'rerun_view', 'rig_picture'):
        monkeypatch.delitem(sys.modules, f'soft_throw_ros.recording.{name}', raising=False)
        monkeypatch.delattr(recording, name, raising=False)
    code, (line,) = run(capsys, bag, '--save', 'scene.rrd')
    assert code == 1
    assert 'soft_throw_ros[rerun]' in line


def test_what_is_no_bag_of_a_twin_is_refused_in_one_line(capsys, tmp_path) -> None:
    (tmp_path / 'text').write_text('some text')
    channel = Channel(topic='/scan', type='sensor_msgs/msg/LaserScan', schema='float32 x')
    write(tmp_path / 'other', [Message(channel, b'\0\1\0\0\0\0\0\0', 5, 5)])
    for name, words in (('missing', 'missing'), ('text', 'text'), ('other', '/scan')):
        code, (line,) = run(capsys, tmp_path / name, '--save', tmp_path / 'scene.rrd')
        assert code == 2
        assert words in line
    assert not (tmp_path / 'scene.rrd').exists()


def test_damaged_bag_is_shown_as_far_as_it_can_be_read_and_says_so(capsys, twin, tmp_path) -> None:
    messages = [
        message._replace(data=message.data[:7])
        if message.channel.topic.endswith('phase')
        else message
        for message in twin.messages
    ]
    path = write(tmp_path / 'bag', messages, chunk=100) / 'bag_0.mcap'
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])
    code, (cut, lost) = run(capsys, path, '--save', tmp_path / 'scene.rrd')
    assert code == 0
    assert f'{path}: ' in cut
    assert 'messages are left out, /twin/phase' in lost
    assert 0 < rows(tmp_path / 'scene.rrd')['/twin/position'] < 500


@pytest.mark.parametrize(
    ('args', 'words'),
    [
        (['--size', '10x10'], '10x10'),
        (['--port', '80'], '80'),
        (['--save', '/nowhere/a.rrd'], '/nowhere'),
        (['--save', 'a.rrd', '--screenshot', 'a.png'], '--screenshot'),
        (['--sink', 'printer'], 'printer'),
        (['--throw', '7', '--save', 'a.rrd'], 'no throw 7'),
        (['--at', 'nan'], 'nan'),
        (
            ['--at', '7', '--screenshot', 'a.png'],
            'from -0.4 to 0.099 s',
        ),
        (['--throw', '1', '--at', '-0.3', '--screenshot', 'a.png'], 'from -0.2 to 0.299 s'),
        (['--save', '.'], 'inspect: .: '),
        (['-', '--screenshot=1'], '--screenshot'),
        (['-', '--throw=1'], '--throw'),
        (['-', '--at=1'], '--at'),
    ],
)
def test_arguments_are_refused_with_their_value(capsys, bag, args, words) -> None:
    code, lines = run(capsys, *([] if '-' in args else [bag]), *args)
    assert code == 2
    assert words in lines[-1]


def test_port_that_is_taken_is_named(capsys, bag) -> None:
    with Viewer(free_port(), '--headless') as viewer:
        code, (line,) = run(capsys, bag, '--sink', 'serve', '--port', viewer.port)
    assert code == 2
    assert f'127.0.0.1:{viewer.port}' in line


# streams


class Process:
    """`inspect -`, what it is fed, and what it says."""

    def __init__(self, *args: Any) -> None:
        hidden = ('DISPLAY', 'WAYLAND_DISPLAY', 'WAYLAND_SOCKET')
        self.process = subprocess.Popen(
            [sys.executable, '-c', INSPECT, '-', *map(str, args)],
            cwd=ROOT,
            env={name: value for name, value in os.environ.items() if name not in hidden},
            stdin=subprocess.PIPE,
            stderr=subprocess.PIPE,
        )
        assert self.process.stdin is not None
        self.pipe = self.process.stdin
        self.lines: list[str] = []
        self._writer = StreamWriter()
        self._thread = threading.Thread(target=self._listen, daemon=True)
        self._thread.start()

    def _listen(self) -> None:
        assert self.process.stderr is not None
        with self.process.stderr as stream:
            for line in stream:
                self.lines.append(line.decode().rstrip())

    def feed(self, messages: list[Message]) -> None:
        self.pipe.write(self._writer.write(messages))
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
        assert all(line.startswith('inspect: ') for line in self.lines), self.lines
        return code


@pytest.fixture
def start() -> Iterator[Callable[..., Process]]:
    processes: list[Process] = []

    def start(*args: Any) -> Process:
        processes.append(Process(*args))
        return processes[-1]

    yield start
    for process in processes:
        process.process.kill()
        with contextlib.suppress(OSError):
            process.pipe.close()
        process.wait()


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
        client = ViewerClient.connect(url_of(port))
        wait_until(lambda: len(client.get_state().views) == 12)
        assert process.end() == 0


@pytest.mark.parametrize(
    ('is_stopped', 'how'),
    [(True, None), (True, signal.SIGINT), (True, signal.SIGTERM), (False, signal.SIGINT)],
)
def test_neither_stopped_nor_missing_viewer_holds_up_the_end(start, twin, is_stopped, how) -> None:
    """A stopped one takes nothing any more, so that Rerun would wait for it for ever."""
    half = len(twin.messages) // 2
    with contextlib.ExitStack() as stack:
        port = free_port()
        viewer = stack.enter_context(viewer_at(port)) if is_stopped else None
        process = start('--port', port)
        process.wait_for_line('connected' if viewer else 'no viewer at')
        process.feed(twin.messages[:half])
        if viewer:
            wait_until(lambda: '/twin/position' in entities(viewer))
            os.killpg(viewer.pid, signal.SIGSTOP)
        process.feed(twin.messages[half:])
        if how is None:
            assert process.end() == 0
        else:
            process.process.send_signal(how)
            assert process.wait() == 0


@pytest.mark.parametrize(('kind', 'code'), [('whole', 0), ('damaged', 0), ('none', 2)])
def test_stream_is_saved_as_far_as_it_goes(twin, bag, tmp_path, kind, code) -> None:
    """The writer is gone long before all is read."""
    path, begin = tmp_path / 'scene.rrd', StreamWriter().write(twin.messages[:100])
    content = {
        'whole': (bag / 'bag_0.mcap').read_bytes(),
        'damaged': begin + b'\5\xff' * 5,  # no record begins like this
        'none': begin[:8] + b'\5\xff' * 5,
    }[kind]
    done = subprocess.run(
        [sys.executable, '-c', INSPECT, '-', '--save', str(path)],
        input=content,
        stderr=subprocess.PIPE,
        cwd=ROOT,
        check=False,
    )
    assert done.returncode == code
    assert (b'standard input' in done.stderr) == (kind != 'whole')
    if code == 0:
        count = rows(path)['/twin/position']
        assert count == 500 if kind == 'whole' else 10 < count < 100


def test_stream_is_served_to_viewers_on_this_machine(start, twin) -> None:
    port = free_port()
    process = start('--sink', 'serve', '--port', port)
    process.wait_for_line(url_of(port))
    process.feed(twin.messages)
    listening = Path('/proc/net/tcp').read_text(encoding='ascii')
    assert f' 0100007F:{port:04X} ' in listening
    assert f' 00000000:{port:04X} ' not in listening + Path('/proc/net/tcp6').read_text()
    with viewer_at(free_port(), '--connect', url_of(port)) as viewer:
        wait_until(lambda: '/twin/throw_result' in entities(viewer))
    assert process.end() == 0
