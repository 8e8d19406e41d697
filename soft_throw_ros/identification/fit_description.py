# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
Treatments of the parameters of a fit: free, held or known with an error, for all throws or some.

Command line, YAML file and Python share them.
"""

from __future__ import annotations

from collections.abc import Collection, Hashable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from enum import Enum
from fnmatch import fnmatchcase
import math
from operator import attrgetter
from pathlib import Path
import re
from typing import cast, Literal, NamedTuple

from soft_throw_ros.configuration import located_yaml
from soft_throw_ros.configuration.located_yaml import Located
from soft_throw_ros.core.rig import Rig
from soft_throw_ros.core.throws import rig_with
from soft_throw_ros.identification.least_squares import Estimate, FitError
from soft_throw_ros.identification.tracks import names_of

ENGINE = ('engine.frequency', 'engine.damping_ratio', 'engine.amplitude')
LAYER = ('layer.wave_speed', 'layer.thickness', 'layer.loss_tangent')
PARAMETERS = (*ENGINE, *LAYER, 'layer.density', 'layer.diameter', 'projectile.mass')
"""Parameters of a rig that can be fitted, by their names in the twin."""

DEFAULT_IS_ANOTHER_RIG = tuple(name for name in PARAMETERS if name != 'layer.loss_tangent')
"""Parameters whose defaults belong to another rig; the default of the loss is none."""

NUISANCE_PARAMETERS = {
    'layer.stiffening': 0.0,
    'plate.drift': 0.0,
    'plate.ringing': 0.0,
    'projectile.drift': 0.0,
    'projectile.scale': 1.0,
    'projectile.delay': 0.0,
}
"""
Nuisance parameters of a bench, and their values without it.

`stiffening` is the increase of the wave speed with the speed of the plate, to which the strain is
proportional. `drift` is the drift of heights over a record, and `ringing` the oscillation of the
plate before the throw, both over the amplitude. `scale` is the measured over the true height of a
projectile, and `delay` the delay of its measurement [s].
"""

DEFAULT_FREE = (*ENGINE, 'layer.wave_speed')
"""Parameters that are fitted by default; the thickness of the layer is usually measured."""

Heights = Literal['own', 'common', 'absolute']
"""
From where heights count: each track from a zero of its own; both from the same; or both from the
plate's position at rest.
"""

Reference = Literal['face', 'centre']
"""Point of the projectile whose heights a track has: its lower face, or its centre."""

HEIGHTS: tuple[Heights, ...] = ('own', 'common', 'absolute')
REFERENCES: tuple[Reference, ...] = ('face', 'centre')

TREATMENTS = (
    "'free', 'held', VALUE, VALUE +- ERROR, or +- ERROR, which may be in %; then 'per throw' or "
    "'if seen' may follow"
)
"""Allowed treatments of a parameter, for messages."""

PARTS = ('layer', 'projectile')
"""Parts of a rig that may be replaced between throws, and have names then."""

_MAX_NAMES = 8
"""Names of throws that a message lists, so that it stays readable."""

_NUMBER = r'[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?'
_TEXT = re.compile(
    rf'(?P<word>free|held)?(?P<value>{_NUMBER})?'
    rf'(?:\s*\+-\s*(?P<error>{_NUMBER})\s*(?P<percent>%)?)?'
    r'(?P<own>\s+per throw)?(?P<seen>\s+if seen)?'
)


class ParameterRole(Enum):
    """Role of a parameter in a fit."""

    FREE = 'free'
    """The fit determines the parameter."""
    FIXED = 'held'
    """The parameter is known exactly."""
    PRIOR = '+-'
    """The parameter is known with an error, which is the prior of the fit."""


class Treatment(NamedTuple):
    """Treatment of a parameter by a fit."""

    role: ParameterRole
    value: float | None = None
    """Value, or mean of the prior; None for the value of the rig."""
    error: float | None = None
    """Standard error of the prior; None for other roles."""
    is_relative: bool = False
    """Whether the error is relative to the value."""
    is_per_throw: bool = False
    """Whether each throw has a value of its own."""
    only_if_significant: bool = False
    """Whether it is fixed until the tracks show that it is needed."""

    @property
    def is_varied(self) -> bool:
        """Whether the fit changes it."""
        return self.role is not ParameterRole.FIXED and not self.only_if_significant


FREE = Treatment(ParameterRole.FREE)
"""Treatment of a parameter that the fit determines."""

FIXED = Treatment(ParameterRole.FIXED)
"""Treatment of a parameter that is known exactly, at the value of the rig."""


def _prior(error: float, **flags: bool) -> Treatment:
    """Return the treatment of a parameter that is known with an error."""
    return Treatment(ParameterRole.PRIOR, error=error, **flags)


DEFAULTS: Mapping[str, Treatment] = dict.fromkeys(
    (*PARAMETERS, *NUISANCE_PARAMETERS), FIXED
) | {
    'engine.frequency': FREE,
    'engine.damping_ratio': FREE,
    'engine.amplitude': FREE._replace(is_per_throw=True),
    'layer.wave_speed': FREE,
    'layer.thickness': _prior(1e-4),
    'layer.diameter': _prior(1e-4),
    'layer.loss_tangent': FREE._replace(only_if_significant=True),
    'layer.stiffening': _prior(0.4),
    'projectile.mass': _prior(0.01, is_relative=True),
    'projectile.scale': _prior(0.005, is_relative=True),
    'projectile.delay': _prior(1e-4),
    'plate.drift': _prior(0.02, is_per_throw=True),
    'projectile.drift': _prior(0.02, is_per_throw=True),
    'plate.ringing': _prior(0.02, is_per_throw=True, only_if_significant=True),
}
"""
Default treatments; errors of lengths and mass are those of the paper.

With 0.4, the wave speed of a layer that is 10 % stiffer at its largest strain is off by about one
error.
"""

IDEAL_BENCH: Mapping[str, Treatment] = {
    name: FIXED for name in DEFAULTS if name not in DEFAULT_FREE
} | {'engine.amplitude': FREE}
"""Treatments for a bench without faults, where all but `DEFAULT_FREE` are known exactly."""


class ThrowConditions(NamedTuple):
    """Treatments of parameters for some throws only, and names of the `PARTS` in these throws."""

    treatments: Mapping[str, Treatment]
    parts: Mapping[str, str]


@dataclass(frozen=True)
class FitDescription:
    """
    The treatments of all parameters of a fit.

    Raises
    ------
    ValueError
        If a name is unknown.

    Examples
    --------
    >>> fit = FitDescription({**IDEAL_BENCH, **parse_treatments({'layer.thickness': '+- 1 %'})})
    >>> [name for name in DEFAULTS if fit.treatment(name).is_varied]
    ['engine.frequency', 'engine.damping_ratio', 'engine.amplitude', 'layer.wave_speed', \
'layer.thickness']

    """

    parameters: Mapping[str, Treatment] = field(default_factory=dict)
    """Treatments of some parameters, see `parse_treatments`; the others have their `DEFAULTS`."""
    heights: Heights = 'own'
    """Origin of the heights, see `Heights`."""
    reference: Reference = 'face'
    """Point whose heights tracks of projectiles have; it matters unless `heights` is 'own'."""
    throws: Mapping[str, ThrowConditions] = field(default_factory=dict)
    """
    Differences of some throws, by names, or patterns of names, of throws or of their files.

    Throws with the same treatment or part share its value.
    """
    assumed: tuple[str, ...] = ()
    """Parameters that are held at the values of another rig, because nobody stated them."""

    def __post_init__(self) -> None:
        for name in (*self.parameters, *(n for item in self.throws.values() for n in item[0])):
            if name not in DEFAULTS:
                raise ValueError(
                    f'a parameter must be one of {", ".join(DEFAULTS)}, got {name!r}'
                )
        for name, value, choices in (
            ('heights', self.heights, HEIGHTS),
            ('reference', self.reference, REFERENCES),
        ):
            if value not in choices:
                raise ValueError(f'{name} must be one of {", ".join(choices)}, got {value!r}')

    @classmethod
    def from_file(cls, path: str | Path, base: FitDescription | None = None) -> FitDescription:
        """
        Read a description from a YAML file.

        It is a mapping with the keys `parameters` (a mapping of names to treatments), `heights`,
        `reference`, and `throws` (names of throws to such mappings, in which the names of `PARTS`
        may stand, too). All keys are optional; the defaults are those of `base`.

        Raises
        ------
        ValueError
            Naming file and line, if something is wrong.

        """
        root = located_yaml.read(Path(path)) or Located(str(path), items=())
        description = base or cls()
        for name, node in _items(root):
            if name == 'throws':
                for throw, conditions in _items(node):
                    for key, item in _items(conditions):
                        with _located(item):
                            description = description._with_condition(throw, key, str(item.value))
            elif name == 'parameters':
                for key, item in _items(node):
                    with _located(item):
                        description = description.change(parse_treatments({key: str(item.value)}))
            elif name in ('heights', 'reference'):
                text = str(node.value)
                with _located(node):
                    if name == 'heights':
                        description = replace(description, heights=cast(Heights, text))
                    else:
                        description = replace(description, reference=cast(Reference, text))
            else:
                raise ValueError(
                    f'{node.where}: must be parameters, heights, reference or throws, got {name!r}'
                )
        return description

    def _with_condition(self, throw: str, name: str, text: str) -> FitDescription:
        """Add the text of a treatment, or the name of a part, to the conditions of some throws."""
        treatments, parts = self.throws.get(throw, ({}, {}))
        if name in PARTS:
            conditions = ThrowConditions(treatments, {**parts, name: text})
        else:
            conditions = ThrowConditions({**treatments, name: _parse_condition(name, text)}, parts)
        return replace(self, throws={**self.throws, throw: conditions})

    def change(self, changes: Mapping[str, Treatment]) -> FitDescription:
        """Change the treatment of some parameters."""
        return replace(self, parameters={**self.parameters, **changes})

    def assume(self, stated: Collection[str], throws: Iterable[str]) -> FitDescription:
        """Hold the parameters that some throw needs and that nobody stated, see `assumed`."""
        used = [(name, self.treatment(name, throw)) for throw in throws
                for name in DEFAULT_IS_ANOTHER_RIG if name not in stated]
        assumed = {name: FIXED for name, treatment in used
                   if treatment.value is None and treatment.role is not ParameterRole.FREE}
        return replace(self.change(assumed), assumed=tuple(assumed))

    def treatment(self, name: str, throw: str | None = None) -> Treatment:
        """Return the treatment of a parameter; of a throw, if its name is given."""
        own = {} if throw is None else self.conditions(throw).treatments
        return own.get(name) or self.parameters.get(name) or DEFAULTS[name]

    def conditions(self, throw: str) -> ThrowConditions:
        """Return the treatments and parts that hold for a throw only."""
        treatments: dict[str, Treatment] = {}
        parts: dict[str, str] = {}
        for pattern, conditions in self.throws.items():
            if _matches(throw, pattern):
                treatments |= conditions.treatments
                parts |= conditions.parts
        return ThrowConditions(treatments, parts)

    def check_throws(self, throws: Sequence[str]) -> None:
        """Raise `FitError` if a name or pattern of `throws` matches none of the given throws."""
        for pattern in self.throws:
            if not any(_matches(throw, pattern) for throw in throws):
                shown = [*throws[:_MAX_NAMES], *['...'] * (len(throws) > _MAX_NAMES)]
                raise FitError(
                    f'no throw matches {pattern!r}, which stands below `throws`; the throws are: '
                    f'{", ".join(shown) or "none"}'
                )

    def group(self, name: str, throw: str, number: int) -> Hashable:
        """Return a key that is equal for throws that share a parameter; None if all do."""
        if self.treatment(name, throw).is_per_throw:
            return number
        treatments, parts = self.conditions(throw)
        own, part = treatments.get(name), parts.get(name.partition('.')[0])
        return (own, part) if own or part else None

    def is_free(self, name: str) -> bool:
        """Return whether a parameter is fitted without a prior."""
        treatment = self.treatment(name)
        return treatment.is_varied and treatment.role is ParameterRole.FREE

    @property
    def if_seen(self) -> list[str]:
        """Names of the parameters that are held until the tracks show that they are needed."""
        return [name for name in DEFAULTS if self.treatment(name).only_if_significant]

    def activate(self, name: str) -> FitDescription:
        """Vary a parameter that is held until the tracks show that it is needed."""
        return self.change({name: self.treatment(name)._replace(only_if_significant=False)})

    def value(self, name: str, rig: Rig, throw: str | None = None) -> float:
        """Return the value of a parameter, or the mean of its prior, or the value of the rig."""
        value = self.treatment(name, throw).value
        if value is not None:
            return value
        if name in NUISANCE_PARAMETERS:
            return NUISANCE_PARAMETERS[name]
        return values_of(rig, [name])[name]

    def known(self, name: str, rig: Rig, throw: str) -> Estimate | None:
        """Return the prior of a parameter; None if it has none."""
        treatment, value = self.treatment(name, throw), self.value(name, rig, throw)
        if treatment.error is None:
            return None
        error = treatment.error * (abs(value) if treatment.is_relative else 1.0)
        if error == 0.0:
            raise FitError(f'{name} is {value:g} and has no error in %; give an absolute error')
        return Estimate(value, error)

    def prepare(self, rig: Rig, throw: str | None = None) -> Rig:
        """Return a rig with the values of the description; raise FitError for invalid ones."""
        values = {name: self.treatment(name, throw).value for name in PARAMETERS}
        try:
            return changed_rig(rig, {n: value for n, value in values.items() if value is not None})
        except ValueError as error:
            raise FitError(str(error)) from None


def parse_treatments(texts: Mapping[str, str]) -> dict[str, Treatment]:
    """
    Parse the treatments of some parameters.

    A treatment is `free`; `held`; a value at which the parameter is held; or a value with a
    standard error, as in `0.0012 +- 1 %` or `0.012 +- 1e-4`. `+- 1 %` alone takes the value of
    the rig. `per throw` may follow `free` or an error, if each throw has its own value; then `if
    seen`, if the parameter is held unless it improves the fit of the tracks much.

    Raises
    ------
    ValueError
        If a text is no treatment, or is not allowed for its parameter.

    """
    return {name: _parse(name, text) for name, text in texts.items()}


def _parse(name: str, text: str) -> Treatment:
    """Parse the treatment of a parameter; raise ValueError with its name."""
    try:
        return _parse_text(text)
    except ValueError as error:
        raise ValueError(f'{name} {error}') from None


def _parse_text(text: str) -> Treatment:
    """Parse a treatment, see `parse_treatments`."""
    match = _TEXT.fullmatch(text.strip())
    groups = match.groupdict() if match else {}
    word, value, error = (groups.get(name) for name in ('word', 'value', 'error'))
    if (word is None) == (value is None and error is None):
        raise ValueError(f'must be {TREATMENTS}, got {text!r}')
    if value is not None and not math.isfinite(float(value)):
        raise ValueError(f'must have a value that is finite, got {text!r}')
    if error is not None and not 0.0 < float(error) < math.inf:
        raise ValueError(f'must have an error that is finite and positive, got {text!r}')
    role = ParameterRole(word) if word else ParameterRole.FIXED
    if error is not None:
        role = ParameterRole.PRIOR
    is_per_throw, only_if_significant = groups['own'] is not None, groups['seen'] is not None
    if (is_per_throw or only_if_significant) and role is ParameterRole.FIXED:
        raise ValueError(
            f"must be free or have an error to be 'per throw' or 'if seen', got {text!r}"
        )
    is_relative = groups['percent'] is not None
    return Treatment(
        role=role,
        value=None if value is None else float(value),
        error=None if error is None else float(error) * (0.01 if is_relative else 1.0),
        is_relative=is_relative,
        is_per_throw=is_per_throw,
        only_if_significant=only_if_significant,
    )


def _parse_condition(name: str, text: str) -> Treatment:
    """Parse the treatment of a parameter of some throws."""
    treatment = _parse(name, text)
    if treatment.only_if_significant:
        raise ValueError(
            f"{name} of some throws must not be 'if seen', got {text!r}; say so below "
            '`parameters`, for all throws'
        )
    return treatment


def _matches(throw: str, pattern: str) -> bool:
    """Return whether a name or pattern is that of a throw, or of the file that it is from."""
    return any(name == pattern or fnmatchcase(name, pattern) for name in names_of(throw))


@contextmanager
def _located(node: Located) -> Iterator[None]:
    """Add file and line to an error."""
    try:
        yield
    except ValueError as error:
        raise ValueError(f'{node.where}: {error}') from None


def values_of(rig: Rig, names: Iterable[str]) -> dict[str, float]:
    """Return the values of some `PARAMETERS` of a rig."""
    return {name: float(attrgetter(name)(rig)) for name in names}


def changed_rig(rig: Rig, values: Mapping[str, float]) -> Rig:
    """Return a copy of a rig with some of `PARAMETERS` changed."""
    return rig_with(rig, {name.rpartition('.')[2]: value for name, value in values.items()})


def _items(node: Located) -> tuple[tuple[str, Located], ...]:
    """Return the items of a mapping, or raise ValueError."""
    if node.items is None:
        raise ValueError(f'{node.where}: must be a mapping, got {node.value!r}')
    return node.items
