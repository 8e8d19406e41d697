# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Design a throw: choose a layer, an amplitude or a motion of the plate, and draw landscapes."""

from __future__ import annotations

import importlib
import sys

from soft_throw_ros.commands.output import CommandParser, run_command

# Name: module, its functions that add arguments and run, and the purpose. Only the module of the
# requested task is imported, because the modules load slowly.
TASKS = {
    'recommend': (
        'design_search', 'add_recommend_arguments', 'run_recommend', 'recommend a layer'
    ),
    'aim': (
        'design_search', 'add_aim_arguments', 'run_aim',
        'find the amplitude that reaches a height or speed',
    ),
    'motion': ('design_motion', 'add_arguments', 'run', 'optimise the motion of the plate'),
    'map': ('design_map', 'add_arguments', 'run', 'map ejection time and energy over two axes'),
}


def main(args: list[str] | None = None) -> int:
    """Run the task named by the first argument with the other arguments; return its exit code."""
    args = sys.argv[1:] if args is None else args
    parser = CommandParser(description=__doc__)
    tasks = parser.add_subparsers(dest='task', metavar='TASK', required=True)
    for name, (*_, purpose) in TASKS.items():
        tasks.add_parser(name, help=purpose, description=f'{purpose.capitalize()}.')
    name = parser.parse_args(args[:1]).task
    module, add_arguments, run, _ = TASKS[name]
    task = importlib.import_module(f'soft_throw_ros.commands.{module}')
    getattr(task, add_arguments)(tasks.choices[name])
    return run_command(tasks.choices[name], getattr(task, run), args[1:])
