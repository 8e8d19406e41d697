# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
Search for the layer: start values without a guess, and other minima of chi squared.

With a stiff layer or a light projectile, which chatters, chi squared has several minima. The later
a height, the narrower they are: soon after the start they are wide, and the best one is the true
one. `find_layers` therefore compares the first heights with layers of a grid, and follows the best
minima while it adds later heights. `find_best_minimum` fits those that may be the best, too.
"""

from __future__ import annotations

from collections.abc import Sequence
import contextlib
from dataclasses import replace
import math
from operator import attrgetter

import numpy as np
from soft_throw_ros.core.rig import Rig
from soft_throw_ros.identification.fit_description import (
    changed_rig,
    ENGINE,
    LAYER,
    LOSS,
    PARAMETERS,
    PROJECTILE_ZERO,
    START,
    values_of,
)
from soft_throw_ros.identification.least_squares import Alternative, Fit, FitError
from soft_throw_ros.identification.rig_model import RigModel
from soft_throw_ros.identification.tracks import Floats, Track

_SPEED, _THICKNESS = 'layer.wave_speed', 'layer.thickness'

MAX_EXCESS = 9.0
"""Largest increase of chi squared at another minimum that is reported. [-]"""

_WAVE_SPEEDS = np.geomspace(2.0, 100.0, 121).tolist()  # of the grid; minima are wider [m/s]
_THICKNESSES = (0.6, 0.8, 1.0, 1.25, 1.6)  # thicknesses of the grid, relative to the given one
_WINDOWS = (0.35, 0.7, 2.0)  # ends of the heights for the grid since the start [plate periods]
_INITIAL_LOSS = 0.05  # initial loss tangent of a fit of a stated loss
_MAX_THROWS = 3  # largest number of throws in the search
_MAX_SAMPLES = 60  # largest number of samples of a track in a window
_MAX_MINIMA = 2  # largest number of minima of a window
_MAX_RATIO = 10.0  # chi squared of a minimum of a window, relative to the best
_MAX_EVALUATIONS = 10  # largest number of evaluations of the model in a fit of a candidate
_MAX_RIVAL_EVALUATIONS = 50  # largest number of evaluations in a fit of another minimum
_MAX_RIVALS = 2  # largest number of fits of other minima, the most promising ones first
_RIVAL_RATIO = 3.0  # chi squared of a rival up to two periods, relative to the best
_NEIGHBOURS = (0.985, 1.015)  # wave speeds of other starts, relative to the best
_MIN_SEPARATION = 4.0  # smallest distance of another minimum, in chi squared of the fit's parabola
_LAYER_TOLERANCE = 5e-3  # relative difference below which two layers count as equal


def find_layers(model: RigModel) -> list[Fit]:
    """
    Fit layers to the first heights, from a grid of layers, the most likely one first.

    A free loss is 0 in the grid: it is small, and the model without it the fastest. Raise FitError
    if no layer can be simulated.
    """
    used = [series.throw for series in model.projectiles[:_MAX_THROWS]]
    throws = tuple(
        throw.apply(Track.without_spikes) if number in used else replace(throw, projectile=None)
        for number, throw in enumerate(model.throws)
    )
    model = replace(model, throws=throws)
    fits = []
    for rig in _best_of_grid(model):
        with contextlib.suppress(FitError):
            fits.append(_follow_minimum(model, rig))
    if not fits:
        raise FitError('no layer can be found, on which such a throw can be simulated in time')
    chosen: list[Fit] = []
    for fit in sorted(fits, key=attrgetter('chi2')):
        if not any(_is_same_layer(fit, other) for other in chosen):
            chosen.append(fit)
    return chosen


def find_best_minimum(model: RigModel, fit: Fit, candidates: Sequence[Fit]) -> Fit:
    """Fit rivals of the first candidate; return the best fit with near alternatives."""
    starts = [
        rival.by_name for rival in candidates[1:][:_MAX_RIVALS]
        if rival.chi2 < _RIVAL_RATIO * candidates[0].chi2
    ]
    if candidates and fit.is_mismatch and _SPEED in candidates[0]:
        # a kink may stop the solver at once, where a contact begins or ends
        first = candidates[0].by_name
        starts += [{**first, _SPEED: factor * first[_SPEED]} for factor in _NEIGHBOURS]
    fits = [fit]
    for values in starts:
        with contextlib.suppress(FitError):
            fits.append(model.fit(model.start(values), max_evaluations=_MAX_RIVAL_EVALUATIONS))
    best, *others = sorted(fits, key=attrgetter('chi2'))
    minima = [best]
    for other in others:
        if other.chi2 - best.chi2 < MAX_EXCESS and all(
            _is_separate(minimum, other) for minimum in minima
        ):
            minima.append(other)
    # The intervals of 95 % extend to the other minima
    halves = [0.5 * (other.values - best.values) for other in minima[1:]]
    return replace(
        best,
        covariance=sum((np.outer(half, half) for half in halves), best.covariance),
        alternatives=tuple(Alternative(item.values, item.chi2 - best.chi2) for item in minima[1:]),
    )


def _is_same_layer(fit: Fit, other: Fit) -> bool:
    """Return whether two fits have almost the same layer."""
    return all(
        math.isclose(fit[name].value, other[name].value, rel_tol=_LAYER_TOLERANCE)
        for name in (_SPEED, _THICKNESS) if name in fit
    )


def _is_separate(fit: Fit, other: Fit) -> bool:
    """Return whether a fit is another minimum, and not on the slope of the same one."""
    way = other.values - fit.values
    parabola = float(way @ np.linalg.lstsq(fit.covariance, way, rcond=1e-14)[0])
    return parabola > _MIN_SEPARATION + 2.0 * abs(other.chi2 - fit.chi2)


def _best_of_grid(model: RigModel) -> list[Rig]:
    """Return the rigs at the lowest minima of each window, without loss."""
    start, rig, treatment = model.start(), model.rig, model.description.treatment
    if treatment(LOSS).is_free:
        rig = changed_rig(rig, {LOSS: 0.0})
    speeds, thicknesses = [rig.layer.wave_speed], [rig.layer.thickness]
    if treatment(_SPEED).is_free:
        speeds = sorted([*_WAVE_SPEEDS, *speeds])  # the given one may be right
    if treatment(_THICKNESS).is_free:
        thicknesses = [factor * thicknesses[0] for factor in _THICKNESSES]
    minima: list[list[tuple[float, tuple[float, float]]]] = [[] for _ in _WINDOWS]
    for thickness in thicknesses:
        row = np.array([
            _mismatches(model, start, changed_rig(rig, {_THICKNESS: thickness, _SPEED: speed}))
            for speed in speeds
        ])
        padded = np.pad(row, ((1, 1), (0, 0)), constant_values=math.inf)
        is_minimum = (row <= padded[:-2]) & (row <= padded[2:]) & np.isfinite(row)
        for index, window in zip(*np.nonzero(is_minimum), strict=True):
            minima[window].append((float(row[index, window]), (thickness, speeds[index])))
    chosen = dict.fromkeys(  # in their order
        layer for of_window in map(sorted, minima) for chi2, layer in of_window[:_MAX_MINIMA]
        if chi2 <= _MAX_RATIO * of_window[0][0]
    )
    return [changed_rig(rig, {_THICKNESS: size, _SPEED: speed}) for size, speed in chosen]


def _mismatches(model: RigModel, start: Floats, rig: Rig) -> list[float]:
    """
    Return the sum of squares in each window; infinity if impossible.

    The zero of heights is free; delay and scale of the measurement are, too, within their priors.
    """
    totals = [0.0] * len(_WINDOWS)
    bench = [name for name in ('projectile.delay', 'projectile.scale') if name in model.indices]
    priors = [model.description.known(name, rig) for name in bench]
    stiffness = np.diag([0.0, *(1.0 / prior.error if prior else 0.0 for prior in priors)])
    for number, body, track in model.projectiles:
        changed = changed_rig(model.rig_of(start, number), values_of(rig, LAYER))
        since = (track.time - model.value(start, START, number)) * rig.engine.frequency
        early = [np.flatnonzero(since <= window) for window in _WINDOWS]
        chosen = [some[:: max(1, -(-some.size // _MAX_SAMPLES))] for some in early]
        union = np.unique(np.concatenate(chosen))
        try:
            path = model.trajectory(start, number, body, track.time[union], changed)
        except FitError:
            return [math.inf] * len(_WINDOWS)
        slopes = {'projectile.delay': -path.velocity, 'projectile.scale': path.height}
        columns = np.stack([np.ones(union.size), *(slopes[name] for name in bench)], axis=1)
        residual = track.position[union] - path.height
        for window, some in enumerate(chosen):
            part, noise = np.searchsorted(union, some), track.deviations[some]
            system = np.concatenate([columns[part] / noise[:, None], stiffness])
            target = np.pad(residual[part] / noise, (0, len(stiffness)))
            best = system @ np.linalg.lstsq(system, target, rcond=None)[0]
            totals[window] += float(np.sum((target - best) ** 2))
    return totals


def _follow_minimum(model: RigModel, rig: Rig) -> Fit:
    """Fit the layer and the projectile in growing windows, with the plates as they are."""
    if model.description.treatment(LOSS).is_free:
        rig = changed_rig(rig, {LOSS: _INITIAL_LOSS})
    model = replace(model, rig=rig)
    only = [
        name for name in (*PARAMETERS, 'projectile.scale', 'projectile.delay', PROJECTILE_ZERO)
        if name in model.indices and name not in ENGINE
    ]
    found: dict[str, float] = {}
    for window in _WINDOWS[1:]:
        part = model.cut_after(window / rig.engine.frequency)
        part = part if part.projectiles else model
        fit = part.fit(part.start(found), only=only, max_evaluations=_MAX_EVALUATIONS)
        found = fit.by_name
    return fit
