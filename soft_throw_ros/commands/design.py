# SPDX-License-Identifier: Apache-2.0
"""Design a throw: the right layer, what it takes to reach a height, and landscapes."""

from __future__ import annotations

import argparse
import importlib
import sys

from soft_throw_ros.commands.output import run_command

# Name: module with add_arguments(parser) and run(arguments), and what it is for. Only the module
# that is asked for is imported, for they are slow to load.
TASKS = {
    'recommend': ('soft_throw_ros.commands.design_recommend', 'recommend a layer'),
    'aim': ('soft_throw_ros.commands.design_aim', 'find what it takes to reach a height or speed'),
    'map': ('soft_throw_ros.commands.design_map', 'map ejection time and energy over two axes'),
}


def main(args: list[str] | None = None) -> int:
    """Run the task that the first argument names with the others; return its exit code."""
    args = sys.argv[1:] if args is None else args
    parser = argparse.ArgumentParser(description=__doc__, allow_abbrev=False)
    tasks = parser.add_subparsers(dest='task', metavar='TASK', required=True)
    for name, (_, purpose) in TASKS.items():
        tasks.add_parser(
            name, help=purpose, description=f'{purpose.capitalize()}.', allow_abbrev=False
        )
    name = parser.parse_args(args[:1]).task
    task = importlib.import_module(TASKS[name][0])
    task.add_arguments(tasks.choices[name])
    return run_command(tasks.choices[name], task.run, args[1:])
