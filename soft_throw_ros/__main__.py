# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
Run an executable of the package by its name: ``soft-throw NAME [ARGUMENTS]``.

pip installs only this command on the PATH, to keep generic names such as ``replay`` out; colcon
installs the plain names into lib/soft_throw_ros, for ``ros2 run``.

"""

from collections.abc import Callable
import importlib
import os
import signal
import sys

# Name, module with a main(args), purpose. setup.py also reads this table, and imports delay the
# signal handlers, so this module imports only a few modules of the standard library.
EXECUTABLES = {
    'calibrator': ('soft_throw_ros.nodes.calibrator', 'ROS 2 node: keep a twin calibrated'),
    'design': ('soft_throw_ros.commands.design', 'find a better layer, amplitude or motion'),
    'free_layers': ('soft_throw_ros.commands.free_layers', 'a wave speed from layers that ring'),
    'identify': ('soft_throw_ros.commands.identify', 'identify a rig from tracks of throws'),
    'inspect': ('soft_throw_ros.commands.inspect_bag', 'show a bag or a stream in Rerun'),
    'recorder': ('soft_throw_ros.nodes.recorder', 'ROS 2 node: record and show topics'),
    'recover': ('soft_throw_ros.commands.recover', 'repair a bag after a crash'),
    'replay': ('soft_throw_ros.nodes.replay', 'ROS 2 node: play a bag or check it'),
    'rig': ('soft_throw_ros.nodes.rig', 'ROS 2 node: simulate a rig with sensors'),
    'throw': ('soft_throw_ros.commands.throw', 'predict a throw by several models'),
    'track': ('soft_throw_ros.commands.track', 'extract tracks from a video'),
    'twin': ('soft_throw_ros.nodes.twin', 'ROS 2 node: twin of a throwing rig in real time'),
    'viewer': ('soft_throw_ros.nodes.viewer', 'ROS 2 node: show twins live in Rerun'),
    'warm_up': ('soft_throw_ros.commands.warm_up', 'compile all kernels in advance'),
}


def main(args: list[str] | None = None) -> int | None:
    """
    Run the executable named by the first argument with the other arguments.

    The module is imported only then, so commands that do not need ROS run without it. The exit
    code is 2 if the name is unknown, and 1 if a required module is not installed.
    """
    name, *arguments = (sys.argv[1:] if args is None else args) or ['--help']
    if name in {'-h', '--help'}:
        return _until_pipe_closes(_print_usage, arguments)
    if name not in EXECUTABLES:
        print(
            f'soft-throw: unknown executable {name!r}; choose from {", ".join(EXECUTABLES)}',
            file=sys.stderr,
        )
        return 2
    sys.argv = [f'soft-throw {name}', *arguments]  # the prefix of its messages
    return _run(name, arguments)


def __getattr__(name: str) -> Callable[[], int | None]:
    """Return the entry point of a name that colcon installs, such as `run_twin`."""
    executable = name.removeprefix('run_')
    if executable == name or executable not in EXECUTABLES:
        raise AttributeError(f'unknown executable {name!r}')
    return lambda: _run(executable, sys.argv[1:])


def _run(name: str, arguments: list[str]) -> int | None:
    """Import the module of an executable and run its main function."""
    module_name, _ = EXECUTABLES[name]
    is_node = '.nodes.' in module_name
    # During the import a signal ends the process at once without output, because an interrupted
    # import prints dozens of lines. Nodes then exit with 0, as they do later.
    numbers = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
    handlers = {number: signal.getsignal(number) for number in numbers}
    for number, handler in handlers.items():
        if handler != signal.SIG_IGN:
            signal.signal(number, lambda number, _: os._exit(0 if is_node else 128 + number))
    try:
        from soft_throw_ros.kernel_cache import use_kernel_cache

        use_kernel_cache()
        module = importlib.import_module(module_name)
    except ModuleNotFoundError as error:
        remedy = '; it is a ROS 2 node: source the setup file of ROS 2, or run make' * is_node
        print(
            f'soft-throw: {name} needs a module that is not installed: {error}{remedy}',
            file=sys.stderr,
        )
        return 1
    finally:
        for number, handler in handlers.items():
            signal.signal(number, handler)
    try:
        return _until_pipe_closes(module.main, arguments)
    except KeyboardInterrupt:  # the executable has not installed a signal handler
        return 0 if is_node else 128 + signal.SIGINT


def _until_pipe_closes(
    run: Callable[[list[str]], int | None], arguments: list[str]
) -> int | None:
    """Run a function; if its reader leaves, as of `| head`, its output ends without an error."""
    try:
        try:
            return run(arguments)
        finally:
            sys.stdout.flush()
    except BrokenPipeError:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())  # for the flush at exit
        return 0


def _print_usage(_arguments: list[str]) -> int:
    """Print the usage of the command with one line per executable; return 0."""
    width = max(map(len, EXECUTABLES))
    lines = [f'  {name:{width}}  {purpose}' for name, (_, purpose) in EXECUTABLES.items()]
    print('usage: soft-throw NAME [ARGUMENTS]', '', 'executables:', *lines, sep='\n')
    return 0


if __name__ == '__main__':
    sys.exit(main())
