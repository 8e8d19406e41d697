# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
r"""
A whole rig from recorded throws: plate, layer, and the start of each throw.

Notes
-----
Both tracks of all throws are compared with Eq. (D2) for the plate, and for the projectile with
the model of the twin. Where ejection times jump, positions are continuous, because the layer
catches up at once with a projectile that has only just left; so the fit uses positions only.

The tracks constrain three time scales of the layer: :math:`t_s = L_s / c_s`, :math:`\tau = m /
(\rho_s S c_s)`, and that of the loss. Mass, density and section enter by :math:`\tau` alone, so
they must be known. A thin, light layer is a spring and shows no more than :math:`t_s \tau`; a
thick, heavy one shows :math:`t_s`.

"""

from __future__ import annotations

from collections.abc import Sequence
import contextlib
from dataclasses import dataclass, replace
from functools import cached_property
import math

import numpy as np
from soft_throw_ros.core.rig import Rig
from soft_throw_ros.identification.fit_description import (
    changed_rig,
    ENGINE,
    FitDescription,
    FREE,
    LAYER,
    LOSS,
    PARAMETERS,
    START,
    values_of,
)
from soft_throw_ros.identification.layer_search import find_best_minimum, find_layers
from soft_throw_ros.identification.least_squares import Estimate, Fit, FitError
from soft_throw_ros.identification.plate_fit import fit_plate
from soft_throw_ros.identification.rig_model import RigModel, ThrowSimulator
from soft_throw_ros.identification.systematics import FLOORS, growth_by, with_floor
from soft_throw_ros.identification.tracks import FEWEST, ThrowTracks, Track

_MIN_NOISE_RATIO = 0.1  # smallest noise of a track, over the largest noise of all tracks
_MODEL_ERROR = 5e-6  # smallest noise of a track, over the range of heights: error of the models
_STIFFENING = 0.4  # error of the wave speed at rest, over the plate's speed, which causes strain
_PRIOR_SHARE = 0.5  # error over that of its prior, above which a value rests on the prior
_MIN_GAIN = 6.0  # smallest decrease of the information criterion for which a loss is fitted
_INITIAL_LOSS = 0.05  # loss tangent that is tried if none is stated
_MAX_TRIAL_EVALUATIONS = 8  # largest number of evaluations of the model with it
_MAX_LOSS_EVALUATIONS = 120  # the same if they are promising
_IN_FLIGHT = 0.97  # share of the time until the landing that a fit uses

_SECONDS_PER_THROW = 60.0  # processor time of a fit; it includes the compilation of kernels [s]


@dataclass(frozen=True, kw_only=True)
class RigFit:
    """A rig fitted to throws."""

    model: RigModel
    fit: Fit  # of all varied parameters, and of start and heights at rest of each throw
    is_complete: bool = True  # whether there was time to try other minima and a loss

    @cached_property
    def rig(self) -> Rig:
        """Rig with the fitted values, means of values per throw, at the strain of these throws."""
        return self.model.rig_of(self.fit.values)

    def estimates(self) -> dict[str, Estimate]:
        """Return the fitted parameters of the rig, with the mean of values per throw."""
        return {name: self.estimate(name) for name in PARAMETERS if name in self.model.indices}

    def terms(self) -> dict[str, Estimate]:
        """Return the other shared parameters, without starts and heights at rest."""
        return {
            name: self.fit[name] for name, throw in self.model.parameters
            if throw is None and name not in PARAMETERS
        }

    def estimate(self, name: str) -> Estimate:
        """Return a fitted parameter of the rig, the mean if each throw has its own."""
        indices = self.model.indices_of(name)
        error = math.sqrt(float(self.fit.covariance[np.ix_(indices, indices)].mean()))
        found = Estimate(values_of(self.rig, [name])[name], error)
        # A value that rests on its prior has the error of the prior
        known = [self.fit.known[index].error for index in indices if index in self.fit.known]
        is_prior = any(error > _PRIOR_SHARE * prior for prior in known)
        return found if is_prior else with_floor(name, found, self.growth)

    def rest_wave_speed(self) -> Estimate:
        """Return the wave speed of the layer at rest, which may be stiffer in a throw [m/s]."""
        speed, error = self.estimate('layer.wave_speed')
        plate_speed = 2.0 * math.pi * self.rig.engine.frequency * self.rig.engine.amplitude
        return Estimate(speed, math.hypot(error, _STIFFENING * plate_speed))

    @cached_property
    def growth(self) -> float:
        """Factor of the floors of systematic errors, by other motions of the plates."""
        pairs = zip(self.model.series, self.fit.residuals, strict=True)
        return max(
            growth_by(residual, self.rig.engine, self.start_time(series.throw).value)
            for series, residual in pairs if series.body == 'plate'
        )

    def start_time(self, throw: int) -> Estimate:
        """Return the start of a throw on the clock of its tracks; throws count from 0 [s]."""
        return self.fit[self.model.own_name(START, throw)]

    def draw(self, count: int, seed: int = 0) -> list[Rig]:
        """Draw rigs from the errors of the fit and the floors of its parameters."""
        rng, fit = np.random.default_rng(seed), self.fit
        steps = fit.errors * rng.multivariate_normal(  # of correlations, since units differ
            np.zeros(fit.values.size), fit.correlation, count, method='eigh'
        )
        for index, (name, _) in enumerate(self.model.parameters):
            if name in FLOORS and index not in fit.known:
                floor = self.growth * FLOORS[name].of(float(fit.values[index]))
                steps[:, index] += floor * rng.standard_normal(count)
        rigs = []
        for values in fit.values + steps:
            with contextlib.suppress(ValueError):
                rigs.append(self.model.rig_of(values))
        return rigs


def fit_rig(
    throws: Sequence[ThrowTracks], rig: Rig, description: FitDescription | None = None
) -> RigFit:
    """
    Fit a rig, as it is known, to the tracks of one throw or many.

    Free parameters need no guess, apart from the thickness, which should be right to a third. If
    one of the layer is free, a throw must have a projectile. FitError has the reason if the tracks
    do not determine the parameters.
    """
    description = description or FitDescription()
    free = [name for name in LAYER if description.treatment(name).is_free]
    if free and all(throw.projectile is None for throw in throws):
        raise FitError(f'{", ".join(free)} cannot be found without a track of the projectile')
    simulator = ThrowSimulator(_SECONDS_PER_THROW * len(throws))
    model = fit_plates(_with_noise(throws), rig, description, simulator)
    candidates = find_layers(model) if free else []
    if candidates:
        model = replace(model, initial={**model.initial, **candidates[0].by_name})
    model = _in_flight(model)
    fit = find_best_minimum(model, model.fit(model.start()), candidates)
    model, fit = _with_loss(model, fit)
    unlimited = replace(model, simulator=ThrowSimulator())
    return RigFit(model=unlimited, fit=fit, is_complete=not simulator.is_late)


def fit_plates(
    throws: Sequence[ThrowTracks], rig: Rig, description: FitDescription, simulator: ThrowSimulator
) -> RigModel:
    """Fit the plates alone, which no layer changes; return the whole model."""
    plates = []
    for throw in throws:
        try:
            plates.append(fit_plate(throw.plate))
        except FitError as error:
            raise FitError(f'{throw.name}: {error}') from None
    engine = np.mean([plate.values[: len(ENGINE)] for plate in plates], axis=0).tolist()
    rig = changed_rig(description.prepare(rig), {
        name: value for name, value in zip(ENGINE, engine, strict=True)
        if description.treatment(name).is_free
    })
    model = RigModel(tuple(throws), rig, description, simulator, initial={})
    return replace(model, initial={
        model.own_name(name, throw): value
        for throw, plate in enumerate(plates) for name, value in plate.by_name.items()
    })


def _with_noise(throws: Sequence[ThrowTracks]) -> list[ThrowTracks]:
    """
    Return tracks whose noise is known, none far below the others or the error of the models.

    A very small estimate shows only a smooth motion, whose track would dominate the fit.
    """
    tracks = [track for throw in throws for track in (throw.plate, throw.projectile) if track]
    least = max(
        _MIN_NOISE_RATIO * max(track.noise for track in tracks),
        _MODEL_ERROR * max(float(np.ptp(track.position)) for track in tracks),
    )

    def with_noise(track: Track) -> Track:
        return replace(track, known_noise=track.known_noise or max(track.noise, least))

    return [throw.apply(with_noise) for throw in throws]


def _in_flight(model: RigModel) -> RigModel:
    """Remove the samples after the landing of the rig from which a fit starts."""
    if not model.projectiles:
        return model
    longest = max(float(track.time[-1]) - model.start_of(n) for n, _, track in model.projectiles)
    rig, until = model.rig_of(model.start()), max(longest, 0.0)
    end = _IN_FLIGHT * model.simulator.landing_time(rig, until, by_cells=model.by_cells)
    cut = model.cut_after(end)
    if not cut.projectiles:
        raise FitError(
            f'the projectile is seen at less than {FEWEST} moments before it lands, {end:.3g} s '
            'after the start'
        )
    return cut


def _with_loss(model: RigModel, before: Fit) -> tuple[RigModel, Fit]:
    r"""
    Return model and fit with a loss if it lowers the Bayesian information criterion strongly.

    The criterion is :math:`\chi^2 + k \ln n` for k parameters and n samples; differences beyond
    6 count as strong (R. E. Kass and A. E. Raftery, J. Am. Stat. Assoc. 90, 773, 1995).
    """
    if LOSS in model.description.parameters or not model.projectiles:
        return model, before
    wider = replace(model, description=model.description.change({LOSS: FREE}))
    start = wider.start({**before.by_name, LOSS: _INITIAL_LOSS})
    try:
        fit = wider.fit(start, max_evaluations=_MAX_TRIAL_EVALUATIONS)
        if fit.chi2 < before.chi2:
            fit = wider.fit(fit.values, max_evaluations=_MAX_LOSS_EVALUATIONS)
    except FitError:
        return model, before
    gain = (before.chi2 - fit.chi2) / max(1.0, fit.reduced_chi2)
    samples = sum(series.track.time.size for series in model.series)
    return (wider, fit) if gain - math.log(samples) > _MIN_GAIN else (model, before)
