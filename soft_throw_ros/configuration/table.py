# SPDX-License-Identifier: Apache-2.0
"""
The one table of parameters: names, defaults, ranges and meanings, and nothing else.

Whatever knows a parameter takes it from here: the node's descriptors and checks, parameter
files, `config/twin.yaml` and the README's table.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
import difflib
import math
from typing import Any, TypeAlias

from soft_throw_ros.core.rig import Rig

Value: TypeAlias = float | int | str

CUSTOM = 'custom'
"""Name of a layer that is none of `LAYERS`."""

LAYERS: Mapping[str, Mapping[str, float]] = {
    f'gelatin_{1e3 * thickness:.1f}mm': {
        'layer.thickness': thickness,
        'layer.wave_speed': 7.8,
        'layer.density': 1000.0,
        'layer.diameter': 12e-3,
        'layer.loss_tangent': 0.0,
    }
    for thickness in (2.0e-3, 5.6e-3, 9.5e-3, 16.8e-3, 23.4e-3, 29.1e-3)
}
"""The paper's gelatin layers: what choosing `layer.name` sets."""


class ParameterError(ValueError):
    """
    A parameter was refused.

    Parameters
    ----------
    message : str
        What was given and what would be right, in one line.
    *names : str
        The parameters concerned, the one to blame first.

    """

    def __init__(self, message: str, *names: str) -> None:
        super().__init__(message)
        self.names = names


@dataclass(frozen=True, kw_only=True)
class Entry:
    """
    One row of the table.

    Parameters
    ----------
    name : str
        Full name; the part before the first dot is its group.
    default : float, int or str
        Its type is the parameter's type.
    meaning : str
        One sentence, without full stop.
    unit : str
        SI, empty if there is none.
    low, high : float
        Smallest and largest number allowed.
    or_zero : bool
        Whether 0 is allowed besides.
    choices : tuple of str
        The texts allowed.
    hint : str
        What to add when a value is refused.

    """

    name: str
    default: Value
    meaning: str
    unit: str = ''
    low: float = -math.inf
    high: float = math.inf
    or_zero: bool = False
    choices: tuple[str, ...] = ()
    hint: str = ''

    @property
    def group(self) -> str:
        """What comes before the first dot."""
        return self.name.partition('.')[0]

    @property
    def is_result(self) -> bool:
        """Whether the twin sets it, and nobody else may."""
        return self.group == 'recommended'

    @property
    def is_of_rig(self) -> bool:
        """Whether a change waits for the next throw: a wave fits no other layer."""
        return self.group in ('engine', 'layer', 'projectile', 'gravity', 'model')

    @property
    def rule(self) -> str:
        """What is allowed, to stand after 'must be'."""
        if self.is_result:
            return 'set by the twin'
        if self.choices:
            return f'{"one of " * (len(self.choices) > 1)}{", ".join(map(repr, self.choices))}'
        if self.low == self.high:
            return f'{self.low:g}'
        kind = 'a whole number' if isinstance(self.default, int) else 'a number'
        unit = f' {self.unit}' if self.unit else ''
        zero = ', or 0' if self.or_zero else ''
        return f'{kind} from {self.low:g} to {self.high:g}{unit}{zero}'

    def allows(self, value: Any) -> bool:
        """Tell whether `value` obeys the rule; a whole number is taken for a float."""
        if self.choices:
            return isinstance(value, str) and value in self.choices
        numbers = int if isinstance(self.default, int) else (int, float)
        if isinstance(value, bool) or not isinstance(value, numbers):
            return False
        return self.low <= value <= self.high or (self.or_zero and value == 0)


_RIG = Rig()
_THICKNESS = {'unit': 'm', 'low': 0.5e-3, 'high': 0.1}
_WAVE_SPEED = {'unit': 'm/s', 'low': 1.0, 'high': 200.0}


def _row(name: str, default: Value, meaning: str, **rest: Any) -> Entry:
    return Entry(name=name, default=default, meaning=meaning, **rest)


TABLE: tuple[Entry, ...] = (
    _row('engine.motion', 'underdamped',
         'How the plate moves: a damped step (D2), or A (1 - cos wt) without damping (Eq. 1)',
         choices=('underdamped', 'harmonic'),
         hint="'measured' needs plate measurements as input, which this version does not take"),
    _row('engine.frequency', _RIG.engine.frequency, 'Natural frequency f of the plate',
         unit='Hz', low=1.0, high=1000.0),
    _row('engine.amplitude', _RIG.engine.amplitude, 'Height A at which the plate settles',
         unit='m', low=1e-5, high=0.1),
    _row('engine.damping_ratio', _RIG.engine.damping_ratio,
         'Damping ratio of the plate, 0 when the motion is harmonic', low=0.0, high=0.99),
    _row('layer.name', 'gelatin_16.8mm',
         "One of the paper's layers, which sets all of `layer.*`; `custom` after any other change",
         choices=(CUSTOM, *LAYERS)),
    _row('layer.thickness', _RIG.layer.thickness, 'Thickness L_s of the layer', **_THICKNESS),
    _row('layer.wave_speed', _RIG.layer.wave_speed,
         'Wave speed c_s; the modulus is density times its square', **_WAVE_SPEED),
    _row('layer.density', _RIG.layer.density, 'Density rho_s of the layer',
         unit='kg/m3', low=50.0, high=5000.0),
    _row('layer.diameter', _RIG.layer.diameter, 'Diameter of the layer',
         unit='m', low=1e-3, high=0.2),
    _row('layer.loss_tangent', _RIG.layer.loss_tangent, 'Internal loss of the layer',
         low=0.0, high=0.0,
         hint='internal loss needs the finite-difference model, which this version has not'),
    _row('projectile.mass', _RIG.projectile.mass, 'Mass m of the projectile',
         unit='kg', low=1e-5, high=1.0),
    _row('projectile.length', _RIG.projectile.length,
         'Length L_r of the projectile; shown only, since it is rigid',
         unit='m', low=1e-4, high=0.5),
    _row('projectile.youngs_modulus', _RIG.projectile.youngs_modulus,
         'Modulus E_r of the projectile; shown only, since it is rigid',
         unit='Pa', low=1e6, high=1e12),
    _row('gravity', _RIG.gravity, 'Gravity, towards the plate', unit='m/s2', low=0.0, high=30.0),
    _row('model', 'travelling_wave', 'Model of the layer', choices=('travelling_wave',),
         hint='no other model runs in real time in this version'),
    _row('throw.period', 1.0, 'Time from one throw to the next; 0 throws only when asked',
         unit='s', low=0.05, high=3600.0, or_zero=True),
    _row('throw.max_events', 20,
         'Contacts after which a throw is over; a lossless bounce has no end',
         low=1, high=1000),
    _row('rate.state', 1000.0, 'Rate of `~/joint_states`', unit='Hz', low=10.0, high=5000.0),
    _row('rate.field', 50.0, 'Rate of `~/layer/strain` and `~/layer/velocity`, at most rate.state',
         unit='Hz', low=0.1, high=1000.0),
    _row('time_scale', 1.0, 'Time of the rig over time of the clock; 0.01 is slow motion',
         low=1e-4, high=10.0),
    _row('max_strain', 0.1, 'Strain beyond which the layer is reported as no longer linear',
         low=1e-3, high=1.0),
    _row('recommendation.objective', 'peak', 'What to look for: the most energy per throw',
         choices=('peak',), hint='no other objective is in this version'),
    _row('recommendation.vary', 'both', 'What of the layer may be changed',
         choices=('thickness', 'wave_speed', 'both')),
    _row('recommendation.thickness_min', 1e-3, 'Thinnest layer to consider', **_THICKNESS),
    _row('recommendation.thickness_max', 50e-3, 'Thickest layer to consider', **_THICKNESS),
    _row('recommendation.wave_speed_min', 1.0, 'Slowest wave to consider', **_WAVE_SPEED),
    _row('recommendation.wave_speed_max', 50.0, 'Fastest wave to consider', **_WAVE_SPEED),
    _row('recommended.thickness', math.nan, 'Best thickness', unit='m'),
    _row('recommended.wave_speed', math.nan, 'Best wave speed', unit='m/s'),
    _row('recommended.youngs_modulus', math.nan, 'Modulus of the best layer', unit='Pa'),
    _row('recommended.mass_ratio', math.nan, 'Projectile over layer mass, mu, of the best layer'),
    _row('recommended.speed_ratio', math.nan, 'c_s / (L_s f), kappa, of the best layer'),
    _row('recommended.energy_transfer', math.nan, 'Energy transfer factor alpha it gives'),
    _row('recommended.ejection_time', math.nan, 'Ejection time t_e it gives', unit='s'),
    _row('recommended.ejection_speed', math.nan, 'Ejection speed V_e it gives', unit='m/s'),
    _row('recommended.peak_strain', math.nan, 'Largest strain of the layer it gives'),
    _row('recommended.peak_acceleration', math.nan,
         'Largest acceleration of the projectile it gives', unit='m/s2'),
    _row('recommended.peak_force', math.nan, 'Largest force on the plate it gives', unit='N'),
    _row('recommended.plate_work', math.nan, 'Work of the plate in one throw it takes', unit='J'),
)  # fmt: skip

BY_NAME: Mapping[str, Entry] = {entry.name: entry for entry in TABLE}

_DERIVED = {
    'layer.youngs_modulus': 'the modulus is density times wave speed squared: '
    'set layer.wave_speed',
}


def _unknown(name: str) -> ParameterError:
    close = difflib.get_close_matches(name, BY_NAME, n=1)
    advice = _DERIVED.get(name) or (f'did you mean {close[0]}?' if close else '')
    return ParameterError(f'no parameter is named {name!r}' + (advice and f'; {advice}'), name)


def check_value(name: str, value: Any) -> Value:
    """
    Return `value` in the parameter's own type.

    Parameters
    ----------
    name : str
        Full name of a parameter.
    value : float, int or str
        A whole number is taken for a float, nothing else is converted.

    Raises
    ------
    ParameterError
        If there is no such parameter, it is a result, or the value is of another type, not
        finite, out of range or not among the choices.

    Examples
    --------
    >>> check_value('throw.period', 2)
    2.0
    >>> check_value('layer.thickness', 16.8)
    Traceback (most recent call last):
    soft_throw_ros.configuration.table.ParameterError: layer.thickness must be a number from \
0.0005 to 0.1 m, got 16.8

    """
    entry = BY_NAME.get(name)
    if entry is None:
        raise _unknown(name)
    if entry.is_result:
        source = name.replace('recommended.', 'layer.')
        setting = f'set {source} or ' if source in BY_NAME else ''
        raise ParameterError(
            f'{name} is a result; {setting}call ~/apply_recommendation (got {value!r})', name
        )
    if not entry.allows(value):
        hint = f'; {entry.hint}' if entry.hint else ''
        raise ParameterError(f'{name} must be {entry.rule}, got {value!r}{hint}', name)
    return type(entry.default)(value)
