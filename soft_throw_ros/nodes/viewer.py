# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""The node `viewer`: shows twins live in Rerun, by subscriptions of its own."""

from __future__ import annotations

from collections.abc import Sequence
import contextlib
import os
from pathlib import Path
from typing import Any

from soft_throw_ros.configuration import ParameterError
from soft_throw_ros.configuration.interface import VIEWER_DIAGNOSTICS
from soft_throw_ros.configuration.node_tables import VIEWER
from soft_throw_ros.nodes.parameters import NodeParameters
from soft_throw_ros.nodes.process import exit_after, EXIT_TIME, run, RunnableNode
from soft_throw_ros.nodes.raw_subscriptions import is_wanted, RawSubscriptions
from soft_throw_ros.nodes.topics import full_name, Publishers
from soft_throw_ros.recording import rerun_viewer

_DRAIN_PERIOD = 0.25  # time between two updates; shorter ones cost more of a core [s]
_FLUSH_TIME = 0.7  # longest wait for viewers and disk at the end [s]


class Viewer(RunnableNode):
    """Node that shows the topics of twins live in Rerun."""

    def __init__(self, *, arguments: Sequence[str] = (), **kwargs: Any) -> None:
        super().__init__('viewer', **kwargs)
        self.parameters = NodeParameters(self, VIEWER, arguments=arguments)
        settings = self.parameters.settings
        if settings['sink'] == 'file' and not settings['file']:
            raise ParameterError("sink is 'file' and file is empty; name a file such as live.rrd")
        try:
            from soft_throw_ros.recording.rerun_view import is_drawn, Scene
        except ModuleNotFoundError as error:
            raise ParameterError(
                f"Rerun is needed: pip install 'soft_throw_ros[rerun]' ({error})"
            ) from error
        self._outgoing = Publishers(self, [VIEWER_DIAGNOSTICS])
        wanted = [full_name(self, name) for name in settings['topics']]
        self.raw_subscriptions = RawSubscriptions(
            self, lambda topic, kind: is_wanted(topic, wanted) and is_drawn(topic, kind)
        )
        self._stream = rerun_viewer.new_stream('live')
        try:
            if settings['sink'] == 'file':
                path = Path(settings['file']).expanduser()
                rerun_viewer.save_to(self._stream, path, is_live=True)
            else:
                self._serve(settings['port'], opens=settings['sink'] == 'viewer')
        except (OSError, ValueError) as error:
            raise ParameterError(str(error)) from error
        self._scene = Scene(self._stream, is_live=True)
        self.create_steady_timer(_DRAIN_PERIOD, self._drain)
        self.create_steady_timer(1.0, self._on_second)

    def close(self) -> None:
        """Draw the last messages, and close the sink."""
        self._drain()
        self.raw_subscriptions.close()
        with contextlib.suppress(OSError):
            rerun_viewer.finish(self._stream, '', _FLUSH_TIME)
        self.get_logger().info(
            f'{self.raw_subscriptions.received} messages, {self.raw_subscriptions.lost} not shown'
        )

    def _serve(self, port: int, *, opens: bool) -> None:
        """Send the drawing to all viewers that connect, and open one."""
        if opens and rerun_viewer.listens(port):  # such as a viewer of bags
            port = rerun_viewer.free_port()
        rerun_viewer.serve(self._stream, port)
        url = rerun_viewer.url_of(port)
        if opens and rerun_viewer.has_display():
            try:
                rerun_viewer.Viewer(rerun_viewer.free_port(), '--connect', url, stays=True)
            except rerun_viewer.ViewerError as error:
                self.get_logger().error(str(error))
        self.get_logger().info(f'to see it: rerun {url}')

    def _drain(self) -> None:
        self._scene.show(self.raw_subscriptions.drain())

    def _on_second(self) -> None:
        """Look for new topics, and publish how many messages are not shown."""
        self.raw_subscriptions.discover()
        values = {'lost': self.raw_subscriptions.lost, 'damaged': self._scene.damaged}
        missing, damage = sum(values.values()), self._scene.damage
        text = f'{missing} messages not shown' + (damage and f'; {damage}')
        status = self._outgoing.status('display', text, values, warn=missing > 0)
        self._outgoing.report(VIEWER_DIAGNOSTICS, [status])


def main(args: Sequence[str] | None = None) -> int:
    """Run the node, and end the process although Rerun may wait for a viewer that hangs."""
    os.environ.setdefault('RUST_LOG', 'off')  # its messages would repeat those of the node
    code = run('viewer', Viewer, args)
    exit_after(EXIT_TIME, code)
    return code
