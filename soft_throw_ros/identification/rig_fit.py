# SPDX-License-Identifier: Apache-2.0
r"""
A whole rig from recorded throws: plate, layer, and when each throw began, all at once.

Notes
-----
Both tracks of all throws are compared with one model: Eq. (D2) for the plate, and for the
projectile what the twin steps through in real time: travelling waves, or cells if there is
internal loss. Positions go on smoothly where ejection times jump, because a projectile that has
only just left is caught up at once. So while it is fitted nothing is said of ejections, and their
jumps do no harm.

What of the layer can be seen are three times: :math:`t_s = L_s / c_s`, :math:`\tau = m / (\rho_s S
c_s)`, and that of the loss. Mass, density and section enter by :math:`\tau` alone, so they have
to be known. Wave speed and thickness are then seen apart if waves are. A thin, light layer is a
spring and shows no more than :math:`t_s \tau`; a thick, heavy one shows :math:`t_s`.
`least_squares.Fit.warnings` says when that is so.

"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
import math

import numpy as np
from numpy.typing import NDArray
from soft_throw_ros.core.rig import Rig
from soft_throw_ros.identification.fit_description import (
    changed_rig,
    ENGINE,
    FitDescription,
    LAYER,
    PARAMETERS,
    values_of,
)
from soft_throw_ros.identification.forward import ThrowSimulator
from soft_throw_ros.identification.layer_search import find_layer
from soft_throw_ros.identification.least_squares import Estimate, Fit, FitError
from soft_throw_ros.identification.plate_fit import fit_plate, PlateFit
from soft_throw_ros.identification.rig_model import RigModel
from soft_throw_ros.identification.tracks import FEWEST, ThrowTracks, Track

Floats = NDArray[np.float64]

_LEAST_NOISE = 0.1  # of the largest, and ...
_MODEL_ERROR = 5e-6  # of the way a projectile goes, which models leave out
_IN_FLIGHT = 0.97  # of the time until the landing is looked at
_LANDING_ROUNDS = 4  # of finding out when that is


@dataclass(frozen=True, kw_only=True)
class RigFit:
    """
    A rig that was fitted to throws.

    Parameters
    ----------
    fit : Fit
        Of what was varied of the rig, and for each throw of its `start_time`, and of
        `plate_offset` and `projectile_offset`, the heights at rest, as far as they were free. The
        number of the throw follows in brackets, from 1, if there are several.
    rig : Rig
        With the values that were found, their mean where each throw has its own.
    throws : tuple of ThrowTracks
        What they were found from: without what comes after a landing, and without outliers.

    """

    fit: Fit
    rig: Rig
    throws: tuple[ThrowTracks, ...]
    _model: RigModel

    def estimates(self) -> dict[str, Estimate]:
        """Return what was varied of the rig, with the mean of what each throw has for itself."""
        found = {}
        for name in self._model.description.varied:
            places = self._model.places_of(name)
            variance = float(self.fit.covariance[np.ix_(places, places)].mean())
            found[name] = Estimate(float(self.fit.values[places].mean()), math.sqrt(variance))
        return found

    def held_values(self) -> dict[str, float]:
        """Return what was taken to be known of the rig."""
        varied = self._model.description.varied
        return values_of(self.rig, [name for name in PARAMETERS if name not in varied])

    def start_time(self, throw: int) -> float:
        """When a throw began, on the clock of its tracks; they count from 0. [s]"""
        return self._model.value(self.fit.values, 'start_time', throw)

    def heights(self, throw: int, time: Floats) -> tuple[Floats, Floats]:
        """Predict heights of plate and projectile [m] at times [s], as the tracks count them."""
        places = [(throw, body, time) for body in ('plate', 'projectile')]
        (plate, _), (projectile, _) = self._model.paths(self.fit.values, places)
        return plate, projectile


def fit_rig(
    throws: Sequence[ThrowTracks], rig: Rig, description: FitDescription | None = None
) -> RigFit:
    """
    Fit a rig to the tracks of one throw or many.

    Parameters
    ----------
    throws : sequence of ThrowTracks
        At least one has a projectile if anything of the layer is free.
    rig : Rig
        What is known. What is free is looked for everywhere, but for the thickness, which should
        be right to a third.
    description : FitDescription, optional
        What is fitted, held, or known with an error; what is usual by default.

    Raises
    ------
    FitError
        If the tracks do not give it, saying why.

    """
    if not throws:
        raise FitError('there is no throw to fit to')
    description = description or FitDescription()
    free = [name for name in LAYER if description.is_free(name)]
    if free and all(throw.projectile is None for throw in throws):
        raise FitError(f'{", ".join(free)} cannot be found without a track of the projectile')
    throws = _with_like_noise(throws)
    plates = [_fit_plate(throw, description) for throw in throws]
    known = description.known(rig)
    rig = _with_engine_of(plates, description.prepare(rig), description)
    simulator = ThrowSimulator(throws=len(throws) if description.per_throw else 1)
    model = RigModel(tuple(throws), rig, description, known, simulator)
    if free:
        model = replace(model, rig=find_layer(model, plates))
    return _fit_until_landing(model, plates)


def _with_like_noise(throws: Sequence[ThrowTracks]) -> list[ThrowTracks]:
    """
    Let no noise that is estimated be far below the others, or below what models leave out.

    Both bodies are seen by the same means; where an estimate is very small it is the motion that
    is smooth, and the fit would see nothing else.
    """
    tracks = [track for throw in throws for track in (throw.plate, throw.projectile) if track]
    least = max(
        _LEAST_NOISE * max(track.noise for track in tracks),
        _MODEL_ERROR * max(float(np.ptp(track.position)) for track in tracks),
    )

    def with_noise(track: Track) -> Track:
        return replace(track, least_noise=max(track.least_noise, least))

    return [
        replace(
            throw,
            plate=with_noise(throw.plate),
            projectile=throw.projectile and with_noise(throw.projectile),
        )
        for throw in throws
    ]


def _fit_plate(throw: ThrowTracks, description: FitDescription) -> PlateFit:
    """Fit the plate of a throw, and name the throw if that fails."""
    try:
        return fit_plate(throw.plate, offset=0.0 if description.heights == 'absolute' else None)
    except FitError as error:
        raise FitError(f'{throw.name}: {error}') from None


def _with_engine_of(plates: Sequence[PlateFit], rig: Rig, description: FitDescription) -> Rig:
    """Give the rig the weighted mean of the plates, as far as the engine is free."""
    values = {}
    for place, name in enumerate(ENGINE):
        if description.is_free(name):
            weights = [1.0 / max(plate.fit.errors[place], 1e-100) ** 2 for plate in plates]
            values[name] = float(
                np.average([plate.fit.values[place] for plate in plates], weights=weights)
            )
    return changed_rig(rig, values)


def _fit_until_landing(model: RigModel, plates: Sequence[PlateFit]) -> RigFit:
    """Fit to what comes before the projectile lands, which depends on the fit."""
    seen = model
    for _ in range(_LANDING_ROUNDS):
        cut = _before_landing(model, seen.rig, plates)
        if seen is not model and _sizes(cut) == _sizes(seen):
            break
        seen = cut
        found = seen.fit(seen.start(plates))
        seen = replace(seen, rig=seen.rig_of(found.values))
    kept = {
        (channel.throw, channel.body): residual.track
        for channel, residual in zip(seen.channels, found.residuals, strict=True)
    }
    throws = tuple(
        replace(throw, plate=kept[number, 'plate'], projectile=kept.get((number, 'projectile')))
        for number, throw in enumerate(seen.throws)
    )
    return RigFit(fit=found, rig=seen.rig, throws=throws, _model=seen)


def _sizes(model: RigModel) -> list[int]:
    """Count the samples of each track."""
    return [channel.track.time.size for channel in model.channels]


def _before_landing(model: RigModel, rig: Rig, plates: Sequence[PlateFit]) -> RigModel:
    """Leave out what comes after the landing, were it this rig."""
    seen = replace(model, rig=rig)
    if not model.projectiles:
        return seen
    longest = max(
        float(track.time[-1]) - plates[throw].start_time for throw, _, track in model.projectiles
    )
    landing = model.simulator.landing_time(rig, max(longest, 0.0), by_cells=model.by_cells)
    seen = seen.cut(plates, _IN_FLIGHT * landing)
    if not seen.projectiles:
        raise FitError(
            f'the projectile is seen at less than {FEWEST} moments before it lands, '
            f'{landing:.3g} s after the start'
        )
    return seen
