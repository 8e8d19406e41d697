# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Recordings of Rerun, read back by Rerun itself, and its viewers."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
import contextlib
from pathlib import Path
from typing import Any
import warnings

import numpy as np
import pytest
from rerun.chunk import RrdReader
from soft_throw_ros.recording.rerun_view import Scene
from soft_throw_ros.recording.rerun_viewer import (
    finish,
    new_stream,
    save_to,
    Viewer,
    ViewerError,
)


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
        self.entities: dict[str, list[Any]] = {}
        self.rows: dict[str, int] = {}
        for chunk in reader.stream():
            self.entities.setdefault(chunk.entity_path, []).append(chunk.to_record_batch())
            if not chunk.is_static:
                self.rows[chunk.entity_path] = self.rows.get(chunk.entity_path, 0) + chunk.num_rows
        blueprints = [
            chunk.to_record_batch().to_pydict()
            for store in reader.blueprints()
            for chunk in reader.stream(store=store)
        ]
        self.views = [
            item['ViewBlueprint:display_name'][0][0]
            for item in blueprints
            if 'ViewBlueprint:display_name' in item
        ]
        self.ranges = [
            tuple(item['ScalarAxis:range'][0][0])
            for item in blueprints
            if 'ScalarAxis:range' in item
        ]

    def series(
        self, entity: str, component: str, timeline: str = 'stamp'
    ) -> tuple[Any, list[Any]]:
        """Return times and values of a component, by time."""
        times: list[int] = []
        values: list[Any] = []
        for batch in self.entities[entity]:
            if {timeline, component} <= set(batch.schema.names):
                times += batch.column(timeline).cast('int64').to_pylist()
                values += batch.column(component).to_pylist()
        order = np.argsort(times, kind='stable')
        return np.array(times)[order], [values[index] for index in order]

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
