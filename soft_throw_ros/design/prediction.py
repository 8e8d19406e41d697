# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Prediction of the first release of one throw, and of its loads."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from soft_throw_ros.core.batch import ThrowUnresolvedError
from soft_throw_ros.core.rig import Rig
from soft_throw_ros.core.throw import throw_many

_OF_LAYER = ('thickness', 'wave_speed', 'density', 'youngs_modulus', 'loss_tangent')


@dataclass(frozen=True, kw_only=True)
class PredictedThrow:
    """First release of a throw, and its loads, with the rig's damping, gravity and loss."""

    thickness: float  # of the layer [m]
    wave_speed: float  # of the layer [m/s]
    density: float  # of the layer [kg/m3]
    youngs_modulus: float  # of the layer [Pa]
    loss_tangent: float  # of the layer [-]
    mass_ratio: float  # projectile over layer mass [-]
    speed_ratio: float  # crossings of the layer per plate period [-]
    ejection_time: float  # since the start of the plate's motion [s]
    ejection_speed: float  # [m/s]
    energy_transfer: float  # square of the ejection speed over the largest of the plate [-]
    peak_strain: float  # largest magnitude anywhere in the layer [-]
    peak_acceleration: float  # of the projectile, largest magnitude [m/s2]
    peak_plate_force: float  # of the layer on the plate, largest magnitude [N]
    plate_work: float  # up to the release, which an actuator has to deliver [J]
    kinetic_energy: float  # of the projectile at the release [J]

    def values(self) -> dict[str, float | str | bool]:
        """Return everything by name, with a dot between the name of a part and of its value."""
        return flat_values(vars(self))


def predict(rig: Rig) -> PredictedThrow:
    """
    Predict one throw of a rig.

    Examples
    --------
    >>> throw = predict(Rig())
    >>> round(1e3 * throw.ejection_time, 3), round(throw.energy_transfer, 3)
    (7.647, 3.637)
    >>> f'{throw.peak_strain:.1%}, {throw.peak_acceleration / 9.81:.0f} g'
    '11.6%, 40 g'

    """
    layer, throws = rig.layer, throw_many(rig, loads=True)
    if not throws.ejection_speed > 0.0:
        raise ThrowUnresolvedError(
            f'the projectile does not leave: mass ratio {rig.mass_ratio:g}, speed ratio '
            f'{rig.speed_ratio:g}, gravity {rig.gravity_ratio:g} of the largest acceleration'
        )
    return PredictedThrow(
        **{name: getattr(layer, name) for name in _OF_LAYER},
        mass_ratio=rig.mass_ratio,
        speed_ratio=rig.speed_ratio,
        **{name: float(getattr(throws, name)) for name in throws._fields if name != 'status'},
        kinetic_energy=0.5 * rig.projectile.mass * float(throws.ejection_speed) ** 2,
    )


def gain_text(gain: float) -> str:
    """Describe a relative gain of energy."""
    if gain >= 0.95:
        return f'{1.0 + gain:.3g} times the energy'
    return f'{100.0 * abs(gain):.2g} % {"more" if gain >= 0.0 else "less"} energy'


def flat_values(record: Mapping[str, Any]) -> dict[str, Any]:
    """Return the values of a record, and those of its parts with the name of the part before."""
    flat: dict[str, Any] = {}
    for name, value in record.items():
        parts = value._asdict() if hasattr(value, '_asdict') else value
        parts = vars(parts) if isinstance(parts, PredictedThrow) else parts
        if isinstance(parts, Mapping):
            flat |= {f'{name}.{key}': item for key, item in parts.items()}
        elif isinstance(parts, (bool, float, str)):
            flat[name] = parts
    return flat
