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
Recommend a layer for a rig: the one that throws best, by the objective that is set.

What counts is the first release, for that is what can be relied on. See
`soft_throw_ros.design.optimise` for how the layer is looked for.
"""

from __future__ import annotations

from collections.abc import Mapping
import contextlib
from dataclasses import dataclass, replace
import functools
import math
from typing import get_args, Literal, NamedTuple, TypeAlias

from soft_throw_ros.configuration.layers import Material
from soft_throw_ros.core import checks
from soft_throw_ros.core.closed_form import first_release, ThrowUnresolvedError
from soft_throw_ros.core.rig import Engine, Layer, Projectile, Rig
from soft_throw_ros.design import texts
from soft_throw_ros.design.evaluate import Cancelled, SEARCH_CELLS
from soft_throw_ros.design.objective import LayerScore, Limits, Objective, Peak, Robust
from soft_throw_ros.design.optimise import find_best_layer, LayerRange, Optimum
from soft_throw_ros.design.prediction import predict, PredictedThrow
from soft_throw_ros.design.search_space import search_spaces, SearchSpace
from soft_throw_ros.design.sensitivity import sensitivities, Sensitivity

Vary: TypeAlias = Literal['thickness', 'wave_speed', 'both', 'library']

_EQUAL = 1e-9  # relative; of scores so close the present layer is kept
_DRAFT_ERROR = 2e-3  # relative, of scores with `SEARCH_CELLS`; what is worse is searched again ...
_NEARBY = 0.03  # within this part of thickness and wave speed
_HOLDING = 1.0  # gravity over the plate's acceleration, beyond which few layers throw well
_MAX_CANDIDATES = 5  # materials that are shown


_PARTS = ('now', 'by_thickness', 'by_wave_speed', 'by_both')
_OF_SENSITIVITY = ('elasticity', 'low', 'high', 'tolerance', 'edge')


class BestRatios(NamedTuple):
    r"""Mass ratio, speed ratio, and what they give without gravity and loss [-]."""

    damping_ratio: float
    """Of the plate."""
    mass_ratio: float
    r""":math:`\mu = m / (\rho_s S L_s)`."""
    speed_ratio: float
    r""":math:`\kappa = c_s / (L_s f)`."""
    ejection_phase: float
    """:math:`t_e f`."""
    energy_transfer: float
    r""":math:`\alpha`."""


@functools.lru_cache(maxsize=64)
def best_ratios(damping_ratio: float) -> BestRatios:
    r"""
    Find the mass and speed ratio that transfer the most energy, were there no limits.

    Parameters
    ----------
    damping_ratio : float
        Of the plate, :math:`\zeta`. [-]

    Returns
    -------
    BestRatios
        Ratios to 1e-5.

    Raises
    ------
    ValueError
        If `damping_ratio` is not in [0, 1).

    Notes
    -----
    For all :math:`\zeta` from 0 to 0.99 the best of :math:`\mu` from 0.001 to 1000 and
    :math:`\kappa` from 0.15 to 500 is at :math:`\mu` from 0.23 to 0.44 and :math:`\kappa` from
    8.2 to 12.3; it is looked for nearby.

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
    best = find_best_layer(LayerScore(rig, Peak()), layers, step=0.06, tolerance=1e-7)
    assert best is not None  # without gravity every layer throws
    mass_ratio, speed_ratio = 1.0 / best.thickness, best.wave_speed / best.thickness
    phase = first_release(
        mass_ratio=mass_ratio, speed_ratio=speed_ratio, damping_ratio=damping_ratio
    ).ejection_phase
    return BestRatios(damping_ratio, mass_ratio, speed_ratio, float(phase), best.score)


class LibraryCandidate(NamedTuple):
    """A layer from the library by its name, its thickness [m], and what it is ranked by [-]."""

    layer: str
    thickness: float
    score: float


@dataclass(frozen=True, kw_only=True)
class Recommendation(PredictedThrow):
    """
    What the recommended layer gives, and what it is to be compared with.

    Parameters
    ----------
    rig : Rig
        The rig with the recommended layer.
    objective : str
        What was looked for.
    vary : {'thickness', 'wave_speed', 'both', 'library'}
        What was allowed to change.
    layer : str
        Name of the recommended layer in the library, if it was picked there.
    score : float
        The energy transfer that counts for the objective. [-]
    now : PredictedThrow or None
        The rig as it is; None if it does not throw.
    now_score : float
        Its score, 0 if it does not throw. [-]
    by_thickness, by_wave_speed, by_both : PredictedThrow or None
        The best layer if this may change; None if nothing is thrown within the limits, or if it
        was not looked for: another objective than the peak takes its time.
    candidates : tuple of LibraryCandidate
        Layers of the library that came near, if one was to be picked; the best first.
    sensitivities : tuple of Sensitivity
        How much the parameters matter around the recommended layer.
    optimum : BestRatios
        The best ratios for the engine's damping, were there no limits and no loss.
    summary : str
        What changes and what is gained, in a sentence.
    remarks : str
        What has to be known besides, about the best ratios, gravity and large strain.

    """

    rig: Rig
    objective: str
    vary: Vary
    layer: str
    score: float
    now: PredictedThrow | None
    now_score: float
    by_thickness: PredictedThrow | None = None
    by_wave_speed: PredictedThrow | None = None
    by_both: PredictedThrow | None = None
    candidates: tuple[LibraryCandidate, ...]
    sensitivities: tuple[Sensitivity, ...]
    optimum: BestRatios
    summary: str = ''
    remarks: str = ''

    @property
    def gain(self) -> float:
        """Part by which the score would grow, infinite if there is none now [-]."""
        return self.score / self.now_score - 1.0 if self.now_score > 0.0 else math.inf

    def values(self) -> dict[str, float | str | bool]:
        """Return everything by name, with a dot between the name of a part and of its value."""
        parts = {name: vars(each) for name, each in vars(self).items() if name in _PARTS and each}
        parts['optimum'] = self.optimum._asdict()
        for item in self.sensitivities:
            parts[item.name] = {name: getattr(item, name) for name in _OF_SENSITIVITY}
        parts['candidate'] = {item.layer: item.score for item in self.candidates}
        return super().values() | {
            f'{name}.{key}': value for name, part in parts.items() for key, value in part.items()
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

    All of the rig but the layer stays. Of the layer thickness and wave speed may change, its
    density and loss tangent not: another wave speed is another modulus. Or all of it is picked
    from a library.

    Parameters
    ----------
    rig : Rig
        With the layer that it has now.
    vary : {'thickness', 'wave_speed', 'both', 'library'}
        What may change.
    objective : Peak, Robust or Versatile, optional
        What is to be largest; the energy of the throw if not given.
    limits : Limits, optional
        What must not be exceeded. What may not change need not be within.
    materials : mapping of str to Material, optional
        From which one is picked, if `vary` is 'library'.
    cancelled : callable, optional
        Asked between batches of throws, some tenths of a second each, whether to give up.

    Returns
    -------
    Recommendation
        The present layer if no other is better, and the thinner one of equals.

    Raises
    ------
    ValueError
        If a choice is unknown, the layer is not of one material, or an uncertainty is as large as
        what is uncertain.
    ThrowUnresolvedError
        If no throw with a layer within the limits can be computed: too many crossings, gravity
        holds the projectile, or every layer exceeds strain or acceleration.
    SearchCancelledError
        If `cancelled` says so.

    Notes
    -----
    The score is within 0.5 % of the best, as seen in random rigs, objectives and limits beside
    fine grids; except as said in `soft_throw_ros.design.optimise`. All numbers returned but those
    of `BestRatios` are with gravity and loss.

    Examples
    --------
    >>> best = recommend(Rig(), vary='thickness')
    >>> best.summary
    'thickness 16.8 -> 13.41 mm: 5.4 % more energy (alpha 3.64 -> 3.83); +-2.1 mm costs 2 %'

    """
    if vary not in get_args(Vary):
        raise ValueError(f'vary must be one of {", ".join(get_args(Vary))}, got {vary!r}')
    search = _Search(objective or Peak(), limits or Limits(), cancelled)
    best, found, picked = _look(rig, vary, search, materials or {})
    if best is None:
        free = replace(search.limits, max_strain=math.inf, max_acceleration=math.inf)
        easier: Recommendation | None = None
        if free != search.limits:
            with contextlib.suppress(ThrowUnresolvedError):
                easier = recommend(
                    rig, vary=vary, objective=objective, limits=free, materials=materials,
                    cancelled=cancelled,
                )
        raise ThrowUnresolvedError(texts.why_nothing(rig, vary, search.limits, easier))
    score_now = LayerScore(rig, search.objective, cancelled=cancelled)
    now = float(score_now(rig.layer.thickness, rig.layer.wave_speed)[0])
    by = {name: predict(each.rig) for name, each in found.items()}
    of_space = search.objective_for(best.space)
    answer = Recommendation(
        **vars(predict(best.rig)),
        rig=best.rig,
        objective=search.objective.name,
        vary=vary,
        layer=best.space.name,
        score=best.score,
        now=predict(rig) if now > 0.0 else None,
        now_score=now,
        by_thickness=by.get('thickness'),
        by_wave_speed=by.get('wave_speed'),
        by_both=by.get('both'),
        candidates=tuple(
            LibraryCandidate(each.space.name, each.rig.layer.thickness, each.score)
            for each in picked
        ),
        sensitivities=tuple(sensitivities(best.rig, of_space, cancelled)),
        optimum=best_ratios(rig.engine.damping_ratio),
    )
    summary = texts.summary_of(answer, rig.layer, search.limits, search.objective.summary)
    return replace(answer, summary=summary, remarks=texts.remarks_of(answer))


class _Found(NamedTuple):
    """The best layer of a space."""

    space: SearchSpace
    rig: Rig
    score: float


def _look(
    rig: Rig, vary: Vary, search: _Search, materials: Mapping[str, Material]
) -> tuple[_Found | None, dict[str, _Found], list[_Found]]:
    """Return the best layer; those by thickness, wave speed or both; those from the library."""
    found: dict[str, _Found] = {}
    for name in ('thickness', 'wave_speed', 'both'):
        if isinstance(search.objective, Peak) or name == vary:
            (space,) = search_spaces(rig, name, search.limits, {})
            starts = tuple(each.rig.layer for each in found.values())
            best = search.finish(space, search.draft(space, starts=starts))
            if best is not None:
                found[name] = best
    picked: list[_Found] = []
    if vary == 'library':
        picked = search.pick(search_spaces(rig, vary, search.limits, materials))
    return (picked[0] if picked else found.get(vary)), found, picked


class _Search(NamedTuple):
    """What is looked for."""

    objective: Objective
    limits: Limits
    cancelled: Cancelled | None

    def objective_for(self, space: SearchSpace) -> Objective:
        """Return the objective for a material whose wave speed may be off by its spread."""
        objective = self.objective
        if isinstance(objective, Robust) and space.spread > objective.uncertainties.wave_speed:
            uncertainties = replace(objective.uncertainties, wave_speed=space.spread)
            return replace(objective, uncertainties=uncertainties)
        return objective

    def pick(self, spaces: list[SearchSpace]) -> list[_Found]:
        """Find the best layers among many spaces, the best first."""
        drafts: list[tuple[SearchSpace, Optimum]] = []
        least = 0.0
        for space in self._promising_first(spaces):
            best = self.draft(space, least=(1.0 - _DRAFT_ERROR) * least)
            if best is not None:
                drafts.append((space, best))
                drafts.sort(key=lambda each: -each[1].score)
            if len(drafts) >= _MAX_CANDIDATES:
                least = drafts[_MAX_CANDIDATES - 1][1].score
        found = [self.finish(*each) for each in drafts[:_MAX_CANDIDATES]]
        return sorted((each for each in found if each is not None), key=lambda each: -each.score)

    def _promising_first(self, spaces: list[SearchSpace]) -> list[SearchSpace]:
        """Sort spaces by about their peaks, which are soon found: no objective gives more."""
        if isinstance(self.objective, Peak):
            return spaces
        peak = _Search(Peak(), Limits(), self.cancelled)
        drafts = [(peak.draft(space, tolerance=1.0), space) for space in spaces]
        drafts.sort(key=lambda each: 0.0 if each[0] is None else -each[0].score)
        return [space for _, space in drafts]

    def score(self, space: SearchSpace, cells: int | None = None) -> LayerScore:
        """Return the score of layers of a space."""
        return LayerScore(
            space.rig, self.objective_for(space), self.limits, cells=cells,
            cancelled=self.cancelled,
        )

    def draft(
        self,
        space: SearchSpace,
        *,
        starts: tuple[Layer, ...] = (),
        least: float = 0.0,
        tolerance: float | None = None,
    ) -> Optimum | None:
        """Find the best layer of a space; by few cells if it takes cells, and not as closely."""
        has_cells = space.rig.layer.needs_cells
        score = self.score(space, SEARCH_CELLS if has_cells else None)
        known = [
            (layer.thickness, layer.wave_speed)
            for layer in (space.rig.layer, *starts)
            if not space.is_single and space.layers.contains(layer.thickness, layer.wave_speed)
        ]
        return find_best_layer(
            score,
            space.layers,
            step=space.step,
            starts=tuple(Optimum(*layer, float(score(*layer, least=least)[0])) for layer in known),
            tolerance=tolerance or (5e-4 if has_cells else 1e-5),
            least=least,
            is_whole=self.limits.of_loads or space.rig.gravity_ratio > _HOLDING,
        )

    def finish(self, space: SearchSpace, best: Optimum | None) -> _Found | None:
        """Make sure of a draft, and prefer the layer that there is if it is as good."""
        score, present = self.score(space), space.rig.layer
        if best is not None and present.needs_cells:
            best = _refine(score, best, space.layers)
        if not space.is_single and space.layers.contains(present.thickness, present.wave_speed):
            now = float(score(present.thickness, present.wave_speed)[0])
            if now > 0.0 and (best is None or now >= (1.0 - _EQUAL) * best.score):
                best = Optimum(present.thickness, present.wave_speed, now)
        return None if best is None else _Found(space, space.rig_with(best), best.score)


def _refine(exact: LayerScore, best: Optimum, layers: LayerRange) -> Optimum | None:
    """Make sure that what was found with few cells is not beyond a jump or a limit with many."""
    score = float(exact(best.thickness, best.wave_speed)[0])
    if score >= (1.0 - _DRAFT_ERROR) * best.score:
        return best._replace(score=score)
    nearby = LayerRange(*(
        (max(low, value * (1.0 - _NEARBY)), min(high, value * (1.0 + _NEARBY)))
        for (low, high), value in zip(layers, best, strict=False)
    ))
    start = (best._replace(score=score),) if score > 0.0 else ()
    return find_best_layer(exact, nearby, step=_NEARBY, starts=start, tolerance=1e-3)
