# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
r"""
A whole rig from recorded throws: plate, layer, and the start of each throw.

Notes
-----
Both tracks of all throws are compared with one model: Eq. (D2) for the plate, and for the
projectile the model of the twin: travelling waves, or cells in a layer with internal loss.
Positions are continuous where ejection times jump, because the layer catches up at once with a
projectile that has only just left. The fit therefore uses positions only, and jumps of the
ejection time do no harm.

The tracks constrain three time scales of the layer: :math:`t_s = L_s / c_s`, :math:`\tau = m /
(\rho_s S c_s)`, and that of the loss. Mass, density and section enter by :math:`\tau` alone, so
they must be known, and their errors are part of the error of the wave speed. Wave speed and
thickness are separate only if the tracks show waves. A thin, light layer is a spring and shows no
more than :math:`t_s \tau`; a thick, heavy one shows :math:`t_s`. `fit_warnings` reports
parameters that are not separate.

"""

from __future__ import annotations

from collections.abc import Callable, Sequence
import contextlib
from dataclasses import dataclass, replace
from functools import cached_property
import math
from operator import attrgetter

import numpy as np
from numpy.typing import NDArray
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
from soft_throw_ros.identification.forward import (
    DeadlineExceeded,
    first_releases,
    FirstReleases,
    ThrowSimulator,
)
from soft_throw_ros.identification.layer_search import (
    find_best_minimum,
    find_layers,
    LayerCandidate,
)
from soft_throw_ros.identification.least_squares import Estimate, Fit, FitError
from soft_throw_ros.identification.plate_fit import fit_plate, PlateFit
from soft_throw_ros.identification.rig_model import RigModel
from soft_throw_ros.identification.systematics import FLOORS, growth_by, plate_speed, with_floor
from soft_throw_ros.identification.tracks import FEWEST, ThrowTracks, Track

Floats = NDArray[np.float64]

_MIN_NOISE_RATIO = 0.1  # smallest noise of a track, over the largest noise of all tracks
_MODEL_ERROR = 5e-6  # smallest noise of a track, over the range of heights: error of the models
_STIFFENING = 0.4  # error of the wave speed at rest over `plate_speed`, to which strain is close
_PRIOR_SHARE = 0.5  # error over that of its prior, above which a value rests on the prior
_MIN_GAIN = 6.0  # smallest decrease of the information criterion for which a loss is fitted
_INITIAL_LOSSES = (0.03, 0.1)  # loss tangents that are tried if none is stated
_MAX_TRIAL_EVALUATIONS = 8  # largest number of evaluations of the model with each of them
_MAX_LOSS_EVALUATIONS = 120  # largest number of evaluations with the better one
_MAX_LANDING_ROUNDS = 4  # largest number of fits to find the time of the landing

_SECONDS_PER_THROW = 60.0
"""Processor time of a fit; it includes the compilation of kernels. [s]"""


@dataclass(frozen=True, kw_only=True)
class RigFit:
    """A rig fitted to throws: the state between the steps of `fit_rig`, and its result."""

    model: RigModel
    fit: Fit
    """
    Fit of all varied parameters. Each throw adds its `start_time` and the heights at rest
    `plate_offset` and `projectile_offset`. The name of a value of one of several throws ends with
    its number in brackets, from 1.
    """
    is_complete: bool = True
    """Whether other minima and a loss were tried within the time of the fit."""

    @cached_property
    def rig(self) -> Rig:
        """
        Rig with the fitted values, and the mean of values per throw.

        The wave speed of the layer is that at the strain of these throws.
        """
        return self.model.rig_of(self.fit.values)

    def estimates(self) -> dict[str, Estimate]:
        """Return the fitted parameters of the rig, with the mean of values per throw."""
        return {name: self.estimate(name) for name in PARAMETERS if name in self.model.layout}

    def terms(self) -> dict[str, Estimate]:
        """Return the other shared parameters, without starts and heights at rest."""
        shared = {name for name, throw in self.model.layout.values if throw is None}
        return {n: self.fit[n] for n in self.fit.names if n in shared and n not in PARAMETERS}

    def estimate(self, name: str) -> Estimate:
        """Return a fitted parameter of the rig, the mean if each throw has its own."""
        indices = self.model.layout.indices_of(name)
        error = math.sqrt(float(self.fit.covariance[np.ix_(indices, indices)].mean()))
        found = Estimate(values_of(self.rig, [name])[name], error)
        known = [self.fit.known[index] for index in indices if index in self.fit.known]
        # A value that rests on its prior has the error of the prior
        is_prior = any(error > _PRIOR_SHARE * prior.error for prior in known)
        return found if is_prior else with_floor(name, found, self.growth)

    def rest_wave_speed(self) -> Estimate:
        """Return the wave speed of the layer at rest, which may be stiffer in a throw [m/s]."""
        speed, error = self.estimate('layer.wave_speed')
        return Estimate(speed, math.hypot(error, _STIFFENING * plate_speed(self.rig.engine)))

    @cached_property
    def growth(self) -> float:
        """Factor of the floors of systematic errors, by other motions of the plates."""
        pairs = zip(self.model.series, self.fit.residuals, strict=True)
        return max(
            growth_by(residual, self.rig.engine, self.start_time(series.throw).value)
            for series, residual in pairs if series.body == 'plate'
        )

    def budget(self, name: str) -> dict[str, float]:
        """Return the contributions of noise, priors and systematic errors to an error [SI]."""
        budget = self.fit.budget(name)
        floor = FLOORS.get(name.partition('[')[0])
        if floor is not None and self.fit.names.index(name) not in self.fit.known:
            budget['systematic'] = self.growth * floor.of(self.fit[name].value)
        return budget

    def start_time(self, throw: int) -> Estimate:
        """Return the start of a throw on the clock of its tracks; throws count from 0 [s]."""
        return self.fit[self.fit.names[self.model.layout.indices[START][throw]]]

    def releases(self, count: int, seed: int = 0) -> FirstReleases:
        """
        Compute the release of the fitted rig, and of rigs drawn from the errors of the fit.

        The first release is that of the fitted rig.
        """
        rng = np.random.default_rng(seed)
        fit = self.fit
        steps = fit.errors * rng.multivariate_normal(  # of correlations, since units differ
            np.zeros(fit.values.size), fit.correlation, count, method='eigh'
        )
        for index, (name, _) in enumerate(self.model.layout.values):
            if name in FLOORS and index not in fit.known:
                floor = self.growth * FLOORS[name].of(float(fit.values[index]))
                steps[:, index] += floor * rng.standard_normal(count)
        rigs = [self.rig]
        for values in fit.values + steps:
            with contextlib.suppress(ValueError):
                rigs.append(self.model.rig_of(values))
        return first_releases(rigs)


def fit_rig(
    throws: Sequence[ThrowTracks],
    rig: Rig,
    description: FitDescription | None = None,
    *,
    on_progress: Callable[[str], object] = lambda _: None,
) -> RigFit:
    """
    Fit a rig to the tracks of one throw or many.

    Parameters
    ----------
    throws : sequence of ThrowTracks
        Tracks. If a parameter of the layer is free, at least one throw has a projectile.
    rig : Rig
        The rig as it is known. Free parameters need no guess, apart from the thickness, which
        should be right to a third.
    description : FitDescription, optional
        Treatments of the parameters; `DEFAULTS` by default.
    on_progress : callable
        Called with the name of each step.

    Raises
    ------
    FitError
        If the tracks do not determine the parameters, with the reason.

    """
    if not throws:
        raise FitError('there is no throw to fit to')
    description = description or FitDescription()
    free = [name for name in LAYER if description.is_free(name)]
    if free and all(throw.projectile is None for throw in throws):
        raise FitError(f'{", ".join(free)} cannot be found without a track of the projectile')
    seconds = _SECONDS_PER_THROW * len(throws)
    simulator = ThrowSimulator(seconds)
    try:
        on_progress('fitting the plate')
        model = _fit_plates(throws, rig, description, simulator)
        others: list[LayerCandidate] = []
        if free:
            on_progress('searching the layers')
            others = find_layers(model)
            model = replace(model, initial={**model.initial, **others[0].values})
        on_progress('fitting')
        result = _fit_until_landing(model)
    except DeadlineExceeded:
        raise FitError(
            f'the fit takes more than {seconds:g} s; leave out late samples of the tracks, or fit '
            'fewer parameters'
        ) from None
    try:
        on_progress('searching for other minima')
        result = replace(result, fit=find_best_minimum(result.model, result.fit, others))
        on_progress('searching for a loss')
        if model.projectiles:
            result = _with_loss(result)
    except DeadlineExceeded:
        result = replace(result, is_complete=False)
    return replace(result, model=replace(result.model, simulator=ThrowSimulator()))


def _fit_plates(
    throws: Sequence[ThrowTracks],
    rig: Rig,
    description: FitDescription,
    simulator: ThrowSimulator,
) -> RigModel:
    """Fit the plates alone, which no layer changes; return the whole model."""
    throws = tuple(_with_noise(throws))
    plates = tuple(map(_fit_plate, throws))
    engine = np.mean([plate.fit.values[:3] for plate in plates], axis=0)
    pairs = zip(ENGINE, engine.tolist(), strict=True)
    rig = changed_rig(
        description.prepare(rig),
        {name: value for name, value in pairs if description.is_free(name)},
    )
    without = tuple(replace(throw, projectile=None) for throw in throws)
    alone = RigModel(without, rig, description, simulator, plates)
    return replace(alone, throws=throws, initial=alone.fit(alone.start()).by_name)


def _with_noise(throws: Sequence[ThrowTracks]) -> list[ThrowTracks]:
    """
    Return tracks whose noise is known, none far below the others or the error of the models.

    One camera measures both bodies. A very small estimate shows only a smooth motion, and this
    track would dominate the fit.
    """
    tracks = [track for throw in throws for track in (throw.plate, throw.projectile) if track]
    least = max(
        _MIN_NOISE_RATIO * max(track.noise for track in tracks),
        _MODEL_ERROR * max(float(np.ptp(track.position)) for track in tracks),
    )

    def with_noise(track: Track) -> Track:
        return replace(track, known_noise=track.known_noise or max(track.noise, least))

    return [throw.apply(with_noise) for throw in throws]


def _fit_plate(throw: ThrowTracks) -> PlateFit:
    """Fit the plate of a throw; an error names the throw."""
    try:
        return fit_plate(throw.plate)
    except FitError as error:
        raise FitError(f'{throw.name}: {error}') from None


def _fit_until_landing(model: RigModel) -> RigFit:
    """Fit the samples before the landing, whose time depends on the fit."""
    rig = model.rig_of(model.start())
    for _ in range(_MAX_LANDING_ROUNDS):
        cut = _in_flight(model, rig)
        result = RigFit(model=cut, fit=cut.fit(cut.start()))
        rig, model = result.rig, replace(model, initial=result.fit.by_name)
        if _in_flight(model, rig).sample_count == cut.sample_count:
            break
    return result


def _with_loss(result: RigFit) -> RigFit:
    r"""
    Return a fit with a loss if it lowers the Bayesian information criterion strongly.

    The criterion is :math:`\chi^2 + k \ln n` for k parameters and n samples; differences beyond
    6 count as strong (R. E. Kass and A. E. Raftery, J. Am. Stat. Assoc. 90, 773, 1995).
    """
    model, before = result.model, result.fit
    if not model.description.searches(LOSS):
        return result
    wider = replace(model, description=model.description.change({LOSS: FREE}))
    start = wider.start(before)
    fits = []
    for loss in _INITIAL_LOSSES:
        start[wider.layout.indices_of(LOSS)] = loss
        with contextlib.suppress(FitError):
            fits.append(wider.fit(start, max_evaluations=_MAX_TRIAL_EVALUATIONS))
    fit = min(fits, key=attrgetter('chi2'), default=before)
    if fit.chi2 >= before.chi2:
        return result
    fit = wider.fit(fit.values, max_evaluations=_MAX_LOSS_EVALUATIONS)
    gain = (before.chi2 - fit.chi2) / max(1.0, fit.reduced_chi2)
    is_needed = gain - math.log(model.sample_count) > _MIN_GAIN
    return replace(result, model=wider, fit=fit) if is_needed else result


def _in_flight(model: RigModel, rig: Rig) -> RigModel:
    """Remove the samples after the landing of a rig."""
    if not model.projectiles:
        return model
    end = model.flight_end(rig)
    cut = model.cut_after(end)
    if not cut.projectiles:
        raise FitError(
            f'the projectile is seen at less than {FEWEST} moments before it lands, {end:.3g} s '
            'after the start'
        )
    return cut
