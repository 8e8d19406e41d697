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

# Name, module with a main(args), purpose, also for setup.py; imports above delay signal handlers
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
    'throw': ('soft_throw_ros.commands.throw', 'predict one throw'),
    'track': ('soft_throw_ros.commands.track', 'extract tracks from a video'),
    'twin': ('soft_throw_ros.nodes.twin', 'ROS 2 node: twin of a throwing rig in real time'),
    'viewer': ('soft_throw_ros.nodes.viewer', 'ROS 2 node: show twins live in Rerun'),
    'warm_up': ('soft_throw_ros.commands.warm_up', 'compile all kernels in advance'),
}


def main(args: list[str] | None = None) -> int | None:
    """
    Run the executable named by the first argument, whose module is imported only then.

    The exit code is 2 if the name is unknown, and 1 if a required module is not installed.
    """
    name, *arguments = (sys.argv[1:] if args is None else args) or ['--help']
    if name in {'-h', '--help'}:
        return _until_pipe_closes(_print_usage)
    if name not in EXECUTABLES:
        rule = f'choose from {", ".join(EXECUTABLES)}'
        print(f'soft-throw: unknown executable {name!r}; {rule}', file=sys.stderr)
        return 2
    sys.argv = [f'soft-throw {name}', *arguments]  # the prefix of its messages
    return _run(name, arguments)


def __getattr__(name: str) -> Callable[[], int | None]:
    """Return the entry point of a name that colcon installs, such as `run_twin`."""
    if not name.startswith('run_') or name[4:] not in EXECUTABLES:
        raise AttributeError(f'unknown executable {name!r}')
    return lambda: _run(name[4:], sys.argv[1:])


def _run(name: str, arguments: list[str]) -> int | None:
    """Import the module of an executable and run its main function."""
    module_name, _ = EXECUTABLES[name]
    is_node = '.nodes.' in module_name
    # During the import a signal ends the process at once without output, because an interrupted
    # import prints dozens of lines. Nodes then exit with 0, as they do later.
    handlers = {n: signal.getsignal(n) for n in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)}
    for number, handler in handlers.items():
        if handler != signal.SIG_IGN:
            signal.signal(number, lambda number, _: os._exit(0 if is_node else 128 + number))
    try:
        from soft_throw_ros.kernel_cache import use_kernel_cache

        use_kernel_cache()
        module = importlib.import_module(module_name)
    except ModuleNotFoundError as error:
        remedy = '; it is a ROS 2 node: source the setup file of ROS 2, or run make' * is_node
        reason = f'needs a module that is not installed: {error}{remedy}'
        print(f'soft-throw: {name} {reason}', file=sys.stderr)
        return 1
    finally:
        for number, handler in handlers.items():
            signal.signal(number, handler)
    try:
        return _until_pipe_closes(lambda: module.main(arguments))
    except KeyboardInterrupt:  # the executable has not installed a signal handler
        return 0 if is_node else 128 + signal.SIGINT


def _until_pipe_closes(run: Callable[[], int | None]) -> int | None:
    """Run a function; if its reader leaves, as of `| head`, its output ends without an error."""
    try:
        try:
            return run()
        finally:
            sys.stdout.flush()
    except BrokenPipeError:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())  # for the flush at exit
        return 0


def _print_usage() -> None:
    """Print a line for each executable."""
    lines = [f'  {name:11}  {purpose}' for name, (_, purpose) in EXECUTABLES.items()]
    print('usage: soft-throw NAME [ARGUMENTS]', '', 'executables:', *lines, sep='\n')


if __name__ == '__main__':
    sys.exit(main())
