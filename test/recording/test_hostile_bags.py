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
"""Sizes that a bag claims are compared with a limit, and texts in YAML are not expanded."""

from __future__ import annotations

import re
from test.recording.conftest import plain, read

from bags import channel, profiles, text, write
import pytest
from soft_throw_ros.nodes.conversions import text_to_profiles
from soft_throw_ros.recording import mcap_scan
from soft_throw_ros.recording.recovery import recover
from soft_throw_ros.storage import mcap_file
from soft_throw_ros.storage.bag_metadata import load_profiles, MAX_FILE_SIZE, profiles_of
from soft_throw_ros.storage.bag_reader import BagReader, UnfinishedError
from soft_throw_ros.storage.message import Message


@pytest.mark.parametrize('compression', ['none', 'zstd'])
def test_too_large_chunk_is_refused_and_left_out(tmp_path, monkeypatch, compression) -> None:
    messages = [plain(0, size=200_000), plain(1)]
    path = write(tmp_path / 'bag', messages, chunk=1, compression=compression)
    for module in (mcap_file, mcap_scan):
        monkeypatch.setattr(module, 'MAX_RECORD', 100_000)
    with pytest.raises(UnfinishedError, match=r'chunk of .* more than 100000'):
        BagReader(path)
    recovery = recover(path, tmp_path / 'new')
    chunk, missing = recovery.skipped
    kind = 'record' if compression == 'none' else 'chunk'
    assert re.search(rf'a {kind} of .* more than 100000', chunk.reason)
    assert missing.messages == 1
    assert [message.sequence for message in read(recovery.target).messages] == [1]


def test_too_large_index_is_refused_and_not_needed_to_recover(tmp_path, monkeypatch) -> None:
    path = write(tmp_path / 'bag', map(plain, range(50)), chunk=1)
    monkeypatch.setattr(mcap_file, 'MAX_RECORD', 3_000)
    with pytest.raises(UnfinishedError, match='index'):
        BagReader(path)
    assert recover(path, tmp_path / 'new').message_count == 50


# metadata.yaml and the quality of service


def bomb(levels: int, merge: str = '') -> str:
    """Return YAML whose expansion grows tenfold with every line."""
    lines = ['a0: &a0 {x: y}' if merge else 'a0: &a0 [x, x, x, x, x, x, x, x, x, x]']
    for level in range(1, levels):
        names = ', '.join([f'*a{level - 1}'] * 10)
        value = f'{{<<: [{names}]}}' if merge else f'[{names}]'
        lines.append(f'a{level}: &a{level} {value}')
    return '\n'.join(lines) + '\n'


@pytest.mark.parametrize('metadata', [
    bomb(12) + 'rosbag2_bagfile_information: {relative_file_paths: [*a11]}',
    bomb(12) + 'rosbag2_bagfile_information: {relative_file_paths: [], ros_distro: *a11}',
    bomb(9, '<<') + 'rosbag2_bagfile_information: {relative_file_paths: [], <<: *a8}',
    '[' * 1000,
    '# ' + 'x' * MAX_FILE_SIZE,
])
def test_exploding_metadata_is_skipped_and_messages_are_read(tmp_path, metadata) -> None:
    path = write(tmp_path / 'bag', [plain(1)])
    (path / 'metadata.yaml').write_text(metadata)
    with BagReader(path) as reader:
        assert len(list(reader.messages())) == 1
        assert '<<' in metadata or 'metadata.yaml: the file ' in reader.damage
        assert '\n' not in reader.damage
        assert len(reader.damage) < 1000


@pytest.mark.parametrize('qos', [
    '- &a {reliability: reliable}\n- *a\n', bomb(9, '<<'), '[' * 1000,
])
def test_exploding_quality_of_service_is_skipped(qos) -> None:
    assert (load_profiles(qos), profiles_of(qos), text_to_profiles(qos)) == ([], [], [])


def test_equal_profiles_are_written_without_aliases(tmp_path) -> None:
    qos = profiles({'depth': 3}, {'depth': 3})
    assert '*' not in qos
    assert len(text_to_profiles(qos)) == 2
    topics = [channel(f'/talk{number}', depth=7) for number in range(3)]
    path = write(tmp_path / 'bag', [Message(topic, text('x'), 1, 1) for topic in topics])
    assert '*' not in (path / 'metadata.yaml').read_text()
    with BagReader(path) as reader:
        assert (reader.damage, reader.distribution) == ('', 'jazzy')
