# SPDX-License-Identifier: Apache-2.0
"""
What of a rig is fitted, held, or known with an error, and what each throw has for itself.

Command line, YAML file and Python share it: a name, and in words how to treat it.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
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

USUAL = (*ENGINE, 'layer.wave_speed')
"""What is fitted if nobody says otherwise: who has the layer has measured its thickness."""

Heights = Literal['own', 'common', 'absolute']
"""
From where heights count: each track from a zero of its own; both from the same; or both from the
plate's position at rest.
"""

Reference = Literal['face', 'centre']
"""Point of the projectile whose heights a track has: its lower face, or its centre."""

HEIGHTS: tuple[Heights, ...] = ('own', 'common', 'absolute')
REFERENCES: tuple[Reference, ...] = ('face', 'centre')

TREATMENTS = "'free', 'held', VALUE, VALUE +- ERROR, or +- ERROR, which may be in %"
"""How a parameter can be treated, for messages."""

_NUMBER = r'[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?'
_TEXT = re.compile(
    rf'(?P<word>free|held)?(?P<value>{_NUMBER})?'
    rf'(?:\s*\+-\s*(?P<error>{_NUMBER})\s*(?P<percent>%)?)?(?P<own>\s+per throw)?'
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

    @classmethod
    def parse(cls, text: str) -> Treatment:
        """
        Read a treatment, or refuse it with ValueError.

        It is `free`; `held`; a value at which it is held; or a value with the error with which it
        is known, as in `0.0012 +- 1 %` or `0.012 +- 1e-4`. `+- 1 %` alone takes the value of the
        rig. What is not held may be followed by `per throw`: then each throw has its own.
        """
        match = _TEXT.fullmatch(text.strip())
        given = match.groupdict() if match else {}
        word, value, error = (given.get(name) for name in ('word', 'value', 'error'))
        if (word is None) == (value is None and error is None):
            raise ValueError(f'must be {TREATMENTS}, got {text!r}')
        if error is not None and not 0.0 < float(error) < math.inf:
            raise ValueError(f'must have an error that is finite and positive, got {text!r}')
        is_varied, is_per_throw = word == 'free' or error is not None, given['own'] is not None
        if is_per_throw and not is_varied:
            raise ValueError(f"must be free or have an error to be 'per throw', got {text!r}")
        is_relative = given['percent'] is not None
        return cls(
            is_varied=is_varied,
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
        How to treat some of `PARAMETERS`, see `Treatment.parse`. Of the others those of `USUAL`
        are free, and the rest is held as the rig says.
    heights : {'own', 'common', 'absolute'}
        From where heights count, see `Heights`.
    reference : {'face', 'centre'}
        Point of the projectile whose heights the tracks have; it matters if heights are not of
        their own.

    Raises
    ------
    ValueError
        If something is none of what it can be.

    Examples
    --------
    >>> fit = FitDescription({'layer.thickness': '12e-3 +- 1 %', 'engine.amplitude': 'held'})
    >>> fit.varied
    ('engine.frequency', 'engine.damping_ratio', 'layer.wave_speed', 'layer.thickness')

    """

    parameters: Mapping[str, str] = field(default_factory=dict)
    heights: Heights = 'own'
    reference: Reference = 'face'
    treatments: dict[str, Treatment] = field(init=False, repr=False)

    def __post_init__(self) -> None:
        for name in self.parameters:
            if name not in PARAMETERS:
                raise ValueError(
                    f'what is fitted must be some of {", ".join(PARAMETERS)}, got {name!r}'
                )
        for name, value, choices in (
            ('heights', self.heights, HEIGHTS),
            ('reference', self.reference, REFERENCES),
        ):
            if value not in choices:
                raise ValueError(f'{name} must be one of {", ".join(choices)}, got {value!r}')
        treatments = {}
        for name in PARAMETERS:
            text = self.parameters.get(name, 'free' if name in USUAL else 'held')
            try:
                treatments[name] = Treatment.parse(text)
            except ValueError as error:
                raise ValueError(f'{name} {error}') from None
        object.__setattr__(self, 'treatments', treatments)

    @classmethod
    def from_file(cls, path: str | Path) -> FitDescription:
        """
        Read a description from a YAML file.

        It is a mapping with the keys `parameters` (a mapping of names to treatments), `heights`
        and `reference`, each of which may be left out.

        Raises
        ------
        ValueError
            Naming file and line, if something is wrong.

        """
        root = located_yaml.read(Path(path)) or Located(str(path), items=())
        entries: list[tuple[str, Located]] = []
        for name, node in _items(root):
            if name == 'parameters':
                entries += _items(node)
            elif name in ('heights', 'reference'):
                entries.append((name, node))
            else:
                raise ValueError(
                    f'{node.where}: must be parameters, heights or reference, got {name!r}'
                )
        description = cls()
        for name, node in entries:
            try:
                description = description.change({name: str(node.value)})
            except ValueError as error:
                raise ValueError(f'{node.where}: {error}') from None
        return description

    def change(self, changes: Mapping[str, str]) -> FitDescription:
        """Treat some parameters otherwise, or set `heights` or `reference`."""
        parameters = {**self.parameters, **changes}
        heights = parameters.pop('heights', self.heights)
        reference = parameters.pop('reference', self.reference)
        return FitDescription(parameters, cast(Heights, heights), cast(Reference, reference))

    @property
    def varied(self) -> tuple[str, ...]:
        """Names of the parameters that the fit changes, in their order."""
        return tuple(name for name, each in self.treatments.items() if each.is_varied)

    @property
    def per_throw(self) -> tuple[str, ...]:
        """Names of those of them that each throw has for itself."""
        return tuple(name for name in self.varied if self.treatments[name].is_per_throw)

    def is_free(self, name: str) -> bool:
        """Whether the fit finds a parameter of which nothing is known."""
        treatment = self.treatments[name]
        return treatment.is_varied and treatment.error is None

    def known(self, rig: Rig) -> dict[str, Estimate]:
        """Return what is known with an error; the rig has what is not said here."""
        values = values_of(self.prepare(rig), PARAMETERS)
        return {
            name: Estimate(
                values[name],
                each.error * (abs(values[name]) if each.is_relative else 1.0),
            )
            for name, each in self.treatments.items()
            if each.error is not None
        }

    def prepare(self, rig: Rig) -> Rig:
        """Give a rig the values that are said here; one that it does not take is a FitError."""
        said = {n: each.value for n, each in self.treatments.items() if each.value is not None}
        try:
            return changed_rig(rig, said)
        except ValueError as error:
            raise FitError(str(error)) from None


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
