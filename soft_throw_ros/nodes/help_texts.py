# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Texts of `--help` for the nodes, from their tables of parameters."""

from __future__ import annotations

import textwrap
from typing import NamedTuple

from soft_throw_ros.configuration import Entry, TWIN
from soft_throw_ros.configuration.recorder import RECORDER, VIEWER
from soft_throw_ros.configuration.rig import CALIBRATOR, RIG
from soft_throw_ros.configuration.table import Table, value_text

_MORE = 'docs/parameters.md lists all parameters, and ros2 param describe explains each.'


class NodeHelp(NamedTuple):
    """Description, main parameters and an example of a node."""

    description: str
    table: Table
    parameters: tuple[str, ...]
    example: str


HELP = {
    'twin': NodeHelp(
        'Simulate a throwing rig in real time; publish its motion and the result of every throw.',
        TWIN,
        ('layer.name', 'layer.thickness', 'projectile.mass', 'engine.motion',
         'throw.period', 'rate.state', 'time_scale'),
        '-p layer.thickness:=0.0095 -p throw.period:=2.0',
    ),
    'recorder': NodeHelp(
        'Record topics into a bag, and show the throws in Rerun.',
        RECORDER,
        ('topics', 'folder', 'start', 'split.duration', 'rerun.sink'),
        '-p folder:=bags -p rerun.sink:=viewer',
    ),
    'viewer': NodeHelp(
        'Show the throws of twins live in Rerun.',
        VIEWER,
        ('topics', 'sink', 'port', 'file'),
        '-p sink:=serve',
    ),
    'rig': NodeHelp(
        'Simulate a rig with faulty sensors; publish the measured heights of its plate.',
        RIG,
        ('rate', 'noise', 'jitter', 'faults.outlier_rate', 'faults.missing_rate', 'wear.throws'),
        '-p rate:=2000.0 -p faults.missing_rate:=0.01',
    ),
    'calibrator': NodeHelp(
        'Identify a rig again when the predictions of its twin are wrong, and update the twin.',
        CALIBRATOR,
        ('twin', 'rig', 'throws'),
        '-p twin:=twin -p throws:=5',
    ),
}
"""The help of each node that has parameters, by the name of its executable."""


def help_text(name: str, usage: str) -> str:
    """Return the usage line of a node, followed by its help if the table `HELP` contains it."""
    if name not in HELP:
        return usage
    node = HELP[name]
    lines = [usage, '', node.description, '', 'main parameters:']
    for key in node.parameters:
        lines.append(f'  {key}')
        lines += textwrap.wrap(
            _describe(node.table.by_name[key]), initial_indent=6 * ' ', subsequent_indent=6 * ' ',
            break_on_hyphens=False,
        )
    example = f'  ros2 run soft_throw_ros {name} --ros-args {node.example}'
    return '\n'.join([*lines, '', _MORE, '', 'example:', example])


def _describe(entry: Entry) -> str:
    """Return meaning, default and unit of a parameter."""
    meaning = entry.meaning.replace('`', '')
    default = value_text(entry.default)
    unit = f' {entry.unit}' if entry.unit else ''
    return f'{meaning} (default {default}{unit})' if default else meaning
