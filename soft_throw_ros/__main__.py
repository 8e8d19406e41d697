# SPDX-License-Identifier: Apache-2.0
"""
Run an executable of the package by its name: ``soft-throw NAME [ARGUMENTS]``.

pip lays this one command on the PATH, so that no generic name (``replay``) lands there; colcon
lays the plain names into lib/soft_throw_ros, for ``ros2 run``.

"""

import importlib
import sys

# Name: module with a main(args), and what it is for. The only such list: setup.py reads it too,
# so nothing may be imported here but the standard library.
EXECUTABLES = {
    'calibrator': ('soft_throw_ros.nodes.calibrator', 'ROS 2 node: keep a twin true to its rig'),
    'design': ('soft_throw_ros.commands.design', 'landscapes over any two parameters'),
    'identify': ('soft_throw_ros.commands.identify', 'a rig from tracks or videos of throws'),
    'inspect': ('soft_throw_ros.commands.inspect_bag', 'look at a bag, or at a stream, in Rerun'),
    'recorder': ('soft_throw_ros.nodes.recorder', 'ROS 2 node: topics into a bag, and to Rerun'),
    'recover': ('soft_throw_ros.commands.recover', 'repair a bag that a crash has cut off'),
    'replay': ('soft_throw_ros.nodes.replay', 'ROS 2 node: play a bag, or check it'),
    'rig': ('soft_throw_ros.nodes.rig', 'ROS 2 node: play a rig that is measured'),
    'throw': ('soft_throw_ros.commands.throw', 'predict one throw by several models'),
    'twin': ('soft_throw_ros.nodes.twin', 'ROS 2 node: the throwing rig in real time'),
}


def main(args: list[str] | None = None) -> int | None:
    """
    Run the executable named by the first argument, with the others.

    Its module is imported only now: what needs no ROS runs without ROS.

    Parameters
    ----------
    args : list of str, optional
        Name of the executable and its arguments; those of the process by default.

    Returns
    -------
    int or None
        Exit code of the executable; 2 if there is none of that name, 1 if it needs a module that
        is not installed.

    """
    name, *rest = (sys.argv[1:] if args is None else args) or ['--help']
    if name in {'-h', '--help'}:
        print(_usage())
        return 0
    if name not in EXECUTABLES:
        print(
            f'soft-throw: no executable is named {name!r}; there are: {", ".join(EXECUTABLES)}',
            file=sys.stderr,
        )
        return 2
    module_name, _ = EXECUTABLES[name]
    try:
        module = importlib.import_module(module_name)
    except ModuleNotFoundError as error:
        print(f'soft-throw: {name} needs what is not installed: {error}', file=sys.stderr)
        return 1
    sys.argv = [f'soft-throw {name}', *rest]  # what the executable calls itself in its messages
    exit_code: int | None = module.main(rest)
    return exit_code


def _usage() -> str:
    """Say how to call the command, with a line for each executable."""
    width = max(map(len, EXECUTABLES))
    lines = [f'  {name:{width}}  {purpose}' for name, (_, purpose) in EXECUTABLES.items()]
    return '\n'.join(['usage: soft-throw NAME [ARGUMENTS]', '', 'executables:', *lines])


if __name__ == '__main__':
    sys.exit(main())
