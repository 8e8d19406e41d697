# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
Recommend the layer of a rig that throws best by an objective, and solve requests of the twin.

The first release counts, because it is more predictable than later ones.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial
import math
from typing import Any, get_args, Literal, NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray
from soft_throw_ros.configuration import rig_of, Settings
from soft_throw_ros.configuration.layers import library, Material
from soft_throw_ros.core.batch import Cancelled, ThrowUnresolvedError
from soft_throw_ros.core.rig import Layer, Rig
from soft_throw_ros.core.throw import rig_with, SEARCH_CELLS
from soft_throw_ros.design.aiming import Aim, aim
from soft_throw_ros.design.maximise import Box, EQUAL, maximise, NEAR, Optimum
from soft_throw_ros.design.motion import design_motion, MotionDesign, PlateLimits
from soft_throw_ros.design.prediction import (
    gain_text,
    predict,
    PredictedThrow,
    stuck_fraction,
    Uncertainties,
)
from soft_throw_ros.design.score import Limits, Objective, peak, robust, Score, versatile

Floats = NDArray[np.float64]

Vary: TypeAlias = Literal['thickness', 'wave_speed', 'both', 'library']

TOLERATED_LOSS = 0.02
"""Part of the score that may be lost within the tolerance of a parameter. [-]"""

MAX_STUCK_FRACTION = 0.05
"""Share of throws without a release, within the uncertainties, of a layer to recommend. [-]"""

_LARGEST_CHANGE = 0.5  # largest relative tolerance of a layer [-]
_COARSE_ERROR = 2e-3  # relative error of scores with `SEARCH_CELLS` [-]
_HOLDING_GRAVITY = 4.0  # over the largest acceleration of the plate; beyond, nothing is thrown [-]
_MAX_CANDIDATES = 5  # layers of the library that are compared with all cells


class LibraryCandidate(NamedTuple):
    """A layer of the library: its name, its thickness [m], and its score [-]."""

    layer: str
    thickness: float
    score: float


@dataclass(frozen=True, kw_only=True)
class Recommendation(PredictedThrow):
    """Throw of the recommended layer, and throws to compare it with."""

    rig: Rig  # the rig with the recommended layer
    present: Rig  # the rig as it is
    vary: Vary  # part of the layer that was allowed to change
    layer: str  # name of the recommended layer in the library, if it was picked there
    score: float  # energy transfer that counts for the objective [-]
    stuck_fraction: float  # share of throws within the uncertainties without a release [-]
    now: PredictedThrow | None  # the rig as it is; None if it does not throw
    now_score: float  # score of the rig as it is, 0 if it does not throw [-]
    now_stuck_fraction: float  # the same share of the rig as it is [-]
    by_thickness: PredictedThrow | None  # the best layer if only the thickness may change
    by_wave_speed: PredictedThrow | None  # the best layer if only the wave speed may change
    candidates: tuple[LibraryCandidate, ...]  # from the library, the best first
    tolerances: Mapping[str, float]  # changes up or down that cost `TOLERATED_LOSS` [SI]

    @property
    def gain(self) -> float:
        """Relative gain of the score, infinite without a score of the present layer [-]."""
        return self.score / self.now_score - 1.0 if self.now_score > 0.0 else math.inf

    @property
    def summary(self) -> str:
        """A sentence with the new layer, the gain of energy, the tolerances, and doubts."""
        name = 'alpha' if math.isclose(self.score, self.energy_transfer) else 'worst alpha'
        held, text = self.now_stuck_fraction, 'the present layer throws nothing'
        if self.now_score > 0.0:
            text = gain_text(self.gain)
            if self.gain < 0.0 and held > MAX_STUCK_FRACTION:
                text += f', but the present layer has no release in {100.0 * held:.2g} %'
            elif self.gain < 0.0:
                text += ', because the present layer exceeds the limits'
        text = f'{self._changes()}: {text} ({name} {self.now_score:.2f} -> {self.score:.2f})'
        if self.rig.layer == self.present.layer:
            text = f'keep your layer: none within the limits is better ({name} {self.score:.2f})'
        if self.stuck_fraction > MAX_STUCK_FRACTION:
            text = f'no release in {100.0 * self.stuck_fraction:.2g} % of all cases; {text}'
        thickness, wave_speed = self.tolerances['thickness'], self.tolerances['wave_speed']
        text += f'; +-{1e3 * thickness:.2g} mm or +-{wave_speed:.2g} m/s costs 2 %'
        if self.peak_strain >= 1.0:
            text += f'; no layer can be compressed by {100.0 * self.peak_strain:.0f} %'
        return text

    def _changes(self) -> str:
        """Name the parameters that change, with their old and new values."""
        old, changes = self.present.layer, [f'layer {self.layer}'] if self.layer else []
        if self.vary != 'wave_speed':
            changes.append(f'thickness {1e3 * old.thickness:.4g} -> {1e3 * self.thickness:.4g} mm')
        if self.vary in ('wave_speed', 'both'):
            changes.append(
                f'wave speed {old.wave_speed:.4g} -> {self.wave_speed:.4g} m/s, that is modulus '
                f'{1e-3 * old.youngs_modulus:.4g} -> {1e-3 * self.youngs_modulus:.4g} kPa'
            )
        return ' and '.join(changes)

    def values(self) -> dict[str, float | str | bool]:
        """Return everything by name, with a dot between the name of a part and of its value."""
        scores = {f'candidates.{item.layer}': item.score for item in self.candidates}
        return super().values() | scores


RequestResult: TypeAlias = Recommendation | Aim | MotionDesign


def solve_request(
    settings: Settings, *, rig: Rig | None = None, cancelled: Cancelled | None = None
) -> RequestResult:
    """
    Recommend a layer or a motion, or aim, by the complete settings of the twin.

    `rig` is the rig that the settings describe, if it exists already. A ValueError has the reason
    why a request is impossible; SearchCancelledError follows when `cancelled` returns True.
    """
    rig, limits = rig or rig_of(settings), Limits.from_settings(settings)
    request = {name.removeprefix('recommendation.'): value for name, value in settings.items()}
    uncertainties = Uncertainties.from_settings(settings)
    if request['objective'] == 'aim':
        height, speed = request['target_height'] or None, request['target_speed'] or None
        return aim(rig, height=height, speed=speed, limits=limits, cancelled=cancelled)
    if request['vary'] == 'motion':
        if request['objective'] != 'peak':
            rule = "recommendation.vary 'motion' is for recommendation.objective 'peak' alone"
            raise ValueError(f'{rule}, got {request["objective"]!r}')
        now = vars(PlateLimits.of(rig.engine))
        plate = PlateLimits(**{name: request.get(f'plate_{name}') or now[name] for name in now})
        return design_motion(
            rig, plate, limits=limits, uncertainties=uncertainties, cancelled=cancelled
        )
    objectives: dict[str, Objective] = {
        'peak': peak,
        'robust': partial(robust, uncertainties=uncertainties),
        'versatile': partial(
            versatile, masses=request['masses'], frequencies=request['frequencies']
        ),
    }
    is_from_library = request['vary'] == 'library'
    return recommend(
        rig,
        vary=request['vary'],
        objective=objectives[request['objective']],
        limits=limits,
        materials=library(settings['layer.library']).materials if is_from_library else None,
        uncertainties=uncertainties,
        cancelled=cancelled,
    )


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

    Only the layer changes: its thickness and wave speed, at the same density and loss tangent, so
    that another wave speed means another modulus; or the whole layer, as one of a library of
    `materials`, of which idealised ones are not recommended. The `limits` of the layer do not
    apply to parameters that may not change. Within the `uncertainties`, those of the paper if not
    given, at most `MAX_STUCK_FRACTION` of the throws have no release, if a layer allows that. The
    result is the present layer if no other is better, and the thinner one of equals.

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
    by = {name: search.rank(_spaces(rig, name, limits)) for name in ('thickness', 'wave_speed')}
    spaces = _spaces(rig, vary, limits, materials)
    ranked = by[vary] if vary in by else search.rank(
        spaces, [item.rig.layer for items in by.values() for item in items]
    )
    box = limits.box if vary == 'library' else spaces[0].box
    candidates = tuple(
        LibraryCandidate(item.name, item.rig.layer.thickness, item.score)
        for item in ranked
        if vary == 'library'
    )
    present = search.evaluate(rig)
    if present.score > 0.0 and box.contains(rig.layer.thickness, rig.layer.wave_speed):
        ranked = [present, *ranked]
        ranked.sort(key=lambda item: -item.score * (1.0 + EQUAL * (item is present)))
    if not ranked:
        raise ThrowUnresolvedError(
            f'no layer{" from the library" if vary == "library" else ""} throws with {vary} '
            f'within {limits}; gravity is {rig.gravity_ratio:.2g} of the largest '
            'acceleration of the plate'
        )

    def stuck(item: _Candidate) -> float:
        return stuck_fraction(item.rig, uncertainties, cancelled=cancelled)

    best = ranked[0]
    if stuck(best) > MAX_STUCK_FRACTION:
        safe = search._replace(objective=partial(robust, uncertainties=uncertainties))
        others = [search.evaluate(item.rig, item.name) for item in safe.rank(spaces)]
        others = sorted([*ranked, *others], key=lambda item: -item.score)
        best = next((item for item in others if stuck(item) <= MAX_STUCK_FRACTION), best)
    now_score = search._replace(limits=Limits()).evaluate(rig).score
    throws: dict[str, Any] = {
        f'by_{name}': predict(items[0].rig) if items else None for name, items in by.items()
    }
    score = Score(best.rig, search.objective, cells=SEARCH_CELLS, cancelled=cancelled)
    return Recommendation(
        **vars(predict(best.rig)),
        **throws,
        rig=best.rig,
        present=rig,
        vary=vary,
        layer=best.name,
        score=best.score,
        stuck_fraction=stuck(best),
        now=predict(rig) if now_score > 0.0 else None,
        now_score=now_score,
        now_stuck_fraction=stuck(present),
        candidates=candidates,
        tolerances={name: _tolerance(score, best.rig.layer, name) for name in by},
    )


def _tolerance(score: Score, layer: Layer, name: str) -> float:
    """Return the change of a value of a layer, up or down, that costs `TOLERATED_LOSS` [SI]."""
    values: dict[str, Any] = {'thickness': layer.thickness, 'wave_speed': layer.wave_speed}
    value, least = values[name], (1.0 - TOLERATED_LOSS) * score(**values)[0]
    low, high = 0.0, _LARGEST_CHANGE
    for _ in range(3):  # each divides the interval by 16
        changes = np.linspace(low, high, 17)[1:]
        values[name] = value * (1.0 + np.concatenate([-changes, changes]))
        scores = score(**values, needed=least).reshape(2, -1).min(axis=0)
        if (scores >= least).all():
            return float(value * high)
        low, high = np.append(low, changes)[(scores < least).argmax() + np.arange(2)].tolist()
    return float(value * low)


class _Space(NamedTuple):
    """A rig whose layer may vary within a box, and the name of a layer of the library."""

    rig: Rig
    box: Box
    name: str = ''


def _spaces(
    rig: Rig, vary: str, limits: Limits, materials: Mapping[str, Material] | None = None
) -> list[_Space]:
    """List the spaces of a request, of the library one for each material or for its sheets."""
    layer, box = rig.layer, limits.box
    if layer.parts:
        raise ValueError(
            f'only layers of one material are designed, got {len(layer.parts)} sheets'
        )
    if vary == 'thickness':
        box = box._replace(wave_speed=(layer.wave_speed,) * 2)
    if vary == 'wave_speed':
        box = box._replace(thickness=(layer.thickness,) * 2)
    if vary != 'library':
        return [_Space(rig, box)]
    spaces = []
    for material in (materials or {}).values():
        speed, values = material.wave_speed, material.settings.items()
        sheet = rig_with(rig, {name.removeprefix('layer.'): value for name, value in values})
        for low, high in [(size, size) for size in material.thicknesses] or [box.thickness]:
            if not material.is_ideal and box.contains(low, speed):
                space = Box((low, high), (speed, speed))
                spaces.append(_Space(sheet, space, material.layer_name(low)))
    return spaces


class _Candidate(NamedTuple):
    """A rig with the best layer of a space, its score, and its name in the library."""

    rig: Rig
    score: float
    name: str


class _Search(NamedTuple):
    """The arguments of `Score` that all layers of a search share."""

    objective: Objective
    limits: Limits
    cancelled: Cancelled | None

    def rank(self, spaces: list[_Space], starts: Sequence[Layer] = ()) -> list[_Candidate]:
        """Find the best layers of spaces with few cells, and the best of them once more."""
        optima: list[tuple[_Space, Optimum]] = []
        layers = [(layer.thickness, layer.wave_speed) for layer in starts]
        for space in spaces:
            if space.rig.gravity_ratio > _HOLDING_GRAVITY:
                continue
            score = self._score(space.rig, SEARCH_CELLS if space.rig.layer.needs_cells else None)
            optimum = maximise(
                score,
                space.box,
                rough=partial(score, stages=2),
                starts=[layer for layer in layers if space.box.contains(*layer)],
                needed=(1.0 - NEAR) * max((item.score for _, item in optima), default=0.0),
            )
            if optimum is not None:
                optima.append((space, optimum))
        optima = sorted(optima, key=lambda item: -item[1].score)[:_MAX_CANDIDATES]
        candidates = [self._finish(*item) for item in optima]
        return sorted(
            (item for item in candidates if item.score > 0.0), key=lambda item: -item.score
        )

    def evaluate(self, rig: Rig, name: str = '') -> _Candidate:
        """Score the layer of a rig with all cells."""
        score = self._score(rig)(rig.layer.thickness, rig.layer.wave_speed)
        return _Candidate(rig, float(score[0]), name)

    def _score(self, rig: Rig, cells: int | None = None) -> Score:
        return Score(rig, self.objective, self.limits, cells=cells, cancelled=self.cancelled)

    def _finish(self, space: _Space, optimum: Optimum) -> _Candidate:
        """Score a layer with all cells, and search near it if its score is lower than it was."""
        score, layer = self._score(space.rig), optimum[:2]
        best = optimum._replace(score=float(score(*layer)[0]))
        if best.score < (1.0 - _COARSE_ERROR) * optimum.score:
            best = maximise(score, space.box, starts=[layer], is_local=True) or best
        rig = rig_with(space.rig, dict(zip(Optimum._fields[:2], best, strict=False)))
        return _Candidate(rig, best.score, space.name)
