# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
Recommend the layer of a rig that throws best by an objective.

The first release counts, because it is more predictable than later ones. The search is described
in `soft_throw_ros.design.maximise`.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
import math
from typing import get_args, Literal, NamedTuple, TypeAlias

import numpy as np
from soft_throw_ros.configuration.layers import Material
from soft_throw_ros.core.batch import Cancelled, ThrowUnresolvedError
from soft_throw_ros.core.rig import Layer, Rig
from soft_throw_ros.core.throws import require_uniform, SEARCH_CELLS, STRONG_GRAVITY
from soft_throw_ros.design.maximise import Box, maximise, Optimum
from soft_throw_ros.design.prediction import predict, PredictedThrow
from soft_throw_ros.design.score import Limits, Objective, peak, Score
from soft_throw_ros.design.uncertainty import stuck_fraction, Uncertainties

Vary: TypeAlias = Literal['thickness', 'wave_speed', 'both', 'library']

TOLERATED_LOSS = 0.02
"""Part of the score that may be lost within the tolerance of a parameter. [-]"""

MAX_STUCK_FRACTION = 0.05
"""Share of throws without a release, within the uncertainties, of a layer to recommend. [-]"""

_CHANGES = np.geomspace(1e-3, 0.5, 24)
"""Relative changes of a parameter that are tried for its tolerance, 30 % apart. [-]"""

_EQUAL = 1e-9
"""Relative difference of scores that count as equal; then the present layer is kept. [-]"""

_COARSE_ERROR = 2e-3
"""Relative error of scores with `SEARCH_CELLS`; a layer that is worse is searched again. [-]"""

_NEARBY = 0.03
"""Relative half width of the second search, in thickness and wave speed. [-]"""

_MAX_CANDIDATES = 5
"""Number of layers of the library that a recommendation lists."""

_ALTERNATIVES = ('now', 'by_thickness', 'by_wave_speed')
"""Names of the throws that a recommendation is compared with."""


class LibraryCandidate(NamedTuple):
    """A layer of the library: its name, its thickness [m], and its score [-]."""

    layer: str
    thickness: float
    score: float


@dataclass(frozen=True, kw_only=True)
class Recommendation(PredictedThrow):
    """Throw of the recommended layer, and throws to compare it with."""

    rig: Rig
    """The rig with the recommended layer."""
    vary: Vary
    """Part of the layer that was allowed to change."""
    layer: str
    """Name of the recommended layer in the library, if it was picked there."""
    score: float
    """Energy transfer that counts for the objective. [-]"""
    stuck_fraction: float
    """Share of the throws within the uncertainties that do not release the projectile. [-]"""
    now: PredictedThrow | None
    """The rig as it is; None if it does not throw."""
    now_score: float
    """Score of the rig as it is, 0 if it does not throw. [-]"""
    now_stuck_fraction: float
    """The stuck fraction of the rig as it is. [-]"""
    by_thickness: PredictedThrow | None
    """The best layer if only the thickness may change; None if none throws within the limits."""
    by_wave_speed: PredictedThrow | None
    """The same for the wave speed."""
    candidates: tuple[LibraryCandidate, ...]
    """Layers of the library that came near, if one was to be picked; the best first."""
    tolerances: Mapping[str, float]
    """Changes of thickness [m] and wave speed [m/s], up or down, that cost `TOLERATED_LOSS`."""

    @property
    def gain(self) -> float:
        """Relative gain of the score, infinite without a score of the present layer [-]."""
        return self.score / self.now_score - 1.0 if self.now_score > 0.0 else math.inf

    def values(self) -> dict[str, float | str | bool]:
        """Return everything by name, with a dot between the name of a part and of its value."""
        groups: dict[str, Mapping[str, float]] = {
            name: vars(throw) for name in _ALTERNATIVES if (throw := getattr(self, name))
        }
        groups['tolerance'] = self.tolerances
        groups['candidate'] = {item.layer: item.score for item in self.candidates}
        return super().values() | {
            f'{name}.{key}': value
            for name, group in groups.items() for key, value in group.items()
        }


def recommend(
    rig: Rig,
    *,
    vary: Vary = 'both',
    objective: Objective | None = None,
    limits: Limits | None = None,
    materials: Mapping[str, Material] | None = None,
    uncertainties: Uncertainties | None = None,
    cancelled: Cancelled | None = None,
) -> Recommendation:
    """
    Recommend the layer that throws best.

    Only the layer changes: either thickness and wave speed, at the same density and loss tangent,
    so that another wave speed means another modulus; or the whole layer, as one of a library.

    Parameters
    ----------
    rig : Rig
        Rig with the present layer.
    vary : {'thickness', 'wave_speed', 'both', 'library'}
        Part of the layer that may change.
    objective : Objective, optional
        Score to maximise, as in `score.OBJECTIVES`; the energy of the throw if not given.
    limits : Limits, optional
        Limits of the layer and its loads. They do not apply to parameters that may not change.
    materials : mapping of str to Material, optional
        The library, if `vary` is 'library'; idealised materials are not recommended.
    uncertainties : Uncertainties, optional
        Errors within which at most `MAX_STUCK_FRACTION` of the throws may have no release, if a
        layer allows that; those of the paper if not given.
    cancelled : callable, optional
        Called every few tenths of a second; returns whether to give up.

    Returns
    -------
    Recommendation
        The present layer if no other is better, and the thinner one of equals.

    Notes
    -----
    The score is within 0.1 % of the best, as seen in random rigs, objectives and limits beside
    fine grids; except as said in `soft_throw_ros.design.maximise`.

    Examples
    --------
    >>> best = recommend(Rig(), vary='thickness')
    >>> round(1e3 * best.thickness, 2), round(best.score, 2), round(best.gain, 3)
    (13.41, 3.83, 0.054)

    """
    if vary not in get_args(Vary):
        raise ValueError(f'vary must be one of {", ".join(get_args(Vary))}, got {vary!r}')
    limits, uncertainties = limits or Limits(), uncertainties or Uncertainties()
    search = _Search(objective or peak, limits, cancelled)
    by = {
        name: search.rank(_spaces(rig, name, limits, {})) for name in ('thickness', 'wave_speed')
    }
    spaces = _spaces(rig, vary, limits, materials or {})
    ranked = by[vary] if vary in by else search.rank(
        spaces, [item.rig.layer for items in by.values() for item in items]
    )
    candidates = tuple(
        LibraryCandidate(item.space.name, item.rig.layer.thickness, item.score)
        for item in ranked
        if vary == 'library'
    )
    box = Box(limits.thickness, limits.wave_speed) if vary == 'library' else spaces[0].box
    present = search.evaluate(_Space(rig, box), rig)
    if present.score > 0.0:
        is_best = not ranked or present.score >= (1.0 - _EQUAL) * ranked[0].score
        ranked = [present, *ranked] if is_best else [*ranked, present]
    if not ranked:
        raise ThrowUnresolvedError(
            f'no layer{" from the library" if vary == "library" else ""} throws with {vary} '
            f'within {limits}; gravity is {rig.gravity_ratio:.2g} of the largest '
            'acceleration of the plate'
        )

    def stuck_fraction_of(item: _Candidate) -> float:
        return stuck_fraction(item.rig, uncertainties, cancelled=cancelled)

    best, stuck = ranked[0], stuck_fraction_of(ranked[0])
    if stuck > MAX_STUCK_FRACTION:
        others = [*ranked[1:], *search._replace(uncertainties=uncertainties).rank(spaces)]
        for other in sorted(others, key=lambda item: -item.score):
            if (share := stuck_fraction_of(other)) <= MAX_STUCK_FRACTION:
                best, stuck = other, share
                break
    score = Score(rig, search.objective, cancelled=cancelled)
    now_score = float(score(rig.layer.thickness, rig.layer.wave_speed)[0])
    throws = {name: predict(items[0].rig) for name, items in by.items() if items}
    return Recommendation(
        **vars(predict(best.rig)),
        rig=best.rig,
        vary=vary,
        layer=best.space.name,
        score=best.score,
        stuck_fraction=stuck,
        now=predict(rig) if now_score > 0.0 else None,
        now_score=now_score,
        now_stuck_fraction=stuck_fraction_of(present),
        by_thickness=throws.get('thickness'),
        by_wave_speed=throws.get('wave_speed'),
        candidates=candidates,
        tolerances=_tolerances(best.rig, search.objective, cancelled),
    )


def _tolerances(
    rig: Rig, objective: Objective, cancelled: Cancelled | None
) -> dict[str, float]:
    """Return the changes of thickness and wave speed that cost `TOLERATED_LOSS` [SI]."""
    score = Score(rig, objective, cells=SEARCH_CELLS, cancelled=cancelled)
    layer, tolerances = rig.layer, {}
    least = (1.0 - TOLERATED_LOSS) * float(score(layer.thickness, layer.wave_speed)[0])
    for name in ('thickness', 'wave_speed'):
        values = {'thickness': layer.thickness, 'wave_speed': layer.wave_speed}
        changes = np.append(0.0, _CHANGES)
        for _ in range(3):  # each time between the last one that is tolerated and the next one
            values[name] = getattr(layer, name) * (1.0 + np.append(-changes, changes))
            is_bad = (score(**values, needed=least) < least).reshape(2, -1).any(axis=0)
            last = max(int(is_bad.argmax()) - 1, 0) if is_bad.any() else changes.size - 2
            changes = np.linspace(changes[last], changes[last + 1], 9)
        tolerances[name] = getattr(layer, name) * float(changes[0])
    return tolerances


class _Space(NamedTuple):
    """A rig whose layer may vary within a box, and the name of a layer of the library."""

    rig: Rig
    box: Box
    name: str = ''


def _spaces(
    rig: Rig, vary: str, limits: Limits, materials: Mapping[str, Material]
) -> list[_Space]:
    """List the spaces of a request, of the library one for each material or for its sheets."""
    layer = require_uniform(rig).layer
    if vary != 'library':
        thickness = limits.thickness if vary != 'wave_speed' else (layer.thickness,) * 2
        speeds = limits.wave_speed if vary != 'thickness' else (layer.wave_speed,) * 2
        return [_Space(rig, Box(thickness, speeds))]
    spaces = []
    for material in materials.values():
        speed = material.wave_speed
        if material.is_ideal or not limits.wave_speed_min <= speed <= limits.wave_speed_max:
            continue
        smallest, largest = limits.thickness
        sheets = [(item, item) for item in material.thicknesses if smallest <= item <= largest]
        for low, high in sheets if material.thicknesses else [limits.thickness]:
            sheet = replace(
                layer,
                thickness=low if low == high else layer.thickness,
                wave_speed=speed,
                density=material.density,
                loss_tangent=material.loss_tangent,
                diameter=material.diameter or layer.diameter,
            )
            box = Box((low, high), (speed, speed))
            spaces.append(_Space(replace(rig, layer=sheet), box, material.layer_name(low)))
    return spaces


def _grid_step(space: _Space, limits: Limits) -> float:
    """
    Return the step of the grid of a search, in logarithms [-].

    A stepper takes thirty times as long as the closed form. Under strong gravity the maxima are
    too narrow for its coarse grid, with limits of loads or not.
    """
    step, gravity = 0.06, space.rig.gravity_ratio
    if STRONG_GRAVITY < gravity < 1.0:
        step = 0.09
    elif gravity < 1.0 and (space.rig.layer.needs_cells or limits.of_loads):
        step = 0.12
    has_one_axis = any(low == high for low, high in space.box)
    return 0.1 * step if has_one_axis else step


class _Candidate(NamedTuple):
    """The best layer of a space."""

    space: _Space
    rig: Rig
    score: float


class _Search(NamedTuple):
    """The arguments of `Score` that all layers of a search share."""

    objective: Objective
    limits: Limits
    cancelled: Cancelled | None
    uncertainties: Uncertainties | None = None

    def evaluate(self, space: _Space, rig: Rig) -> _Candidate:
        """Score a layer of a space with all cells; 0 outside the space."""
        layer = (rig.layer.thickness, rig.layer.wave_speed)
        is_inside = space.box.contains(*layer)
        return _Candidate(space, rig, float(self._score(space)(*layer)[0]) if is_inside else 0.0)

    def rank(self, spaces: list[_Space], starts: Sequence[Layer] = ()) -> list[_Candidate]:
        """
        Find the best layers of some spaces, the best first; `starts` are layers to search near.

        All spaces are searched coarsely, and the best of them once more.
        """
        optima = [
            (space, best)
            for space in spaces
            if (best := self._search(space, starts)) is not None
        ]
        optima = sorted(optima, key=lambda optimum: -optimum[1].score)[:_MAX_CANDIDATES]
        candidates = [self._finish(space, best) for space, best in optima]
        return sorted(
            (item for item in candidates if item.score > 0.0), key=lambda item: -item.score
        )

    def _score(self, space: _Space, cells: int | None = None) -> Score:
        """Return the score of layers of a space."""
        return Score(
            space.rig, self.objective, self.limits, uncertainties=self.uncertainties,
            cells=cells, cancelled=self.cancelled,
        )

    def _search(self, space: _Space, starts: Sequence[Layer]) -> Optimum | None:
        """Find the best layer of a space, coarsely and with few cells if it has loss."""
        has_cells = space.rig.layer.needs_cells
        first = [(layer.thickness, layer.wave_speed) for layer in starts]
        return maximise(
            self._score(space, SEARCH_CELLS if has_cells else None),
            space.box,
            step=_grid_step(space, self.limits),
            starts=[layer for layer in first if space.box.contains(*layer)],
            tolerance=5e-4 if has_cells else 1e-4,
        )

    def _finish(self, space: _Space, best: Optimum) -> _Candidate:
        """Score a layer with all cells, and search near it if its score is lower than it was."""
        layer = replace(space.rig.layer, thickness=best.thickness, wave_speed=best.wave_speed)
        exact = self.evaluate(space, replace(space.rig, layer=layer))
        if not layer.needs_cells or exact.score >= (1.0 - _COARSE_ERROR) * best.score:
            return exact
        nearby = Box(*(
            (max(low, value * (1.0 - _NEARBY)), min(high, value * (1.0 + _NEARBY)))
            for (low, high), value in zip(space.box, best, strict=False)
        ))
        best = maximise(
            self._score(space), nearby, step=_NEARBY, starts=[best[:2]], tolerance=1e-3
        ) or best._replace(score=0.0)
        layer = replace(layer, thickness=best.thickness, wave_speed=best.wave_speed)
        return _Candidate(space, replace(space.rig, layer=layer), best.score)
