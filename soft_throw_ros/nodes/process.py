# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
A node as a process: from its arguments to its exit code.

`config/fastdds.xml` explains the transport of messages between processes.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import ExitStack
from functools import partial
from importlib import metadata, resources
import os
import signal
import subprocess
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
from soft_throw_ros.recording.child_process import bound_to_parent
from soft_throw_ros.twin.session import RequestRejected
from std_srvs.srv import Trigger

POLL = 0.1  # longest wait between two looks at the request to stop [s]
EXIT_TIME = 0.6  # longest time from the end of `close` to the end of the process [s]
STOP_TIMEOUT = 0.3  # longest wait for one thread to end [s]
_REFUSAL_LOG_PERIOD = 1.0  # shortest time between two log lines about exceptions [s]
_KILTED = 9  # version of rclpy
_RANGE = 'ROS_AUTOMATIC_DISCOVERY_RANGE'
_LOCAL = ('LOCALHOST', 'OFF')  # discovery ranges that are limited to this machine
_PROFILES = ('FASTDDS_DEFAULT_PROFILES_FILE', 'FASTRTPS_DEFAULT_PROFILES_FILE')


class RunnableNode(Node):
    """
    Base class of all nodes: a node with a start, an end and an exit code.

    The constructor checks the parameters, raising ParameterError in one line; a signal interrupts
    it. `start` starts threads and recordings. The executor then runs callbacks until a signal
    comes, a thread dies, or `exit_code` is set. `close` completes files, while threads and
    publishers still work. `destroy_node` calls the functions registered by `add_cleanup`, the
    latest first, so that a thread stops before anything that it uses, within `EXIT_TIME`.
    """

    def __init__(self, name: str, **kwargs: Any) -> None:
        self.exit_code: int | None = None
        self._cleanups = ExitStack()
        try:
            super().__init__(name, **kwargs)
        except (InvalidParameterTypeException, NameValidationException) as error:
            raise ParameterError(' '.join(str(error).split())) from error

    def create_service(
        self, srv_type: Any, srv_name: str, callback: Callable[..., Any], **kwargs: Any
    ) -> Service:
        """
        Create a service as `rclpy.node.Node` does, whose exceptions refuse the request.

        rclpy's parameter services raise one for a value of an unknown type, which anybody may
        send. The response so far is a refusal in every type; a Trigger has the reason.
        """

        def guarded(request: Any, response: Any) -> Any:
            try:
                return callback(request, response)
            except Exception as error:  # noqa: BLE001  no request ends a node
                reason = str(error)
                if not isinstance(error, (RequestRejected, ParameterError)):
                    reason = f'{srv_name}: a request is refused: {error}'
                    self.get_logger().error(reason, throttle_duration_sec=_REFUSAL_LOG_PERIOD)
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

    def log(self, text: str, *, is_error: bool) -> None:
        """Log at level ERROR or INFO; rclpy allows one level per line of code."""
        if is_error:
            self.get_logger().error(text)
        else:
            self.get_logger().info(text)

    def add_cleanup(self, callback: Callable[..., object], *args: object) -> None:
        """Register a function to call when the node is destroyed, in reverse order."""
        self._cleanups.callback(callback, *args)

    def destroy_node(self) -> None:
        """Release all resources, also those of a node whose constructor raised an exception."""
        self._cleanups.close()
        super().destroy_node()

    def start(self) -> None:
        """Start threads and recordings, and log that the node is ready."""
        self.get_logger().info('ready')

    def close(self) -> None:
        """Complete files and everything else that must not be cut short."""


def run(name: str, make: Callable[..., RunnableNode], args: Sequence[str] | None = None) -> int:
    """
    Run a node until SIGINT, SIGTERM or SIGHUP, or until it comes to an end by itself.

    `make` creates the node from the keyword `arguments`. The exit code is 0 after a signal, 2 if
    an argument or a parameter is refused, otherwise that of the node.
    """
    usage = f'{name} [--ros-args [-p NAME:=VALUE] [--params-file FILE] [-r FROM:=TO] ...]'
    arguments = sys.argv[1:] if args is None else args
    if '--help' in arguments or '-h' in arguments:
        more = 'docs/parameters.md lists the parameters, and ros2 param describe explains each.'
        print(f'usage: {usage}\n\n{more}')
        return 0
    is_stopping = threading.Event()

    def interrupt(*_: object) -> None:
        is_stopping.set()  # numba may suppress the exception; the node then ends after its start
        raise KeyboardInterrupt

    _on_signals(interrupt)
    node = None
    code = 0
    try:
        _init(name, arguments, usage)
        node = make(arguments=arguments)
        _spin(node, is_stopping)
    except KeyboardInterrupt:
        pass
    except ParameterError as error:
        print(f'{name}: {error}', file=sys.stderr)
        code = 2
    finally:
        _on_signals(signal.SIG_IGN)
        code = _shut_down(node, code)
    return code


def start_child(*words: str) -> subprocess.Popen[bytes]:
    """Start `soft-throw` as a process that ends with this one, and which Ctrl-C does not reach."""
    command = bound_to_parent([sys.executable, '-m', 'soft_throw_ros', *words])
    return subprocess.Popen(command, stdin=subprocess.DEVNULL, start_new_session=True)


def exit_after(seconds: float, code: int) -> threading.Timer:
    """End the process after a time [s] unless the timer that is returned is cancelled."""
    watchdog = threading.Timer(seconds, os._exit, (code,))
    watchdog.daemon = True
    watchdog.start()
    return watchdog


def _on_signals(handler: Callable[[int, object], object] | signal.Handlers) -> None:
    """Handle the signals that ask a process to end; SIGHUP stays ignored below `nohup`."""
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


def _spin(node: RunnableNode, is_stopping: threading.Event) -> None:
    """Serve until a signal comes, or the node has an exit code."""
    _on_signals(lambda *_: is_stopping.set())
    threading.excepthook = partial(_on_death, node)
    executor = SingleThreadedExecutor()
    executor.add_node(node)
    node.start()
    node.get_logger().info(describe_discovery())
    while node.exit_code is None and not is_stopping.is_set():
        executor.spin_once(timeout_sec=POLL)


def _on_death(node: RunnableNode, death: threading.ExceptHookArgs) -> None:
    """End the node after an exception has ended one of its threads."""
    threading.__excepthook__(death)  # prints the traceback
    name = death.thread.name if death.thread is not None else 'unknown'
    node.get_logger().fatal(
        f'the node ends, since an exception has ended its thread {name!r}: {death.exc_value!r}'
    )
    node.exit_code = 1


def _shut_down(node: RunnableNode | None, code: int) -> int:
    """Close and destroy the node in a bounded time, and return the exit code."""
    if node is not None:
        node.close()
        code = code or node.exit_code or 0
    watchdog = exit_after(EXIT_TIME, code)  # the middleware may wait for a stopped subscriber
    # The destruction of publishers makes threads fail that still run; this is no error.
    threading.excepthook = lambda _death: None
    if node is not None:
        node.destroy_node()
    rclpy.try_shutdown()
    watchdog.cancel()
    watchdog.join()
    if node is not None and threading.active_count() > 1:
        # The end of the interpreter would abort a library that a thread is still computing in.
        sys.stdout.flush()
        sys.stderr.flush()
        os._exit(code)
    return code


def _discovery_range() -> str:
    is_local = os.environ.get('ROS_LOCALHOST_ONLY') == '1'  # obsolete, and has precedence
    return 'LOCALHOST' if is_local else os.environ.get(_RANGE) or 'SUBNET'


def describe_discovery() -> str:
    """Return which machines can reach a node of this process, and how to limit them."""
    reach = _discovery_range()
    verb = 'do not' if reach in _LOCAL else f'may, unless {_RANGE}=LOCALHOST,'
    return f'discovery range {reach}: other machines {verb} reach this node'


def use_transport_profile() -> None:
    """Let Fast DDS buffer a second of messages, and use local ports if discovery is local."""
    # if another transport is selected, the package changes nothing
    if not any(name in os.environ for name in ('FASTDDS_BUILTIN_TRANSPORTS', *_PROFILES)):
        is_former = _rclpy_version() < _KILTED  # whose Fast DDS reads the former name only
        file = 'fastdds_loopback.xml' if _discovery_range() in _LOCAL else 'fastdds.xml'
        path = resources.files('soft_throw_ros') / 'config' / file
        os.environ[_PROFILES[is_former]] = str(path)


def _rclpy_version() -> int:
    return int(metadata.version('rclpy').partition('.')[0])
