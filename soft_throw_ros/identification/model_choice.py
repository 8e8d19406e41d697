# SPDX-License-Identifier: Apache-2.0
r"""
Which of several minima, and which of several models, explains throws.

Notes
-----
Where a stiff layer makes the projectile chatter, chi squared has several minima. Wave speeds
beside the best one are looked at with all else adapted to first order, and other layers that the
search has found; each that may be as good is fitted. What is not worse by more than `NEAR` is
named.

What a bench may add and seldom does (a loss, a layer that sticks, a plate that rings) is fitted
only if it lowers chi squared by more than chance would. That is told from the residuals of the fit
without it, by what a change of it leaves beside all other derivatives (a score test), so that
nothing is fitted in vain. The limits are about those of the Bayesian information criterion for
1000 samples, with some more for what is searched over frequencies.

"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from soft_throw_ros.core.rig import Rig
from soft_throw_ros.identification.fit_description import changed_rig, LAYER, values_of
from soft_throw_ros.identification.forward import EffortError
from soft_throw_ros.identification.least_squares import Alternative, Fit, FitError
from soft_throw_ros.identification.plate_fit import PlateFit
from soft_throw_ros.identification.plate_modes import find_mode, Mode
from soft_throw_ros.identification.rig_model import RigModel, START, WAVES
from soft_throw_ros.identification.tracks import FEWEST

Floats = NDArray[np.float64]

NEAR = 9.0
"""By how much chi squared of another minimum may be larger for it to be named."""

_SCAN = np.linspace(-0.08, 0.08, 65)  # relative changes of the wave speed, to see other minima
_PROMISING = 60.0  # chi squared above the best from which a fit is still tried
_MOST_STARTS = 4  # of other minima, the most promising ones first, each with ...
_EVALUATIONS = 20  # of the model
_MOST_TERMS = 3  # that are added one after the other
_GAIN = 12.0  # of chi squared by which a term is seen, unless it is one of ...
_GAINS = {'plate.ringing': 16.0, 'plate.mode': 30.0, 'projectile.sticking': 6.0}
_POSITIVE = ('layer.loss_tangent', 'projectile.sticking')
_TRIALS = {  # values by which it is tried whether a term is seen
    'layer.loss_tangent': 0.01,
    'projectile.sticking': 2e-4,
    **dict.fromkeys([part for parts in WAVES.values() for part in parts], 1e-3),
}
_EXPLANATIONS = {
    'layer.loss_tangent': 'a layer with loss explains these throws',
    'projectile.sticking': 'a layer that sticks to the projectile explains these throws',
    'plate.ringing': 'a plate that rings before the throw explains these throws',
    'plate.mode': 'a plate with a second mode explains these throws',
}


def find_best_minimum(
    model: RigModel, plates: Sequence[PlateFit], fit: Fit, others: Sequence[Rig]
) -> Fit:
    """
    Try what else the layer may be: take what is better, and name what is hardly worse.

    Parameters
    ----------
    model : RigModel
    plates : sequence of PlateFit
        Of each throw.
    fit : Fit
        Of the model.
    others : sequence of Rig
        That the layer may be of.

    """
    if 'layer.wave_speed' not in model.places:
        return fit
    noise = _noise_of(model, fit)
    starts = _find_valleys(model, fit, noise)
    for rig in others:
        trial = replace(model, rig=changed_rig(model.rig, values_of(rig, LAYER)))
        starts.append(trial.start(plates))
    found = [fit]
    for start in starts[:_MOST_STARTS]:
        try:
            other = model.fit(start, noise=noise, max_evaluations=_EVALUATIONS)
        except EffortError:
            break
        except FitError:
            continue
        if all(np.abs((each.values - other.values) / other.errors).max() > 1.0 for each in found):
            found.append(other)
    found.sort(key=lambda each: each.chi2)
    best = fit if found[0] is fit else model.fit(found[0].values)
    excesses = [each.chi2 - found[0].chi2 for each in found]
    return best.spanning(
        [
            Alternative(each.values, excess)
            for each, excess in zip(found[1:], excesses[1:], strict=True)
            if excess < NEAR
        ]
    )


def _find_valleys(model: RigModel, fit: Fit, noise: Floats) -> list[Floats]:
    """Find wave speeds at which chi squared is lower than beside, all else being adapted."""
    places = model.places_of('layer.wave_speed')
    kept = _kept(model, fit)
    others = np.delete(np.arange(fit.values.size), places)
    priors = [place for place in others.tolist() if place in model.known]
    rows = np.zeros((len(priors), others.size))
    for row, place in zip(rows, priors, strict=True):
        row[others == place] = 1.0 / model.known[place].error
    slopes = (model.jacobian(fit.values) / noise[:, None])[kept][:, others]
    design = np.concatenate([slopes, rows])
    sizes = np.maximum(np.linalg.norm(design, axis=0), 1e-300)
    position = np.concatenate([track.position for _, track in model.tracks()])
    profile, values = [], []
    for part in _SCAN:
        moved = fit.values.copy()
        moved[places] *= 1.0 + part
        try:
            left = ((position - model.predict(moved)) / noise)[kept]
        except FitError:
            return []
        known = [(model.known[p].value - moved[p]) / model.known[p].error for p in priors]
        target = np.concatenate([left, np.array(known)])
        change, *_ = np.linalg.lstsq(design / sizes, target, rcond=None)
        profile.append(float(np.sum((target - design / sizes @ change) ** 2)))
        moved[others] += change / sizes
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
            tried = [_try_term(model, plates, fit, name) for name in model.description.if_seen]
            best, gain = None, 0.0
            for each in tried:
                if each is not None:
                    more = _gain(model, fit, each) - _GAINS.get(each.name, _GAIN)
                    best, gain = (each, more) if more > gain else (best, gain)
            if best is None:
                break
            found = best.model.fit(best.model.start_from(fit, plates))
        except EffortError as error:
            remarks.append(f'not all that may be on a bench was looked for: {error}')
            break
        except FitError:
            break  # what explains so much cannot be followed
        if found.reduced_chi2 >= fit.reduced_chi2:
            break  # it led elsewhere
        remarks.append(_remark(best, fit, found))
        model, fit = best.model, find_best_minimum(best.model, plates, found, [])
    return model, fit, remarks


def _try_term(
    model: RigModel, plates: Sequence[PlateFit], fit: Fit, name: str
) -> _Candidate | None:
    """Add a term to a model, and change it by a little; None if there is nothing to see it by."""
    if not name.startswith('plate') and not model.projectiles:
        return None
    wider = replace(model, description=model.description.see(name))
    if name == 'plate.mode':
        wider = replace(wider, mode=_mode_of(model, fit))
        if wider.mode is None:
            return None
    start = wider.start_from(fit, plates)
    parts = WAVES.get(name, (name,))
    start[[place for part in parts for place in wider.places_of(part)]] = 0.0
    base = wider.predict(start)
    rows = np.repeat(
        [channel.throw for channel in wider.channels],
        [channel.track.time.size for channel in wider.channels],
    )
    columns = []
    for part in parts:
        moved = start.copy()
        moved[wider.places_of(part)] = _TRIALS[part]
        change = (wider.predict(moved) - base) / _TRIALS[part]
        for place in wider.places_of(part):
            throws = [throw for throw, at in wider.places[part].items() if at == place]
            columns.append(np.where(np.isin(rows, throws), change, 0.0))
    return _Candidate(name, wider, np.stack(columns, axis=1))


def _gain(model: RigModel, fit: Fit, candidate: _Candidate) -> float:
    """By how much chi squared would fall, were the model linear in the term."""
    kept, noise = _kept(model, fit), _noise_of(model, fit)
    left = np.concatenate([residual.values / residual.noise for residual in fit.residuals])
    design = (model.jacobian(fit.values) / noise[:, None])[kept]
    extra = (candidate.columns / noise[:, None])[kept]
    basis, _ = np.linalg.qr(design / np.maximum(np.linalg.norm(design, axis=0), 1e-300))
    extra = extra - basis @ (basis.T @ extra)
    left = left - basis @ (basis.T @ left)
    sizes = np.maximum(np.linalg.norm(extra, axis=0), 1e-300)
    found, *_ = np.linalg.lstsq(extra / sizes, left, rcond=1e-6)
    if candidate.name in _POSITIVE and found.max() <= 0.0:
        return 0.0
    gain = float(left @ left - np.sum((left - extra / sizes @ found) ** 2))
    return gain / max(1.0, fit.reduced_chi2 if fit.is_mismatch else 1.0)


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
    parts = WAVES.get(added.name, (added.name,))
    size = ', '.join(str(fit[name]) for name in fit.names if name.partition('[')[0] in parts)
    mode = added.model.mode if added.name == 'plate.mode' else None
    return (
        f'{_EXPLANATIONS[added.name]} (chi squared {fit.reduced_chi2:.2f} per degree of freedom); '
        f'without it they are not explained ({worse:.2f}). {added.name}'
        + (f' at {mode.frequency:.4g} Hz' if mode else '')
        + f': {size}'
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
