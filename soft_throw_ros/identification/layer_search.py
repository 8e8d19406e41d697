# SPDX-License-Identifier: Apache-2.0
"""Where to start from to find a layer: a look at all that there may be, so that nobody guesses."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Sequence
import contextlib
from dataclasses import replace
import math

import numpy as np
from scipy import optimize
from soft_throw_ros.core.rig import Rig
from soft_throw_ros.core.stepping import EventLimitError
from soft_throw_ros.identification.fit import FitError
from soft_throw_ros.identification.path import follow
from soft_throw_ros.identification.plate_fit import PlateFit
from soft_throw_ros.identification.problem import changed_rig, Problem

_WAVE_SPEEDS = np.geomspace(1.0, 200.0, 321)
_THICKNESSES = (0.6, 0.8, 1.0, 1.25, 1.6)  # times what it is said to be
_NEAR = np.geomspace(0.75, 1.33, 41)  # times a thickness that looks good
_THINNEST = 1e-4  # [m]
_LOSS = 0.05  # to start from
_SCANNED = 3  # throws that are looked at; of these ...
_PERIODS = 2.0  # of the plate, and ...
_SAMPLES = 120  # in each
_NARROWINGS = 12  # of a wave speed between two others
_REFINED = 6  # of the best places found, unless ...
_HOPELESS = 20.0  # their sum of squares is so many times that of the best, or ...
_ALIKE = 5e-3  # they differ by less, relatively


def find_layer(problem: Problem, plates: Sequence[PlateFit], layer: tuple[str, ...]) -> Rig:
    """
    Find about which layer it is: look at many, nearer where it looks good, and refine the best.

    Where a stiff layer makes the projectile chatter, the sum of squares has valleys less than a
    percent wide. A loss that is looked for is none at first; it is small, and the model without
    it the fastest.

    Raises
    ------
    FitError
        If no layer can be followed.

    """
    looked_at = [number for number, _ in problem.projectiles[:_SCANNED]]
    problem = replace(problem, throws=tuple(problem.throws[number] for number in looked_at))
    plates = [plates[number] for number in looked_at]
    early = problem.cut(plates, _PERIODS / problem.rig.engine.frequency)
    if not early.projectiles:
        early = problem
    valleys = [
        valley
        for line in _lines(problem, plates, layer)
        for valley in _valleys(early, plates, line)
    ]
    if not valleys:
        raise FitError('the models can follow no throw of such a projectile on any layer')
    if 'layer.thickness' in layer:
        valleys += [
            valley
            for _, rig in _lowest(valleys, _REFINED)
            for valley in _valleys(early, plates, _springs_like(rig, layer))
        ]
    # What a projectile does early is much alike on many layers; how it flies then is not
    seen = problem.cut(plates, _fall(problem, plates))
    refined = []
    for _, rig in _lowest(valleys, _REFINED):
        change = {'layer.loss_tangent': _LOSS} if 'layer.loss_tangent' in layer else {}
        trial = replace(seen, rig=changed_rig(rig, change), free=layer)
        with contextlib.suppress(FitError):  # it went where no model can follow
            found = trial.fit(trial.start(plates))
            refined.append((found.chi2, trial.rig_of(found.values)))
    return _lowest(refined or valleys, 1)[0][1]


def _lowest(found: list[tuple[float, Rig]], count: int) -> list[tuple[float, Rig]]:
    """Return those of the lowest sums of squares, no two of which are almost the same."""
    chosen: list[tuple[float, Rig]] = []
    lowest = min(chi2 for chi2, _ in found)
    for chi2, rig in sorted(found, key=lambda entry: entry[0]):
        if len(chosen) == count or chi2 > _HOPELESS * lowest:
            break
        if not any(_are_alike(rig, other) for _, other in chosen):
            chosen.append((chi2, rig))
    return chosen


def _are_alike(first: Rig, second: Rig) -> bool:
    speeds = first.layer.wave_speed, second.layer.wave_speed
    thicknesses = first.layer.thickness, second.layer.thickness
    return all(math.isclose(*pair, rel_tol=_ALIKE) for pair in (speeds, thicknesses))


def _fall(problem: Problem, plates: Sequence[PlateFit]) -> float:
    """Find how long after the start the first of the projectiles is down again, as they show."""
    ends = [math.inf]
    for number, track in problem.projectiles:
        since = track.time - plates[number].start_time
        resting = float(np.median(track.position[: max(1, int((since < 0.0).sum()))]))
        summit = int(np.argmax(track.position))
        low = resting + 2.0 * plates[number].motion.amplitude
        down = np.flatnonzero(track.position[summit:] < low)
        if down.size:
            ends.append(float(since[summit + down[0]]))
    return max(min(ends), _PERIODS / problem.rig.engine.frequency)


def _lines(
    problem: Problem, plates: Sequence[PlateFit], layer: Collection[str]
) -> Iterator[list[Rig]]:
    """Yield rigs from the softest to the stiffest layer, for some thicknesses."""
    loss_tangent = 0.0 if 'layer.loss_tangent' in layer else problem.rig.layer.loss_tangent
    speeds = [problem.rig.layer.wave_speed]
    if 'layer.wave_speed' in layer:
        speeds = sorted([*_WAVE_SPEEDS.tolist(), *speeds])  # in case somebody knows it
    for thickness in _thicknesses(problem, plates, layer):
        known = {'layer.thickness': thickness, 'layer.loss_tangent': loss_tangent}
        yield [changed_rig(problem.rig, {'layer.wave_speed': speed, **known}) for speed in speeds]


def _springs_like(rig: Rig, layer: Collection[str]) -> list[Rig]:
    """Make rigs of other thicknesses, with layers as stiff if the wave speed is free."""
    power = 0.5 if 'layer.wave_speed' in layer else 0.0
    return [
        changed_rig(
            rig,
            {
                'layer.wave_speed': rig.layer.wave_speed * part**power,
                'layer.thickness': rig.layer.thickness * part,
            },
        )
        for part in _NEAR.tolist()
    ]


def _valleys(
    problem: Problem, plates: Sequence[PlateFit], rigs: list[Rig]
) -> list[tuple[float, Rig]]:
    """
    Find rigs with smaller sums of squares than those beside them in a row, and these sums.

    Between its neighbours the wave speed is made the best.
    """
    misfit = np.array([math.inf, *(_misfit(problem, plates, rig) for rig in rigs), math.inf])
    inner = misfit[1:-1]
    is_valley = (inner < math.inf) & (inner <= misfit[:-2]) & (inner <= misfit[2:])
    found = []
    for place in np.flatnonzero(is_valley).tolist():
        rig, chi2 = rigs[place], float(inner[place])
        beside = [rigs[k].layer.wave_speed for k in (place - 1, place + 1) if 0 <= k < len(rigs)]
        if len(beside) == 2 and beside[0] < beside[1]:
            best = optimize.minimize_scalar(
                lambda speed, rig=rig: _misfit(
                    problem, plates, changed_rig(rig, {'layer.wave_speed': float(speed)})
                ),
                bounds=beside,
                method='bounded',
                options={'maxiter': _NARROWINGS},
            )
            if best.fun < chi2:
                chi2 = float(best.fun)
                rig = changed_rig(rig, {'layer.wave_speed': float(best.x)})
        found.append((chi2, rig))
    return found


def _misfit(problem: Problem, plates: Sequence[PlateFit], rig: Rig) -> float:
    """
    Sum up how far the projectiles are from those of a rig, wherever their heights count from.

    Infinity if the model cannot follow it.
    """
    tracks = []
    for number, track in problem.projectiles:
        every = -(-track.time.size // _SAMPLES)
        since = track.time[::every] - plates[number].start_time
        tracks.append((since, track.position[::every], track.noise))
    try:
        path = follow(rig, np.concatenate([since for since, _, _ in tracks]))
    except (ValueError, EventLimitError):
        return math.inf
    heights = np.split(path.position, np.cumsum([since.size for since, _, _ in tracks])[:-1])
    chi2 = 0.0
    for (_, position, noise), predicted in zip(tracks, heights, strict=True):
        left = position - predicted
        chi2 += float(np.sum((left - left.mean()) ** 2)) / noise**2
    return chi2


def _thicknesses(
    problem: Problem, plates: Sequence[PlateFit], layer: Collection[str]
) -> list[float]:
    """Choose thicknesses to look at."""
    if 'layer.thickness' not in layer:
        return [problem.rig.layer.thickness]
    if problem.heights == 'own':
        return [factor * problem.rig.layer.thickness for factor in _THICKNESSES]
    half = 0.5 * problem.rig.projectile.length if problem.reference == 'centre' else 0.0
    gaps = []
    for number, track in problem.projectiles:
        resting = track.position[track.time <= plates[number].start_time]
        lowest = resting if resting.size else track.position[:1]
        gaps.append(float(np.median(lowest)) - plates[number].offset - half)
    gap = float(np.mean(gaps))
    if gap <= _THINNEST:
        raise FitError(
            f'the resting projectile must be higher than the plate by the thickness of the '
            f'layer, got {gap + half:.4g} m of which {half:.4g} m belong to the projectile; '
            'is the reference right, and do heights count from the same zero?'
        )
    return [gap]
