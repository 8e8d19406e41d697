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
"""Repair a bag that a crash has cut off, or a disk has damaged, by writing what is left anew."""

from __future__ import annotations

import argparse
from pathlib import Path

from soft_throw_ros.commands.output import print_text, run_command
from soft_throw_ros.recording.recovery import recover, Recovery

_SHOWN = 10  # places that are named one by one


def main(args: list[str] | None = None) -> int:
    """Run the command; exit code 0 if all was recovered, 1 if not, 2 if nothing was."""
    parser = argparse.ArgumentParser(
        description='Repair a bag that a crash has cut off, or a disk has damaged: write what is '
        'left into a new bag. The old one is not changed.',
        epilog='Exit code: 0 if all was recovered, 1 if something was not, 2 if nothing was.',
        allow_abbrev=False,
    )
    parser.add_argument('bag', metavar='BAG', help='folder of the bag, or one file of it')
    parser.add_argument(
        '--to', metavar='OUT', help='the new bag (default: beside the old one, BAG_recovered)'
    )
    return run_command(parser, _run, args)


def _run(arguments: argparse.Namespace) -> int:
    source = Path(arguments.bag)
    path = source.resolve()  # the new bag is named after the folder, or after a file of it
    name = path.name if path.is_dir() else path.name.partition('.')[0]
    recovery = recover(source, arguments.to or path.with_name(f'{name}_recovered'))
    print_text('\n'.join(_lines(recovery)) + '\n')
    return 1 if recovery.skipped or recovery.doubts else 0


def _lines(recovery: Recovery) -> list[str]:
    """Say what was recovered, and what was not."""
    width = max(map(len, recovery.saved))
    lines = [f'{recovery.target}: {recovery.message_count} messages recovered']
    lines += [f'  {topic:{width}} {count:12}' for topic, count in recovery.saved.items()]
    lines += [f'left out: {doubt}' for doubt in recovery.doubts]
    skipped = recovery.skipped
    if skipped:
        places = '1 place' if len(skipped) == 1 else f'{len(skipped)} places'
        lines.append(f'{sum(gap.size for gap in skipped)} bytes skipped, in {places}:')
        lines += [f'  {gap}' for gap in skipped[:_SHOWN]]
        if len(skipped) > _SHOWN:
            lines.append(f'  and {len(skipped) - _SHOWN} more')
    return lines
