# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Show a recorded bag in Rerun."""

from __future__ import annotations

import argparse
import itertools
import os
from pathlib import Path
import tempfile

from soft_throw_ros.commands import options, output
from soft_throw_ros.configuration.interface import find_topic, TWIN_TOPICS
from soft_throw_ros.recording import rerun_viewer as viewer
from soft_throw_ros.recording.twin_journal import find_throws, ThrowStart
from soft_throw_ros.storage.bag_reader import BagReader

_BATCH = 5000  # number of messages of a bag that are drawn at once
_MOMENT = 0.7  # default time of the cursor in a contact [ejection times]
_SIZE = '1600x1000'  # of a screenshot [pixels]


def main(args: list[str] | None = None) -> int:
    """
    Run the command.

    The exit code is 0; 1 if the viewer is not there; 2 if Rerun is not installed, or there is no
    such bag, or none of a twin; 130 after Ctrl-C while a bag is read.
    """
    parser = output.CommandParser(description=__doc__)
    add = parser.add_argument
    add('bag', metavar='BAG', help='a bag or an .mcap file')
    files = parser.add_mutually_exclusive_group()
    files.add_argument('--save', metavar='FILE.rrd', type=options.new_file(),
                       help='write a recording of Rerun, show nothing')
    files.add_argument('--screenshot', metavar='FILE.png', type=options.new_file(),
                       help='write a picture, open no window')
    add('--throw', metavar='N', type=int,
        help='show this throw (default the last complete one with a release)')
    add('--at', metavar='TIME', type=options.any_number,
        help='show it at this time of the rig since the throw started, in seconds '
        '(default in the contact)')
    port = options.number_type('from 1024 to 65535', lambda port: port in range(1024, 65536))
    add('--port', type=port, default=viewer.PORT, help='port of the viewer (default %(default)s)')
    return output.run_command(parser, _run, args, compiles=True)


def _run(arguments: argparse.Namespace) -> int:
    output.require('inspect', 'rerun', 'rerun', 'matplotlib')
    os.environ.setdefault('RUST_LOG', 'off')  # the command has messages of its own
    try:
        with BagReader(arguments.bag) as reader:
            _show_bag(reader, arguments)
    except viewer.ViewerError as error:
        output.print_note('inspect', str(error))
        return 1
    return 0


def _show_bag(reader: BagReader, arguments: argparse.Namespace) -> None:
    """Show a bag, or write a recording or a picture."""
    from soft_throw_ros.recording.rerun_layout import THROW_TIME

    throw = _choose_throw(reader, arguments.throw)
    seconds = arguments.at
    if throw is None and seconds is not None:
        raise ValueError(f'{reader.path}: --at {seconds:g} needs a throw, and the bag has none')
    if throw is not None and seconds is None:
        seconds = _MOMENT * (throw.ejection_time or 0.0)
    at = THROW_TIME, seconds if throw is not None else None
    if arguments.save:
        with output.written_file(arguments.save) as unfinished:
            _draw(reader, throw, unfinished)
        return
    with tempfile.TemporaryDirectory() as folder:
        recording = Path(folder) / 'scene.rrd'
        _draw(reader, throw, recording)
        if arguments.screenshot:
            words = '--headless', '--window-size', _SIZE
            with viewer.Viewer(viewer.free_port(), *words) as process:
                picture = process.photograph(recording, *at)
            with output.written_file(arguments.screenshot) as unfinished:
                unfinished.write_bytes(picture)
        else:
            viewer.show(recording, int(arguments.port), *at)


def _choose_throw(reader: BagReader, number: int | None) -> ThrowStart | None:
    """Return the throw to show; None if the bag contains none and none is requested."""
    topics = {item.topic: find_topic(item.topic, item.type) for item in reader.channels}
    if not any(found and found[1] in TWIN_TOPICS for found in topics.values()):
        raise ValueError(
            f'{reader.path}: no topic of a twin is in the bag; topics: {", ".join(topics)}'
        )
    journals = [
        name for name, found in topics.items() if found and found[1] == TWIN_TOPICS.journal
    ]
    throws = next(iter(find_throws(reader.messages(journals)).values()), [])  # the view in front
    chosen = [throw for throw in throws if number in (None, throw.number)]
    if number is not None and not chosen:
        known = f'{throws[0].number}-{throws[-1].number}' if throws else 'no throws'
        raise ValueError(f'{reader.path}: throw {number} not found (bag contains {known})')
    return max(chosen, key=lambda throw: (throw.ejection_time is not None, throw.is_over,
                                          throw.stamp), default=None)


def _draw(reader: BagReader, throw: ThrowStart | None, path: Path) -> None:
    """Draw a whole bag into a recording, and report damage."""
    from soft_throw_ros.recording.rerun_view import Scene

    stream = viewer.new_stream(reader.path.name)
    viewer.save_to(stream, path, is_live=False)
    scene, messages = Scene(stream, throw=throw), reader.messages()
    while batch := list(itertools.islice(messages, _BATCH)):
        scene.show(batch)
    scene.arrange()
    damage = f', {scene.damage}' if scene.damage else ''
    if not scene.drawn_twins():
        raise ValueError(f'{reader.path}: nothing of a twin could be read{damage}')
    if scene.damaged:
        text = f'{reader.path}: {scene.damaged} messages are left out{damage}'
        output.print_note('inspect', text)
    viewer.finish(stream, path)
