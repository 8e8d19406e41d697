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
"""Start values for a layer: a search over all possible ones, so that no guess is needed."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from soft_throw_ros.core.rig import Engine, Rig
from soft_throw_ros.identification.fit_description import changed_rig, LAYER
from soft_throw_ros.identification.forward import BudgetExceeded
from soft_throw_ros.identification.least_squares import Fit, FitError
from soft_throw_ros.identification.parameter_layout import OWN, START
from soft_throw_ros.identification.plate_fit import PlateFit
from soft_throw_ros.identification.plate_waves import PlateWithWaves
from soft_throw_ros.identification.rig_model import cut_after, RigModel
from soft_throw_ros.identification.tracks import Track

Floats = NDArray[np.float64]

_WAVE_SPEEDS = np.geomspace(1.0, 200.0, 321)
_THICKNESSES = (0.6, 0.8, 1.0, 1.25, 1.6)  # coarse grid, relative to the given thickness
_THICKNESSES_NEARBY = np.geomspace(0.75, 1.33, 41)  # fine grid, relative to a candidate
_MIN_THICKNESS = 1e-4  # smallest thickness of the search [m]
_LOSS_TANGENT = 0.05  # initial loss tangent

_THROWS = 3  # largest number of throws in the search
_PERIODS = 2.0  # time of each throw in the search [plate periods]
_SAMPLES = 120  # largest number of samples of each track in the search

_NARROWED = 24  # largest number of valleys that are narrowed
_NARROWING_STEPS = 12  # number of wave speeds within a narrowed valley
_REFINED = 6  # largest number of refined candidates
_REFINING_STEPS = 20  # largest number of evaluations of a refinement
_MAX_RATIO = 20.0  # sum of squares, relative to the best, above which candidates are dropped
_ALIKE = 5e-3  # relative difference below which two layers count as equal


class PlateAtWork(NamedTuple):
    """The motion of the plate of a throw, and the time of its start [s]."""

    engine: Engine
    motion: PlateWithWaves
    start_time: float


class LayerCandidate(NamedTuple):
    """A rig to start from, and the sum of squares that it leaves."""

    chi2: float
    rig: Rig

    def is_like(self, other: LayerCandidate) -> bool:
        """Return whether two layers are almost equal."""
        layer, rival = self.rig.layer, other.rig.layer
        pairs = (layer.wave_speed, rival.wave_speed), (layer.thickness, rival.thickness)
        return all(math.isclose(*pair, rel_tol=_ALIKE) for pair in pairs)


def find_layers(model: RigModel, plates: Sequence[PlateFit], of_plates: Fit) -> list[Rig]:
    """
    Find about which layer it is: look at many, nearer where it looks good, and refine the best.

    Returns the best, and then others that might turn out to be. `of_plates` is a fit of the plates
    alone.

    Where a stiff layer makes the projectile chatter, the sum of squares has valleys less than a
    percent wide. A loss that is looked for is none at first; it is small, and the model without
    it the fastest. FitError if no layer can be followed.
    """
    free = {name for name in LAYER if model.description.is_free(name)}
    used = [channel.throw for channel in model.projectiles[:_THROWS]]
    throws = tuple(
        throw.apply(Track.without_spikes) if number in used else replace(throw, projectile=None)
        for number, throw in enumerate(model.throws)
    )
    model = replace(model, throws=throws)
    start = model.start_from(of_plates, plates)
    at_work = {}
    for throw in used:
        rig, motion = model.motion(start, throw)
        at_work[throw] = PlateAtWork(rig.engine, motion, model.value(start, START, throw))
    early = cut_after(model, plates, _PERIODS / model.rig.engine.frequency)
    if not early.projectiles:
        early = model
    candidates = _search_grid(early, plates, at_work, free)
    if 'layer.thickness' in free:
        candidates += _search_thicknesses(early, at_work, _best_of(candidates, _REFINED), free)
    # Early heights are much alike on many layers; the flight afterwards is not
    seen = cut_after(model, plates, _fall_time(model, plates))
    best = _best_of(candidates, _REFINED)
    refined = _refine(seen, plates, of_plates, best, free)
    return [candidate.rig for candidate in _best_of(refined or candidates, _REFINED)]


def _search_grid(
    model: RigModel, plates: Sequence[PlateFit], at_work: Mapping[int, PlateAtWork], free: set[str]
) -> list[LayerCandidate]:
    """Return the minima among all wave speeds and some thicknesses, without loss."""
    rig = model.rig
    if 'layer.loss_tangent' in free:
        rig = changed_rig(rig, {'layer.loss_tangent': 0.0})
    speeds = [rig.layer.wave_speed]
    if 'layer.wave_speed' in free:
        speeds = sorted([*_WAVE_SPEEDS.tolist(), *speeds])  # in case somebody knows it
    candidates = []
    for thickness in _thicknesses(model, plates, free):
        row = [{'layer.thickness': thickness, 'layer.wave_speed': speed} for speed in speeds]
        candidates += _valleys(model, at_work, [changed_rig(rig, each) for each in row])
    if not candidates:
        raise FitError('the models can follow no throw of such a projectile on any layer')
    return candidates


def _search_thicknesses(
    model: RigModel,
    at_work: Mapping[int, PlateAtWork],
    candidates: Sequence[LayerCandidate],
    free: set[str],
) -> list[LayerCandidate]:
    """Return the minima among equally stiff layers of other thicknesses."""
    power = 0.5 if 'layer.wave_speed' in free else 0.0
    found = []
    for candidate in candidates:
        layer = candidate.rig.layer
        row = [
            {
                'layer.wave_speed': layer.wave_speed * part**power,
                'layer.thickness': layer.thickness * part,
            }
            for part in _THICKNESSES_NEARBY.tolist()
        ]
        found += _valleys(model, at_work, [changed_rig(candidate.rig, each) for each in row])
    return found


def _refine(
    model: RigModel,
    plates: Sequence[PlateFit],
    of_plates: Fit,
    candidates: Sequence[LayerCandidate],
    free: set[str],
) -> list[LayerCandidate]:
    """Fit the layer alone from each candidate; leave out those that no model can follow."""
    loss = {'layer.loss_tangent': _LOSS_TANGENT} if 'layer.loss_tangent' in free else {}
    refined = []
    for candidate in candidates:
        trial = replace(model, rig=changed_rig(candidate.rig, loss))
        noise = np.concatenate([np.full(t.time.size, t.noise) for _, t in trial.tracks()])
        try:
            fit = trial.fit(
                trial.start_from(of_plates, plates), noise=noise, only=(*free, *OWN),
                max_evaluations=_REFINING_STEPS,
            )
            rig = trial.rig_of(trial.start_from(fit, plates))
        except BudgetExceeded:
            raise
        except FitError:
            continue
        refined.append(LayerCandidate(fit.chi2, rig))
    return refined


def _best_of(candidates: list[LayerCandidate], count: int) -> list[LayerCandidate]:
    """Return the candidates with the lowest sums of squares, without near duplicates."""
    chosen: list[LayerCandidate] = []
    for candidate in sorted(candidates, key=lambda each: each.chi2):
        if len(chosen) == count or (chosen and candidate.chi2 > _MAX_RATIO * chosen[0].chi2):
            break
        if not any(map(candidate.is_like, chosen)):
            chosen.append(candidate)
    return chosen


def _fall_time(model: RigModel, plates: Sequence[PlateFit]) -> float:
    """Return the time from the start to the first landing in the tracks."""
    ends = [math.inf]
    for throw, _, track in model.projectiles:
        since = track.time - plates[throw].start_time
        resting = float(np.median(track.position[: max(1, int((since < 0.0).sum()))]))
        apex = int(np.argmax(track.position))
        low = resting + 2.0 * plates[throw].motion.amplitude
        down = np.flatnonzero(track.position[apex:] < low)
        if down.size:
            ends.append(float(since[apex + down[0]]))
    return max(min(ends), _PERIODS / model.rig.engine.frequency)


def _valleys(
    model: RigModel, at_work: Mapping[int, PlateAtWork], rigs: list[Rig]
) -> list[LayerCandidate]:
    """Find rigs that fit better than their neighbours, and narrow the wave speed of the best."""

    def mismatch(rig: Rig) -> LayerCandidate:
        return LayerCandidate(_mismatch(model, at_work, rig), rig)

    outside = LayerCandidate(math.inf, model.rig)
    row = [outside, *map(mismatch, rigs), outside]
    valleys = [
        place
        for place in range(1, len(row) - 1)
        if row[place].chi2 < math.inf
        and row[place].chi2 <= min(row[place - 1].chi2, row[place + 1].chi2)
    ]
    found = [row[place] for place in valleys]
    valleys.sort(key=lambda place: row[place].chi2)
    for place in valleys[:_NARROWED]:
        near = [row[k].rig.layer.wave_speed for k in (place - 1, place + 1)]
        if 1 < place < len(rigs) and near[0] < near[1]:
            tried = [
                mismatch(changed_rig(row[place].rig, {'layer.wave_speed': speed}))
                for speed in np.linspace(near[0], near[1], _NARROWING_STEPS + 2)[1:-1].tolist()
            ]
            found.append(min(tried, key=lambda each: each.chi2))
    return found


def _mismatch(model: RigModel, at_work: Mapping[int, PlateAtWork], rig: Rig) -> float:
    """Sum up squared distances wherever heights count from; infinity if it cannot be followed."""
    rigs = replace(model, rig=rig).rigs
    total = 0.0
    for throw, _, track in model.projectiles:
        plate = at_work[throw]
        some = slice(None, None, -(-track.time.size // _SAMPLES))
        time, height = track.time[some] - plate.start_time, track.position[some]
        each = replace(rigs[throw], engine=plate.engine)
        try:
            path = model.simulator.follow(each, time, motion=plate.motion)
        except BudgetExceeded:
            raise
        except FitError:
            return math.inf
        total += time.size * float(np.var(height - path.position)) / track.noise**2
    return total


def _thicknesses(model: RigModel, plates: Sequence[PlateFit], free: set[str]) -> list[float]:
    """Choose thicknesses to look at."""
    if 'layer.thickness' not in free:
        return [model.rig.layer.thickness]
    if model.description.heights == 'own':
        return [factor * model.rig.layer.thickness for factor in _THICKNESSES]
    half = 0.5 * model.rig.projectile.length if model.description.reference == 'centre' else 0.0
    gaps = []
    for throw, _, track in model.projectiles:
        resting = track.position[track.time <= plates[throw].start_time]
        lowest = resting if resting.size else track.position[:1]
        gaps.append(float(np.median(lowest)) - plates[throw].offset - half)
    gap = float(np.mean(gaps))
    if gap <= _MIN_THICKNESS:
        raise FitError(
            f'the resting projectile must be higher than the plate by the thickness of the '
            f'layer, got {gap + half:.4g} m of which {half:.4g} m belong to the projectile; '
            'is the reference right, and do heights count from the same zero?'
        )
    return [gap]
