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
"""What layer to recommend for the present settings, or why none."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict, dataclass
import functools
import os
from pathlib import Path
import zlib

from diagnostic_msgs.msg import DiagnosticStatus
from soft_throw_ros.configuration import motions, rig_of, rig_values, Settings, TWIN
from soft_throw_ros.configuration.atomic_file import atomic_file
from soft_throw_ros.configuration.layers import library
from soft_throw_ros.configuration.twin_config import model_of
from soft_throw_ros.core.rig import Rig, STANDARD_GRAVITY
from soft_throw_ros.design.aiming import Aim
from soft_throw_ros.design.evaluate import SearchCancelledError
from soft_throw_ros.design.motion_design import MotionDesign
from soft_throw_ros.design.requests import Answer, answer, uncertainties_of
from soft_throw_ros.design.uncertainty import prediction_uncertainty, Uncertainties
from soft_throw_ros.nodes.conversions import status_to_msg
from soft_throw_ros.twin.other_models import predict_by_other_models

_RESULTS = tuple(entry.name.partition('.')[2] for entry in TWIN.entries if entry.is_result)
"""What `recommended.*` shows of an answer."""


@dataclass(frozen=True, kw_only=True)
class RecommendationFor:
    """A recommendation, or an aim, and the settings that it is for; or why there is none."""

    settings: Settings
    best: Answer | None = None
    reason: str = ''

    @property
    def rig(self) -> Rig:
        """Return what it is for."""
        return rig_of(self.settings)

    def is_for(self, settings: Settings) -> bool:
        """Tell whether it is for these settings as well."""
        return all(
            value == settings[name] for name, value in self.settings.items() if matters(name)
        )

    def changes(self) -> dict[str, float | str]:
        """Return the parameters that make the rig what is recommended; a motion becomes a file."""
        best = self.best
        if best is None:
            return {}
        if isinstance(best, MotionDesign):
            return {motions.PARAMETER: str(_save_motion(best))}
        changes: dict[str, float | str] = {}
        if isinstance(best, Aim):
            changes['engine.amplitude'] = best.amplitude
        if best.layer:
            changes['layer.name'] = best.layer
            known = library(self.settings['layer.library']).layers[best.layer]
            if 'layer.thickness' not in known:
                changes['layer.thickness'] = best.thickness
            return changes
        for name in ('thickness', 'wave_speed'):
            if best.vary in (name, 'both'):
                changes[f'layer.{name}'] = getattr(best, name)
        return changes

    def results(self) -> dict[str, float | str]:
        """Return the parameters `recommended.*` by their last names; none, if none is there."""
        return {name: getattr(self.best, name) for name in _RESULTS if hasattr(self.best, name)}

    def describe(self) -> str:
        """Say in a line what is recommended, or why nothing is."""
        best = self.best
        if best is None:
            return f'there is no recommendation: {self.reason}'
        if isinstance(best, (Aim, MotionDesign)):
            return best.summary
        name = f'{best.layer}, ' if best.layer else ''
        return (
            f'recommended: {name}{1e3 * best.thickness:.4g} mm and {best.wave_speed:.4g} m/s, '
            f'alpha {best.energy_transfer:.3f}'
        )

    def to_status(self, node_name: str) -> DiagnosticStatus:
        """Make a status of it, with the rig that it is for."""
        best, rig = self.best, rig_values(self.rig)
        if best is None:
            return status_to_msg(
                node_name, 'recommendation', self.describe(), rig, level=DiagnosticStatus.ERROR
            )
        values = {'g_load': best.peak_acceleration / STANDARD_GRAVITY, **best.values(), **rig}
        is_missed = isinstance(best, Aim) and not best.is_reached
        return status_to_msg(node_name, 'recommendation', best.summary, values, warn=is_missed)


def _save_motion(best: MotionDesign) -> Path:
    """Write a motion to where ROS keeps its files, under a name that no other motion has."""
    text = '\n'.join(motions.csv_lines(best.motion)) + '\n'
    folder = Path(os.environ.get('ROS_HOME', '~/.ros')).expanduser() / 'soft_throw'
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / f'motion_{zlib.crc32(text.encode()):08x}.csv'
    with atomic_file(path) as unfinished:
        unfinished.write_text(text, encoding='utf-8')
    return path


def matters(name: str) -> bool:
    """Tell whether a parameter matters for what is recommended."""
    entry = TWIN.by_name[name]
    return entry.is_of_rig or entry.group in ('recommendation', 'uncertainty')


def recommend_for(
    settings: Settings, cancelled: Callable[[], bool] = lambda: False
) -> RecommendationFor:
    """Recommend a layer, or aim, or say why not."""
    for error in TWIN.contradictions(settings):  # such as come about by single changes
        if all(name.startswith('recommendation.') for name in error.names):
            return RecommendationFor(settings=settings, reason=str(error))
    try:
        return RecommendationFor(settings=settings, best=answer(settings, cancelled=cancelled))
    except (SearchCancelledError, ValueError) as error:
        return RecommendationFor(settings=settings, reason=str(error))


def uncertainty_values(rig: Rig, settings: Settings) -> dict[str, float]:
    """Return how far a rig's throw may be off, as values of a status."""
    if settings['model'] not in _RELEASED:
        return {}
    return _uncertainty_values(rig, uncertainties_of(settings))


def other_models_values(rig: Rig, settings: Settings) -> dict[str, float]:
    """Return the first release as other models predict it, as values of a status."""
    if rig.engine.motion is not None:
        return {}  # they know the motion of the engine alone
    found = predict_by_other_models(rig, model_of(settings, rig))
    return {
        f'{model}.{name}': value
        for model, release in found.items()
        if release is not None
        for name, value in asdict(release).items()
    }


_RELEASED = ('travelling_wave', 'finite_difference', 'finite_difference_elastic')
"""Models whose first release is that of waves in the layer, or differs by 1e-5."""


@functools.lru_cache(maxsize=4)
def _uncertainty_values(rig: Rig, uncertainties: Uncertainties) -> dict[str, float]:
    try:
        found = prediction_uncertainty(rig, uncertainties)
    except ValueError:
        return {}
    return {f'uncertainty.{name}': value for name, value in found.values().items()}
