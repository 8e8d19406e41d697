# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
The parameters of a fit: which are free, fixed, or known with an error.

Command line, YAML file and Python share this description.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass, field, replace
import math
from operator import attrgetter
from pathlib import Path
from typing import Any, NamedTuple

from soft_throw_ros.configuration.table import float_of
from soft_throw_ros.configuration.yaml_file import read_yaml
from soft_throw_ros.core.rig import Rig
from soft_throw_ros.core.throw import rig_with
from soft_throw_ros.identification.least_squares import Estimate

ENGINE = ('engine.frequency', 'engine.damping_ratio', 'engine.amplitude')
LOSS = 'layer.loss_tangent'
LAYER = ('layer.wave_speed', 'layer.thickness', LOSS)
PARAMETERS = (*ENGINE, *LAYER, 'layer.density', 'layer.diameter', 'projectile.mass')
"""Parameters of a rig that can be fitted, by their names in the twin."""

START, PLATE_ZERO, PROJECTILE_ZERO = 'start_time', 'plate_offset', 'projectile_offset'
OWN = (START, PLATE_ZERO, PROJECTILE_ZERO)
"""Parameters of each throw: the time of its start, and the heights of its bodies at rest."""

DEFAULT_IS_ANOTHER_RIG = tuple(name for name in PARAMETERS if name != LOSS)
"""Parameters whose defaults belong to another rig; the default of the loss is none."""

NUISANCE_PARAMETERS = {
    'plate.drift': 0.0,  # of heights over a record, over the amplitude
    'projectile.drift': 0.0,
    'projectile.scale': 1.0,  # measured over true height
    'projectile.delay': 0.0,  # of its measurement [s]
}
"""Nuisance parameters of a bench, and their values without it."""

DEFAULT_FREE = (*ENGINE, 'layer.wave_speed')
"""Parameters that are fitted by default; the thickness of the layer is usually measured."""

_KEYS = ('free', 'fixed', 'prior', 'per_throw', 'topic')


class Treatment(NamedTuple):
    """Treatment of a parameter by a fit."""

    is_varied: bool  # whether the fit changes it
    value: float | None = None  # value, or mean of the prior; None for the value of the rig
    error: float | None = None  # standard error of the prior; None without a prior
    is_relative: bool = False  # whether the error is relative to the value
    is_per_throw: bool = False  # whether each throw has a value of its own

    @property
    def is_free(self) -> bool:
        """Whether the fit determines it without a prior."""
        return self.is_varied and self.error is None


FREE = Treatment(True)
"""Treatment of a parameter that the fit determines."""

FIXED = Treatment(False)
"""Treatment of a parameter that is known exactly, at the value of the rig."""

DEFAULTS: Mapping[str, Treatment] = {
    **dict.fromkeys((*PARAMETERS, *NUISANCE_PARAMETERS), FIXED),
    **dict.fromkeys(DEFAULT_FREE, FREE),
    'engine.amplitude': FREE._replace(is_per_throw=True),
    'layer.thickness': Treatment(True, error=1e-4),
    'layer.diameter': Treatment(True, error=1e-4),
    'projectile.mass': Treatment(True, error=0.01, is_relative=True),
    'projectile.scale': Treatment(True, error=0.005),
    'projectile.delay': Treatment(True, error=1e-4),
    'plate.drift': Treatment(True, error=0.02, is_per_throw=True),
    'projectile.drift': Treatment(True, error=0.02, is_per_throw=True),
}
"""Default treatments; errors of lengths and mass are those of the paper."""

IDEAL_BENCH: Mapping[str, Treatment] = {
    name: FIXED for name in DEFAULTS if name not in DEFAULT_FREE
} | {'engine.amplitude': FREE}
"""Treatments for a bench without faults, where all but `DEFAULT_FREE` are known exactly."""


@dataclass(frozen=True)
class FitDescription:
    """The treatments of all parameters of a fit; raise ValueError for an unknown name."""

    parameters: Mapping[str, Treatment] = field(default_factory=dict)  # the others: `DEFAULTS`
    topic: str | None = None  # topic to read from bags; needed if several topics have a plate
    assumed: tuple[str, ...] = ()  # held at the values of another rig, as nobody stated them

    def __post_init__(self) -> None:
        for name in self.parameters:
            _check_name(name)

    @classmethod
    def from_file(cls, path: str | Path) -> FitDescription:
        """
        Read a description from a YAML file; raise ValueError with the file and the wrong value.

        It is a mapping with the keys `free` and `per_throw` (lists of names), `fixed` (names to
        values), `prior` (names to values and standard errors) and `topic`, all of them optional.
        """
        tree = read_yaml(path)
        try:
            return cls(_read_treatments(tree), str(tree['topic']) if 'topic' in tree else None)
        except ValueError as error:
            raise ValueError(f'{path}: {error}') from None

    def change(self, changes: Mapping[str, Treatment]) -> FitDescription:
        """Change the treatment of some parameters."""
        return replace(self, parameters={**self.parameters, **changes})

    def assume(self, stated: Collection[str]) -> FitDescription:
        """Hold the parameters that a fit needs and that nobody stated, see `assumed`."""
        treatments = {name: self.treatment(name) for name in DEFAULT_IS_ANOTHER_RIG}
        assumed = tuple(
            name for name, item in treatments.items()
            if name not in stated and item.value is None and not item.is_free
        )
        return replace(self.change(dict.fromkeys(assumed, FIXED)), assumed=assumed)

    def treatment(self, name: str) -> Treatment:
        """Return the treatment of a parameter."""
        return self.parameters.get(name, DEFAULTS[name])

    def value(self, name: str, rig: Rig) -> float:
        """Return the value of a parameter, or the mean of its prior, or the value of the rig."""
        value = self.treatment(name).value
        if value is None:
            value = NUISANCE_PARAMETERS.get(name)
        return values_of(rig, [name])[name] if value is None else value

    def known(self, name: str, rig: Rig) -> Estimate | None:
        """Return the prior of a parameter; None if it has none."""
        treatment, value = self.treatment(name), self.value(name, rig)
        if treatment.error is None:
            return None
        return Estimate(value, treatment.error * (abs(value) if treatment.is_relative else 1.0))

    def prepare(self, rig: Rig) -> Rig:
        """Return a rig with the values of the description; raise ValueError for invalid ones."""
        return changed_rig(rig, {name: self.value(name, rig) for name in PARAMETERS})


def parse_error(text: str, value: str) -> Treatment:
    """Parse the error of a value, which may be in %; raise ValueError."""
    number, is_relative = text.strip().removesuffix('%'), text.strip().endswith('%')
    error = float_of(number.strip())
    if error is None or not 0.0 < error < math.inf or (is_relative and not float_of(value)):
        raise ValueError(f'must be VALUE+-ERROR or VALUE+-ERROR%, got {value}+-{text}')
    return Treatment(True, error=0.01 * error if is_relative else error, is_relative=is_relative)


def _read_treatments(tree: Mapping[str, Any]) -> dict[str, Treatment]:
    """Return the treatments of a fit file."""
    for key in tree:
        if key not in _KEYS:
            raise ValueError(f'must be one of {", ".join(_KEYS)}, got {key!r}')
    treatments = dict.fromkeys(_section(tree, 'free', list), FREE)
    for name, value in _section(tree, 'fixed', dict).items():
        treatments[name] = Treatment(False, _finite(name, [value], 'a finite number')[0])
    for name, value in _section(tree, 'prior', dict).items():
        mean, error = _finite(name, value, '[VALUE, ERROR]')
        treatments[name] = Treatment(True, mean, error)
    for name in _section(tree, 'per_throw', list):
        treatment = treatments.get(name, DEFAULTS[name])
        if not treatment.is_varied:
            raise ValueError(f'{name} must be free or have a prior')
        treatments[name] = treatment._replace(is_per_throw=True)
    return treatments


def _section(tree: Mapping[str, Any], key: str, kind: type[Any]) -> Any:
    """Return a list, or the keys of a mapping, of names of parameters."""
    section: Any = tree.get(key, kind())
    if not isinstance(section, kind):
        raise ValueError(f'{key} must be a {kind.__name__} of names, got {section!r}')
    for name in section:
        _check_name(name)
    return section


def _finite(name: str, values: Any, rule: str) -> list[float]:
    """Return a finite value, or one with a positive error."""
    items = values if isinstance(values, list) else [values]
    numbers = [float_of(str(item)) for item in items]
    finite = [number for number in numbers if number is not None and math.isfinite(number)]
    if not len(items) == len(finite) == 1 + rule.count(',') or min(finite[1:], default=1.0) <= 0.0:
        raise ValueError(f'{name} must be {rule}, got {values!r}')
    return finite


def _check_name(name: str) -> None:
    """Raise ValueError if a name is not that of a parameter of a fit."""
    if name not in tuple(DEFAULTS):
        raise ValueError(f'a parameter must be one of {", ".join(DEFAULTS)}, got {name!r}')


def values_of(rig: Rig, names: Iterable[str]) -> dict[str, float]:
    """Return the values of some `PARAMETERS` of a rig."""
    return {name: float(attrgetter(name)(rig)) for name in names}


def changed_rig(rig: Rig, values: Mapping[str, float]) -> Rig:
    """Return a copy of a rig with some of `PARAMETERS` changed."""
    return rig_with(rig, {name.rpartition('.')[2]: value for name, value in values.items()})
