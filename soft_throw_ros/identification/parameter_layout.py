# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""The order of the values of a fit: shared parameters, and those of one or some throws."""

from __future__ import annotations

from collections.abc import Hashable, Sequence
from dataclasses import dataclass
from functools import cached_property

from soft_throw_ros.identification.fit_description import DEFAULTS, FitDescription
from soft_throw_ros.identification.tracks import ThrowTracks

START, PLATE_ZERO, PROJECTILE_ZERO = 'start_time', 'plate_offset', 'projectile_offset'
OWN = (START, PLATE_ZERO, PROJECTILE_ZERO)
"""Parameters of each throw: the time of its start, and the heights of its bodies at rest."""


@dataclass(frozen=True)
class ParameterLayout:
    """The order of the values of a fit; made by `of`."""

    groups: dict[tuple[str, Hashable], list[int]]
    """
    Numbers of the throws that share each value, by the name of the parameter and a key.

    They are in the order of the values. The key is None if all throws share the value, and the
    number of the throw if it belongs to a single one.
    """
    is_single: bool
    """Whether there is one throw only."""

    @classmethod
    def of(cls, throws: Sequence[ThrowTracks], description: FitDescription) -> ParameterLayout:
        """Return the layout of a fit: first the values that all throws share."""
        groups: dict[tuple[str, Hashable], list[int]] = {}
        for name in DEFAULTS:
            for number, throw in enumerate(throws):
                is_measured = throw.projectile is not None or name.startswith(('engine', 'plate'))
                if is_measured and description.treatment(name, throw.name).is_varied:
                    key = description.group(name, throw.name, number)
                    groups.setdefault((name, key), []).append(number)
        own = [START]
        own += [] if description.heights == 'absolute' else [PLATE_ZERO]
        own += [PROJECTILE_ZERO] if description.heights == 'own' else []
        for number, throw in enumerate(throws):
            for name in own:
                if name != PROJECTILE_ZERO or throw.projectile is not None:
                    groups[name, number] = [number]
        ordered = sorted(groups.items(), key=lambda item: item[0][1] is not None)
        return cls(dict(ordered), len(throws) == 1)

    def __contains__(self, name: str) -> bool:
        return name in self.indices

    @cached_property
    def indices(self) -> dict[str, dict[int, int]]:
        """Indices of each parameter among the values, by throw."""
        indices: dict[str, dict[int, int]] = {}
        for index, ((name, _), throws) in enumerate(self.groups.items()):
            indices.setdefault(name, {}).update(dict.fromkeys(throws, index))
        return indices

    @cached_property
    def names(self) -> tuple[str, ...]:
        """Names of the values; of some of several throws, with the number of the first from 1."""
        return tuple(
            name if key is None or self.is_single else f'{name}[{throws[0] + 1}]'
            for (name, key), throws in self.groups.items()
        )

    def indices_of(self, name: str) -> list[int]:
        """Return the indices of a parameter among the values, of all throws."""
        return sorted(set(self.indices[name].values()))

    def is_per_throw(self, name: str) -> bool:
        """Return whether each throw has its own value of a parameter."""
        return any(isinstance(key, int) for other, key in self.groups if other == name)
