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
to be known, and what they are not known to is in the error of the wave speed. Wave speed and
thickness are then seen apart if waves are. A thin, light layer is a spring and shows no more than
:math:`t_s \tau`; a thick, heavy one shows :math:`t_s`. `least_squares.Fit.warnings` says when that
is so.

"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
import contextlib
from dataclasses import dataclass, replace
import math

import numpy as np
from numpy.typing import NDArray
from soft_throw_ros.core.plate import Underdamped
from soft_throw_ros.core.rig import Rig
from soft_throw_ros.identification.fit_description import (
    changed_rig,
    ENGINE,
    FitDescription,
    LAYER,
    PARAMETERS,
    values_of,
)
from soft_throw_ros.identification.forward import (
    EffortError,
    first_releases,
    FirstReleases,
    ThrowSimulator,
)
from soft_throw_ros.identification.layer_search import find_layers
from soft_throw_ros.identification.least_squares import Estimate, Fit, FitError
from soft_throw_ros.identification.linear_fit import profile_intervals
from soft_throw_ros.identification.minima import find_best_minimum
from soft_throw_ros.identification.model_choice import (
    add_terms,
    compare_layers,
    criterion,
    describe_layers,
    is_best_term,
    LayerModel,
    likely_modes,
)
from soft_throw_ros.identification.plate_fit import estimate_peak_velocity, fit_plate, PlateFit
from soft_throw_ros.identification.rig_model import (
    cut_after,
    PLATE_MODE,
    ReleaseShift,
    RigModel,
    shift_of_release,
    START,
    STICKING,
)
from soft_throw_ros.identification.sticking import let_stick
from soft_throw_ros.identification.tracks import FEWEST, ThrowTracks, Track

Floats = NDArray[np.float64]

_LEAST_NOISE = 0.1  # of the largest, and ...
_MODEL_ERROR = 5e-6  # of the way a projectile goes, which models leave out
_IN_FLIGHT = 0.97  # of the time until the landing is looked at
_SEEN = 3.0  # errors, from which on a layer is said to stick
_LANDING_ROUNDS = 4  # of finding out when that is


@dataclass(frozen=True, kw_only=True)
class RigFit:
    """A rig that was fitted to throws."""

    fit: Fit
    """
    Of what was varied, and for each throw of its `start_time`, and of `plate_offset` and
    `projectile_offset`, the heights at rest, as far as they were free. What only some of several
    throws have in common has the number of the first of them in brackets, from 1.
    """
    rig: Rig
    """
    With the values that were found, their mean where each throw has its own, and the wave speed
    that the layer has when it is squeezed as much as in these throws.
    """
    throws: tuple[ThrowTracks, ...]
    """What they were found from: without what comes after a landing, and without outliers."""
    remarks: tuple[str, ...]
    """What had to be assumed to explain these throws, each in a sentence."""
    layers: tuple[LayerModel, ...]
    """How well several kinds of layers explain them."""
    intervals: Mapping[str, tuple[float, float]]
    """Intervals of 95 % of parameters for which errors are no good, see `profile_intervals`."""
    _model: RigModel

    def estimates(self) -> dict[str, Estimate]:
        """Return what was varied of the rig, with the mean of what each throw has for itself."""
        return {name: self.estimate(name) for name in PARAMETERS if name in self._model.places}

    def terms(self) -> dict[str, Estimate]:
        """Return what else was varied, but for starts and heights at rest."""
        shared = {name for name, key in self._model.groups if key is None}
        return {n: self.fit[n] for n in self.fit.names if n in shared and n not in PARAMETERS}

    def estimate(self, name: str) -> Estimate:
        """
        Return what was found of a parameter of the rig, the mean if each throw has its own.

        The wave speed is that of the squeezed layer, for a linear model, and its error that with
        which it is the one of a layer at rest.
        """
        places = self._model.places_of(name)
        if not self._model.is_per_throw(name):
            places = places[:1]
        variance = float(self.fit.covariance[np.ix_(places, places)].mean())
        return Estimate(values_of(self.rig, [name])[name], math.sqrt(variance))

    def held_values(self) -> dict[str, float]:
        """Return what was taken to be known exactly of the rig."""
        return values_of(self.rig, [name for name in PARAMETERS if name not in self._model.places])

    def warnings(self) -> list[str]:
        """Say what there is to doubt, each in a sentence."""
        sticking = self.terms().get(STICKING)
        if sticking is None or sticking.value < _SEEN * sticking.error:
            return self.fit.warnings()
        warning = (
            f'the layer seems to hold the projectile for {1e3 * sticking.value:.2g} ms when it '
            'would leave; one whose stiffness changes does much alike, from which it leaves so '
            f'much earlier (as with --hold {STICKING})'
        )
        return [*self.fit.warnings(), warning]

    def start_time(self, throw: int) -> Estimate:
        """When a throw began, on the clock of its tracks; they count from 0 [s]."""
        return self.fit[self.fit.names[self._model.places[START][throw]]]

    def heights(self, throw: int, time: Floats) -> tuple[Floats, Floats]:
        """Predict heights of plate and projectile [m] at times [s], as the tracks count them."""
        places = [(throw, body, time) for body in ('plate', 'projectile')]
        plate, projectile = self._model.paths(self.fit.values, places)
        return plate.height, projectile.height

    def without_drift(self, throw: int) -> ThrowTracks:
        """Take the drift that was found off the projectile of a throw."""
        tracks = self.throws[throw]
        if tracks.projectile is None:
            return tracks
        time = tracks.projectile.time
        drift = self._model.drift(self.fit.values, throw, 'projectile', time)
        return replace(
            tracks,
            projectile=replace(tracks.projectile, position=tracks.projectile.position - drift),
        )

    def peak_plate_speed(self, throw: int) -> Estimate:
        """Find the largest speed of the step of a throw, :math:`V_p^*` (D4) [m/s]."""
        motion = Underdamped.of(self._model.rig_of(self.fit.values, throw).engine)
        places = {k: self._model.places.get(name, {}).get(throw) for k, name in enumerate(ENGINE)}
        varied = {k: place for k, place in places.items() if place is not None}
        covariance = np.zeros((len(ENGINE), len(ENGINE)))
        of_fit = self.fit.covariance[np.ix_([*varied.values()], [*varied.values()])]
        covariance[np.ix_([*varied], [*varied])] = of_fit
        return estimate_peak_velocity(motion, covariance)

    def releases(self, count: int, seed: int = 0) -> FirstReleases:
        """
        Find how projectiles leave: that of the rig, and of others that may be as well.

        The first is of the rig that was fitted. Waves of the plate and a layer that sticks change
        when and how fast they leave.
        """
        rng = np.random.default_rng(seed)
        powers, axes = np.linalg.eigh(self.fit.correlation)
        steps = rng.normal(size=(count, powers.size)) * np.sqrt(np.maximum(powers, 0.0))
        rigs, stuck, drawn = [], [], []
        for step in (np.zeros(powers.size), *(steps @ axes.T)):
            values = self.fit.values + self.fit.errors * step
            with contextlib.suppress(ValueError):
                rigs.append(self._model.rig_of(values))
                stuck.append(self._model.value(values, STICKING, 0))
                drawn.append(step)
        found = first_releases(rigs)
        shift, slopes = self._shift_of_release()
        shifted = np.array(drawn) @ slopes
        # A time below 0 stands for as much less of what a layer that sticks does
        slowed = 0.5 * shift.jerk * np.array(stuck) * np.abs(stuck)
        speed = found.speed + shift.speed + shifted[:, 1] + slowed
        return found._replace(
            time=found.time + shift.time + shifted[:, 0] + stuck,
            speed=speed,
            energy_transfer=(speed / found.peak_plate_speed) ** 2,
        )

    def _shift_of_release(self) -> tuple[ReleaseShift, Floats]:
        """Return what waves of the plate do to the release, and time and speed per error."""
        fit, model = self.fit, self._model
        shift = shift_of_release(model, fit.values, 0)
        slopes = np.zeros((fit.values.size, 2))
        for place in model.wave_places(0):
            values = fit.values.copy()
            values[place] += fit.errors[place]
            there = shift_of_release(model, values, 0)
            slopes[place] = there.time - shift.time, there.speed - shift.speed
        return shift, slopes


def fit_rig(
    throws: Sequence[ThrowTracks],
    rig: Rig,
    description: FitDescription | None = None,
    *,
    tell: Callable[[str], object] = lambda _: None,
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
    tell : callable
        Is told what is being done, in a few words.

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
    sticks = description.treatment(STICKING).is_varied
    if sticks:  # a loss looks much alike: first it is seen whether either is needed
        description = description.change({STICKING: f'{description.text(STICKING)} if seen'})
    throws = _with_like_noise(throws)
    plates = [_fit_plate(throw, description) for throw in throws]
    rig = _with_engine_of(plates, description.prepare(rig), description)
    simulator = ThrowSimulator(throws=len(throws))
    model = RigModel(tuple(throws), rig, description, simulator)
    tell('fitting the plate')
    model, of_plates, remarks = _fit_plates(model, plates)
    others: list[Rig] = []
    if free:
        tell('looking at all layers that it may be')
        model, others = _find_layers(model, plates, of_plates, free)
    tell('fitting')
    model, fit = _fit_until_landing(model, plates, of_plates)
    simulator.bound()
    tell('looking for other minima')
    fit = find_best_minimum(model, fit, others)
    tell('looking for what a bench may add, and comparing layers')
    model, fit, layers, more = _choose_layer(model, plates, fit)
    simulator.unbind()  # what is left does not take long
    if sticks and model.projectiles:
        model, fit = let_stick(model, plates, fit)
    intervals = profile_intervals(model, fit)
    remarks += [*more, *([describe_layers(layers, fit)] if layers else [])]
    tracks: list[dict[str, Track]] = [{} for _ in throws]
    for (number, body, _), residual in zip(model.channels, fit.residuals, strict=True):
        tracks[number][body] = residual.track
    used = [ThrowTracks(name=old.name, **of) for old, of in zip(throws, tracks, strict=True)]
    return RigFit(
        fit=fit,
        rig=model.rig_of(fit.values),
        throws=tuple(used),
        remarks=tuple(remarks),
        layers=tuple(layers),
        intervals=intervals,
        _model=model,
    )


def _fit_plates(model: RigModel, plates: Sequence[PlateFit]) -> tuple[RigModel, Fit, list[str]]:
    """Fit the plates alone, and find what they do beside a step, which no layer changes."""
    alone = replace(model, throws=tuple(replace(throw, projectile=None) for throw in model.throws))
    alone, fit, remarks = add_terms(alone, plates, alone.fit(alone.start(plates)))
    # What their own tracks do not show may later explain no projectile; but for a mode, which may
    # be too small to be seen until a layer amplifies it
    plates_own = [name for name in alone.description.if_seen if name.startswith('plate')]
    unseen = [name for name in plates_own if name != PLATE_MODE]
    description = alone.description.change(dict.fromkeys(unseen, 'held'))
    modes = likely_modes(alone, fit) if PLATE_MODE in alone.description.if_seen else ()
    model = replace(model, description=description, mode=alone.mode, likely_modes=modes)
    return model, fit, remarks


def _choose_layer(
    model: RigModel, plates: Sequence[PlateFit], fit: Fit
) -> tuple[RigModel, Fit, list[LayerModel], list[str]]:
    """Add what the tracks show to be needed, and take the kind of layer that explains them."""
    is_mode = is_best_term(PLATE_MODE, model, plates, fit)
    best = _choose_kind(model, plates, fit)
    if is_mode:  # what that explains, a layer of another kind may explain better
        model.simulator.allow_more()
        other = _choose_kind(model, plates, fit, but=PLATE_MODE)
        best = min(best, other, key=lambda option: criterion(option[1]))
    return best


def _choose_kind(
    model: RigModel, plates: Sequence[PlateFit], fit: Fit, *, but: str = ''
) -> tuple[RigModel, Fit, list[LayerModel], list[str]]:
    """Add what is needed, `but` for one term, and take the kind of layer that is best with it."""
    simple = model
    model, fit, remarks = add_terms(model, plates, fit, but=but)
    layers, strained = compare_layers(model, plates, fit)
    if strained is not None:
        other = replace(simple, rig=strained[0])
        with contextlib.suppress(EffortError):
            fit = other.fit(other.start_from(strained[1], plates))
            model, fit, remarks = add_terms(other, plates, fit, but=but)
    return model, fit, layers, remarks


def _find_layers(
    model: RigModel, plates: Sequence[PlateFit], of_plates: Fit, free: Sequence[str]
) -> tuple[RigModel, list[Rig]]:
    """Find about which layer each throw has, and what else it may be if all have the same."""
    groups: dict[str | None, list[int]] = {}
    for number, throw in enumerate(model.throws):
        if throw.projectile is not None:
            conditions = model.description.conditions(throw.name)
            groups.setdefault(conditions.get('layer'), []).append(number)
    found: dict[int, dict[str, float]] = {}
    for numbers in groups.values():
        throws = tuple(
            throw if number in numbers else replace(throw, projectile=None)
            for number, throw in enumerate(model.throws)
        )
        best, *others = find_layers(replace(model, throws=throws), plates, of_plates)
        if len(groups) == 1:
            return replace(model, rig=best), others
        found |= dict.fromkeys(numbers, values_of(best, free))
    return replace(model, found=found), []


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

    return [throw.apply(with_noise) for throw in throws]


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


def _fit_until_landing(
    model: RigModel, plates: Sequence[PlateFit], of_plates: Fit
) -> tuple[RigModel, Fit]:
    """Fit to what comes before the projectile lands, which depends on the fit."""
    seen, rig = model, model.rig
    for _ in range(_LANDING_ROUNDS):
        cut = _before_landing(model, rig, plates)
        if seen is not model and _sizes(cut) == _sizes(seen):
            break
        seen = cut
        found = seen.fit(seen.start_from(of_plates, plates))
        rig = seen.rig_of(found.values)
    return seen, found


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
    seen = cut_after(seen, plates, _IN_FLIGHT * landing)
    if not seen.projectiles:
        raise FitError(
            f'the projectile is seen at less than {FEWEST} moments before it lands, '
            f'{landing:.3g} s after the start'
        )
    return seen
