# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
r"""
Prediction of the first release of one throw, and effect of the uncertainties of a rig on it.

Notes
-----
Ejection time and energy transfer jump where the release passes 3, 5, 7 ... crossings of the wave,
so that no derivative tells how far they may be off. Instead throws are computed for rigs all over
the uncertainties: a sequence of points that fills the unit cube evenly [1]_, always the same one.
Between its bounds every value is taken as equally likely.

References
----------
.. [1] The additive recurrence by powers of the root of :math:`x^{d + 1} = x + 1`: M. Roberts,
   "The unreasonable effectiveness of quasirandom sequences" (2018).

"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields
import itertools
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from soft_throw_ros.configuration import Settings
from soft_throw_ros.core import checks
from soft_throw_ros.core.batch import Cancelled, ThrowUnresolvedError
from soft_throw_ros.core.rig import Rig
from soft_throw_ros.core.throw import SEARCH_CELLS, throw_many, Throws

Floats = NDArray[np.float64]

COVERAGE = 0.95
"""Part of the throws that lies in an `Interval`."""

CORNERS = np.array(list(itertools.product((-1.0, 1.0), repeat=5)))
"""All combinations of the largest errors of the five uncertain values, up and down."""

_SAMPLE, _FEW = 1000, 200  # throws of a prediction, and of a share without a release
_JUMP = 0.1  # part of the range of ejection times that is a jump if it has no throw [-]
_ROOT = np.roots([1.0, *[0.0] * (CORNERS.shape[1] - 1), -1.0, -1.0]).real.max()  # see Notes
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


@dataclass(frozen=True, kw_only=True)
class Uncertainties:
    """Largest errors of a rig, up or down; the defaults are those of the paper."""

    wave_speed: float = 0.3  # of the layer [m/s]
    thickness: float = 0.1e-3  # [m]
    mass: float = 0.01  # relative; the paper gives lengths to 0.1 mm, 1 % of 8.2 mm [-]
    frequency: float = 0.1  # of the plate [Hz]
    damping_ratio: float = 0.003  # [-]

    def __post_init__(self) -> None:
        for name, value in vars(self).items():
            checks.require_all(f'uncertainty.{name}', value, 'not_negative')
        checks.require_all('uncertainty.mass', self.mass, 'in_unit_interval')

    @classmethod
    def from_settings(cls, settings: Settings) -> Uncertainties:
        """Return the uncertainties that the settings of the twin describe."""
        return cls(**{item.name: settings[f'uncertainty.{item.name}'] for item in fields(cls)})

    def variants(self, rig: Rig, offsets: Floats) -> Floats:
        """Return `variants` of a rig with errors: shares from -1 to 1, shape (n, 5)."""
        for name in ('thickness', 'wave_speed', 'frequency'):
            value = getattr(rig.engine if name == 'frequency' else rig.layer, name)
            if getattr(self, name) >= value:
                raise ValueError(
                    f'uncertainty.{name} must be below the {name.replace("_", " ")} itself, '
                    f'{value:g}, got {getattr(self, name):g}'
                )
        errors = np.array(list(vars(self).values()))
        errors[2] *= rig.projectile.mass
        variants: Floats = variant_of(rig) + offsets * errors
        variants[:, 4] = np.clip(variants[:, 4], 0.0, 0.999)
        return variants


def variant_of(rig: Rig) -> Floats:
    """
    Return the nominal variant of a rig, shape (1, 5).

    A variant has errors of the layer's wave speed [m/s] and thickness [m], and values of mass
    [kg], frequency [Hz] and damping ratio [-].
    """
    engine = rig.engine
    return np.array([[0.0, 0.0, rig.projectile.mass, engine.frequency, engine.damping_ratio]])


def changes_of(
    variants: Floats, thickness: Floats | float, wave_speed: Floats | float
) -> dict[str, Floats]:
    """Return the changes of a rig for `throw_many`: variants of layers."""
    speed_error, thickness_error, *values = variants.T
    return {
        'wave_speed': wave_speed + speed_error,
        'thickness': thickness + thickness_error,
        **dict(zip(('mass', 'frequency', 'damping_ratio'), values, strict=True)),
    }


class Interval(NamedTuple):
    """Where a predicted value lies, with the probability `COVERAGE`, half of the rest beside."""

    low: float
    high: float


@dataclass(frozen=True, kw_only=True)
class PredictionUncertainty:
    """Intervals of a prediction, from the uncertainties of the rig."""

    ejection_time: Interval  # [s]
    ejection_speed: Interval  # [m/s]
    energy_transfer: Interval  # [-]
    jumps: bool  # whether the release jumps, so that throws fall into groups
    stuck_fraction: float  # share of the throws without a release, not in the intervals [-]

    def values(self) -> dict[str, float]:
        """Return everything by name, with a dot between the name of an interval and its end."""
        return flat_values(vars(self))

    def __str__(self) -> str:
        jump = ', with a jump between' * self.jumps
        (early, late), (slow, fast), (least, most) = (
            self.ejection_time, self.ejection_speed, self.energy_transfer
        )
        text = (
            f'{1e3 * early:.3f} to {1e3 * late:.3f} ms, {slow:.4f} to {fast:.4f} m/s, '
            f'alpha {least:.3f} to {most:.3f}{jump}'
        )
        if self.stuck_fraction > 0.0:
            text += f'; no release in {100.0 * self.stuck_fraction:.2g} % of all cases'
        return text


def prediction_uncertainty(
    rig: Rig, uncertainties: Uncertainties | None = None, *, cancelled: Cancelled | None = None
) -> PredictionUncertainty:
    """
    Compute the intervals of the first release, by default with the uncertainties of the paper.

    SearchCancelledError follows when `cancelled` returns True.

    Examples
    --------
    >>> low, high = prediction_uncertainty(Rig()).ejection_time
    >>> round(1e3 * low, 3), round(1e3 * high, 3)
    (7.455, 7.846)

    """
    throws = _throws(rig, uncertainties or Uncertainties(), _SAMPLE, cancelled)
    is_released = throws.ejection_speed > 0.0
    if not is_released.any():
        raise ThrowUnresolvedError('the projectile does not leave within the uncertainties')
    ends = 0.5 + 0.5 * COVERAGE * np.array([-1.0, 1.0])
    times = np.sort(throws.ejection_time[is_released])
    return PredictionUncertainty(
        **{
            name: Interval(*np.quantile(getattr(throws, name)[is_released], ends).tolist())
            for name in ('ejection_time', 'ejection_speed', 'energy_transfer')
        },
        jumps=bool(np.diff(times).max(initial=0.0) > _JUMP * np.ptp(times)),
        stuck_fraction=1.0 - float(is_released.mean()),
    )


def stuck_fraction(
    rig: Rig, uncertainties: Uncertainties, *, cancelled: Cancelled | None = None
) -> float:
    """
    Compute the share of the throws within the uncertainties without a release [-].

    It is 0 if an uncertainty is as large as the uncertain value, because then nothing is known.
    """
    if rig.gravity == 0.0:
        return 0.0
    try:
        throws = _throws(rig, uncertainties, _FEW, cancelled)
    except ValueError:
        return 0.0
    return 1.0 - float((throws.ejection_speed > 0.0).mean())


def _throws(
    rig: Rig, uncertainties: Uncertainties, count: int, cancelled: Cancelled | None
) -> Throws:
    """Compute throws that fill the uncertainties evenly, the nominal one first."""
    steps = _ROOT ** -np.arange(1.0, CORNERS.shape[1] + 1.0)
    offsets = 2.0 * np.mod(0.5 + np.arange(count)[:, None] * steps, 1.0) - 1.0
    variants = uncertainties.variants(rig, offsets)
    changes = changes_of(variants, rig.layer.thickness, rig.layer.wave_speed)
    return throw_many(rig, changes, cells=SEARCH_CELLS, cancelled=cancelled)
