# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
A node as a process: from its arguments to its exit code.

`run` calls the methods of a node in the order that `RunnableNode` documents.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Sequence
from contextlib import ExitStack
import os
import signal
import sys
import threading
from typing import Any

from rcl_interfaces.msg import SetParametersResult
import rclpy
from rclpy.clock import Clock, ClockType
from rclpy.exceptions import InvalidParameterTypeException, NameValidationException
from rclpy.executors import SingleThreadedExecutor
from rclpy.logging import LoggingSeverity, set_logger_level
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.service import Service
from rclpy.signals import SignalHandlerOptions
from rclpy.timer import Timer
from rclpy.utilities import remove_ros_args
from soft_throw_ros.configuration import files, ParameterError
from soft_throw_ros.nodes.transport import describe_discovery, use_transport_profile
from std_srvs.srv import Trigger

POLL = 0.1
"""Longest wait between two looks at the request to stop [s]."""

EXIT_TIME = 0.6
"""Longest time from the end of `close` to the end of the process [s]."""

STOP_TIMEOUT = 0.3
"""Longest wait for one thread to end [s]."""

REFUSAL_LOG_PERIOD = 1.0
"""Shortest time between two log lines about requests that raise exceptions [s]."""

_MORE = 'docs/parameters.md lists the parameters, and ros2 param describe explains each.'


class RunnableNode(Node):
    """
    Base class of all nodes: a node with a start, an end and an exit code.

    Raises
    ------
    ParameterError
        In one line, if the name, the namespace or a parameter is refused.

    Notes
    -----
    A node passes through these stages:

    1. The constructor checks the parameters, compiles missing kernels, and creates publishers,
       subscriptions, services and timers. A signal interrupts it.
    2. `start` starts threads and recordings. From now on a signal ends the node in order.
    3. The executor runs callbacks until a signal comes, a thread dies, or `exit_code` has a value.
       Ticks run in a thread of their own, see `nodes.realtime`.
    4. `close` completes files. Threads, publishers and subscriptions still work.
    5. `destroy_node` calls the functions registered by `add_cleanup`, the latest first, so that a
       thread stops before anything that was registered earlier and that the thread uses.
    6. The publishers, subscriptions and services are destroyed, and ROS is shut down.

    Steps 5 and 6 take at most `EXIT_TIME`.

    """

    def __init__(self, name: str, **kwargs: Any) -> None:
        self._cleanups = ExitStack()
        try:
            super().__init__(name, **kwargs)
        except (InvalidParameterTypeException, NameValidationException) as error:
            raise ParameterError(' '.join(str(error).split())) from error

    def create_service(
        self, srv_type: Any, srv_name: str, callback: Callable[..., Any], **kwargs: Any
    ) -> Service:
        """
        Create a service as `rclpy.node.Node` does, and keep its errors away from the node.

        The node logs an exception of the callback, and answers with the response so far, which is
        a refusal in every type of this package and of parameters. rclpy's parameter services raise
        for a value of an unknown type, which anybody may send.
        """

        def guarded(request: Any, response: Any) -> Any:
            try:
                return callback(request, response)
            except Exception as error:  # noqa: BLE001  no request ends a node
                reason = f'{srv_name}: a request is refused: {error}'
                self.get_logger().error(reason, throttle_duration_sec=REFUSAL_LOG_PERIOD)
                if isinstance(response, Trigger.Response):
                    response.message = reason
                return response

        return super().create_service(srv_type, srv_name, guarded, **kwargs)

    def set_parameters_atomically(self, parameter_list: list[Parameter]) -> SetParametersResult:
        """Set parameters as `rclpy.node.Node` does; a callback refuses them by ParameterError."""
        try:
            return super().set_parameters_atomically(parameter_list)
        except ParameterError as error:
            return SetParametersResult(successful=False, reason=str(error))

    def create_steady_timer(self, seconds: float, callback: Callable[[], None]) -> Timer:
        """Call a function periodically on steady time, also while `/clock` stands still."""
        steady = Clock(clock_type=ClockType.STEADY_TIME)
        return self.create_timer(seconds, callback, clock=steady)

    def add_cleanup(self, callback: Callable[..., object], *args: object) -> None:
        """Register a function to call when the node is destroyed, in reverse order."""
        self._cleanups.callback(callback, *args)

    def destroy_node(self) -> None:
        """Release all resources, also those of a node whose constructor raised an exception."""
        self._cleanups.close()
        super().destroy_node()

    @property
    def exit_code(self) -> int | None:
        """Return the exit code of a node that has come to its end, None before."""
        return None

    def start(self) -> None:
        """Start threads and recordings."""

    def close(self) -> None:
        """Complete files and everything else that must not be cut short."""


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
        Name of the executable, the prefix of its messages.
    make : callable
        Creates the node from the keyword `arguments` after the initialization of ROS.
    args : sequence of str or None
        ROS arguments, or `--help`; the arguments of the process if None.
    usage : str
        Usage, printed for `--help` and for unknown arguments; by default that of ROS arguments.

    Returns
    -------
    int
        Exit code: 0 after a signal, 2 if an argument or a parameter is refused, the node's own
        if it has come to an end by itself.

    """
    usage = usage or f'{name} [--ros-args [-p NAME:=VALUE] [--params-file FILE] [-r FROM:=TO] ...]'
    arguments = sys.argv[1:] if args is None else args
    if '--help' in arguments or '-h' in arguments:
        title = (sys.modules[make.__module__].__doc__ or '').strip().partition('\n')[0]
        argparse.ArgumentParser(usage=usage, description=title, epilog=_MORE).print_help()
        return 0
    is_stopping = threading.Event()

    def interrupt(*_: object) -> None:
        is_stopping.set()  # numba may suppress the exception; the node then ends after its start
        raise KeyboardInterrupt

    _on_signals(interrupt)
    deaths = _watch_threads()
    node = None
    code = 0
    try:
        _init(name, arguments, usage)
        node = make(arguments=arguments)
        node.get_logger().info(describe_discovery())
        code = _spin(node, is_stopping, deaths)
    except KeyboardInterrupt:
        pass
    except ParameterError as error:
        print(f'{name}: {error}', file=sys.stderr)
        code = 2
    finally:
        _on_signals(signal.SIG_IGN)
        code = _shut_down(node, code)
    return code


def exit_after(seconds: float, code: int) -> threading.Timer:
    """End the process after a time [s] unless the timer that is returned is cancelled."""
    watchdog = threading.Timer(seconds, os._exit, (code,))
    watchdog.daemon = True
    watchdog.start()
    return watchdog


def _on_signals(handler: Callable[[int, object], object] | signal.Handlers) -> None:
    """
    Handle the signals that ask a process to end.

    SIGHUP is one, which a terminal sends when it is closed; below `nohup` it stays ignored.
    """
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        if number != signal.SIGHUP or signal.getsignal(number) != signal.SIG_IGN:
            signal.signal(number, handler)


def _init(name: str, arguments: Sequence[str], usage: str) -> None:
    """Initialize ROS; raise ParameterError with one line if it refuses its arguments."""
    files.read_arguments(arguments)  # its errors are clearer than those of ROS
    use_transport_profile()
    set_logger_level('rcl', LoggingSeverity.FATAL)  # rcl would log the same error again
    try:
        unknown = remove_ros_args(args=[name, *arguments])[1:]
        rclpy.init(args=list(arguments), signal_handler_options=SignalHandlerOptions.NO)
    except RuntimeError as error:
        reason = str(error).partition(', at /')[0]
        raise ParameterError(f'ROS does not start: {reason}') from error
    finally:
        set_logger_level('rcl', LoggingSeverity.UNSET)
    if unknown:
        raise ParameterError(f'no such argument: {" ".join(unknown)}; usage: {usage}')


def _watch_threads() -> list[threading.ExceptHookArgs]:
    """Return a list of the exceptions that end threads of this process from now on."""
    deaths: list[threading.ExceptHookArgs] = []

    def on_death(death: threading.ExceptHookArgs) -> None:
        threading.__excepthook__(death)  # prints the traceback
        deaths.append(death)

    threading.excepthook = on_death
    return deaths


def _spin(
    node: RunnableNode, is_stopping: threading.Event, deaths: list[threading.ExceptHookArgs]
) -> int:
    """Serve until a signal comes, the node has an exit code, or one of its threads dies."""
    _on_signals(lambda *_: is_stopping.set())
    executor = SingleThreadedExecutor()
    executor.add_node(node)
    node.start()
    code = None
    while code is None and not is_stopping.is_set():
        executor.spin_once(timeout_sec=POLL)
        code = node.exit_code
        for death in deaths:
            name = death.thread.name if death.thread is not None else 'unknown'
            node.get_logger().fatal(
                f'the node ends, since an exception has ended its thread {name!r}: '
                f'{death.exc_value!r}'
            )
            code = 1
    return code or 0


def _shut_down(node: RunnableNode | None, code: int) -> int:
    """
    Close and destroy the node in a bounded time, and return the exit code.

    The middleware may wait for a stopped subscriber.
    """
    if node is not None:
        node.close()
        code = code or node.exit_code or 0
    watchdog = exit_after(EXIT_TIME, code)
    # The destruction of publishers makes threads fail that still run; this is no error.
    threading.excepthook = lambda _death: None
    if node is not None:
        node.destroy_node()
    rclpy.try_shutdown()
    watchdog.cancel()
    return code
