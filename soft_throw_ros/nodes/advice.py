# SPDX-License-Identifier: Apache-2.0
"""What layer to recommend for the present settings, or why none."""

from __future__ import annotations

from dataclasses import dataclass
import functools
from typing import Any

from diagnostic_msgs.msg import DiagnosticStatus
from soft_throw_ros.configuration import rig_of, Settings, TWIN
from soft_throw_ros.configuration.layers import library
from soft_throw_ros.core.rig import Rig, STANDARD_GRAVITY
from soft_throw_ros.design.aiming import Aim
from soft_throw_ros.design.requests import Answer, answer, uncertainties_of
from soft_throw_ros.design.uncertainty import (
    prediction_uncertainty,
    PredictionUncertainty,
    Uncertainties,
)
from soft_throw_ros.nodes.conversions import rig_to_values, status_to_msg

RESULTS = tuple(entry.name.partition('.')[2] for entry in TWIN.entries if entry.is_result)
"""What `recommended.*` shows of a recommendation."""


@dataclass(frozen=True, kw_only=True)
class Advice:
    """
    A recommendation, or an aim, and what it is for.

    Parameters
    ----------
    settings : mapping of str to value
        What it is for.
    recommendation : Recommendation, Aim or None
        None if there is none.
    reason : str
        Why there is none.

    """

    settings: Settings
    recommendation: Answer | None = None
    reason: str = ''

    @property
    def rig(self) -> Rig:
        """What it is for."""
        return rig_of(self.settings)

    def is_for(self, settings: Settings) -> bool:
        """Tell whether it is for these settings as well."""
        return all(
            value == settings[name] for name, value in self.settings.items() if matters(name)
        )

    def changes(self) -> dict[str, float | str]:
        """Return the parameters that make the rig what is recommended."""
        best = self.recommendation
        if best is None:
            return {}
        changes: dict[str, float | str] = {}
        if isinstance(best, Aim):
            changes['engine.amplitude'] = best.amplitude
        if best.layer:
            changes['layer.name'] = best.layer
            known = library(self.settings['layer.library']).layers[best.layer]
            if 'layer.thickness' not in known:
                changes['layer.thickness'] = best.thickness
            return changes
        if best.vary in ('thickness', 'both'):
            changes['layer.thickness'] = best.thickness
        if best.vary in ('wave_speed', 'both'):
            changes['layer.wave_speed'] = best.wave_speed
        return changes

    def results(self) -> dict[str, float | str]:
        """Return the parameters `recommended.*` by their last names; none, if none is there."""
        best = self.recommendation
        return {name: getattr(best, name) for name in RESULTS if hasattr(best, name)}

    def sentence(self) -> str:
        """Say what the recommended layer would give."""
        best = self.recommendation
        if best is None:
            return f'there is no recommendation: {self.reason}'
        if isinstance(best, Aim):
            return best.summary
        name = f'{best.layer}, ' if best.layer else ''
        return (
            f'the recommended layer of {name}{1e3 * best.thickness:.4g} mm and '
            f'{best.wave_speed:.4g} m/s would give alpha {best.energy_transfer:.3f}'
        )

    def to_status(self, *, name: str, hardware_id: str) -> DiagnosticStatus:
        """Make a status of it, with the rig that it is for."""
        best = self.recommendation
        values: dict[str, Any] = {}
        if best is not None:
            values = {'g_load': best.peak_acceleration / STANDARD_GRAVITY, **best.values()}
        return status_to_msg(
            name,
            hardware_id=hardware_id,
            message=self.sentence() if best is None else best.summary,
            values={**values, **rig_to_values(self.rig)},
            level=self._level,
        )

    @property
    def _level(self) -> bytes:
        best = self.recommendation
        level: bytes = DiagnosticStatus.OK
        if best is None:
            level = DiagnosticStatus.ERROR
        elif isinstance(best, Aim) and not best.is_reached:
            level = DiagnosticStatus.WARN
        return level


def matters(name: str) -> bool:
    """Tell whether a parameter matters for what is recommended."""
    entry = TWIN.by_name[name]
    return entry.is_of_rig or entry.group in ('recommendation', 'uncertainty')


def advise(settings: Settings) -> Advice:
    """Recommend a layer, or aim, or say why not."""
    try:
        return Advice(settings=settings, recommendation=answer(settings))
    except ValueError as error:
        return Advice(settings=settings, reason=str(error))


def uncertainty_of(rig: Rig, settings: Settings) -> PredictionUncertainty | None:
    """Find how far a rig's throw may be off; None for a model that has no releases of its own."""
    if settings['model'] not in _RELEASED:
        return None
    return _uncertainty(rig, uncertainties_of(settings))


_RELEASED = ('travelling_wave', 'finite_difference', 'finite_difference_elastic')
"""Models whose first release is that of waves in the layer, or differs by 1e-5."""


@functools.lru_cache(maxsize=4)
def _uncertainty(rig: Rig, uncertainties: Uncertainties) -> PredictionUncertainty | None:
    try:
        return prediction_uncertainty(rig, uncertainties)
    except ValueError:
        return None
