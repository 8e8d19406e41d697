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
"""
Run an executable of the package by its name: ``soft-throw NAME [ARGUMENTS]``.

pip lays this one command on the PATH, so that no generic name (``replay``) lands there; colcon
lays the plain names into lib/soft_throw_ros, for ``ros2 run``.

"""

from collections.abc import Callable, Iterator
import contextlib
import importlib
import os
import signal
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
    'warm_up': (
        'soft_throw_ros.commands.warm_up',
        'compile all kernels beforehand',
    ),
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
    sys.argv = [f'soft-throw {name}', *rest]  # what the executable calls itself in its messages
    return _run(name, rest)


def __getattr__(name: str) -> Callable[[], int | None]:
    """Return the function behind a plain name that colcon lays: `run_twin` and the like."""
    executable = name.removeprefix('run_')
    if executable == name or executable not in EXECUTABLES:
        raise AttributeError(f'no executable is named {name!r}')
    return lambda: _run(executable, sys.argv[1:])


def _run(name: str, arguments: list[str]) -> int | None:
    """Import the module of an executable, and run it."""
    module_name, _ = EXECUTABLES[name]
    try:
        with _ended_by_signals(is_node='.nodes.' in module_name):
            module = importlib.import_module(module_name)
    except ModuleNotFoundError as error:
        print(f'soft-throw: {name} needs what is not installed: {error}', file=sys.stderr)
        return 1
    exit_code: int | None = module.main(arguments)
    return exit_code


@contextlib.contextmanager
def _ended_by_signals(*, is_node: bool) -> Iterator[None]:
    """
    Let a signal end the process at once and quietly, as it may while nothing has begun.

    An import that is interrupted halfway would say so in dozens of lines. Nodes then end as they
    do later, with 0.

    """
    numbers = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
    handlers = {number: signal.getsignal(number) for number in numbers}
    for number, handler in handlers.items():
        if handler != signal.SIG_IGN:
            signal.signal(number, lambda number, _: os._exit(0 if is_node else 128 + number))
    try:
        yield
    finally:
        for number, handler in handlers.items():
            signal.signal(number, handler)


def _usage() -> str:
    """Say how to call the command, with a line for each executable."""
    width = max(map(len, EXECUTABLES))
    lines = [f'  {name:{width}}  {purpose}' for name, (_, purpose) in EXECUTABLES.items()]
    return '\n'.join(['usage: soft-throw NAME [ARGUMENTS]', '', 'executables:', *lines])


if __name__ == '__main__':
    sys.exit(main())
