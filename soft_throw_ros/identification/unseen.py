# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
r"""
Effects that the tracks hardly show, as part of the errors of a fit.

Notes
-----
A projectile that sticks for 0.1 ms, a layer whose stress is no linear function of the strain, or
a second mode of the plate change the release by more than the tracks show. They are not fitted.
Each is a column :math:`C_k` of changes of all heights for one standard deviation of its prior.
Least squares with the gain :math:`G = (J^T W J)^{-1} J^T W` are then off by :math:`G C_k`, which
the covariance of the fit gets as :math:`G C_k C_k^T G^T` (as "consider" parameters of a Kalman
filter [1]_). The error of the time and speed of the release is the change due to the shifted
parameters, minus the effect itself.

The size of an effect is the root mean square of its posterior: an effect that the tracks would
show, and do not, is small, and one that the residuals show keeps its size.

References
----------
.. [1] S. F. Schmidt, "Application of state-space methods to navigation problems", Advances in
   Control Systems 3, 293 (1966).

"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
import math
from typing import Any, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import special
from soft_throw_ros.core.rig import Rig
from soft_throw_ros.core.stepper import Event
from soft_throw_ros.core.throw import ejections
from soft_throw_ros.identification.fit_description import PLATE_MODE, RELEASE_DELAY
from soft_throw_ros.identification.least_squares import Fit
from soft_throw_ros.identification.linear_fit import LinearFit
from soft_throw_ros.identification.parameter_layout import RINGING, RINGING_AMPLITUDES
from soft_throw_ros.identification.plate_waves import Mode, PlateWithWaves
from soft_throw_ros.identification.rig_model import Change, RigModel

Floats = NDArray[np.float64]

STRESS_LAW = 'layer.stress_strain_law'
"""Name of the effect of a law that a linear layer with another wave speed does not follow."""

ROUNDING = 'rounding'
"""Name of the effect of heights that are rounded while a body hardly moves."""

_MODE_FREQUENCIES = np.linspace(2.75, 7.25, 19)
"""Possible frequencies of a second mode, over the frequency of the plate. [-]"""

_MODE_DAMPING = 0.02
"""Damping ratio of a second mode, typical of metal structures. [-]"""

_RINGING = 0.02
"""Default size of ringing with another damping than the plate, over the amplitude. [-]"""

_RINGING_MARGIN = 2.0
"""Factor on the effect of undamped ringing, since its true damping is not known. [-]"""

_LAST_RELEASE = 3.0
"""Time until which a projectile is released. [periods of the plate]"""

_JERK_STEP = 0.05
"""Part of the ejection time before the release over which the contact force vanishes. [-]"""

_SPEED_STEP = 0.01
"""Relative step of the wave speed for the derivative of the release. [-]"""

_MIN_RUN = 3
"""Number of consecutive equal heights from which on rounding errors are correlated."""

Presence = Literal['all', 'one pair', 'any pair']
"""Causes of an effect that exist: all, one pair of neighbours, or any number of pairs."""


class UnseenEffect(NamedTuple):
    """Changes by one standard deviation of each of k independent causes."""

    name: str
    heights: Floats
    """Changes of all samples of all tracks, shape (k, n). [m]"""
    time: Floats
    """Changes of the ejection time of the first throw, shape (k,). [s]"""
    speed: Floats
    """Changes of the ejection speed, shape (k,). [m/s]"""
    presence: Presence = 'all'
    """Causes that exist; before the fit, `any pair` exists with a probability of 50 %."""
    margin: float = 1.0
    """Factor on the sizes of an effect whose shape is known roughly only. [-]"""
    is_linear: bool = True
    """Whether shifts of the fitted values cancel parts of the change of the release."""

    def changes(self, random: np.random.Generator, causes: Floats) -> Floats:
        """Return changes of time and speed of the release, shape (m, 2), from shape (m, k)."""
        if not self.is_linear:
            causes = random.permutation(causes)
        return causes @ np.column_stack([self.time, self.speed])

    def scaled(self, seen: Floats, products: Floats) -> UnseenEffect:
        """Return the effect with the sizes after a fit, see `sizes`."""
        sizes = self.sizes(seen, products)
        return self._replace(
            heights=sizes[:, None] * self.heights,
            time=sizes * self.time,
            speed=sizes * self.speed,
        )

    def sizes(self, seen: Floats, products: Floats) -> Floats:
        """
        Return the sizes after a fit, over those before.

        Parameters
        ----------
        seen, products : ndarray, shape (k,)
            See `LinearFit.score`.

        """
        precision = 1.0 + seen
        best = products / precision
        squares = 1.0 / precision + best**2
        if self.presence != 'all':
            evidence = 0.5 * (best**2 * precision - np.log(precision))
            pairs = evidence.reshape(-1, 2).sum(axis=1)  # logarithms of Bayes factors
            weigh = special.softmax if self.presence == 'one pair' else special.expit
            squares *= np.repeat(weigh(pairs), 2)
        return np.asarray(self.margin * np.sqrt(squares))


def release_shift(model: RigModel, values: Floats) -> Floats:
    """Return the effect of waves of the plate on time and speed of the release, first throw."""
    rig, motion = model.motion(values, 0)
    plain = _release(model, rig, PlateWithWaves(motion.step))
    return _difference(_release(model, rig, motion, near=plain), plain)


def unseen_effects(
    model: RigModel, values: Floats
) -> tuple[list[UnseenEffect], dict[str, str]]:
    """
    Compute the effects that the description of a fit leaves open, at the values of the fit.

    Second come the reasons why throws with an effect cannot be simulated, by its name.
    """
    makers: dict[str, Callable[[], UnseenEffect]] = {}
    size = model.description.treatment(PLATE_MODE).error
    if size is not None:
        makers[PLATE_MODE] = partial(
            _of_changes, PLATE_MODE, model, values, _modes(size), presence='one pair'
        )
    is_fitted = RINGING_AMPLITUDES[0] in model.layout
    size = model.description.treatment(RINGING).error or (_RINGING if is_fitted else None)
    if size is not None:
        makers[RINGING] = partial(
            _ringing, model, values, size, presence='all' if is_fitted else 'any pair'
        )
    if model.projectiles:
        size = model.description.treatment(RELEASE_DELAY).error
        if size is not None:
            makers[RELEASE_DELAY] = partial(_sticking, model, values, size)
        if 'layer.stiffening' in model.layout:
            makers[STRESS_LAW] = partial(_stress_law, model, values)
    if any(item.track.rounding_step for item in model.series):
        makers[ROUNDING] = partial(_rounding, model)
    effects: list[UnseenEffect] = []
    skipped: dict[str, str] = {}
    for name, make in makers.items():
        try:
            effects.append(make())
        except ValueError as error:
            skipped[name] = str(error)
    return effects, skipped


def add_unseen(
    model: RigModel, fit: Fit
) -> tuple[Fit, list[UnseenEffect], dict[str, str]]:
    """Add unseen effects to the covariance of a fit; see `unseen_effects`."""
    linear = LinearFit(model, fit)
    effects, skipped = unseen_effects(model, fit.values)
    shifts = {}
    for index, effect in enumerate(effects):
        if effect.name != ROUNDING:  # noise of rounded heights does not show their errors
            effects[index] = effect.scaled(*linear.score(effect.heights))
        shifts[effect.name] = linear.shifts(effects[index].heights)
    return fit.with_unseen(shifts), effects, skipped


def _of_changes(
    name: str,
    model: RigModel,
    values: Floats,
    changes: Sequence[Change],
    *,
    base: Change = lambda rig, motion: (rig, motion),
    presence: Presence = 'all',
) -> UnseenEffect:
    """Return the effects of changes of the motion of the plate, each beside a base."""
    heights = model.predict(values, base)
    rig, motion = base(*model.motion(values, 0))
    plain = _release(model, rig, motion)
    moved = [
        _difference(_release(model, *change(rig, motion), near=plain), plain)
        for change in changes
    ]
    columns = [model.predict(values, change) - heights for change in changes]
    time, speed = np.array(moved).T
    return UnseenEffect(name, np.array(columns), time, speed, presence)


def _modes(size: float) -> list[Change]:
    """Return changes that add a second mode of the plate, by frequency and phase."""

    def with_mode(rig: Rig, motion: PlateWithWaves, mode: Mode) -> tuple[Rig, PlateWithWaves]:
        frequency = mode.frequency * rig.engine.frequency
        return rig, motion._replace(mode=mode._replace(frequency=frequency))

    return [
        partial(with_mode, mode=Mode(frequency, _MODE_DAMPING, *sizes))
        for frequency in _MODE_FREQUENCIES.tolist()
        for sizes in ((size, 0.0), (0.0, size))
    ]


def _ringing(model: RigModel, values: Floats, size: float, presence: Presence) -> UnseenEffect:
    """
    Return the effects of ringing without damping, a pair for each throw.

    So rings a plate that its drive damps during a throw only.
    """
    changes = [
        _with_waves(ringing=amplitudes, ringing_damping=0.0)
        for amplitudes in ((size, 0.0), (0.0, size))
    ]
    base = _with_waves(ringing=(0.0, 0.0))
    effect = _of_changes(RINGING, model, values, changes, base=base, presence=presence)
    throws = np.arange(len(model.throws))[:, None]
    own = (model.throw_of_sample == throws)[:, None, :]
    is_first = np.repeat(throws[:, 0] == 0, 2)
    return effect._replace(
        heights=(own * effect.heights).reshape(-1, effect.heights.shape[1]),
        time=is_first * np.tile(effect.time, throws.size),
        speed=is_first * np.tile(effect.speed, throws.size),
        margin=_RINGING_MARGIN,
    )


def _with_waves(**waves: Any) -> Change:
    """Return a change that replaces some of the waves of the plate."""
    return lambda rig, motion: (rig, motion._replace(**waves))


def _sticking(model: RigModel, values: Floats, duration: float) -> UnseenEffect:
    """Return the effect of a layer that holds the projectile for a while at its release."""
    columns = []
    for throw, body, track in model.series:
        column = np.zeros(track.time.size)
        rig, motion = model.motion(values, throw)
        releases = ejections(_events(model, rig, motion))
        if body == 'projectile' and releases:
            jerk = _jerk(model, rig, motion, releases[-1])
            after = model.since(values, throw, body, track.time) - releases[-1].time
            held = np.clip(after, 0.0, duration)
            free = np.maximum(after - duration, 0.0)
            column = jerk * (held**3 / 6.0 + 0.5 * duration**2 * free)
        columns.append(column)
    rig, motion = model.motion(values, 0)
    release = _release(model, rig, motion)
    jerk = _jerk(model, rig, motion, release) if release else 0.0
    return UnseenEffect(
        RELEASE_DELAY,
        np.concatenate(columns)[None, :],
        np.array([duration if release else 0.0]),
        np.array([0.5 * jerk * duration**2]),
        is_linear=False,  # it is quadratic in the duration
    )


def _stress_law(model: RigModel, values: Floats) -> UnseenEffect:
    """
    Return the effect of a layer that follows the neo-Hookean law.

    The part that another wave speed of a linear layer explains is left out: it belongs to
    `layer.stiffening`.
    """

    def with_law(law: str) -> Change:
        def change(rig: Rig, motion: PlateWithWaves) -> tuple[Rig, PlateWithWaves]:
            return replace(rig, layer=replace(rig.layer, stress_strain_law=law)), motion

        return change

    ends, releases = [], []
    rig, motion = model.motion(values, 0)
    cells = replace(model, needs_cells=True)
    for law in ('linear', 'neo_hookean'):
        ends.append(cells.predict(values, with_law(law)))
        releases.append(_release(cells, *with_law(law)(rig, motion)))
    column = ends[1] - ends[0]
    moved = _difference(releases[1], releases[0])
    if 'layer.wave_speed' in model.layout:
        faster = values.copy()
        faster[model.layout.indices_of('layer.wave_speed')] *= 1.0 + _SPEED_STEP
        slope = model.predict(faster) - model.predict(values)
        noise = np.concatenate([np.full(t.time.size, t.noise) for _, t in model.tracks()])
        weighted = slope / noise**2
        change = float(weighted @ column) / max(float(weighted @ slope), 1e-300)
        column = column - change * slope
        plain = _release(model, rig, motion)
        quicker = _release(model, *model.motion(faster, 0), near=plain)
        moved = moved - change * _difference(quicker, plain)
    return UnseenEffect(STRESS_LAW, column[None, :], moved[:1], moved[1:])


def _events(model: RigModel, rig: Rig, motion: PlateWithWaves) -> tuple[Event, ...]:
    """Return the events of the first few periods of the plate."""
    end = np.array([_LAST_RELEASE / rig.engine.frequency])
    return model.simulator.follow(rig, end, motion=motion, by_cells=model.by_cells).events


def _release(
    model: RigModel, rig: Rig, motion: PlateWithWaves, *, near: Event | None = None
) -> Event | None:
    """
    Return the release nearest to another one, by default to the release without waves, or None.

    Waves of the plate may release the projectile briefly, long before the throw.
    """
    if near is None:
        step = PlateWithWaves(motion.step)
        near = next(iter(ejections(_events(model, rig, step))), None)
    if near is None:
        return None
    time = near.time
    releases = [event for event in _events(model, rig, motion) if event.kind == 'release']
    return min(releases, key=lambda event: abs(event.time - time), default=None)


def _difference(release: Event | None, plain: Event | None) -> Floats:
    """Return the differences of time [s] and speed [m/s] of two releases; 0 if one is None."""
    if release is None or plain is None:
        return np.zeros(2)
    return np.array([release.time - plain.time, release.velocity - plain.velocity])


def _jerk(model: RigModel, rig: Rig, motion: PlateWithWaves, release: Event) -> float:
    """Return the rate at which the contact force over the mass falls at a release [m/s3]."""
    since = _JERK_STEP * release.time
    before = np.array([release.time - since])
    path = model.simulator.follow(rig, before, motion=motion, by_cells=model.by_cells)
    return float(
        2.0 * (path.velocity[0] - release.velocity - rig.gravity * since) / max(since, 1e-12)**2
    )


def _rounding(model: RigModel) -> UnseenEffect:
    """Return the effect of rounding on runs of equal heights, each of which shares one error."""
    columns = [np.zeros((0, model.throw_of_sample.size))]
    first = 0
    for _, _, track in model.series:
        starts = np.flatnonzero(np.diff(track.position, prepend=np.nan) != 0.0)
        sizes = np.diff(starts, append=track.time.size)
        if track.rounding_step > 0.0:
            for start, size in zip(starts.tolist(), sizes.tolist(), strict=True):
                if size >= _MIN_RUN:
                    column = np.zeros((1, model.throw_of_sample.size))
                    run = slice(first + start, first + start + size)
                    column[0, run] = track.rounding_step / math.sqrt(12.0)
                    columns.append(column)
        first += track.time.size
    heights = np.concatenate(columns)
    return UnseenEffect(ROUNDING, heights, np.zeros(len(heights)), np.zeros(len(heights)))
