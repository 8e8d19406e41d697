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
"""The recommended layer of a twin: a table, and the map of all layers of the rig."""

from __future__ import annotations

from concurrent.futures import Executor, Future

from soft_throw_ros.configuration import Settings
from soft_throw_ros.core.rig import Rig
from soft_throw_ros.recording import charts
from soft_throw_ros.recording import rerun_canvas as drawing
from soft_throw_ros.recording import rerun_text as words
from soft_throw_ros.recording.energy_map import compute_energy_map, EnergyMap
from soft_throw_ros.recording.timeseries import Values


class RecommendationPanel:
    """
    Table and map below the root of a twin.

    The executor computes the maps, which may take a second each.
    """

    def __init__(self, canvas: drawing.Canvas, root: str, executor: Executor) -> None:
        self._canvas = canvas
        self._root = root
        self._executor = executor
        self._recommended_for: Rig | None = None
        self._values: Values = {}  # of the last recommendation
        self._map_rig: Rig | None = None
        self._maps: list[tuple[int, Future[EnergyMap]]] = []  # with their stamps [ns]

    def change_rig(self, stamp: int, rig: Rig, settings: Settings) -> None:
        """Request the map of a rig, unless its recommendation has done so before."""
        if self._map_rig != rig:
            self._request_map(stamp, rig, settings)

    def draw(
        self, stamp: int, message: str, values: Values, rig: Rig | None, settings: Settings
    ) -> None:
        """Draw a recommendation, and request the map of its rig if that is known."""
        self._recommended_for, self._values = rig, values
        text = words.recommendation_text(message, values)
        self._canvas.log_text(f'{self._root}/recommendation', stamp, text)
        if rig is not None:
            self._request_map(stamp, rig, settings)

    def draw_maps(self, *, is_waiting: bool) -> None:
        """Draw the maps that are complete; with `is_waiting` wait for all."""
        while self._maps and (is_waiting or self._maps[0][1].done()):
            stamp, future = self._maps.pop(0)
            image = drawing.encoded_image(charts.to_png(future.result().draw()))
            self._canvas.log_latched(f'{self._root}/landscape', stamp, image)

    def _request_map(self, stamp: int, rig: Rig, settings: Settings) -> None:
        """Compute a map in the background; the last requested one is shown last."""
        values = self._values
        if self._recommended_for not in (None, rig):
            values = {}
            text = words.UNKNOWN_BEST  # the recommendation was of another rig
            self._canvas.log_text(f'{self._root}/recommendation', stamp, text)
        self._map_rig = rig
        stamp = max([stamp, *(earlier for earlier, _ in self._maps)])
        future = self._executor.submit(compute_energy_map, rig, settings, values)
        self._maps.append((stamp, future))
