# SPDX-License-Identifier: Apache-2.0
r"""
A whole rig from recorded throws: plate, layer, and when each throw began, all at once.

Notes
-----
Both tracks of all throws are compared with one model: Eq. (D2) for the plate, and for the
projectile what the twin steps through in real time, which is the travelling wave, exact to
:math:`10^{-9}` m, or finite differences if there is internal loss. Positions go on smoothly where
ejection times jump, because a projectile that has only just left is caught up at once. So while
it is fitted nothing is said of ejections, and their jumps do no harm.

What of the layer can be seen are three times: :math:`t_s = L_s / c_s`, :math:`\tau = m / (\rho_s S
c_s)`, and that of the loss. Mass, density and section enter by :math:`\tau` alone, so they have
to be known. Wave speed and thickness are then seen apart if waves are. A thin, light layer is a
spring and shows no more than :math:`t_s \tau`; a thick, heavy one shows :math:`t_s`.
`fit.Fit.warnings` says when that is so.

"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from soft_throw_ros.core.rig import Rig
from soft_throw_ros.identification.fit import Fit, FitError
from soft_throw_ros.identification.layer_search import find_layer
from soft_throw_ros.identification.path import follow, landing_time
from soft_throw_ros.identification.plate_fit import fit_plate, PlateFit
from soft_throw_ros.identification.problem import (
    changed_rig,
    ENGINE,
    Heights,
    LAYER,
    PARAMETERS,
    Problem,
    Reference,
    USUAL,
    values_of,
)
from soft_throw_ros.identification.tracks import FEWEST, ThrowTracks, Track

Floats = NDArray[np.float64]

_LEAST_NOISE = 0.1  # of the largest, and ...
_LEFT_OUT = 5e-6  # of the way a projectile goes
_IN_FLIGHT = 0.97  # of the time until the landing is looked at
_ROUNDS = 4  # of finding out when that is


@dataclass(frozen=True, kw_only=True)
class RigFit:
    """
    A rig that was fitted to throws.

    Parameters
    ----------
    fit : Fit
        Of some of `PARAMETERS`, and for each throw of its `start_time`, and of `plate_offset`
        and `projectile_offset`, the heights at rest, as far as they were free. The number of the
        throw follows in brackets, from 1, if there are several.
    rig : Rig
        With the values that were found.
    throws : tuple of ThrowTracks
        What they were found from: without what comes after a landing.

    """

    fit: Fit
    rig: Rig
    throws: tuple[ThrowTracks, ...]
    _problem: Problem

    def start_time(self, throw: int) -> float:
        """When a throw began, on the clock of its tracks; they count from 0. [s]"""
        return self._problem.value(self.fit.values, 'start_time', throw)

    def heights(self, throw: int, time: Floats) -> tuple[Floats, Floats]:
        """
        Predict what the tracks of a throw should show.

        Parameters
        ----------
        throw : int
            Which, from 0.
        time : ndarray, shape (n,)
            On the clock of its tracks. [s]

        Returns
        -------
        tuple of ndarray
            Heights of plate and projectile, as the tracks count them. [m]

        """
        problem, values = self._problem, self.fit.values
        path = follow(self.rig, time - self.start_time(throw), by_grid=problem.by_grid)
        zero = problem.zero(values, throw, self.rig)
        return problem.plate(values, throw, time), path.position + zero


def fit_rig(
    throws: Sequence[ThrowTracks],
    rig: Rig,
    *,
    free: Collection[str] = USUAL,
    heights: Heights = 'own',
    reference: Reference = 'face',
    start: Rig | None = None,
) -> RigFit:
    """
    Fit a rig to the tracks of one throw or many.

    Parameters
    ----------
    throws : sequence of ThrowTracks
        Of the same rig. At least one has a projectile if anything of the layer is free.
    rig : Rig
        What is known. Its mass, density, diameter and gravity are never changed. What is free is
        looked for everywhere, but for the thickness, which should be right to a third.
    free : collection of str
        Which of `PARAMETERS` to find.
    heights : {'own', 'common', 'absolute'}
        From where heights count, see `Heights`. If not each from a zero of its own, the resting
        projectile tells how thick the layer is, less the static sag.
    reference : {'face', 'centre'}
        Point of the projectile whose heights the tracks have; it matters if heights are not of
        their own.

    Returns
    -------
    RigFit

    Raises
    ------
    FitError
        If the tracks do not give it, saying why.
    ValueError
        If an argument is none of what it can be.

    """
    for name in free:
        if name not in PARAMETERS:
            raise ValueError(f'free must be some of {", ".join(PARAMETERS)}, got {name!r}')
    if heights not in ('own', 'common', 'absolute'):
        raise ValueError(f"heights must be 'own', 'common' or 'absolute', got {heights!r}")
    if reference not in ('face', 'centre'):
        raise ValueError(f"reference must be 'face' or 'centre', got {reference!r}")
    if not throws:
        raise FitError('there is no throw to fit to')
    throws = _with_like_noise(throws)
    in_order = tuple(name for name in PARAMETERS if name in free)
    layer = tuple(name for name in LAYER if name in free)
    if layer and all(throw.projectile is None for throw in throws):
        raise FitError(f'{", ".join(layer)} cannot be found without a track of the projectile')
    plates = [_fit_plate(throw, heights) for throw in throws]
    rig = _with_engine_of(plates, rig, in_order)
    problem = Problem(tuple(throws), rig, in_order, heights, reference)
    if layer and start is None:
        problem = replace(problem, rig=find_layer(problem, plates, layer))
    elif start is not None:
        problem = replace(problem, rig=changed_rig(rig, values_of(start, layer)))
    return _until_landing(problem, plates)


def _with_like_noise(throws: Sequence[ThrowTracks]) -> list[ThrowTracks]:
    """
    Let no noise that is estimated be far below the others, or below what models leave out.

    Both bodies are seen by the same means; where an estimate is very small it is the motion that
    is smooth, as that of a computed projectile in flight, and the fit would see nothing else.
    """
    tracks = [track for throw in throws for track in (throw.plate, throw.projectile) if track]
    least = max(
        _LEAST_NOISE * max(track.noise for track in tracks),
        _LEFT_OUT * max(float(np.ptp(track.position)) for track in tracks),
    )

    def like(track: Track) -> Track:
        return replace(track, least_noise=max(track.least_noise, least))

    return [
        replace(
            throw, plate=like(throw.plate), projectile=throw.projectile and like(throw.projectile)
        )
        for throw in throws
    ]


def _fit_plate(throw: ThrowTracks, heights: Heights) -> PlateFit:
    try:
        return fit_plate(throw.plate, offset=0.0 if heights == 'absolute' else None)
    except FitError as error:
        raise FitError(f'{throw.name}: {error}') from None


def _with_engine_of(plates: Sequence[PlateFit], rig: Rig, free: Collection[str]) -> Rig:
    """Give the rig the weighted mean of the plates, as far as the engine is free."""
    values = {}
    for place, name in enumerate(ENGINE):
        if name in free:
            weights = [1.0 / max(plate.fit.errors[place], 1e-100) ** 2 for plate in plates]
            values[name] = float(
                np.average([plate.fit.values[place] for plate in plates], weights=weights)
            )
    return changed_rig(rig, values)


def _until_landing(problem: Problem, plates: Sequence[PlateFit]) -> RigFit:
    """Fit to what comes before the projectile lands, which depends on the fit."""
    seen = problem
    for _ in range(_ROUNDS):
        cut = _before_landing(problem, seen.rig, plates)
        if seen is not problem and cut.sizes() == seen.sizes():
            break
        seen = cut
        found = seen.fit(seen.start(plates))
        seen = replace(seen, rig=seen.rig_of(found.values))
    return RigFit(fit=found, rig=seen.rig, throws=seen.throws, _problem=seen)


def _before_landing(problem: Problem, rig: Rig, plates: Sequence[PlateFit]) -> Problem:
    """Leave out what comes after the landing, were it this rig."""
    seen = replace(problem, rig=rig)
    if not problem.projectiles:
        return seen
    longest = max(
        float(track.time[-1]) - plates[number].start_time for number, track in problem.projectiles
    )
    landing = landing_time(rig, max(longest, 0.0), by_grid=problem.by_grid)
    seen = seen.cut(plates, _IN_FLIGHT * landing)
    if not seen.projectiles:
        raise FitError(
            f'the projectile is seen at less than {FEWEST} moments before it lands, '
            f'{landing:.3g} s after the start'
        )
    return seen
