# SPDX-License-Identifier: Apache-2.0
"""What layer to recommend for the present settings, or why none."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from diagnostic_msgs.msg import DiagnosticStatus
from soft_throw_ros.configuration import rig_of, Settings, TWIN
from soft_throw_ros.core.rig import Rig, STANDARD_GRAVITY
from soft_throw_ros.design.recommendation import recommend, Recommendation
from soft_throw_ros.nodes.conversions import rig_to_values, status_to_msg

RESULTS = tuple(entry.name.partition('.')[2] for entry in TWIN.entries if entry.is_result)
"""What `recommended.*` shows of a recommendation."""


@dataclass(frozen=True, kw_only=True)
class Advice:
    """
    A recommendation, and what it is for.

    Parameters
    ----------
    settings : mapping of str to value
        What it is for.
    recommendation : Recommendation or None
        None if there is none.
    reason : str
        Why there is none.

    """

    settings: Settings
    recommendation: Recommendation | None = None
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

    def changes(self) -> dict[str, float]:
        """Return the parameters that make the rig what is recommended."""
        vary = self.settings['recommendation.vary']
        names = ('thickness', 'wave_speed') if vary == 'both' else (vary,)
        return {f'layer.{name}': getattr(self.recommendation, name) for name in names}

    def results(self) -> dict[str, float]:
        """Return the parameters `recommended.*` by their last names; none, if none is there."""
        if self.recommendation is None:
            return {}
        return {name: getattr(self.recommendation, name) for name in RESULTS}

    def sentence(self) -> str:
        """Say what the recommended layer would give."""
        best = self.recommendation
        if best is None:
            return f'there is no recommendation: {self.reason}'
        return (
            f'the recommended layer of {1e3 * best.thickness:.4g} mm and '
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
            message=self.sentence() if best is None else best.why,
            values={**values, **rig_to_values(self.rig)},
            level=DiagnosticStatus.ERROR if best is None else DiagnosticStatus.OK,
        )


def matters(name: str) -> bool:
    """Tell whether a parameter matters for what is recommended."""
    entry = TWIN.by_name[name]
    return entry.is_of_rig or entry.group == 'recommendation'


def advise(settings: Settings) -> Advice:
    """Recommend a layer, or say why not."""
    group = {
        name.partition('.')[2]: value
        for name, value in settings.items()
        if name.startswith('recommendation.')
    }
    try:
        return Advice(settings=settings, recommendation=recommend(rig_of(settings), **group))
    except ValueError as error:
        return Advice(settings=settings, reason=str(error))
