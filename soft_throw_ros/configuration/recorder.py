# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""The parameters of the recorder and of the viewer."""

from __future__ import annotations

from soft_throw_ros.configuration.table import NAME, row, Table

RECORDER = Table(
    node='recorder',
    entries=(
        row('topics', ('twin', '/diagnostics', '/parameter_events', '/rosout'),
            'Topics to record, and namespaces with all their topics, relative to the namespace of '
            'the recorder unless they begin with /; `/` records everything',
            kind='the name of a topic or namespace', pattern=f'/|{NAME}'),
        row('folder', '.', 'Folder of the bags'),
        row('name', '', 'Name of the new bag, which must not exist; empty for the current time',
            kind='the name of a folder', pattern=r'(?!\.{1,2}$)[^/]*'),
        row('start', True, 'Start recording at once, without `~/start`'),
        row('compression', 'zstd', 'Compression of the chunks of the bag',
            choices=('none', 'lz4', 'zstd')),
        row('split.size', 0, 'Size after which the bag continues in a new file; 0 for never',
            unit='byte', low=1_000_000, high=1_000_000_000_000, or_zero=True),
        row('split.duration', 0.0, 'Time after which the bag continues in a new file; 0 for never',
            unit='s', low=1.0, high=1e6, or_zero=True),
        row('sync', False, 'Store all data on the disk every second, against power failures'),
        row('buffer', 256_000_000, 'Data that may wait for the disk before messages are dropped',
            unit='byte', low=1_000_000, high=16_000_000_000),
        row('rerun.sink', 'none',
            'Sink of a viewer that is started with the recorder and shows its topics; `file` '
            'writes a recording beside the bag',
            choices=('none', 'viewer', 'serve', 'file'), is_fixed=True),
    ),
)
"""The parameters of the recorder; `rerun.sink` is fixed, the others are for the next recording."""

VIEWER = Table(
    node='viewer',
    entries=(
        row('topics', ('twin', '/diagnostics', '/rosout'),
            'Topics to show, as of the recorder; `/` shows every twin',
            kind='the name of a topic or namespace', pattern=f'/|{NAME}'),
        row('sink', 'viewer',
            '`viewer` opens Rerun, `serve` waits for viewers, `file` writes a recording',
            choices=('viewer', 'serve', 'file')),
        row('port', 9876, 'Port of the viewer, or for viewers, on 127.0.0.1',
            low=1024, high=65535),
        row('file', '', 'Path of the Rerun recording (.rrd) for the sink `file`'),
    ),
)
"""The parameters of the viewer; all take effect when it is started."""
