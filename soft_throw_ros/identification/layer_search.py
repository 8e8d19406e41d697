# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
Search for the layer: start values without a guess, and other minima of chi squared.

With a stiff layer, on which the projectile chatters, chi squared has several minima. `find_layers`
compares the tracks with many layers; `find_best_minimum` fits those that may turn out to be the
best, too. Minima within `MAX_EXCESS` of the best are reported.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
import contextlib
from dataclasses import replace
import math
from operator import attrgetter
from typing import NamedTuple

import numpy as np
from soft_throw_ros.core.rig import Rig
from soft_throw_ros.identification.fit_description import changed_rig, LAYER, values_of
from soft_throw_ros.identification.least_squares import Alternative, Fit, FitError
from soft_throw_ros.identification.parameter_layout import OWN, START
from soft_throw_ros.identification.plate_waves import PlateWithWaves
from soft_throw_ros.identification.rig_model import RigModel
from soft_throw_ros.identification.tracks import Track

MAX_EXCESS = 9.0
"""Largest increase of chi squared at another minimum that is reported. [-]"""

_WAVE_SPEEDS = np.geomspace(1.0, 200.0, 641).tolist()
"""Wave speeds of the grid; the valleys of chi squared may be less than a percent wide. [m/s]"""

_THICKNESSES = (0.6, 0.8, 1.0, 1.25, 1.6)
"""Thicknesses of the grid, relative to the given one. [-]"""

_MIN_THICKNESS = 1e-4  # smallest thickness of the search [m]
_INITIAL_LOSS = 0.05  # initial loss tangent

_MAX_THROWS = 3  # largest number of throws in the search
_SEARCH_PERIODS = 2.0  # time of each throw in the search [plate periods]
_MAX_SAMPLES = 120  # largest number of samples of each track in the search

_MAX_REFINED = 6  # largest number of refined candidates
_MAX_EVALUATIONS = 20  # largest number of evaluations of the model in a fit of a candidate
_MAX_RATIO = 20.0  # sum of squares, relative to the best, above which candidates are dropped
_LAYER_TOLERANCE = 5e-3  # relative difference below which two layers count as equal
_MAX_STARTS = 4  # largest number of fits of other minima, the most promising ones first
_MIN_SEPARATION = 4.0  # smallest distance of another minimum, in chi squared of the fit's parabola


class SearchedThrow(NamedTuple):
    """A throw whose layer is searched."""

    rig: Rig
    motion: PlateWithWaves
    start_time: float
    """[s]"""
    searched: tuple[str, ...]
    """Parameters of the rig that the search changes."""


class LayerCandidate(NamedTuple):
    """A rig to start from, and the sum of squares that it leaves."""

    chi2: float
    rig: Rig

    def is_like(self, other: LayerCandidate) -> bool:
        """Return whether two layers are almost equal."""
        layer, rival = self.rig.layer, other.rig.layer
        pairs = (layer.wave_speed, rival.wave_speed), (layer.thickness, rival.thickness)
        return all(math.isclose(*pair, rel_tol=_LAYER_TOLERANCE) for pair in pairs)


def find_layers(model: RigModel) -> list[Rig]:
    """
    Find rigs to start a fit from, the most likely one first, in a grid of layers.

    A free loss is 0 in the grid: it is small, and the model without it the fastest.

    Raises
    ------
    FitError
        If no layer can be simulated.

    """
    free = {name for name in LAYER if model.description.is_free(name)}
    used = [series.throw for series in model.projectiles[:_MAX_THROWS]]
    throws = tuple(
        throw.apply(Track.without_spikes) if number in used else replace(throw, projectile=None)
        for number, throw in enumerate(model.throws)
    )
    model = replace(model, throws=throws)
    start = model.start()
    searched = {}
    for number in used:
        throw = throws[number].name
        names = tuple(n for n in free if model.description.treatment(n, throw).value is None)
        begin = model.value(start, START, number)
        searched[number] = SearchedThrow(*model.motion(start, number), begin, names)
    early = model.cut_after(_SEARCH_PERIODS / model.rig.engine.frequency)
    if not early.projectiles:
        early = model
    candidates = _best_of(_search_grid(early, searched, free))
    # Early heights are much alike on many layers; the flight afterwards is not
    end = max(model.flight_end(candidates[0].rig), _SEARCH_PERIODS / model.rig.engine.frequency)
    refined = _refine(model.cut_after(end), candidates, free)
    return [candidate.rig for candidate in _best_of(refined or candidates)]


def find_best_minimum(model: RigModel, fit: Fit, others: Sequence[Rig] = ()) -> Fit:
    """Fit `others`, the most likely ones first; return the best fit with near alternatives."""
    if 'layer.wave_speed' not in model.layout:
        return fit
    starts = []
    for rig in others:
        start = fit.values.copy()
        for name, value in values_of(rig, LAYER).items():
            if name in model.layout:
                start[model.layout.indices_of(name)] = value
        starts.append(start)
    fits = [fit]
    for start in starts[:_MAX_STARTS]:
        with contextlib.suppress(FitError):
            fits.append(model.fit(start, max_evaluations=_MAX_EVALUATIONS))
    best, *others_found = sorted(fits, key=attrgetter('chi2'))
    minima = [best]
    for other in others_found:
        is_near = other.chi2 - best.chi2 < MAX_EXCESS
        if is_near and all(_is_separate(minimum, other) for minimum in minima):
            minima.append(other)
    alternatives = [Alternative(item.values, item.chi2 - best.chi2) for item in minima[1:]]
    if best is not fit:
        best = model.fit(best.values)
    return best.spanning(alternatives)


def _is_separate(fit: Fit, other: Fit) -> bool:
    """Return whether a fit is another minimum, and not on the slope of the same one."""
    way = other.values - fit.values
    parabola = float(way @ np.linalg.lstsq(fit.covariance, way, rcond=1e-14)[0])
    return parabola > _MIN_SEPARATION + 2.0 * (other.chi2 - fit.chi2)


def _search_grid(
    model: RigModel, searched: Mapping[int, SearchedThrow], free: set[str]
) -> list[LayerCandidate]:
    """Return the minima among all wave speeds and some thicknesses, without loss."""
    rig = model.rig
    if 'layer.loss_tangent' in free:
        rig = changed_rig(rig, {'layer.loss_tangent': 0.0})
    speeds = [rig.layer.wave_speed]
    if 'layer.wave_speed' in free:
        speeds = sorted([*_WAVE_SPEEDS, *speeds])  # the given one may be right
    candidates = []
    for thickness in _thicknesses(model, free):
        row = [{'layer.thickness': thickness, 'layer.wave_speed': speed} for speed in speeds]
        candidates += _minima(model, searched, [changed_rig(rig, item) for item in row])
    if not candidates:
        raise FitError('the models can follow no throw of such a projectile on any layer')
    return candidates


def _refine(
    model: RigModel, candidates: Sequence[LayerCandidate], free: set[str]
) -> list[LayerCandidate]:
    """Fit the layer alone from each candidate; leave out those that no model can follow."""
    loss = {'layer.loss_tangent': _INITIAL_LOSS} if 'layer.loss_tangent' in free else {}
    refined = []
    for candidate in candidates:
        trial = replace(model, rig=changed_rig(candidate.rig, loss))
        with contextlib.suppress(FitError):
            fit = trial.fit(
                trial.start(), only=(*free, *OWN), max_evaluations=_MAX_EVALUATIONS
            )
            refined.append(LayerCandidate(fit.chi2, trial.rig_of(trial.start(fit))))
    return refined


def _best_of(candidates: Sequence[LayerCandidate]) -> list[LayerCandidate]:
    """Return the candidates with the lowest sums of squares, without near duplicates."""
    chosen: list[LayerCandidate] = []
    for candidate in sorted(candidates, key=attrgetter('chi2')):
        is_bad = bool(chosen) and candidate.chi2 > _MAX_RATIO * chosen[0].chi2
        if is_bad or len(chosen) == _MAX_REFINED:
            break
        if not any(map(candidate.is_like, chosen)):
            chosen.append(candidate)
    return chosen


def _minima(
    model: RigModel, searched: Mapping[int, SearchedThrow], rigs: Sequence[Rig]
) -> list[LayerCandidate]:
    """Return the rigs of a row that fit better than their neighbours."""
    chi2 = [math.inf, *(_mismatch(model, searched, rig) for rig in rigs), math.inf]
    return [
        LayerCandidate(chi2[k], rig)
        for k, rig in enumerate(rigs, 1)
        if chi2[k] < math.inf and chi2[k] <= min(chi2[k - 1], chi2[k + 1])
    ]


def _mismatch(model: RigModel, searched: Mapping[int, SearchedThrow], rig: Rig) -> float:
    """Return the sum of squares for any zero of heights; infinity for an impossible throw."""
    total = 0.0
    for number, _, track in model.projectiles:
        throw = searched[number]
        some = slice(None, None, -(-track.time.size // _MAX_SAMPLES))
        time, height = track.time[some] - throw.start_time, track.position[some]
        changed = changed_rig(throw.rig, values_of(rig, throw.searched))
        try:
            path = model.simulator.follow(changed, time, motion=throw.motion)
        except FitError:
            return math.inf
        total += time.size * float(np.var(height - path.position)) / track.noise**2
    return total


def _thicknesses(model: RigModel, free: set[str]) -> list[float]:
    """Return the thicknesses of the grid [m]."""
    if 'layer.thickness' not in free:
        return [model.rig.layer.thickness]
    if model.description.heights == 'own':
        return [factor * model.rig.layer.thickness for factor in _THICKNESSES]
    half = 0.5 * model.rig.projectile.length if model.description.reference == 'centre' else 0.0
    gaps = []
    for throw, _, track in model.projectiles:
        resting = track.position[track.time <= model.plates[throw].start_time]
        lowest = resting if resting.size else track.position[:1]
        gaps.append(float(np.median(lowest)) - model.plates[throw].offset - half)
    gap = float(np.mean(gaps))
    if gap <= _MIN_THICKNESS:
        raise FitError(
            f'the resting projectile must be higher than the plate by the thickness of the '
            f'layer, got {gap + half:.4g} m of which {half:.4g} m belong to the projectile; '
            'is the reference right, and do heights count from the same zero?'
        )
    return [gap]
