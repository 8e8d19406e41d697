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
Which of several minima, and which of several models, explains throws.

Notes
-----
Where a stiff layer makes the projectile chatter, chi squared has several minima. Wave speeds
beside the best one are looked at with all else adapted to first order, and other layers that the
search has found; each that may be as good is fitted. What is not worse by more than `NEAR` is
named.

What a bench may add and seldom does (a loss, a plate that rings) is fitted only if that lowers the
Bayesian information criterion, :math:`\chi^2 + k \ln n` for k parameters and n samples [1]_. That
is told from the residuals of the fit without it, by what a change of it leaves beside all other
derivatives (a score test), so that nothing is fitted in vain.

A layer that sticks for a time s shifts the projectile by about :math:`s^2`, so that near 0 nothing
is seen of s, and it is in no sense normally distributed. So all is fitted first without it. Its
distribution is computed along its axis, all else being adapted to first order (a profile), and its
second moments about the fit take the place of the covariance. Only where the profile is lower than
without it is all fitted again from there, and kept if that is better.

References
----------
.. [1] R. E. Kass and A. E. Raftery, "Bayes factors", J. Am. Stat. Assoc. 90, 773 (1995), who take
   differences beyond 6 for strong.

"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
import contextlib
from dataclasses import replace
import math
from operator import attrgetter, itemgetter
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from soft_throw_ros.core.rig import Rig
from soft_throw_ros.identification.fit_description import (
    changed_rig,
    FitDescription,
    LAYER,
    values_of,
)
from soft_throw_ros.identification.forward import EffortError
from soft_throw_ros.identification.least_squares import (
    Alternative,
    Fit,
    FitError,
    INSEPARABLE,
)
from soft_throw_ros.identification.plate_fit import PlateFit
from soft_throw_ros.identification.plate_modes import find_mode, Mode
from soft_throw_ros.identification.rig_model import (
    MODE,
    OWN,
    RigModel,
    START,
    START_OF_STICKING,
    WAVES,
)
from soft_throw_ros.identification.tracks import FEWEST

Floats = NDArray[np.float64]

STICKING = 'projectile.sticking'

NEAR = 9.0
"""By how much chi squared of another minimum may be larger for it to be named."""

_APART = 4.0  # of chi squared, that another minimum is farther than chance and its slope explain
_SCAN = np.linspace(-0.08, 0.08, 65)  # relative changes of the wave speed, to see other minima
_PROMISING = 60.0  # chi squared above the best from which a fit is still tried
_MOST_STARTS = 4  # of other minima, the most promising ones first, each with ...
_EVALUATIONS = 20  # of the model
_TRIED_FIRST = {'layer.loss_tangent': 0.05, STICKING: START_OF_STICKING}
_SOFTER = (1.0, 0.85)  # wave speeds of other kinds of layers to start from, over the one found
_MOST_TERMS = 3  # that are added one after the other
_STRONG = 6.0  # by how much the criterion is lower where a term is seen
_MODE_SIZE = 4  # parameters of a second mode
_TRIALS = {  # values by which it is tried whether a term is seen
    'layer.loss_tangent': 0.01,
    STICKING: 2e-4,
    **dict.fromkeys([part for parts in WAVES.values() for part in parts], 1e-3),
}
_NOTICED = 1.0  # by how much chi squared must be lower for a layer to be said to stick
_PROVEN = 12.0  # by how much chi squared is larger of layers that do not explain throws
_PROFILE = np.linspace(-5.0, 5.0, 31)  # errors of sticking at which its profile is computed, ...
_PROFILE_ROUNDS = 12  # each with the errors of the one before, until they are ...
_SAME = 0.8  # of those at least, and at most over that
_NARROWER = 0.1  # of them that they are taken to be, at least
_NEWTON_STEPS = 3  # along an interval
_CHI2_95 = 3.84  # that 95 % are below, of one degree of freedom
_LONGEST = 6.0  # errors that half of an interval may be long
_HALVES = 8  # in which its end is looked for


class LayerKind(NamedTuple):
    """A kind of layer that is compared with others; what is not named is held at 0."""

    name: str
    terms: Mapping[str, str] = {}
    """What is fitted then, and how."""
    material: Mapping[str, str] = {}
    """Fields of `core.rig.Layer` that are otherwise."""


_OF_LAYERS = ('layer.loss_tangent', STICKING)
_LOSS, _STICKING = {_OF_LAYERS[0]: 'free'}, {STICKING: '+- 2e-4'}
_KINDS = (
    LayerKind('without loss'),
    LayerKind('with loss', _LOSS),
    LayerKind('that sticks', _STICKING),
    LayerKind('with loss that sticks', _LOSS | _STICKING),
    LayerKind('of large strain', material={'elasticity': 'neo_hookean'}),
)
_EXPLANATIONS = {
    'plate.ringing': 'a plate that rings before the throw explains these throws',
    'plate.mode': 'a plate with a second mode explains these throws',
}


class LayerModel(NamedTuple):
    """How well a kind of layer explains throws."""

    name: str
    chi2: float
    dof: int
    criterion: float
    """The Bayesian information criterion, above the lowest one."""
    is_fitted: bool
    """Whether it was, or chi squared is what a fit would leave to first order."""


def find_best_minimum(model: RigModel, fit: Fit, others: Sequence[Rig]) -> Fit:
    """
    Try what else the layer may be: take what is better, and name what is hardly worse.

    Parameters
    ----------
    model : RigModel
        Of all throws.
    fit : Fit
        Of the model.
    others : sequence of Rig
        That the layer may be of.

    """
    if 'layer.wave_speed' not in model.places:
        return fit
    noise = _noise_of(model, fit)
    try:
        starts = _find_valleys(model, fit)
    except EffortError:
        return fit
    for rig in others:
        start = fit.values.copy()
        for name, value in values_of(rig, LAYER).items():
            if name in model.places:
                start[model.places_of(name)] = value
        starts.append(start)
    if fit.is_mismatch:
        starts.insert(0, _without_faults(model, fit.values))
    found = [fit]
    for start in starts[:_MOST_STARTS]:
        try:
            other = model.fit(start, noise=noise, max_evaluations=_EVALUATIONS)
        except EffortError:
            break
        except FitError:
            continue
        found.append(other)
    first, *rest = sorted(found, key=attrgetter('chi2'))
    alternatives: list[Alternative] = []
    known = [first]
    for each in rest:
        if each.chi2 - first.chi2 < NEAR and all(_is_apart(one, each) for one in known):
            known.append(each)
            alternatives.append(Alternative(each.values, each.chi2 - first.chi2))
    if first is not fit:
        with contextlib.suppress(EffortError):
            first = model.fit(first.values)  # with its own noise
    return first.spanning(alternatives)


def _is_apart(fit: Fit, other: Fit) -> bool:
    """Tell another minimum from the slope of a valley, where chi squared is a parabola."""
    way = other.values - fit.values
    parabola = float(way @ np.linalg.lstsq(fit.covariance, way, rcond=1e-14)[0])
    return parabola > _APART + 2.0 * (other.chi2 - fit.chi2)


def _without_faults(model: RigModel, values: Floats) -> Floats:
    """Put what a bench may add back to what is known of it, lest a fit go astray with that."""
    start: Floats = values.copy()
    for place, known in model.known.items():
        if not model.names[place].startswith('plate'):  # as the plates alone have it
            start[place] = known.value
    return start


def _start_layer(model: RigModel, values: Floats, noise: Floats) -> Floats:
    """Find where to start from with a layer of another kind: it alone is fitted first."""
    start = _without_faults(model, values)
    for name, value in _TRIED_FIRST.items():
        if name in model.places:
            start[model.places_of(name)] = value
    tried: list[tuple[float, Floats]] = []
    for part in _SOFTER:
        moved = start.copy()
        moved[model.places_of('layer.wave_speed')] *= part
        with contextlib.suppress(FitError):
            found = model.fit(
                moved, noise=noise, only=(*LAYER, STICKING, *OWN), max_evaluations=_EVALUATIONS
            )
            moved[[model.names.index(name) for name in found.names]] = found.values
            tried.append((found.chi2, moved))
    best: Floats = min(tried, key=lambda each: each[0])[1] if tried else start
    return best


def _find_valleys(model: RigModel, fit: Fit) -> list[Floats]:
    """Find wave speeds at which chi squared is lower than beside, all else being adapted."""
    places = model.places_of('layer.wave_speed')
    system = _Linear(model, fit, places)
    profile, values = [], []
    for part in _SCAN:
        moved = fit.values.copy()
        moved[places] *= 1.0 + part
        try:
            left = system.left(moved)
        except FitError:
            return []
        profile.append(float(np.sum(system.project(left) ** 2)))
        moved[system.others] += system.change(left)
        values.append(moved)
    limit = min(profile) + _PROMISING
    valleys = [
        k
        for k in range(1, len(profile) - 1)
        if profile[k] < min(profile[k - 1], profile[k + 1], limit) and k != _SCAN.size // 2
    ]
    return [values[k] for k in sorted(valleys, key=lambda k: profile[k])]


class _Candidate(NamedTuple):
    """A model with one more term, and how heights change with each part of it."""

    name: str
    model: RigModel
    columns: Floats

    @property
    def size(self) -> int:
        """How many parameters more it has."""
        return _MODE_SIZE if self.name == 'plate.mode' else self.columns.shape[1]


def add_terms(
    model: RigModel, plates: Sequence[PlateFit], fit: Fit
) -> tuple[RigModel, Fit, list[str]]:
    """
    Add what the tracks show to be needed, one after the other, the best first.

    Returns the model with it, its fit, and a sentence for each term.
    """
    remarks = []
    for _ in range(_MOST_TERMS):
        try:
            tried = [
                _try_term(model, plates, fit, name, model.description.see(name))
                for name in model.description.if_seen
            ]
            gains = [
                (_gain(model, fit, each) - _penalty(fit, each.size) - _STRONG, each)
                for each in tried
                if each is not None
            ]
            gain, best = max(gains, key=itemgetter(0), default=(0.0, None))
            if best is None or gain <= 0.0:
                break
            start = best.model.start_from(fit, plates)
            if best.name in _OF_LAYERS and 'layer.wave_speed' in best.model.places:
                start = _start_layer(best.model, start, _noise_of(model, fit))
            found = best.model.fit(start)
        except EffortError as error:
            remarks.append(f'not all that may be on a bench was looked for: {error}')
            break
        except FitError:
            break  # what explains so much cannot be followed
        if found.reduced_chi2 >= fit.reduced_chi2:
            break  # it led elsewhere
        if best.name in _EXPLANATIONS:
            remarks.append(_remark(best, fit, found))
        model, fit = best.model, find_best_minimum(best.model, found, [])
    return model, fit, remarks


def _penalty(fit: Fit, parameters: int) -> float:
    """By how much more parameters raise the criterion."""
    return parameters * math.log(fit.dof + fit.values.size)


def _try_term(
    model: RigModel,
    plates: Sequence[PlateFit],
    fit: Fit,
    name: str,
    description: FitDescription,
) -> _Candidate | None:
    """Add a term to a model, and change it by a little; None if there is nothing to see it by."""
    if not name.startswith('plate') and not model.projectiles:
        return None
    wider = replace(model, description=description)
    if name == 'plate.mode':
        wider = replace(wider, mode=_mode_of(model, fit))
        if wider.mode is None:
            return None
    start = wider.start_from(fit, plates)
    parts = WAVES.get(name, (name,))
    start[[place for part in parts for place in wider.places_of(part)]] = 0.0
    base = wider.predict(start)
    columns = []
    for part in parts:
        moved = start.copy()
        moved[wider.places_of(part)] = _TRIALS[part]
        change = (wider.predict(moved) - base) / _TRIALS[part]
        for place in wider.places_of(part):
            throws = [throw for throw, at in wider.places[part].items() if at == place]
            columns.append(np.where(np.isin(wider.rows, throws), change, 0.0))
    return _Candidate(name, wider, np.stack(columns, axis=1))


def _gain(model: RigModel, fit: Fit, candidate: _Candidate) -> float:
    """By how much chi squared would fall, were the model linear in the term."""
    system = _Linear(model, fit)
    extra = (candidate.columns / system.noise[:, None])[system.kept]
    extra = system.project(np.concatenate([extra, np.zeros((system.priors, extra.shape[1]))]))
    left = system.project(system.left(fit.values))
    sizes = np.maximum(np.linalg.norm(extra, axis=0), 1e-300)
    found, *_ = np.linalg.lstsq(extra / sizes, left, rcond=1e-6)
    if candidate.name in _OF_LAYERS and found.max() <= 0.0:
        return 0.0
    gain = float(left @ left - np.sum((left - extra / sizes @ found) ** 2))
    return gain / max(1.0, fit.reduced_chi2 if fit.is_mismatch else 1.0)


class _Linear:
    """A fit as a linear problem: samples and what is known, over their errors."""

    def __init__(self, model: RigModel, fit: Fit, without: Sequence[int] = ()) -> None:
        self._model = model
        self._position = np.concatenate([track.position for _, track in model.tracks()])
        self.kept, self.noise = _kept(model, fit), _noise_of(model, fit)
        self.others = np.delete(np.arange(fit.values.size), without)
        self._known = [place for place in self.others.tolist() if place in model.known]
        self.priors = len(self._known)
        rows = np.zeros((self.priors, fit.values.size))
        for row, place in zip(rows, self._known, strict=True):
            row[place] = 1.0 / model.known[place].error
        slopes = (model.jacobian(fit.values) / self.noise[:, None])[self.kept]
        design = np.concatenate([slopes, rows])[:, self.others]
        self._sizes = np.maximum(np.linalg.norm(design, axis=0), 1e-300)
        self._basis, self._triangle = np.linalg.qr(design / self._sizes)

    def left(self, values: Floats) -> Floats:
        """Weigh what a model with such values leaves."""
        known = self._model.known
        left = ((self._position - self._model.predict(values)) / self.noise)[self.kept]
        more = [(known[p].value - values[p]) / known[p].error for p in self._known]
        return np.concatenate([left, more])

    def project(self, left: Floats) -> Floats:
        """Take off what the parameters can explain."""
        return np.asarray(left - self._basis @ (self._basis.T @ left))

    def change(self, left: Floats) -> Floats:
        """Find by what change of the parameters they explain it."""
        found, *_ = np.linalg.lstsq(self._triangle, self._basis.T @ left, rcond=1e-12)
        return np.asarray(found / self._sizes)


def let_stick(model: RigModel, plates: Sequence[PlateFit], fit: Fit) -> tuple[RigModel, Fit]:
    """
    Let the layer stick, too, as far as the tracks allow.

    It sticks for no time unless that lowers chi squared by more than chance does; then all is
    fitted again from where its profile is lowest, and taken if it is better in truth.
    """
    if STICKING not in model.places:
        narrower = model
        model = replace(model, description=model.description.see(STICKING))
        fit = _widen(narrower, fit, model, plates)
    profile = _profile_sticking(model, fit)
    if profile is not None and profile.gain > _NOTICED:
        with contextlib.suppress(FitError):
            start = fit.values + profile.best
            found = model.fit(start, noise=_noise_of(model, fit), max_evaluations=_EVALUATIONS)
            if found.dof >= fit.dof and fit.chi2 - found.chi2 > _NOTICED:
                fit = model.fit(found.values).spanning(fit.alternatives)
                profile = _profile_sticking(model, fit)
    return model, _spread_sticking(model, fit, profile)


def _widen(model: RigModel, fit: Fit, wider: RigModel, plates: Sequence[PlateFit]) -> Fit:
    """Take a fit for one of a wider model, in which the layer might stick, but does not."""

    def widened(values: Floats) -> Floats:
        found = wider.start_from(replace(fit, values=values), plates)
        found[wider.places_of(STICKING)] = 0.0
        return found

    places = [wider.names.index(name) for name in model.names]
    covariance = np.zeros(2 * (len(wider.names),))
    covariance[np.ix_(places, places)] = fit.covariance
    return replace(
        fit,
        names=tuple(wider.names),
        values=widened(fit.values),
        covariance=covariance,
        known=wider.known,
        alternatives=tuple(e._replace(values=widened(e.values)) for e in fit.alternatives),
    )


class _Profile(NamedTuple):
    """How a fit changes with the time that a layer sticks, all else being adapted."""

    changes: Floats
    """Of all values, from those of the fit, shape (k, n)."""
    weights: Floats
    """Of these, shape (k,), whose sum is 1."""
    gain: float
    """By how much chi squared is lower than that of the fit, at its lowest, ..."""
    best: Floats
    """... and the change of the values that leads there."""


def _profile_sticking(model: RigModel, fit: Fit) -> _Profile | None:
    """Follow chi squared along the time that the layer sticks; None if that cannot be done."""
    places = model.places_of(STICKING)
    known = model.known.get(places[0])
    best, width = float(fit.values[places[0]]), known.error if known else START_OF_STICKING
    try:
        system = _Linear(model, fit, places)
        for _ in range(_PROFILE_ROUNDS):
            tried = best + width * np.append(_PROFILE, -best / width)
            times = np.unique(np.maximum(tried, 0.0))
            chi2, changes = [], []
            for time in times.tolist():
                moved = fit.values.copy()
                moved[places] = time
                left = system.left(moved)
                change = np.zeros_like(moved)
                change[places] = time - best
                change[system.others] = system.change(left)
                prior = ((time - known.value) / known.error) ** 2 if known else 0.0
                chi2.append(float(np.sum(system.project(left) ** 2)) + prior)
                changes.append(change)
            excess = (np.array(chi2) - min(chi2)) / max(fit.variance_scale, 1e-300)
            weights = np.exp(-0.5 * excess) * np.gradient(times)
            weights /= weights.sum()
            old, width = width, math.sqrt(float(weights @ (times - best) ** 2))
            if _SAME < width / old < 1.0 / _SAME:
                break
            width = max(
                width, _NARROWER * old
            )  # between two of the times that were tried it is blind
    except FitError:
        return None
    here = chi2[int(np.argmin(np.abs(times - best)))]
    return _Profile(
        np.array(changes),
        weights,
        (here - min(chi2)) / max(1.0, fit.reduced_chi2),
        changes[int(np.argmin(chi2))],
    )


def _spread_sticking(model: RigModel, fit: Fit, profile: _Profile | None) -> Fit:
    """Let the covariance span how long the layer may stick: as its profile tells, or the prior."""
    places = model.places_of(STICKING)
    covariance = fit.covariance.copy()
    own = covariance[np.ix_(places, places)] + 1e-300 * np.eye(len(places))
    covariance -= covariance[:, places] @ np.linalg.solve(own, covariance[places])
    if profile is not None:
        changes = profile.changes
        covariance += np.einsum('k,ki,kj->ij', profile.weights, changes, changes)
    else:
        for place in places:
            covariance[place, place] += model.known[place].error ** 2 if model.known else 0.0
    return replace(fit, covariance=covariance)


def profile_intervals(model: RigModel, fit: Fit) -> dict[str, tuple[float, float]]:
    """
    Find intervals of 95 % of what the covariance is no good for: what is hardly told apart.

    Along such a parameter chi squared is followed to where it is larger by 3.84, while all others
    are adapted, by steps of Gauss and Newton with the derivatives of the fit.
    """
    correlation = np.abs(fit.correlation)
    found = {}
    for name in LAYER:
        if name not in fit.names:
            continue
        place = fit.names.index(name)
        others = [fit.names.index(each) for each in LAYER if each in fit.names and each != name]
        if correlation[place, others].max(initial=0.0) > INSEPARABLE:
            with contextlib.suppress(FitError):
                system = _Linear(model, fit, [place])
                ends = [_end_of_interval(system, fit, place, sign) for sign in (-1.0, 1.0)]
                found[name] = (ends[0], ends[1])
    return found


def _end_of_interval(system: _Linear, fit: Fit, place: int, sign: float) -> float:
    """Find by halves where the profile of a parameter leaves the interval of 95 %."""
    lowest = float(np.sum(system.project(system.left(fit.values)) ** 2))
    limit = _CHI2_95 * max(1.0, fit.reduced_chi2)
    direction = fit.covariance[place] / fit.covariance[place, place]

    def is_inside(distance: float) -> bool:
        moved = fit.values + sign * distance * direction
        try:
            for _ in range(_NEWTON_STEPS):
                moved[system.others] += system.change(system.left(moved))
            return bool(np.sum(system.project(system.left(moved)) ** 2) - lowest < limit)
        except EffortError:
            raise
        except (FitError, ValueError):
            return False  # no rig is like that

    inside, outside = 0.0, _LONGEST * fit.errors[place]
    for _ in range(_HALVES):
        middle = 0.5 * (inside + outside)
        inside, outside = (middle, outside) if is_inside(middle) else (inside, middle)
    return float(fit.values[place] + sign * inside)


class LayerComparison(NamedTuple):
    """Kinds of layers side by side."""

    layers: list[LayerModel]
    other: tuple[Rig, Fit] | None = None
    """A layer of another material, if it alone explains the throws, and its fit."""


def compare_layers(model: RigModel, plates: Sequence[PlateFit], fit: Fit) -> LayerComparison:
    """Say how well each kind of layer explains the throws; none if that is not to be found out."""
    if not model.projectiles or not model.description.is_free('layer.wave_speed'):
        return LayerComparison([])
    noise = _noise_of(model, fit)
    seen = {name for name in _OF_LAYERS if name in model.places}
    simple, plain = model, fit
    found: list[tuple[LayerKind, float, bool]] = []
    others: dict[str, tuple[Rig, Fit]] = {}
    try:
        if seen:
            simple = replace(
                model,
                description=model.description.change(dict.fromkeys(_OF_LAYERS, '0')),
                rig=changed_rig(model.rig, {_OF_LAYERS[0]: 0.0}),
            )
            plain = simple.fit(
                simple.start_from(fit, plates), noise=noise, max_evaluations=_EVALUATIONS
            )
        for kind in _KINDS:
            chi2, is_fitted = plain.chi2, True
            if kind.material:
                other = _fit_material(simple, plain, noise, kind)
                if other is None:
                    continue
                chi2, others[kind.name] = other[1].chi2, other
            elif kind.terms and seen == set(kind.terms):
                chi2 = fit.chi2
            elif len(kind.terms) > 1:
                continue
            elif kind.terms:
                wider = simple.description.change(kind.terms)
                each = _try_term(simple, plates, plain, next(iter(kind.terms)), wider)
                chi2, is_fitted = chi2 - (_gain(simple, plain, each) if each else 0.0), False
            found.append((kind, chi2, is_fitted))
    except FitError:
        return LayerComparison([])  # it cannot be followed, or not in time
    samples = plain.dof + plain.values.size
    scale = max(1.0, min(chi2 for _, chi2, _ in found) / plain.dof)
    criteria = [chi2 / scale + len(kind.terms) * math.log(samples) for kind, chi2, _ in found]
    layers = [
        LayerModel(kind.name, chi2, plain.dof - len(kind.terms), each - min(criteria), fitted)
        for (kind, chi2, fitted), each in zip(found, criteria, strict=True)
    ]
    best, second, *_ = sorted(range(len(layers)), key=lambda k: layers[k].criterion)
    # Somebody who holds the stiffening knows that the layer is linear
    is_proven = layers[second].criterion > _PROVEN and 'layer.stiffening' in model.places
    return LayerComparison(layers, others.get(layers[best].name) if is_proven else None)


def _fit_material(
    model: RigModel, fit: Fit, noise: Floats, kind: LayerKind
) -> tuple[Rig, Fit] | None:
    """Fit a layer of another material; None if it is one, or cannot be followed in time."""
    layer = model.rig.layer
    if not layer.is_uniform or all(
        getattr(layer, name) == value for name, value in kind.material.items()
    ):
        return None
    rig = replace(model.rig, layer=replace(layer, **kind.material))  # type: ignore[arg-type]
    other = replace(model, rig=rig)
    start = fit.values.copy()
    start[model.places_of('layer.wave_speed')] = model.rig_of(start).layer.wave_speed
    if 'layer.stiffening' in model.places:  # which it has by itself
        start[model.places_of('layer.stiffening')] = 0.0
    tried: list[Fit] = []
    with contextlib.suppress(FitError):
        tried.append(other.fit(start, noise=noise, max_evaluations=_EVALUATIONS))
    if fit.is_mismatch and (not tried or tried[0].chi2 > fit.chi2):
        with contextlib.suppress(FitError):
            start = _start_layer(other, start, noise)
            tried.append(other.fit(start, noise=noise, max_evaluations=_EVALUATIONS))
    return (rig, min(tried, key=attrgetter('chi2'))) if tried else None


def describe_layers(layers: Sequence[LayerModel], fit: Fit) -> str:
    """Say in a sentence which layers explain the throws, and which do not."""
    ranked = sorted(layers, key=attrgetter('criterion'))
    good = [each for each in ranked if each.criterion < _STRONG]
    # Of the fewest parameters, and the first in the table among those
    best = max((each for each in layers if each in good), key=attrgetter('dof'))
    others = [each for each in ranked if each is not best]
    found = f'a layer {best.name} explains these throws' + ' best' * fit.is_mismatch
    found += f' (chi squared {best.chi2 / best.dof:.3g} per degree of freedom)'
    for verb, some in (
        # What only has more parameters is no other explanation
        ('does as well', [each for each in others if each in good and each.dof >= best.dof]),
        ('does not', [each for each in others if each.chi2 - best.chi2 > _PROVEN]),
    ):
        if some:
            listed = ' or one '.join(f'{each.name} ({each.chi2 / each.dof:.3g})' for each in some)
            found += f'; one {listed} {verb}'
    if fit.is_mismatch:
        off = max(fit.residuals, key=lambda residual: residual.reduced_chi2)
        found += '; none does well: most is left of {} from {:.4g} s to {:.4g} s'.format(
            off.name, *off.worst_part
        )
    return found


def _mode_of(model: RigModel, fit: Fit) -> Mode | None:
    """Find the second mode that explains most of what is left of the plates."""
    since, residuals = [], []
    for channel, residual in zip(model.channels, fit.residuals, strict=True):
        time = residual.track.time - model.value(fit.values, START, channel.throw)
        if channel.body == 'plate' and (time > 0.0).sum() >= FEWEST:
            since.append(time[time > 0.0])
            residuals.append((residual.values / residual.noise)[time > 0.0])
    return find_mode(since, residuals, model.rig.engine.frequency) if since else None


def _remark(added: _Candidate, before: Fit, fit: Fit) -> str:
    """Say what was added to a model, and how much better it is."""
    noise = np.concatenate([np.full(r.values.size, r.rms_noise) for r in fit.residuals])
    left = np.concatenate([residual.values for residual in before.residuals])
    if noise.size == left.size:
        worse = float(np.sum((left / noise) ** 2)) / before.dof
    else:  # other samples were left out
        worse = before.reduced_chi2
    parts = WAVES.get(added.name, (added.name,)) + MODE * (added.name == 'plate.mode')
    size = ', '.join(str(fit[name]) for name in fit.names if name.partition('[')[0] in parts)
    return (
        f'{_EXPLANATIONS[added.name]} (chi squared {fit.reduced_chi2:.2f} per degree of freedom); '
        f'without it they are not explained ({worse:.2f}). {added.name}: {size}'
    )


def _kept(model: RigModel, fit: Fit) -> NDArray[np.bool_]:
    """Tell which samples of all tracks are no outliers."""
    return np.concatenate(
        [
            np.isin(track.time, residual.track.time)
            for (_, track), residual in zip(model.tracks(), fit.residuals, strict=True)
        ]
    )


def _noise_of(model: RigModel, fit: Fit) -> Floats:
    """Return the noise of each sample of all tracks as a fit has it."""
    return np.concatenate(
        [
            np.interp(track.time, residual.track.time, residual.noise)
            for (_, track), residual in zip(model.tracks(), fit.residuals, strict=True)
        ]
    )
