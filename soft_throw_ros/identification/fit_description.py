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
"""
What of a rig is fitted, held, or known with an error, and what each throw has for itself.

Command line, YAML file and Python share it: a name, and in words how to treat it.
"""

from __future__ import annotations

from collections.abc import Hashable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from fnmatch import fnmatchcase
from functools import cache
import math
from operator import attrgetter
from pathlib import Path
import re
from typing import cast, Literal, NamedTuple

from soft_throw_ros.configuration import located_yaml
from soft_throw_ros.configuration.located_yaml import Located
from soft_throw_ros.core.rig import Rig
from soft_throw_ros.identification.least_squares import Estimate, FitError

ENGINE = ('engine.frequency', 'engine.damping_ratio', 'engine.amplitude')
LAYER = ('layer.wave_speed', 'layer.thickness', 'layer.loss_tangent')
PARAMETERS = (*ENGINE, *LAYER, 'layer.density', 'layer.diameter', 'projectile.mass')
"""What of a rig can be fitted, by the names that the twin has for it."""

TERMS = {
    'layer.stiffening': 0.0,
    'plate.drift': 0.0,
    'plate.ringing': 0.0,
    'plate.mode': 0.0,
    'projectile.drift': 0.0,
    'projectile.scale': 1.0,
    'projectile.delay': 0.0,
    'projectile.sticking': 0.0,
}
"""
What a bench may add, and its value if it does not.

`stiffening` is by how much the wave speed grows with the speed of the plate, to which the strain
is proportional. `drift` is that of heights over a record, `ringing` what the plate still does from
before the throw and `mode` a second one that the throw excites, all over the amplitude. `scale`
is the measured over the true height of a projectile, `delay` by how much it is seen too late [s],
`sticking` for how long the layer holds it when it would leave [s].
"""

USUAL = (*ENGINE, 'layer.wave_speed')
"""What is found if nobody says otherwise: who has the layer has measured its thickness."""

DEFAULTS: Mapping[str, str] = dict.fromkeys((*PARAMETERS, *TERMS), 'held') | {
    'engine.frequency': 'free',
    'engine.damping_ratio': 'free',
    'engine.amplitude': 'free per throw',
    'layer.wave_speed': 'free',
    'layer.thickness': '+- 1e-4',
    'layer.diameter': '+- 1e-4',
    'layer.loss_tangent': 'free if seen',
    'layer.stiffening': '+- 0.4',
    'projectile.mass': '+- 1 %',
    'projectile.scale': '+- 0.5 %',
    'projectile.delay': '+- 1e-4',
    'projectile.sticking': '+- 2e-4',
    'plate.drift': '+- 0.02 per throw',
    'projectile.drift': '+- 0.02 per throw',
    'plate.ringing': '+- 0.02 per throw if seen',
    'plate.mode': '+- 0.01 per throw if seen',
}
"""
How everything is treated if nothing is said; errors of lengths and mass are those of the paper.

With 0.4, the wave speed of a layer that is 10 % stiffer at its largest strain is off by about one
error.
"""

HELD: Mapping[str, str] = {
    name: 'held' for name in DEFAULTS if name not in ENGINE and name != 'layer.wave_speed'
} | {'engine.amplitude': 'free'}
"""What describes a bench without any fault, on which all is known exactly but `USUAL`."""

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
"""How a parameter can be treated, for messages."""

_PARTS = ('layer', 'projectile')  # that may be others in other throws
_NUMBER = r'[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?'
_TEXT = re.compile(
    rf'(?P<word>free|held)?(?P<value>{_NUMBER})?'
    rf'(?:\s*\+-\s*(?P<error>{_NUMBER})\s*(?P<percent>%)?)?'
    r'(?P<own>\s+per throw)?(?P<seen>\s+if seen)?'
)


class Treatment(NamedTuple):
    """How a fit treats a parameter."""

    is_varied: bool
    """Whether the fit changes it."""
    is_per_throw: bool
    """Whether each throw has its own."""
    value: float | None
    """What it is, or is known to be; None if that is for the rig to say."""
    error: float | None
    """With what error it is known; None if it is free or held."""
    is_relative: bool
    """Whether the error is relative to the value."""
    is_if_seen: bool = False
    """Whether it is held until the tracks show that it is needed."""

    @classmethod
    @cache
    def parse(cls, text: str) -> Treatment:
        """
        Read a treatment, or refuse it with ValueError.

        It is `free`; `held`; a value at which it is held; or a value with the error with which it
        is known, as in `0.0012 +- 1 %` or `0.012 +- 1e-4`. `+- 1 %` alone takes the value of the
        rig. What is not held may be followed by `per throw`: then each throw has its own; and by
        `if seen`: then it is held unless the tracks are explained much better with it.
        """
        match = _TEXT.fullmatch(text.strip())
        given = match.groupdict() if match else {}
        word, value, error = (given.get(name) for name in ('word', 'value', 'error'))
        if (word is None) == (value is None and error is None):
            raise ValueError(f'must be {TREATMENTS}, got {text!r}')
        if value is not None and not math.isfinite(float(value)):
            raise ValueError(f'must have a value that is finite, got {text!r}')
        if error is not None and not 0.0 < float(error) < math.inf:
            raise ValueError(f'must have an error that is finite and positive, got {text!r}')
        is_varied, is_per_throw = word == 'free' or error is not None, given['own'] is not None
        is_if_seen = given['seen'] is not None
        if (is_per_throw or is_if_seen) and not is_varied:
            raise ValueError(
                f"must be free or have an error to be 'per throw' or 'if seen', got {text!r}"
            )
        is_relative = given['percent'] is not None
        return cls(
            is_varied=is_varied and not is_if_seen,
            is_if_seen=is_if_seen,
            is_per_throw=is_per_throw,
            value=None if value is None else float(value),
            error=None if error is None else float(error) * (0.01 if is_relative else 1.0),
            is_relative=is_relative,
        )


@dataclass(frozen=True)
class FitDescription:
    """
    What is fitted.

    Parameters
    ----------
    parameters : mapping of str to str
        How to treat some of `PARAMETERS` and `TERMS`, see `Treatment.parse`. The others are as
        `DEFAULTS` say.
    heights : {'own', 'common', 'absolute'}
        From where heights count, see `Heights`.
    reference : {'face', 'centre'}
        Point of the projectile whose heights the tracks have; it matters if heights are not of
        their own.
    throws : mapping of str to mapping of str to str
        What is otherwise for throws of such names (or patterns of names, as of files): treatments
        of parameters, and under `layer` and `projectile` any names of these. Throws share what is
        the same for them.

    Raises
    ------
    ValueError
        If something is none of what it can be.

    Examples
    --------
    >>> fit = FitDescription({**HELD, 'layer.thickness': '12e-3 +- 1 %'})
    >>> [name for name in DEFAULTS if fit.treatment(name).is_varied]
    ['engine.frequency', 'engine.damping_ratio', 'engine.amplitude', 'layer.wave_speed', \
'layer.thickness']

    """

    parameters: Mapping[str, str] = field(default_factory=dict)
    heights: Heights = 'own'
    reference: Reference = 'face'
    throws: Mapping[str, Mapping[str, str]] = field(default_factory=dict)

    def __post_init__(self) -> None:
        _check_treatments(self.parameters)
        for conditions in self.throws.values():
            _check_treatments({n: each for n, each in conditions.items() if n not in _PARTS})
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
        `reference`, and `throws` (names of throws to such mappings), each of which may be left
        out; then it is as `base` has it.

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
                    for key, each in _items(conditions):
                        with _located(each):
                            description = description.set_condition(throw, key, str(each.value))
            elif name == 'parameters':
                for key, each in _items(node):
                    with _located(each):
                        description = description.change({key: str(each.value)})
            elif name in ('heights', 'reference'):
                with _located(node):
                    description = description.change({name: str(node.value)})
            else:
                raise ValueError(
                    f'{node.where}: must be parameters, heights, reference or throws, got {name!r}'
                )
        return description

    def change(self, changes: Mapping[str, str]) -> FitDescription:
        """Treat some parameters otherwise, or set `heights` or `reference`."""
        parameters = {**self.parameters, **changes}
        heights = parameters.pop('heights', self.heights)
        reference = parameters.pop('reference', self.reference)
        return replace(
            self,
            parameters=parameters,
            heights=cast(Heights, heights),
            reference=cast(Reference, reference),
        )

    def set_condition(self, throw: str, name: str, treatment: str) -> FitDescription:
        """Treat a parameter of some throws otherwise, or name their layer or projectile."""
        conditions = {**self.throws.get(throw, {}), name: treatment}
        return replace(self, throws={**self.throws, throw: conditions})

    def text(self, name: str, throw: str | None = None) -> str:
        """Return how to treat a parameter, in words; of a throw, if its name is given."""
        default = self.parameters.get(name, DEFAULTS[name])
        return default if throw is None else self.conditions(throw).get(name, default)

    def treatment(self, name: str, throw: str | None = None) -> Treatment:
        """Return how to treat a parameter; of a throw, if its name is given."""
        return Treatment.parse(self.text(name, throw))

    def conditions(self, throw: str) -> dict[str, str]:
        """Return what is otherwise for a throw."""
        found: dict[str, str] = {}
        for pattern, conditions in self.throws.items():
            if fnmatchcase(throw, pattern) or throw == pattern:
                found |= conditions
        return found

    def group(self, name: str, throw: str, number: int) -> Hashable:
        """Return what is the same for throws that share a parameter; None if all do."""
        conditions = self.conditions(throw)
        if self.treatment(name, throw).is_per_throw:
            return number
        part = conditions.get(name.partition('.')[0])
        return (conditions.get(name), part) if name in conditions or part else None

    def is_free(self, name: str) -> bool:
        """Whether the fit finds a parameter of which nothing is known."""
        treatment = self.treatment(name)
        return treatment.is_varied and treatment.error is None

    @property
    def if_seen(self) -> list[str]:
        """List what is held until the tracks show that it is needed."""
        return [name for name in DEFAULTS if self.treatment(name).is_if_seen]

    def see(self, name: str) -> FitDescription:
        """Vary what is held until it is seen."""
        return self.change({name: self.text(name).removesuffix('if seen')})

    def value(self, name: str, rig: Rig, throw: str | None = None) -> float:
        """Return what a parameter is, or is known to be; the rig has what is not said here."""
        value = self.treatment(name, throw).value
        if value is not None:
            return value
        return TERMS[name] if name in TERMS else values_of(rig, [name])[name]

    def known(self, name: str, rig: Rig, throw: str) -> Estimate | None:
        """Return what is known of a parameter with an error."""
        treatment, value = self.treatment(name, throw), self.value(name, rig, throw)
        if treatment.error is None:
            return None
        error = treatment.error * (abs(value) if treatment.is_relative else 1.0)
        if error == 0.0:
            raise FitError(f'{name} is {value:g}, of which an error in % is nothing')
        return Estimate(value, error)

    def prepare(self, rig: Rig, throw: str | None = None) -> Rig:
        """Give a rig the values that are said here; one that it does not take is a FitError."""
        said = {name: self.treatment(name, throw).value for name in PARAMETERS}
        try:
            return changed_rig(rig, {n: value for n, value in said.items() if value is not None})
        except ValueError as error:
            raise FitError(str(error)) from None


def _check_treatments(parameters: Mapping[str, str]) -> None:
    """Refuse names and treatments that there are not."""
    for name, text in parameters.items():
        if name not in DEFAULTS:
            raise ValueError(f'what is fitted must be some of {", ".join(DEFAULTS)}, got {name!r}')
        try:
            Treatment.parse(text)
        except ValueError as error:
            raise ValueError(f'{name} {error}') from None


@contextmanager
def _located(node: Located) -> Iterator[None]:
    """Say where in the file something stands that is refused."""
    try:
        yield
    except ValueError as error:
        raise ValueError(f'{node.where}: {error}') from None


def values_of(rig: Rig, names: Iterable[str]) -> dict[str, float]:
    """Look up some of `PARAMETERS`."""
    return {name: float(attrgetter(name)(rig)) for name in names}


def changed_rig(rig: Rig, values: Mapping[str, float]) -> Rig:
    """Make another rig of one, with some of `PARAMETERS` changed."""
    changes: dict[str, dict[str, float]] = {}
    for name, value in values.items():
        part, _, item = name.partition('.')
        changes.setdefault(part, {})[item] = value
    parts = {part: replace(getattr(rig, part), **each) for part, each in changes.items()}
    return replace(rig, **parts)


def _items(node: Located) -> tuple[tuple[str, Located], ...]:
    """List what is in a mapping."""
    if node.items is None:
        raise ValueError(f'{node.where}: must be a mapping, got {node.value!r}')
    return node.items
