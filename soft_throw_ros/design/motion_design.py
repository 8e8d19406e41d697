# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Design of the plate's motion, compared with other throws of the same actuator."""

from __future__ import annotations

from collections.abc import Mapping
import contextlib
from dataclasses import dataclass, replace
import math

import numpy as np
from soft_throw_ros.core.closed_form import ThrowUnresolvedError
from soft_throw_ros.core.plate import motion_of, PlateMotion, SampledMotion
from soft_throw_ros.core.rig import Engine, Rig
from soft_throw_ros.core.throw import Throw
from soft_throw_ros.core.throws import (
    Cancelled,
    rig_with,
    throw_many,
)
from soft_throw_ros.design.objective import Limits
from soft_throw_ros.design.plate_motion import (
    find_best_motion,
    first_stroke,
    follow,
    linear_layer,
    PlateLimits,
    Pulses,
    rest_to_rest,
)
from soft_throw_ros.design.prediction import predict, PredictedThrow
from soft_throw_ros.design.recommendation import recommend

_FREQUENCIES = np.geomspace(0.05, 20.0, 1200)
"""Frequencies of harmonic motions that are tried, in parts of the rig's. [-]"""


@dataclass(frozen=True, kw_only=True)
class MotionDesign(PredictedThrow):
    """The best motion of the plate, and its throw."""

    rig: Rig
    """The rig with the best motion."""
    limits: PlateLimits
    """Limits of the actuator."""
    others: Mapping[str, Rig]
    """
    Rigs for comparison; rigs without a release are missing.

    The present rig (`now`), the rigs with the best `harmonic` stroke and the best `step` within
    the same limits of plate and loads, the best `layer` for the present motion unless the layer
    is a stack, and a `linear` layer with the best motion if the layer is not linear.
    """
    throws: Mapping[str, PredictedThrow]
    """
    Throws of the rigs for comparison, and the `best` throw.

    The `best` throw is never slower than `harmonic` and `step`.
    """
    layer: str = ''
    """Empty: the layer is not from a library."""

    @property
    def motion(self) -> SampledMotion:
        """Designed motion of the plate."""
        assert self.rig.engine.motion is not None
        return self.rig.engine.motion

    @property
    def motions(self) -> dict[str, PlateMotion]:
        """Motion of the plate in each case; the best one last."""
        shown = [name for name in ('now', 'harmonic', 'step') if name in self.others]
        result = {name: motion_of(self.others[name].engine) for name in shown}
        return {**result, 'best': self.motion}

    def values(self) -> dict[str, float | str | bool]:
        """Return everything by name, with a dot between the name of a part and of its value."""
        return super().values() | {
            f'{name}.{key}': value
            for name, throw in self.throws.items() if name != 'best'
            for key, value in vars(throw).items()
        }


def design_motion(
    rig: Rig,
    plate: PlateLimits | None = None,
    *,
    limits: Limits | None = None,
    cancelled: Cancelled | None = None,
) -> MotionDesign:
    """
    Find the best motion of the plate.

    Parameters
    ----------
    rig : Rig
        The present rig.
    plate : PlateLimits, optional
        Limits of the actuator; those of its present motion if not given.
    limits, cancelled : optional
        As for `recommend`; the strain of the layer and the acceleration count.

    Raises
    ------
    ThrowUnresolvedError
        If no throw within the limits releases the projectile.
    SearchCancelledError
        If `cancelled` returns True.

    Examples
    --------
    >>> design = design_motion(Rig(gravity=0.0))
    >>> round(design.kinetic_energy / design.throws['now'].kinetic_energy, 2)
    1.15

    """
    plate, limits = plate or PlateLimits.of(rig.engine), limits or Limits()
    motions = _motions(rig, plate, limits, cancelled)
    own = motions.pop('best')
    rigs = {'now': rig} | {name: throw.rig for name, throw in motions.items() if name != 'now'}
    if rig.layer.is_uniform:
        with contextlib.suppress(ThrowUnresolvedError):
            rigs['layer'] = recommend(rig, limits=limits, cancelled=cancelled).rig
    result = {'best': own.rig}
    best = own.rig
    if rig.layer.stress_strain_law != 'linear':
        rigs['linear'] = replace(best, layer=linear_layer(best.layer))
    throws = {}
    for name, candidate in (rigs | result).items():
        with contextlib.suppress(ThrowUnresolvedError):
            throws[name] = predict(candidate)
    return MotionDesign(
        **vars(throws['best']),
        rig=best,
        limits=plate,
        others={name: other for name, other in rigs.items() if name in throws},
        throws=throws,
    )


def _speed(throw: Throw) -> float:
    return throw.ejection_speed


def _motions(
    rig: Rig, plate: PlateLimits, loads: Limits, cancelled: Cancelled | None
) -> dict[str, Throw]:
    """Simulate the simple motions that keep all limits, and the best motion of all."""
    motions = {
        'now': first_stroke(rig.engine),
        'harmonic': first_stroke(_harmonic(rig, plate, loads, cancelled)),
        'step': _step(rig, plate),
    }
    followed = {
        name: follow(rig, pulses.within(plate), loads=loads)
        for name, pulses in motions.items()
    }
    throws = {name: throw for name, throw in followed.items() if throw is not None}
    best = list(throws.values())
    try:
        best.append(find_best_motion(rig, plate, loads=loads, cancelled=cancelled))
    except ThrowUnresolvedError:
        if not throws:
            raise
    return throws | {'best': max(best, key=_speed)}


def _harmonic(
    rig: Rig, plate: PlateLimits, loads: Limits, cancelled: Cancelled | None
) -> Engine:
    """Return the engine whose harmonic motion within the limits throws best."""
    frequency = rig.engine.frequency * _FREQUENCIES
    omega = 2.0 * math.pi * frequency
    amplitude = np.min(
        [
            plate.speed / omega,
            plate.acceleration / omega**2,
            plate.jerk / omega**3,
            np.full(omega.shape, 0.5 * plate.travel),
        ],
        axis=0,
    )
    growth = _FREQUENCIES if rig.layer.loss == 'kelvin_voigt' else np.ones(omega.size)
    changes = {
        'frequency': frequency,
        'amplitude': amplitude,
        'loss_tangent': rig.layer.loss_tangent * growth,
    }
    harmonic = replace(rig, engine=replace(rig.engine, damping_ratio=0.0, motion=None))
    throws = throw_many(harmonic, changes, loads=loads.of_loads, cancelled=cancelled)
    speed = throws.ejection_speed
    if loads.of_loads:  # scale the amplitude down to the limits
        excess = np.maximum(
            throws.peak_strain / loads.max_strain,
            throws.peak_acceleration / loads.max_acceleration,
        )
        speed = speed / np.maximum(excess, 1.0)
    best = int(np.nan_to_num(speed).argmax())
    return rig_with(
        harmonic, {name: float(values[best]) for name, values in changes.items()}
    ).engine


def _step(rig: Rig, plate: PlateLimits) -> Pulses:
    """Return the fastest step of a plate within the limits."""
    wait = 3.0 * rig.crossing_time + 1.0 / rig.natural_frequency
    travel = min(plate.travel, plate.speed * (2.0 * plate.rise_time + wait))
    return rest_to_rest(plate, travel=travel)
