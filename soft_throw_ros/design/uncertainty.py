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
r"""
What the uncertainties of a rig make of a prediction.

Notes
-----
Ejection time and energy transfer jump where the release passes 3, 5, 7 ... crossings of the wave,
so that no derivative tells how far they may be off. Instead throws are computed for rigs all over
the uncertainties: a sequence of points that fills the unit cube evenly [1]_, always the same one.
Between its bounds every value is taken as equally likely.

References
----------
.. [1] The additive recurrence by powers of the root of :math:`x^{d + 1} = x + 1`, a
   generalisation of the golden section. M. Roberts, "The unreasonable effectiveness of
   quasirandom sequences" (2018).

"""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from soft_throw_ros.core import checks
from soft_throw_ros.core.closed_form import ThrowUnresolvedError
from soft_throw_ros.core.rig import Rig
from soft_throw_ros.design.evaluate import Cancelled, first_throws, SEARCH_CELLS

Floats = NDArray[np.float64]

COVERAGE = 0.95
"""Part of the throws that lies in an `Interval`."""

_SAMPLE = 1000
_JUMP = 0.1  # of the range of ejection times: a gap without any
_ROOT = 1.1347241384015194  # of x^6 = x + 1, for the five things that are uncertain


class Variants(NamedTuple):
    """
    Throws in which a rig differs from what it is: arrays of one shape.

    Mass [kg], frequency [Hz] and damping ratio are absolute; the errors [m], [m/s] are added to
    thickness and wave speed of whatever layer is looked at.
    """

    mass: Floats
    frequency: Floats
    damping_ratio: Floats
    thickness_error: Floats
    wave_speed_error: Floats

    @classmethod
    def of(cls, rig: Rig) -> Variants:
        """Return the one throw of the rig as it is."""
        engine = rig.engine
        values = (rig.projectile.mass, engine.frequency, engine.damping_ratio, 0.0, 0.0)
        return cls(*(np.array([value]) for value in values))

    def changes(self, thickness: Floats | float, wave_speed: Floats | float) -> dict[str, Floats]:
        """Return what is other than in the rig, for layers of a thickness and wave speed."""
        return {
            'mass': self.mass,
            'frequency': self.frequency,
            'damping_ratio': self.damping_ratio,
            'thickness': thickness + self.thickness_error,
            'wave_speed': wave_speed + self.wave_speed_error,
        }


@dataclass(frozen=True, kw_only=True)
class Uncertainties:
    """
    How far a rig may be off, up or down; the defaults are those of [1]_.

    Parameters
    ----------
    wave_speed, thickness : float
        Of the layer. [m/s], [m]
    mass : float
        Of the projectile, as a part of it; [1]_ gives lengths to 0.1 mm, 1 % of 8.2 mm. [-]
    frequency, damping_ratio : float
        Of the plate. [Hz], [-]

    Raises
    ------
    ValueError
        If a value is negative or not finite, or `mass` is not below 1.

    References
    ----------
    .. [1] "Use of compliant actuators for throwing rigid projectiles", Phys. Rev. E (2022).

    """

    wave_speed: float = 0.3
    thickness: float = 0.1e-3
    mass: float = 0.01
    frequency: float = 0.1
    damping_ratio: float = 0.003

    def __post_init__(self) -> None:
        for name, value in vars(self).items():
            checks.require_not_negative(f'uncertainty.{name}', value)
        checks.require_in_unit_interval('uncertainty.mass', self.mass)

    def variants(self, rig: Rig, offsets: Floats) -> Variants:
        """
        Return n throws of rigs that are off by a part of the uncertainties each.

        Parameters
        ----------
        rig : Rig
            What is uncertain.
        offsets : ndarray, shape (n, 5)
            From -1 to 1, in the order of the fields. [-]

        Raises
        ------
        ValueError
            If a value is as large as what is uncertain.

        """
        for name, uncertain in (
            ('thickness', rig.layer.thickness),
            ('wave_speed', rig.layer.wave_speed),
            ('frequency', rig.engine.frequency),
        ):
            value = getattr(self, name)
            if value >= uncertain:
                raise ValueError(
                    f'uncertainty.{name} must be below the {name.replace("_", " ")} itself, '
                    f'{uncertain:g}, got {value:g}'
                )
        wave_speed, thickness, mass, frequency, damping = offsets.T
        damping_ratio = rig.engine.damping_ratio + self.damping_ratio * damping
        return Variants(
            mass=rig.projectile.mass * (1.0 + self.mass * mass),
            frequency=rig.engine.frequency + self.frequency * frequency,
            damping_ratio=np.clip(damping_ratio, 0.0, 0.999),
            thickness_error=self.thickness * thickness,
            wave_speed_error=self.wave_speed * wave_speed,
        )


def even_offsets(count: int) -> Floats:
    """Return points that fill the cube from -1 to 1 evenly, the middle first: (count, 5)."""
    steps = _ROOT ** -np.arange(1.0, len(fields(Uncertainties)) + 1.0)
    return 2.0 * np.mod(0.5 + np.arange(count)[:, None] * steps, 1.0) - 1.0


class Interval(NamedTuple):
    """Where a predicted value lies, with the probability `COVERAGE`."""

    low: float
    high: float

    @classmethod
    def of(cls, values: Floats) -> Interval:
        """Leave out as much at one end as at the other."""
        rest = 0.5 * (1.0 - COVERAGE)
        low, high = np.quantile(values, [rest, 1.0 - rest])
        return cls(float(low), float(high))


@dataclass(frozen=True, kw_only=True)
class PredictionUncertainty:
    r"""
    How far a prediction may be off, from the uncertainties of the rig.

    Parameters
    ----------
    ejection_time : Interval
        :math:`t_e`. [s]
    ejection_speed : Interval
        :math:`V_e`, for the amplitude as given: it is off by the same part as that. [m/s]
    energy_transfer : Interval
        :math:`\alpha`. [-]
    jumps : bool
        Whether the release jumps within the uncertainties, so that the throws fall into groups.
    held : float
        Part of the throws in which the projectile does not leave, which are in no interval. [-]

    """

    ejection_time: Interval
    ejection_speed: Interval
    energy_transfer: Interval
    jumps: bool
    held: float

    def describe(self) -> str:
        """Say it for people to read."""
        time, speed, transfer = self.ejection_time, self.ejection_speed, self.energy_transfer
        text = (
            f'{1e3 * time.low:.3f} to {1e3 * time.high:.3f} ms, '
            f'{speed.low:.4f} to {speed.high:.4f} m/s, '
            f'alpha {transfer.low:.3f} to {transfer.high:.3f}'
        )
        if self.jumps:
            text += ', with a jump between'
        if self.held > 0.0:
            text += f'; in {100.0 * self.held:.2g} % of all cases it does not leave'
        return text

    def values(self) -> dict[str, float | bool]:
        """Return everything by name, with a dot between the name of an interval and its end."""
        flat: dict[str, float | bool] = {}
        for name, value in vars(self).items():
            if isinstance(value, Interval):
                flat[f'{name}.low'], flat[f'{name}.high'] = value
            else:
                flat[name] = value
        return flat


def prediction_uncertainty(
    rig: Rig,
    uncertainties: Uncertainties | None = None,
    *,
    cancelled: Cancelled | None = None,
) -> PredictionUncertainty:
    """
    Find how far the first release of a throw may be off.

    Parameters
    ----------
    rig : Rig
        What throws.
    uncertainties : Uncertainties, optional
        How far the rig may be off; by default as the paper's.
    cancelled : callable, optional
        Asked between batches of throws.

    Raises
    ------
    ValueError
        If an uncertainty is as large as what is uncertain.
    ThrowUnresolvedError
        If the projectile does not leave in any of the throws.
    SearchCancelledError
        If `cancelled` says so.

    Examples
    --------
    >>> print(prediction_uncertainty(Rig()).describe())
    7.455 to 7.846 ms, 1.3524 to 1.3943 m/s, alpha 3.527 to 3.728

    """
    uncertainties = uncertainties or Uncertainties()
    variants = uncertainties.variants(rig, even_offsets(_SAMPLE))
    changes = variants.changes(rig.layer.thickness, rig.layer.wave_speed)
    throws = first_throws(rig, changes, cells=SEARCH_CELLS, cancelled=cancelled)
    left = throws.ejection_speed > 0.0
    if not left.any():
        raise ThrowUnresolvedError('the projectile does not leave, whatever is uncertain')
    times = throws.ejection_time[left]
    gaps = np.diff(np.sort(times))
    return PredictionUncertainty(
        ejection_time=Interval.of(times),
        ejection_speed=Interval.of(throws.ejection_speed[left]),
        energy_transfer=Interval.of(throws.energy_transfer[left]),
        jumps=bool(gaps.size and gaps.max() > _JUMP * np.ptp(times)),
        held=1.0 - float(left.mean()),
    )
