# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Bags to test with."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
import os
from pathlib import Path
import resource
import subprocess
import sys
import time
from types import SimpleNamespace
from typing import Any

from bags import BEGIN, channel, text
import pytest
from rosbags.typesys import get_typestore, Stores
from soft_throw_ros.recording.bag_writer import BagWriter
from soft_throw_ros.storage.bag_reader import BagReader
from soft_throw_ros.storage.cdr import JointStateEncoder
from soft_throw_ros.storage.message import Channel, Message
import yaml

TIMEOUT = 60.0  # reached only when something is wrong [s]
TYPES = get_typestore(Stores.ROS2_JAZZY)
ENCODE = JointStateEncoder('rig', ('plate', 'projectile')).encode
PLAIN = Channel(topic='/plain', type='std_msgs/msg/String', schema='string data')


def plain(number: int, *, size: int = 100) -> Message:
    """Make a message that contains only its number, which is also its time."""
    data = number.to_bytes(8, 'little') + bytes(size - 8)
    return Message(PLAIN, data, number, number, number)


def wait_until(done: Callable[[], bool]) -> None:
    """Wait for an effect of another thread or process."""
    deadline = time.monotonic() + TIMEOUT
    while not done():
        assert time.monotonic() < deadline
        time.sleep(0.01)


@contextmanager
def largest_file(size: int) -> Iterator[None]:
    """Limit the size of files that this process may write, like a full disk."""
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, limits[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)


def read(path: Path) -> SimpleNamespace:
    """Read all contents of an undamaged bag."""
    with BagReader(path) as bag:
        contents = SimpleNamespace(
            messages=list(bag.messages()),
            metadata=bag.metadata,
            channels=bag.channels,
            counts=list(bag.counts.values()),
            span=(bag.start_time, bag.end_time),
        )
        assert sum(bag.counts.values()) == len(contents.messages)
        return contents


def content(messages: Iterable[Message], *topics: str) -> list[tuple[Any, ...]]:
    """Return the properties of messages, on some topics or all, that a bag keeps."""
    return [
        (message.channel.topic, *message[1:])
        for message in messages
        if not topics or message.channel.topic in topics
    ]


def information(folder: Path) -> Any:
    return yaml.safe_load((folder / 'metadata.yaml').read_text())['rosbag2_bagfile_information']


class SampleBag:
    """A bag, and the messages that were written into it."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.messages: list[Message] = []
        self.states = channel('/twin/joint_states', 'sensor_msgs/msg/JointState', depth=1000)
        self.texts = channel('/twin/journal', 'std_msgs/msg/String', durability='transient_local')

    @property
    def files(self) -> list[Path]:
        return sorted(self.folder.glob('*.mcap'))

    def state(self, number: int) -> Message:
        """Make the state at a time in milliseconds."""
        time = BEGIN + number * 1_000_000
        values = [float(scale * number) for scale in (1, 1, 2, 2, -1, -1)]
        return Message(self.states, ENCODE(time, values), time + 50_000, time, number)

    def text(self, number: int, content: str) -> Message:
        time = BEGIN + number * 1_000_000
        return Message(self.texts, text(content), time + 60_000, time + 10_000, number)

    def make(self, count: int) -> list[Message]:
        """Make `count` states, one per millisecond, and a text after every hundredth state."""
        for number in range(count):
            self.messages.append(self.state(number))
            if number % 100 == 0:
                self.messages.append(self.text(number, f'step {number} äöü'))
        return self.messages

    def write(self, count: int = 3000, *, flush_every: int = 1000, **options: Any) -> SampleBag:
        """Write such messages into the bag, and close it."""
        with BagWriter(self.folder, distribution='jazzy', **options) as writer:
            writer.add_metadata('parameters of /twin', {'gravity': '9.81', 'model': 'exact'})
            for number, message in enumerate(self.make(count)):
                writer.write(message)
                if number % flush_every == flush_every - 1:
                    writer.flush()
        return self


@pytest.fixture
def recording(tmp_path: Path) -> SampleBag:
    """Return a bag that is not written yet."""
    return SampleBag(tmp_path / 'bag')


@pytest.fixture(scope='session')
def rerun(tmp_path_factory: pytest.TempPathFactory) -> Callable[..., str]:
    """Return a function that runs Rerun without telemetry."""
    program = Path(sys.executable).with_name('rerun')
    if not program.exists():
        pytest.skip('Rerun comes with the extra [rerun]')
    environment = os.environ | {'HOME': str(tmp_path_factory.mktemp('home'))}
    environment.pop('XDG_CONFIG_HOME', None)

    def run(*arguments: str | Path) -> str:
        done = subprocess.run(
            [program, *map(str, arguments)],
            capture_output=True,
            check=True,
            env=environment,
            text=True,
            timeout=60,
        )
        return done.stdout + done.stderr

    run('analytics', 'disable')
    return run
