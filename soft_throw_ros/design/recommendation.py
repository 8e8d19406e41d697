# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
Recommend the layer of a rig that throws best by an objective.

The first release counts, because it is more predictable than later ones. The search is described
in `soft_throw_ros.design.optimise`.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
import functools
import math
from typing import get_args, Literal, NamedTuple, TypeAlias

import numpy as np
from soft_throw_ros.configuration.layers import Material
from soft_throw_ros.core import checks
from soft_throw_ros.core.batch import Cancelled, ThrowUnresolvedError
from soft_throw_ros.core.closed_form import first_release
from soft_throw_ros.core.rig import Engine, Layer, Projectile, Rig
from soft_throw_ros.core.throws import SEARCH_CELLS
from soft_throw_ros.design.objective import LayerScore, Limits, Objective, peak
from soft_throw_ros.design.optimise import find_best_layer, LayerRange, Optimum
from soft_throw_ros.design.prediction import predict, PredictedThrow
from soft_throw_ros.design.search_space import search_spaces, SearchSpace

Vary: TypeAlias = Literal['thickness', 'wave_speed', 'both', 'library']

TOLERATED_LOSS = 0.02
"""Part of the score that may be lost within the tolerance of a parameter. [-]"""

_SMALLEST_CHANGE, _LARGEST_CHANGE = 2.0**-8, 0.5
"""Relative changes of a parameter between which the search for its tolerance begins. [-]"""

_HALVINGS = 8
"""Number of bisections of a tolerance, which leave an error of 0.4 %."""

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


class BestRatios(NamedTuple):
    r"""Mass ratio, speed ratio, and their release without gravity and loss [-]."""

    damping_ratio: float
    r"""Damping ratio of the plate, :math:`\zeta`."""
    mass_ratio: float
    r"""Mass of the projectile over that of the layer, :math:`\mu`."""
    speed_ratio: float
    r"""Crossings of the wave per plate period, :math:`\kappa = c_s / (L_s f)`."""
    ejection_phase: float
    """Ejection time in plate periods, :math:`t_e f`."""
    energy_transfer: float
    r"""Energy transfer, :math:`\alpha`."""


@functools.lru_cache(maxsize=64)
def best_ratios(damping_ratio: float) -> BestRatios:
    r"""
    Find the mass and speed ratio that transfer the most energy without limits.

    Parameters
    ----------
    damping_ratio : float
        Damping ratio of the plate, :math:`\zeta`. [-]

    Notes
    -----
    The ratios are exact to 1e-5. For all :math:`\zeta` from 0 to 0.99 the best of :math:`\mu`
    from 0.001 to 1000 and :math:`\kappa` from 0.15 to 500 is at :math:`\mu` from 0.23 to 0.44
    and :math:`\kappa` from 8.2 to 12.3; it is looked for nearby.

    Examples
    --------
    >>> best = best_ratios(0.064)
    >>> round(best.mass_ratio, 5), round(best.speed_ratio, 5), round(best.energy_transfer, 6)
    (0.2554, 8.57592, 4.142897)

    """
    damping_ratio = checks.require_in_unit_interval('damping_ratio', damping_ratio)
    # a rig whose layer has these very ratios for thickness and wave speed
    rig = Rig(
        engine=Engine(frequency=1.0, amplitude=1.0, damping_ratio=damping_ratio),
        layer=Layer(thickness=1.0, wave_speed=1.0, density=1.0, diameter=2.0 / math.sqrt(math.pi)),
        projectile=Projectile(mass=1.0),
        gravity=0.0,
    )
    layers = LayerRange(thickness=(1.5, 6.0), wave_speed=(15.0, 75.0))
    best = find_best_layer(LayerScore(rig, peak), layers, step=0.06, tolerance=1e-7)
    assert best is not None  # without gravity every layer throws
    mass_ratio, speed_ratio = 1.0 / best.thickness, best.wave_speed / best.thickness
    phase = first_release(
        mass_ratio=mass_ratio, speed_ratio=speed_ratio, damping_ratio=damping_ratio
    ).ejection_phase
    return BestRatios(damping_ratio, mass_ratio, speed_ratio, float(phase), best.score)


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
    now: PredictedThrow | None
    """The rig as it is; None if it does not throw."""
    now_score: float
    """Score of the rig as it is, 0 if it does not throw. [-]"""
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
        Score to maximise, as in `objective.OBJECTIVES`; the energy of the throw if not given.
    limits : Limits, optional
        Limits of the layer and its loads. They do not apply to parameters that may not change.
    materials : mapping of str to Material, optional
        The library, if `vary` is 'library'.
    cancelled : callable, optional
        Called every few tenths of a second; returns whether to give up.

    Returns
    -------
    Recommendation
        The present layer if no other is better, and the thinner one of equals.

    Raises
    ------
    ValueError
        If a choice is unknown, the layer is not of one material, or an uncertainty is as large as
        its value.
    ThrowUnresolvedError
        If no throw with a layer within the limits can be computed: too many crossings, gravity
        holds the projectile, or every layer exceeds strain or acceleration.
    SearchCancelledError
        If `cancelled` returns True.

    Notes
    -----
    The score is within 0.1 % of the best, as seen in random rigs, objectives and limits beside
    fine grids; except as said in `soft_throw_ros.design.optimise`. All numbers returned but those
    of `BestRatios` are with gravity and loss.

    Examples
    --------
    >>> best = recommend(Rig(), vary='thickness')
    >>> round(1e3 * best.thickness, 2), round(best.score, 2), round(best.gain, 3)
    (13.41, 3.83, 0.054)

    """
    if vary not in get_args(Vary):
        raise ValueError(f'vary must be one of {", ".join(get_args(Vary))}, got {vary!r}')
    search = _Search(objective or peak, limits or Limits(), cancelled)
    alternatives: dict[str, _Candidate] = {}
    for name in ('thickness', 'wave_speed'):
        for alternative in search.rank(search_spaces(rig, name, search.limits, {})):
            alternatives[name] = alternative
    if vary in ('thickness', 'wave_speed'):
        ranked = [alternatives[vary]] if vary in alternatives else []
    else:
        spaces = search_spaces(rig, vary, search.limits, materials or {})
        ranked = search.rank(spaces, [item.rig.layer for item in alternatives.values()])
    if not ranked:
        raise ThrowUnresolvedError(
            f'no layer{" from the library" if vary == "library" else ""} throws with {vary} '
            f'within {search.limits}; gravity is {rig.gravity_ratio:.2g} of the largest '
            'acceleration of the plate'
        )
    best = ranked[0]
    score_now = LayerScore(rig, search.objective, cancelled=cancelled)
    now = float(score_now(rig.layer.thickness, rig.layer.wave_speed)[0])
    by = {name: predict(item.rig) for name, item in alternatives.items()}
    return Recommendation(
        **vars(predict(best.rig)),
        rig=best.rig,
        vary=vary,
        layer=best.space.name,
        score=best.score,
        now=predict(rig) if now > 0.0 else None,
        now_score=now,
        by_thickness=by.get('thickness'),
        by_wave_speed=by.get('wave_speed'),
        candidates=tuple(
            LibraryCandidate(item.space.name, item.rig.layer.thickness, item.score)
            for item in ranked
            if vary == 'library'
        ),
        tolerances=_tolerances(best.rig, search.objective, cancelled),
    )


def _tolerances(
    rig: Rig, objective: Objective, cancelled: Cancelled | None
) -> dict[str, float]:
    """Return the changes of thickness and wave speed that cost `TOLERATED_LOSS` [SI]."""
    score = LayerScore(rig, objective, cells=SEARCH_CELLS, cancelled=cancelled)
    thickness, wave_speed = rig.layer.thickness, rig.layer.wave_speed
    least = (1.0 - TOLERATED_LOSS) * float(score(thickness, wave_speed)[0])

    def is_tolerated(of_thickness: float, of_speed: float) -> bool:
        signs = np.array([-1.0, 1.0])
        scores = score(
            thickness * (1.0 + of_thickness * signs), wave_speed * (1.0 + of_speed * signs)
        )
        return bool(scores.min() >= least)

    return {
        'thickness': thickness * _largest(lambda change: is_tolerated(change, 0.0)),
        'wave_speed': wave_speed * _largest(lambda change: is_tolerated(0.0, change)),
    }


def _largest(is_tolerated: Callable[[float], bool]) -> float:
    """Find the largest relative change up to which all are tolerated, by bisection [-]."""
    low, high = 0.0, _SMALLEST_CHANGE
    while is_tolerated(high):
        if high >= _LARGEST_CHANGE:
            return high
        low, high = high, 2.0 * high
    for _ in range(_HALVINGS):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if is_tolerated(middle) else (low, middle)
    return low


class _Candidate(NamedTuple):
    """The best layer of a space."""

    space: SearchSpace
    rig: Rig
    score: float


class _Search(NamedTuple):
    """The objective, the limits and the cancellation callback of a search."""

    objective: Objective
    limits: Limits
    cancelled: Cancelled | None

    def rank(
        self, spaces: list[SearchSpace], starts: Sequence[Layer] = ()
    ) -> list[_Candidate]:
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
        candidates = filter(None, (self._finish(space, best) for space, best in optima))
        return sorted(candidates, key=lambda candidate: -candidate.score)

    def _score(self, space: SearchSpace, cells: int | None = None) -> LayerScore:
        """Return the score of layers of a space."""
        return LayerScore(
            space.rig, self.objective, self.limits, cells=cells, cancelled=self.cancelled
        )

    def _search(self, space: SearchSpace, starts: Sequence[Layer]) -> Optimum | None:
        """Find the best layer of a space, coarsely and with few cells if it has loss."""
        has_cells = space.rig.layer.needs_cells
        first = [(layer.thickness, layer.wave_speed) for layer in (space.rig.layer, *starts)]
        score = self._score(space, SEARCH_CELLS if has_cells else None)
        return find_best_layer(
            score,
            space.layers,
            step=space.grid_step(loads=self.limits.of_loads, throws=score.throws_per_layer),
            starts=[layer for layer in first if space.layers.contains(*layer)],
            tolerance=5e-4 if has_cells else 1e-4,
        )

    def _finish(self, space: SearchSpace, best: Optimum | None) -> _Candidate | None:
        """Score a layer with all cells, and prefer the present layer if it is as good."""
        score, present = self._score(space), space.rig.layer
        if best is not None and present.needs_cells:
            best = _refine(score, best, space.layers)
        if not space.is_single and space.layers.contains(present.thickness, present.wave_speed):
            now = float(score(present.thickness, present.wave_speed)[0])
            if now > 0.0 and (best is None or now >= (1.0 - _EQUAL) * best.score):
                best = Optimum(present.thickness, present.wave_speed, now)
        return None if best is None else _Candidate(space, space.rig_with(best), best.score)


def _refine(score: LayerScore, best: Optimum, layers: LayerRange) -> Optimum | None:
    """Search near a layer with all cells if its score with all cells is lower."""
    exact = float(score(best.thickness, best.wave_speed)[0])
    if exact >= (1.0 - _COARSE_ERROR) * best.score:
        return best._replace(score=exact)
    nearby = LayerRange(*(
        (max(low, value * (1.0 - _NEARBY)), min(high, value * (1.0 + _NEARBY)))
        for (low, high), value in zip(layers, best, strict=False)
    ))
    return find_best_layer(score, nearby, step=_NEARBY, starts=[best[:2]], tolerance=1e-3)
