# SPDX-License-Identifier: Apache-2.0
"""The parameters of the recorder."""

from __future__ import annotations

from collections.abc import Collection

from soft_throw_ros.configuration.table import ParameterError, row, Settings, Table


def check_together(settings: Settings, changed: Collection[str]) -> None:
    """
    Refuse to record nothing, if that was asked for at once.

    Raises
    ------
    ParameterError
        Quoting both values.

    """
    if {'storage', 'rerun.sink'} <= set(changed):
        refuse_nothing(settings)


def refuse_nothing(settings: Settings) -> None:
    """
    Refuse settings with which nothing would be recorded nor shown.

    Raises
    ------
    ParameterError
        Quoting both values.

    """
    if settings['storage'] == settings['rerun.sink'] == 'none':
        raise ParameterError(
            "storage and rerun.sink are both 'none', so that nothing would be recorded nor "
            "shown; set storage to 'mcap', or rerun.sink to 'viewer', 'serve' or 'file'",
            'storage',
            'rerun.sink',
        )


RECORDER = Table(
    node='recorder',
    entries=(
        row('topics', ('/twin', '/diagnostics', '/parameter_events', '/rosout'),
              'Topics to record, and namespaces of which all are recorded; `/` records everything',
              pattern='/'),
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
    check_together=check_together,
)  # fmt: skip
"""The parameters of the recorder; all take effect when recording is started."""
