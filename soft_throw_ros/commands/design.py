# SPDX-License-Identifier: Apache-2.0
"""Design a throw: the right layer, what it takes to reach a height, and landscapes."""

from __future__ import annotations

import argparse
import importlib
import sys

# Name: module with add_arguments(parser) and run(arguments), and what it is for. Only the module
# that is asked for is imported, for they are slow to load.
TASKS = {
    'recommend': ('soft_throw_ros.commands.design_recommend', 'recommend a layer'),
    'aim': ('soft_throw_ros.commands.design_aim', 'find what it takes to reach a height or speed'),
    'map': ('soft_throw_ros.commands.design_map', 'map ejection time and energy over two axes'),
}


def main(args: list[str] | None = None) -> int:
    """
    Run one of the tasks.

    Parameters
    ----------
    args : list of str, optional
        Its name and its arguments; those of the process by default.

    Returns
    -------
    int
        Exit code of the task.

    Raises
    ------
    SystemExit
        With exit code 2 if something is refused, after a line that says what: whatever ValueError
        a task raises is such a refusal.

    """
    args = sys.argv[1:] if args is None else args
    parser = argparse.ArgumentParser(description=__doc__, allow_abbrev=False)
    tasks = parser.add_subparsers(dest='task', metavar='TASK', required=True)
    for name, (_, purpose) in TASKS.items():
        tasks.add_parser(
            name, help=purpose, description=f'{purpose.capitalize()}.', allow_abbrev=False
        )
    name = parser.parse_args(args[:1]).task
    task = importlib.import_module(TASKS[name][0])
    subparser = tasks.choices[name]
    task.add_arguments(subparser)
    arguments = subparser.parse_args(args[1:])
    try:
        exit_code: int = task.run(arguments)
    except ValueError as error:
        subparser.error(str(error))
    return exit_code
