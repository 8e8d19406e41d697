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
"""The parameters of the recorder."""

from __future__ import annotations

from collections.abc import Iterator

from soft_throw_ros.configuration.table import NAME, ParameterError, row, Settings, Table


def contradictions(settings: Settings) -> Iterator[ParameterError]:
    """Find settings with which nothing would be recorded nor shown."""
    if settings['storage'] == settings['rerun.sink'] == 'none':
        yield ParameterError(
            "storage and rerun.sink are both 'none', so that nothing would be recorded nor "
            "shown; set storage to 'mcap', or rerun.sink to 'viewer', 'serve' or 'file'",
            'storage',
            'rerun.sink',
        )


RECORDER = Table(
    node='recorder',
    entries=(
        row('topics', ('twin', '/diagnostics', '/parameter_events', '/rosout'),
            'Topics to record, and namespaces of which all are recorded, below the namespace of '
            'the recorder unless they begin with /; `/` records everything',
            kind='the name of a topic or namespace', pattern=f'/|{NAME}'),
        row('storage', 'mcap', 'Whether to write a bag, or to show only',
            choices=('mcap', 'none')),
        row('folder', '.', 'Where bags are put'),
        row('name', '',
            'Name of the bag, which must not be there yet; empty names it by the time'),
        row('start', True, 'Whether to begin at once, or when `~/start` is called'),
        row('compression', 'zstd', 'How the bag is compressed',
            choices=('none', 'lz4', 'zstd')),
        row('split.size', 0, 'Size after which the bag goes on in another file; 0 for never',
            unit='byte', low=1_000_000, high=1_000_000_000_000, or_zero=True),
        row('split.duration', 0.0,
            'Time after which the bag goes on in another file; 0 for never',
            unit='s', low=1.0, high=1e6, or_zero=True),
        row('sync', False,
            'Whether to wait every second until the disk has it, for when the power may fail'),
        row('buffer', 256_000_000, 'What may wait for the disk before messages are dropped',
            unit='byte', low=1_000_000, high=16_000_000_000),
        row('rerun.sink', 'none',
            'Whether to show it live in Rerun: in a viewer, to viewers that connect, or later '
            'from a file beside the bag',
            choices=('none', 'viewer', 'serve', 'file')),
        row('rerun.port', 9876, 'Port of the viewer, or for viewers, on 127.0.0.1',
            low=1024, high=65535),
        row('rerun.python', '',
            'Python that has Rerun and this package; empty for the one that runs the recorder'),
    ),
    contradictions=contradictions,
)
"""The parameters of the recorder; all take effect when recording is started."""
