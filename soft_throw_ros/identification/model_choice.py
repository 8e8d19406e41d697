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
Which of several models explains throws.

Notes
-----
What a bench may add and seldom does (a loss, a plate that rings) is fitted only if that lowers the
Bayesian information criterion, :math:`\chi^2 + k \ln n` for k parameters and n samples [1]_. That
is told from the residuals of the fit without it, by what a change of it leaves beside all other
derivatives (a score test), so that nothing is fitted in vain.

References
----------
.. [1] R. E. Kass and A. E. Raftery, "Bayes factors", J. Am. Stat. Assoc. 90, 773 (1995), who take
   differences beyond 6 for strong.

"""

from __future__ import annotations

from collections.abc import Sequence
import contextlib
from dataclasses import replace
import math
from operator import attrgetter
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from soft_throw_ros.core.rig import Rig
from soft_throw_ros.identification.fit_description import changed_rig, FitDescription, LAYER
from soft_throw_ros.identification.forward import EffortError
from soft_throw_ros.identification.least_squares import Fit, FitError
from soft_throw_ros.identification.linear_fit import LinearFit
from soft_throw_ros.identification.minima import find_best_minimum
from soft_throw_ros.identification.plate_fit import PlateFit
from soft_throw_ros.identification.plate_modes import find_modes, Mode
from soft_throw_ros.identification.rig_model import (
    MODE,
    OWN,
    PLATE_MODE,
    RigModel,
    START,
    START_OF_STICKING,
    STICKING,
    WAVES,
)
from soft_throw_ros.identification.tracks import FEWEST

Floats = NDArray[np.float64]

_EVALUATIONS = 20  # of the model, to compare kinds of layers
_SOFTER = (1.0, 0.85)  # wave speeds of other kinds of layers to start from, over the one found
_MOST_TERMS = 3  # that are added one after the other
_STRONG = 6.0  # by how much the criterion is lower where a term is seen
_PROVEN = 12.0  # by how much chi squared is larger of layers that do not explain throws
_MODE_SIZE = 4  # parameters of a second mode

_LOSS = 'layer.loss_tangent'
_OF_LAYERS = {_LOSS: 'free', STICKING: '+- 2e-4'}  # how they are treated where kinds are compared
_KINDS = {
    (): 'without loss',
    (_LOSS,): 'with loss',
    (STICKING,): 'that sticks',
    tuple(_OF_LAYERS): 'with loss that sticks',
}
_LARGE_STRAIN = 'of large strain'
_TRIED_FIRST = {_LOSS: 0.05, STICKING: START_OF_STICKING}
_TRIALS = {_LOSS: 0.01, STICKING: 2e-4}  # by which it is tried whether a term is seen, or ...
_TRIAL = 1e-3  # of waves
_EXPLANATIONS = {
    'plate.ringing': 'a plate that rings before the throw explains these throws',
    PLATE_MODE: 'a plate with a second mode explains these throws',
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


class _Candidate(NamedTuple):
    """A model with one more term, and by how much chi squared falls with it, to first order."""

    name: str
    model: RigModel
    gain: float
    size: int


def add_terms(
    model: RigModel, plates: Sequence[PlateFit], fit: Fit, *, but: str = ''
) -> tuple[RigModel, Fit, list[str]]:
    """
    Add what the tracks show to be needed, `but` for one, one after the other, the best first.

    Returns the model with it, its fit, and a sentence for each term.
    """
    remarks = []
    for _ in range(_MOST_TERMS):
        try:
            best = _best_term(model, plates, fit, but)
            if best is None:
                break
            start = best.model.start_from(fit, plates)
            if best.name in _OF_LAYERS and 'layer.wave_speed' in best.model.places:
                start = _start_layer(best.model, start, fit.noise)
            found = best.model.fit(start)
        except EffortError as error:
            remarks.append(f'not all that may be on a bench was looked for: {error}')
            break
        except FitError:
            break  # what explains so much cannot be followed
        if found.reduced_chi2 >= fit.reduced_chi2:
            break  # it led elsewhere
        if best.name in _EXPLANATIONS:
            remarks.append(_remark(best.name, fit, found))
        model, fit = best.model, find_best_minimum(best.model, found)
    return model, fit, remarks


def is_best_term(name: str, model: RigModel, plates: Sequence[PlateFit], fit: Fit) -> bool:
    """Tell whether this is what explains the tracks best, if anything is needed."""
    try:
        best = _best_term(model, plates, fit, '')
    except FitError:
        return False  # which is said where it is added
    return best is not None and best.name == name


def _best_term(
    model: RigModel, plates: Sequence[PlateFit], fit: Fit, but: str
) -> _Candidate | None:
    """Find the term that lowers the criterion most; None if none does so strongly."""
    names = [name for name in model.description.if_seen if name != but]
    if not names:
        return None
    best, most = None, _STRONG
    linear = LinearFit(model, fit)
    for name in names:
        each = _try_term(linear, plates, name, model.description.see(name))
        if each is not None and each.gain - _penalty(fit, each.size) > most:
            best, most = each, each.gain - _penalty(fit, each.size)
    return best


def criterion(fit: Fit) -> float:
    """Return the Bayesian information criterion of a fit."""
    return fit.chi2 + _penalty(fit, fit.values.size)


def _penalty(fit: Fit, parameters: int) -> float:
    """By how much more parameters raise the criterion."""
    return parameters * math.log(fit.dof + fit.values.size)


def _try_term(
    linear: LinearFit, plates: Sequence[PlateFit], name: str, description: FitDescription
) -> _Candidate | None:
    """Add a term to a model, and change it by a little; None if there is nothing to see it by."""
    if not name.startswith('plate') and not linear.model.projectiles:
        return None
    wider = replace(linear.model, description=description)
    if name != PLATE_MODE:
        return _try_model(linear, plates, name, wider)
    modes = likely_modes(linear.model, linear.fit)
    tried = [_try_model(linear, plates, name, replace(wider, mode=mode)) for mode in modes]
    return max(tried, key=attrgetter('gain'), default=None)


def _try_model(
    linear: LinearFit, plates: Sequence[PlateFit], name: str, wider: RigModel
) -> _Candidate:
    """Change a term of a wider model by a little."""
    fit = linear.fit
    start = wider.start_from(fit, plates)
    parts, trial = WAVES.get(name, (name,)), _TRIALS.get(name, _TRIAL)
    start[[place for part in parts for place in wider.places_of(part)]] = 0.0
    base = wider.predict(start)
    columns = []
    for part in parts:
        moved = start.copy()
        moved[wider.places_of(part)] = trial
        change = (wider.predict(moved) - base) / trial
        for place in wider.places_of(part):
            throws = [throw for throw, at in wider.places[part].items() if at == place]
            columns.append(np.where(np.isin(wider.rows, throws), change, 0.0))
    gain, found = linear.gain(np.stack(columns, axis=1))
    if name in _OF_LAYERS and found.max() <= 0.0:
        gain = 0.0
    if fit.is_mismatch:
        gain /= max(1.0, fit.reduced_chi2)
    return _Candidate(name, wider, gain, _MODE_SIZE if name == PLATE_MODE else len(columns))


def likely_modes(model: RigModel, fit: Fit) -> tuple[Mode, ...]:
    """Find second modes of plates by what a fit leaves of them, if that was not done before."""
    if model.likely_modes:
        return model.likely_modes
    since, residuals = [], []
    for channel, residual in zip(model.channels, fit.residuals, strict=True):
        time = residual.track.time - model.value(fit.values, START, channel.throw)
        if channel.body == 'plate' and (time > 0.0).sum() >= FEWEST:
            since.append(time[time > 0.0])
            residuals.append((residual.values / residual.noise)[time > 0.0])
    return find_modes(since, residuals, model.rig.engine.frequency)


def _start_layer(model: RigModel, values: Floats, noise: Floats) -> Floats:
    """Find where to start from with a layer of another kind: it alone is fitted first."""
    start = model.without_faults(values)
    for name, value in _TRIED_FIRST.items():
        if name in model.places:
            start[model.places_of(name)] = value
    best, least = start, math.inf
    for part in _SOFTER:
        moved = start.copy()
        moved[model.places_of('layer.wave_speed')] *= part
        with contextlib.suppress(FitError):
            found = model.fit(
                moved, noise=noise, only=(*LAYER, STICKING, *OWN), max_evaluations=_EVALUATIONS
            )
            if found.chi2 < least:
                moved[[model.names.index(name) for name in found.names]] = found.values
                best, least = moved, found.chi2
    return best


def _remark(name: str, before: Fit, fit: Fit) -> str:
    """Say what was added to a model, and how much better it is."""
    parts = WAVES[name] + MODE * (name == PLATE_MODE)
    size = ', '.join(str(fit[each]) for each in fit.names if each.partition('[')[0] in parts)
    return (
        f'{_EXPLANATIONS[name]} (chi squared {fit.reduced_chi2:.2f} per degree of freedom); '
        f'without it they are not explained ({before.reduced_chi2:.2f}). {name}: {size}'
    )


def compare_layers(
    model: RigModel, plates: Sequence[PlateFit], fit: Fit
) -> tuple[list[LayerModel], tuple[Rig, Fit] | None]:
    """
    Say how well each kind of layer explains the throws; none if that is not to be found out.

    Second comes a layer of large strain, if that alone explains the throws, and its fit.
    """
    if not model.projectiles or not model.description.is_free('layer.wave_speed'):
        return [], None
    seen = tuple(name for name in _OF_LAYERS if name in model.places)
    simple, plain = model, fit
    try:
        if seen:
            simple = replace(
                model,
                description=model.description.change(dict.fromkeys(_OF_LAYERS, '0')),
                rig=changed_rig(model.rig, {_LOSS: 0.0}),
            )
            plain = simple.fit(
                simple.start_from(fit, plates), noise=fit.noise, max_evaluations=_EVALUATIONS
            )
        found = [(_KINDS[()], plain.chi2, 0, True)]
        linear = LinearFit(simple, plain)
        for terms, name in list(_KINDS.items())[1:]:
            if terms == seen:
                found.append((name, fit.chi2, len(terms), True))
            elif len(terms) == 1:
                wider = simple.description.change({terms[0]: _OF_LAYERS[terms[0]]})
                each = _try_term(linear, plates, terms[0], wider)
                found.append((name, plain.chi2 - (each.gain if each else 0.0), 1, False))
        strained = _fit_large_strain(simple, plain, fit.noise)
    except FitError:
        return [], None  # it cannot be followed, or not in time
    if strained:
        found.append((_LARGE_STRAIN, strained[1].chi2, 0, True))
    scale = max(1.0, min(chi2 for _, chi2, *_ in found) / plain.dof)
    criteria = [chi2 / scale + _penalty(plain, size) for _, chi2, size, _ in found]
    layers = [
        LayerModel(name, chi2, plain.dof - size, each - min(criteria), is_fitted)
        for (name, chi2, size, is_fitted), each in zip(found, criteria, strict=True)
    ]
    best, second, *_ = sorted(layers, key=attrgetter('criterion'))
    # Somebody who holds the stiffening knows that the layer is linear
    is_proven = second.criterion > _PROVEN and 'layer.stiffening' in model.places
    return layers, strained if is_proven and best.name == _LARGE_STRAIN else None


def _fit_large_strain(model: RigModel, fit: Fit, noise: Floats) -> tuple[Rig, Fit] | None:
    """Fit a layer of large strain; None if it is one, or cannot be followed in time."""
    layer = model.rig.layer
    if not layer.is_uniform or layer.elasticity == 'neo_hookean':
        return None
    rig = replace(model.rig, layer=replace(layer, elasticity='neo_hookean'))
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
        start, end = off.worst_part
        found += f'; none does well: most is left of {off.name} from {start:.4g} s to {end:.4g} s'
    return found
