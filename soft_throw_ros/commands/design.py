# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Design a throw: choose a layer, an amplitude or a motion of the plate, and draw landscapes."""

from __future__ import annotations

from soft_throw_ros.commands import design_map, design_motion, design_search
from soft_throw_ros.commands.output import CommandParser, run_command

TASKS = {
    'recommend': (
        design_search.add_recommend_arguments, design_search.run_recommend, 'recommend a layer',
    ),
    'aim': (
        design_search.add_aim_arguments, design_search.run_aim,
        'find the amplitude that reaches a height or speed',
    ),
    'motion': (
        design_motion.add_arguments, design_motion.run, 'optimise the motion of the plate'
    ),
    'map': (
        design_map.add_arguments, design_map.run, 'map ejection time and energy over two axes'
    ),
}


def main(args: list[str] | None = None) -> int:
    """Run the task named by the first argument with the other arguments; return its exit code."""
    parser = CommandParser(description=__doc__)
    tasks = parser.add_subparsers(dest='task', metavar='TASK', required=True)
    for name, (add_arguments, run, purpose) in TASKS.items():
        task = tasks.add_parser(name, help=purpose, description=f'{purpose.capitalize()}.')
        task.usage = '%(prog)s [OPTION ...]'
        add_arguments(task)
        task.set_defaults(run=run)
    return run_command(parser, lambda arguments: arguments.run(arguments), args)
