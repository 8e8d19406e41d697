# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Recommendations of the twin for its present settings."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
import os
from pathlib import Path
import threading
import traceback
from typing import Any
import zlib

from diagnostic_msgs.msg import DiagnosticStatus
from soft_throw_ros.configuration import motions, rig_values, TWIN
from soft_throw_ros.configuration.layers import library
from soft_throw_ros.configuration.twin_config import TwinConfig
from soft_throw_ros.core.batch import leave_processors, SearchCancelledError
from soft_throw_ros.core.rig import Rig
from soft_throw_ros.design.aiming import Aim
from soft_throw_ros.design.motion import MotionDesign
from soft_throw_ros.design.prediction import prediction_uncertainty, Uncertainties
from soft_throw_ros.design.recommendation import RequestResult, solve_request
from soft_throw_ros.nodes.conversions import status_to_msg
from soft_throw_ros.storage.regular_file import atomic_file
from soft_throw_ros.twin.session import RequestRejected

_INTERVAL = 0.3  # from the end of a search to the next one, so that many requests cost little [s]


@dataclass(frozen=True, kw_only=True)
class RecommendationState:
    """A recommendation or an aim with its configuration, or the reason why there is none."""

    config: TwinConfig
    best: RequestResult | None = None
    reason: str = ''

    def changes(self) -> dict[str, float | str]:
        """Return the changes that apply the recommendation; a motion is saved to a file."""
        best = self.best
        if best is None:
            raise RequestRejected(self.describe())
        if isinstance(best, MotionDesign):
            return {motions.PARAMETER: str(_save_motion(best))}
        if isinstance(best, Aim):
            return {'engine.amplitude': best.amplitude}
        if best.layer:
            known = library(self.config.settings['layer.library']).layers[best.layer]
            thickness = {} if 'layer.thickness' in known else {'layer.thickness': best.thickness}
            return {'layer.name': best.layer, **thickness}
        names = (name for name in ('thickness', 'wave_speed') if best.vary in (name, 'both'))
        return {f'layer.{name}': getattr(best, name) for name in names}

    def results(self) -> dict[str, Any]:
        """Return the parameters `recommended.*`; those without an answer are nan, or empty."""
        defaults: dict[str, Any] = {e.name: e.default for e in TWIN.entries if e.is_result}
        return {
            name: type(default)(getattr(self.best, name.partition('.')[2], default))
            for name, default in defaults.items()
        }

    def describe(self) -> str:
        """Return the recommendation, or the reason why there is none, in one line."""
        return self.best.summary if self.best else f'no recommendation: {self.reason}'

    def to_status(self, node_name: str) -> DiagnosticStatus:
        """Return a diagnostic status with the recommendation and its rig."""
        values = {} if self.best is None else self.best.values()
        level = DiagnosticStatus.ERROR if self.best is None else None
        values |= rig_values(self.config.rig)
        return status_to_msg(node_name, 'recommendation', self.describe(), values, level=level)


def _save_motion(best: MotionDesign) -> Path:
    """Write a motion below ROS_HOME; the name of the file contains the checksum of the motion."""
    text = motions.to_csv(best.motion)
    folder = Path(os.environ.get('ROS_HOME', '~/.ros')).expanduser() / 'soft_throw'
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / f'motion_{zlib.crc32(text.encode()):08x}.csv'
    with atomic_file(path) as unfinished:
        unfinished.write_text(text, encoding='utf-8')
    return path


def affects_recommendation(name: str) -> bool:
    """Return whether a parameter affects the recommendation."""
    entry = TWIN.by_name[name]
    return entry.is_of_rig or entry.group in ('recommendation', 'uncertainty')


class Recommender:
    """
    A thread that computes recommendations and aims, and calls `publish` with each in this thread.

    A newer request cancels all earlier ones. After that it computes the uncertainty of throws of
    the rig.
    """

    def __init__(self, publish: Callable[[RecommendationState], None]) -> None:
        self.request: TwinConfig  # the latest
        self.uncertainty: tuple[Rig | None, dict[str, float]] = None, {}  # of throws of a rig
        self._publish = publish
        self._is_waiting = threading.Event()
        self._is_closing = threading.Event()
        self._thread = threading.Thread(name='worker', target=self._work, daemon=True)
        self._thread.start()

    def submit(self, request: TwinConfig) -> None:
        """Replace all earlier requests by this one."""
        self.request = request
        self._is_waiting.set()

    def close(self, timeout: float) -> None:
        """Cancel everything, and wait at most `timeout` for the thread to end [s]."""
        self._is_closing.set()
        self._is_waiting.set()
        self._thread.join(timeout)

    @leave_processors(1)  # to the thread of the ticks
    def _work(self) -> None:
        while self._is_waiting.wait() and not self._is_closing.is_set():
            self._is_waiting.clear()
            self._serve(self.request)
            self._is_closing.wait(_INTERVAL)

    def _serve(self, config: TwinConfig) -> None:
        """Publish the recommendation for a configuration, then find the uncertainty of its rig."""
        try:
            state = recommend_for(config, self._is_waiting.is_set)
            if not self._is_waiting.is_set():
                self._publish(state)
                self.uncertainty = config.rig, uncertainty_values(config, self._is_waiting.is_set)
        except SearchCancelledError:
            return  # for a newer request
        except Exception as error:  # noqa: BLE001  later requests must still be answered
            traceback.print_exc()
            reason = f'the search has failed: {error!r}'
            self._publish(RecommendationState(config=config, reason=reason))


def recommend_for(config: TwinConfig, cancelled: Callable[[], bool]) -> RecommendationState:
    """Return a recommendation or an aim, or the reason why there is none."""
    best, reason = None, ''
    try:
        best = solve_request(config.settings, rig=config.rig, cancelled=cancelled)
    except ValueError as error:
        reason = str(error)
    return RecommendationState(config=config, best=best, reason=reason)


def uncertainty_values(config: TwinConfig, cancelled: Callable[[], bool]) -> dict[str, float]:
    """Return the uncertainty of a rig's throw, as values of a status."""
    uncertainties = Uncertainties.from_settings(config.settings)
    try:
        uncertainty = prediction_uncertainty(config.rig, uncertainties, cancelled=cancelled)
    except ValueError:
        return {}
    return {f'uncertainty.{name}': value for name, value in uncertainty.values().items()}
