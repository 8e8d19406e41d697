# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
r"""
Choice of the terms that a fit needs: a loss of the layer, or a plate that rings.

Notes
-----
A loss, or ringing of the plate, is fitted only if that lowers the Bayesian information criterion,
:math:`\chi^2 + k \ln n` for k parameters and n samples [1]_. A score test predicts the gain from
the residuals of the fit without the term, so that only useful terms are fitted.

References
----------
.. [1] R. E. Kass and A. E. Raftery, "Bayes factors", J. Am. Stat. Assoc. 90, 773 (1995).
   Differences beyond 6 count as strong.

"""

from __future__ import annotations

from dataclasses import replace
import math
from operator import attrgetter
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from soft_throw_ros.identification.layer_search import find_best_minimum
from soft_throw_ros.identification.least_squares import Estimate, Fit, FitError
from soft_throw_ros.identification.parameter_layout import value_names
from soft_throw_ros.identification.rig_model import RigModel

Floats = NDArray[np.float64]

_MAX_TERMS = 3  # largest number of added terms
_MIN_GAIN = 6.0  # smallest decrease of the criterion for which a term is added

_LOSS = 'layer.loss_tangent'
_INITIAL_LOSS = 0.05  # initial loss tangent of a fit with loss
_SCORE_STEPS = {_LOSS: 0.01}  # step of the score test of a term
_SCORE_STEP = 1e-3  # step of the score test of all other terms


class AddedTerm(NamedTuple):
    """A term that the tracks need."""

    name: str
    values: tuple[Estimate, ...]
    """Values of its parts, of all throws."""
    reduced_chi2: float
    """Chi squared per degree of freedom with the term. [-]"""
    reduced_chi2_before: float
    """Chi squared per degree of freedom without the term. [-]"""


class _Candidate(NamedTuple):
    """A model with one more term, and the decrease of the criterion to first order."""

    name: str
    model: RigModel
    gain: float


def add_terms(model: RigModel, fit: Fit) -> tuple[RigModel, Fit, list[AddedTerm]]:
    """Add the terms that the tracks need, one by one, the best first."""
    terms = []
    for _ in range(_MAX_TERMS):
        try:
            best = _best_term(model, fit)
            if best is None:
                break
            start = best.model.start(fit)
            if best.name == _LOSS:
                start = best.model.without_faults(start)
                start[best.model.layout.indices_of(_LOSS)] = _INITIAL_LOSS
            result = best.model.fit(start)
        except FitError:
            break  # the model with this term cannot be fitted
        if result.reduced_chi2 >= fit.reduced_chi2:
            break  # the fit ended in a worse minimum
        names = value_names(best.name)
        values = tuple(result[n] for n in result.names if n.partition('[')[0] in names)
        terms.append(AddedTerm(best.name, values, result.reduced_chi2, fit.reduced_chi2))
        model, fit = best.model, find_best_minimum(best.model, result)
    return model, fit, terms


def _best_term(model: RigModel, fit: Fit) -> _Candidate | None:
    """Return the term that lowers the criterion most, None if no term does so strongly."""
    # Waves that the tracks of the plates do not show must not explain a projectile
    names = [
        name
        for name in model.description.if_seen
        if name.startswith('plate') != bool(model.projectiles)
    ]
    if not names:
        return None
    best = max((_try_term(model, fit, name) for name in names), key=attrgetter('gain'))
    return best if best.gain > _MIN_GAIN else None


def _try_term(model: RigModel, fit: Fit, name: str) -> _Candidate:
    """Try a term beside a model."""
    wider = replace(model, description=model.description.activate(name))
    start = wider.start(fit)
    layout, trial = wider.layout, _SCORE_STEPS.get(name, _SCORE_STEP)
    names = value_names(name)
    start[[index for value_name in names for index in layout.indices_of(value_name)]] = 0.0
    base = wider.predict(start)
    columns = []
    for value_name in names:
        moved = start.copy()
        moved[layout.indices_of(value_name)] = trial
        change = (wider.predict(moved) - base) / trial
        for index in layout.indices_of(value_name):
            throws = [throw for throw, at in layout.indices[value_name].items() if at == index]
            columns.append(np.where(np.isin(wider.throw_of_sample, throws), change, 0.0))
    gain, result = predicted_gain(model, fit, np.stack(columns, axis=1))
    if name == _LOSS and result.max() <= 0.0:
        gain = 0.0
    if fit.is_mismatch:
        gain /= max(1.0, fit.reduced_chi2)
    return _Candidate(name, wider, gain - len(columns) * math.log(fit.dof + fit.values.size))


def predicted_gain(model: RigModel, fit: Fit, columns: Floats) -> tuple[float, Floats]:
    """
    Return the decrease of chi squared by further parameters, and their values, to first order.

    `columns` are the derivatives of all heights by these parameters, in any units. Their part that
    the fitted parameters explain is projected off, and so the others adapt.
    """
    known = fit.known
    priors = np.zeros((len(known), fit.values.size))
    deviations = np.zeros(len(known))
    for row, (index, prior) in enumerate(known.items()):
        priors[row, index] = 1.0 / prior.error
        deviations[row] = (prior.value - fit.values[index]) / prior.error

    def weigh(heights: Floats) -> Floats:
        return np.asarray((heights.T / fit.noise)[..., fit.kept].T)

    design = np.concatenate([weigh(model.jacobian(fit.values)), priors])
    basis, _ = np.linalg.qr(design / np.maximum(np.linalg.norm(design, axis=0), 1e-300))
    position = np.concatenate([track.position for _, track in model.tracks()])
    residuals = np.append(weigh(position - model.predict(fit.values)), deviations)
    residuals -= basis @ (basis.T @ residuals)
    extra = np.concatenate([weigh(columns), np.zeros((len(known), columns.shape[1]))])
    extra -= basis @ (basis.T @ extra)
    extra /= np.maximum(np.linalg.norm(extra, axis=0), 1e-300)
    result, *_ = np.linalg.lstsq(extra, residuals, rcond=1e-6)
    remainder = residuals - extra @ result
    return float(residuals @ residuals - remainder @ remainder), np.asarray(result)
