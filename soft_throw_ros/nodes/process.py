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
"""A node as a process: from its arguments to its exit code."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import ExitStack
import os
import signal
import sys
import threading
from typing import Any

import rclpy
from rclpy.clock import Clock, ClockType
from rclpy.exceptions import InvalidParameterTypeException, NameValidationException
from rclpy.executors import SingleThreadedExecutor
from rclpy.logging import LoggingSeverity, set_logger_level
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions
from rclpy.timer import Timer
from rclpy.utilities import remove_ros_args
from soft_throw_ros.configuration import files, ParameterError
from soft_throw_ros.nodes.transport import use_transport_profile

POLL = 0.1
"""Longest wait, after which it is looked whether to stop [s]."""

EXIT_TIME = 0.6
"""After this the process ends, whatever the middleware still waits for [s]."""


class RunnableNode(Node):
    """
    A node that is more than its callbacks; to be derived from. It is made like any of rclpy.

    Raises
    ------
    ParameterError
        If the name, the namespace or a parameter of rclpy's own is refused.

    """

    def __init__(self, name: str, **kwargs: Any) -> None:
        self._at_end = ExitStack()
        try:
            super().__init__(name, **kwargs)
        except (InvalidParameterTypeException, NameValidationException) as error:
            raise ParameterError(' '.join(str(error).split())) from error

    def call_every(self, seconds: float, callback: Callable[[], None]) -> Timer:
        """Have something called by a clock that always goes, also when `/clock` does not."""
        steady = Clock(clock_type=ClockType.STEADY_TIME)
        return self.create_timer(seconds, callback, clock=steady)

    def at_end(self, callback: Callable[..., object], *args: object) -> None:
        """Have something called when the node is destroyed, before what was asked for earlier."""
        self._at_end.callback(callback, *args)

    def destroy_node(self) -> None:
        """Let go of everything, also if the node was not finished: a parameter may be refused."""
        self._at_end.close()
        super().destroy_node()

    @property
    def exit_code(self) -> int | None:
        """Return what to end with, None to go on."""
        return None

    def prepare(self) -> None:
        """Do what takes long before the node starts."""

    def start(self) -> None:
        """Begin with what does not happen in the executor."""

    def close(self) -> None:
        """Bring to an end what must not be cut short, such as a file."""


def run(
    name: str,
    make: Callable[..., RunnableNode],
    args: Sequence[str] | None = None,
    *,
    usage: str = '',
) -> int:
    """
    Run a node until SIGINT, SIGTERM or SIGHUP, or until it comes to an end by itself.

    Parameters
    ----------
    name : str
        Of the executable, to begin a message with.
    make : callable
        Makes the node from the keyword `arguments`, once ROS has begun.
    args : sequence of str or None
        The arguments of ROS, or the request for help; those of the process if None.
    usage : str
        What to say if there is something else among them, or if help is asked for; by default
        how ROS arguments are given.

    Returns
    -------
    int
        Exit code: 0 after a signal, 2 if an argument or a parameter is refused, the node's own
        if it has come to an end by itself.

    """
    usage = usage or (
        f'usage: {name} [--ros-args [-p NAME:=VALUE] [--params-file FILE] [-r FROM:=TO] ...]'
    )
    arguments = sys.argv[1:] if args is None else args
    if '--help' in arguments or '-h' in arguments:
        print(usage)
        return 0
    is_stopping = threading.Event()
    deadline = threading.Timer(EXIT_TIME, os._exit, (0,))
    deadline.daemon = True

    def interrupt(*_: object) -> None:
        if not is_stopping.is_set():
            is_stopping.set()
            deadline.start()  # numba may swallow what is raised in it
        raise KeyboardInterrupt

    _on_signals(interrupt)
    node = None
    code = 0
    try:
        _init(name, arguments, usage)
        node = make(arguments=arguments)
        node.prepare()
        code = _spin(node, is_stopping)
    except KeyboardInterrupt:
        pass
    except ParameterError as error:
        print(f'{name}: {error}', file=sys.stderr)
        code = 2
    finally:
        _on_signals(signal.SIG_IGN)
        deadline.cancel()
        code = _shut_down(node, code)
    return code


def _on_signals(handler: Callable[[int, object], object] | signal.Handlers) -> None:
    """
    Handle the signals that ask a process to end.

    SIGHUP is one, which a terminal sends when it is closed; below `nohup` it stays ignored.
    """
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        if number != signal.SIGHUP or signal.getsignal(number) != signal.SIG_IGN:
            signal.signal(number, handler)


def _init(name: str, arguments: Sequence[str], usage: str) -> None:
    """Begin with ROS, or say in one line what is wrong with the arguments."""
    files.read_arguments(arguments)  # for its words, before ROS has its own
    use_transport_profile()
    set_logger_level('rcl', LoggingSeverity.FATAL)  # it would say the same in a line of its own
    try:
        left = remove_ros_args(args=[name, *arguments])[1:]
        rclpy.init(args=list(arguments), signal_handler_options=SignalHandlerOptions.NO)
    except RuntimeError as error:
        reason = str(error).partition(', at /')[0]
        raise ParameterError(f'ROS does not take the arguments: {reason}') from error
    finally:
        set_logger_level('rcl', LoggingSeverity.UNSET)
    if left:
        raise ParameterError(f'no such argument: {" ".join(left)}; {usage}')


def _spin(node: RunnableNode, is_stopping: threading.Event) -> int:
    """Serve until a signal comes, or the node has an exit code."""
    _on_signals(lambda *_: is_stopping.set())
    executor = SingleThreadedExecutor()
    executor.add_node(node)
    node.start()
    code = None
    while code is None and not is_stopping.is_set():
        executor.spin_once(timeout_sec=POLL)
        code = node.exit_code
    return code or 0


def _shut_down(node: RunnableNode | None, code: int) -> int:
    """
    Let go of everything, and return the exit code, also of what fails only now.

    That takes a bounded time: the middleware may wait for a stopped subscriber.
    """
    if node is not None:
        node.close()
        code = code or node.exit_code or 0
    deadline = threading.Timer(EXIT_TIME, os._exit, (code,))
    deadline.daemon = True
    deadline.start()
    if node is not None:
        node.destroy_node()
    rclpy.try_shutdown()
    deadline.cancel()
    return code
