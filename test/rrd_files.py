# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Recordings of Rerun, read back by Rerun itself, and its viewers."""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Iterator, Sequence
import contextlib
from pathlib import Path
from typing import Any
import warnings

import numpy as np
import pytest
from rerun.chunk import RrdReader
from soft_throw_ros.recording.rerun_view import Scene
from soft_throw_ros.recording.rerun_viewer import finish, new_stream, save_to, Viewer, ViewerError


@contextlib.contextmanager
def viewer_at(port: int, *options: str | Path) -> Iterator[Viewer]:
    """Start a viewer without a window; skip the test on a machine without graphics."""
    with Viewer(port, '--headless', *options) as viewer:
        try:
            viewer.client()
        except ViewerError as error:
            pytest.skip(str(error))
        yield viewer


class RrdFile:
    """A Rerun file opened for reading: rows by entity and component, times in [ns]."""

    def __init__(self, path: Path) -> None:
        with warnings.catch_warnings():
            warnings.filterwarnings('ignore', 'RRD file has no footer')  # of a stream, as it grows
            reader = RrdReader(path)
        self.entities: dict[str, list[Any]] = defaultdict(list)
        self.rows = Counter[str]()  # numbers of those with a time
        for chunk in reader.stream():
            self.entities[chunk.entity_path].append(chunk.to_record_batch())
            if not chunk.is_static:
                self.rows[chunk.entity_path] += chunk.num_rows
        self._blueprints = [
            chunk.to_record_batch().to_pydict()
            for store in reader.blueprints() for chunk in reader.stream(store=store)
        ]

    def layout(self, component: str) -> list[Any]:
        """Return the values of a component of the layout."""
        return [item[component][0][0] for item in self._blueprints if component in item]

    def series(
        self, entity: str, component: str, timeline: str = 'stamp'
    ) -> tuple[Any, list[Any]]:
        """Return times and values of a component, by time."""
        rows: list[tuple[int, Any]] = []
        for batch in self.entities[entity]:
            if {timeline, component} <= set(batch.schema.names):
                times = batch.column(timeline).cast('int64').to_pylist()
                rows += zip(times, batch.column(component).to_pylist(), strict=True)
        rows.sort(key=lambda row: row[0])
        return np.array([time for time, _ in rows]), [value for _, value in rows]

    def scalars(self, entity: str, timeline: str = 'stamp') -> tuple[Any, Any]:
        times, values = self.series(entity, 'Scalars:scalars', timeline)
        return times, np.array(values)

    def last(self, entity: str, component: str) -> Any:
        return self.series(entity, component)[1][-1]


def record(
    path: Path, messages: Sequence[Any], batch: int = 1000, **options: Any
) -> tuple[RrdFile, Scene]:
    """Write a scene to a file; return the recording and the scene."""
    stream = new_stream('test')
    save_to(stream, path, is_live=False)
    scene = Scene(stream, **options)
    for begin in range(0, len(messages), batch):
        scene.show(messages[begin:begin + batch])
    scene.arrange()
    finish(stream, path)
    return RrdFile(path), scene
