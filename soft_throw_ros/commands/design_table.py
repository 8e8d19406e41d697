# SPDX-License-Identifier: Apache-2.0
"""Predictions side by side, for people to read, and whole for programs."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import asdict, is_dataclass
import json
import math
from typing import Any

from soft_throw_ros.commands.options import OPTIONS, Row, write_columns
from soft_throw_ros.configuration import Settings
from soft_throw_ros.core.rig import Rig, STANDARD_GRAVITY
from soft_throw_ros.design.recommendation import PredictedThrow
from soft_throw_ros.design.requests import uncertainties_of
from soft_throw_ros.design.uncertainty import prediction_uncertainty

_ROWS = (
    Row('amplitude', 'amplitude A', 'mm', 1e3),
    Row('thickness', 'thickness L_s', 'mm', 1e3),
    Row('wave_speed', 'wave speed c_s', 'm/s'),
    Row('density', 'density', 'kg/m3'),
    Row('youngs_modulus', 'modulus', 'kPa', 1e-3),
    Row('loss_tangent', 'loss tangent'),
    Row('mass_ratio', 'mu'),
    Row('speed_ratio', 'kappa'),
    Row('ejection_time', 'ejection time t_e', 'ms', 1e3),
    Row('ejection_speed', 'ejection speed V_e', 'm/s'),
    Row('energy_transfer', 'energy transfer alpha'),
    Row('speed', 'speed of last release', 'm/s'),
    Row('height', 'rise above the layer', 'mm', 1e3),
    Row('peak_strain', 'peak strain', '%', 1e2),
    Row('peak_acceleration', 'peak acceleration', 'm/s2'),
    Row('peak_acceleration', '  in g', 'g', 1.0 / STANDARD_GRAVITY),
    Row('peak_force', 'peak force on plate', 'N'),
    Row('plate_work', 'work of the plate', 'mJ', 1e3),
    Row('kinetic_energy', '  to the projectile', 'mJ', 1e3),
)


def prediction_lines(
    predictions: Mapping[str, PredictedThrow | None], *, max_strain: float
) -> Iterator[str]:
    """
    Write predictions side by side.

    Parameters
    ----------
    predictions : mapping of str to PredictedThrow or None
        Under which head stands what; the second one is what is proposed.
    max_strain : float
        Beyond it the layer is no longer linear. [-]

    Yields
    ------
    str
        Line by line.

    """
    columns = {head: vars(each) if each else None for head, each in predictions.items()}
    yield from write_columns(_ROWS, columns)
    beyond = [
        head.replace('_', ' ')
        for head, each in predictions.items()
        if each is not None and each.peak_strain > max_strain
    ]
    if beyond:
        yield (
            f'Strain beyond {1e2 * max_strain:.3g} % leaves the linear range '
            f'({", ".join(beyond)}): a real layer will do otherwise.'
        )


def uncertainty_line(rig: Rig, settings: Settings) -> str:
    """Say how far the first release of a rig may be off."""
    uncertainty = prediction_uncertainty(rig, uncertainties_of(settings))
    return f'From what is uncertain (--uncertain-...): {uncertainty.describe()}'


def to_json(settings: Settings, rig: Rig, **parts: Any) -> str:
    """
    Write all that is known as one object.

    Parameters
    ----------
    settings : mapping of str to value
        What was asked for; written as `parameters`.
    rig : Rig
        What is proposed; how far its first release may be off is written as `uncertainty`.
    **parts : object
        What else there is, dataclasses among it. What is not finite becomes null.

    """
    asked = {
        name: value
        for name, value in settings.items()
        if name in OPTIONS or name.startswith(('recommendation.', 'uncertainty.'))
    }
    uncertainty = prediction_uncertainty(rig, uncertainties_of(settings))
    whole = {'parameters': asked, **parts, 'uncertainty': uncertainty.values()}
    return json.dumps(_plain(whole), indent=2, allow_nan=False) + '\n'


def _plain(value: Any) -> Any:
    """Make of a value what JSON can write."""
    if is_dataclass(value) and not isinstance(value, type):
        return _plain(asdict(value))
    if isinstance(value, Mapping):
        return {key: _plain(part) for key, part in value.items()}
    if isinstance(value, (list, tuple)):
        return [_plain(part) for part in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value
