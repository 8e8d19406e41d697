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
What to measure next: which throws would narrow the parameters of a rig most, and by how much.

Notes
-----
With the Jacobian :math:`J` of the heights that a throw would show, and white noise of
:math:`\sigma`, the throw adds :math:`J^T J / \sigma^2` to the information about the parameters.
What each throw has for itself, its amplitude, its start and the heights from which its tracks
count, is eliminated. The inverse of the sum of the information of throws,
and of what is known beforehand, is the covariance that least squares reach, the bound of Cramer
and Rao. Wave speed, loss and engine are the same in all throws; a thickness belongs to one
layer, a mass to one projectile.

Throws are chosen one after the other, each such that the determinant of the covariance of what
is sought becomes smallest (D-optimal). That takes no scales, and a throw may be chosen again. The
error of :math:`\alpha` is that over points of one standard error along the axes of the
covariance, so that jumps of :math:`\alpha` are not taken for slopes.

"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from soft_throw_ros.core import checks
from soft_throw_ros.core.rig import Rig
from soft_throw_ros.core.throw import simulate
from soft_throw_ros.identification.fit_description import changed_rig, FitDescription, values_of
from soft_throw_ros.identification.forward import first_releases, ThrowSimulator
from soft_throw_ros.identification.least_squares import FitError
from soft_throw_ros.identification.rig_model import RigModel
from soft_throw_ros.identification.tracks import FEWEST, ThrowTracks, Track

Floats = NDArray[np.float64]

SOUGHT = ('layer.wave_speed', 'layer.thickness', 'layer.loss_tangent')
"""What throws are to narrow, as far as it is not known exactly."""

_CONDITIONS = ('projectile.mass', 'layer.thickness', 'engine.amplitude')
_WEAKLY_KNOWN = 1.0  # relative error with which all is known that is free, and ...
_WEAK_ERRORS = {'layer.loss_tangent': 0.3, 'engine.damping_ratio': 0.3}  # ... absolute
_LARGEST_STEP = 0.5  # of these, to see how alpha changes
_REST = 0.25  # plate periods before the start that are seen
_IN_FLIGHT = 0.97  # of the time until the landing that a fit looks at
_TARGET = 0  # number of the rig that alpha is wanted of, among the throws of the model


class Condition(NamedTuple):
    """A throw that can be made."""

    mass: float
    """Of the projectile. [kg]"""
    thickness: float
    """Of the layer. [m]"""
    amplitude: float
    """Of the plate. [m]"""

    @classmethod
    def of(cls, rig: Rig) -> Condition:
        """Return that of a rig."""
        return cls(*values_of(rig, _CONDITIONS).values())

    def values(self) -> dict[str, float]:
        """Return the values by the names of the rig."""
        return dict(zip(_CONDITIONS, self, strict=True))

    def describe(self, description: FitDescription) -> dict[str, str]:
        """Say how to treat them: alike for all that is alike, but for the amplitude."""
        texts = {}
        for name, value in self.values().items():
            treatment = description.treatment(name)
            text = f'{value:.12g}'
            if treatment.error is not None:
                error = treatment.error * (1e2 if treatment.is_relative else 1.0)
                text += f' +- {error:g}' + ' %' * treatment.is_relative
            elif treatment.is_varied:
                text += f' +- {1e2 * _WEAKLY_KNOWN:g} %'
            own = name == 'engine.amplitude' and treatment.is_varied
            texts[name] = text + ' per throw' * own
        return texts


@dataclass(frozen=True, kw_only=True)
class Sight:
    """How throws are seen."""

    rate: float = 5000.0
    """Samples per second of both tracks [Hz]."""
    noise: float = 2e-5
    """Standard deviation of heights [m]."""
    duration: float = 0.05
    """For how long after its start a throw is seen [s]."""

    def __post_init__(self) -> None:
        for name in ('rate', 'noise', 'duration'):
            checks.require_positive(name, getattr(self, name))


@dataclass(frozen=True, kw_only=True)
class Knowledge:
    """What is known of the parameters that all throws share."""

    names: tuple[str, ...]
    """Those of the rig; other thicknesses and masses than its own have their value in brackets."""
    information: Floats
    """Inverse of the covariance, shape (n, n)."""

    @property
    def covariance(self) -> Floats:
        """Covariance of the parameters."""
        scale = 1.0 / np.sqrt(np.diag(self.information))
        scaled = self.information * np.outer(scale, scale)
        return np.linalg.inv(scaled) * np.outer(scale, scale)

    def errors(self) -> dict[str, float]:
        """Return standard errors by names."""
        return dict(zip(self.names, np.sqrt(np.diag(self.covariance)).tolist(), strict=True))

    def after(self, information: Floats) -> Knowledge:
        """Add what a throw tells."""
        return Knowledge(names=self.names, information=self.information + information)

    @property
    def volume(self) -> float:
        """Logarithm of the determinant of the covariance of what is sought."""
        places = [k for k, name in enumerate(self.names) if name.partition('[')[0] in SOUGHT]
        return float(np.linalg.slogdet(self.covariance[np.ix_(places, places)])[1])


@dataclass(frozen=True, kw_only=True)
class PlannedThrow:
    """A throw, and what would be known after it."""

    condition: Condition
    errors: Mapping[str, float]
    """Standard errors of what all throws share, by the names of the rig."""
    energy_transfer_error: float
    """Standard error of alpha of the rig that the plan is for, over alpha [-]."""
    peak_strain: float
    """Of the layer in this throw [-]."""
    leaves_linear_range: bool
    """Whether that is more than the linear model takes."""


@dataclass(frozen=True)
class Planner:
    """
    Judges throws by what they would tell.

    Parameters
    ----------
    rig : Rig
        As it is thought to be; its layer and projectile are those that alpha is wanted of.
    conditions : sequence of Condition
        Throws that can be made.
    sight : Sight
    description : FitDescription
        What will be fitted, and with what error the rest is known. The loss is sought unless it
        is held.
    measured : Knowledge, optional
        What earlier throws have told, in the names of the rig; it has what was known before them
        in it.

    Raises
    ------
    FitError
        If there is no condition, nothing is sought, or a throw cannot be followed.

    """

    rig: Rig
    conditions: Sequence[Condition]
    sight: Sight
    description: FitDescription
    measured: Knowledge | None = None

    def __post_init__(self) -> None:
        if not self.conditions:
            raise FitError('there is no throw to choose from')
        if not any(self._described.treatment(name).is_varied for name in SOUGHT):
            raise FitError(f'nothing is sought: one of {", ".join(SOUGHT)} must be free')

    @cached_property
    def _described(self) -> FitDescription:
        return seeking_loss(self.description)

    @cached_property
    def _model(self) -> RigModel:
        """Take the rig, and then all throws that can be made, as if they were measured."""
        description, throws = self._described, []
        found = {}
        simulator = ThrowSimulator(throws=len(self.conditions) + 1)
        for number, condition in enumerate((Condition.of(self.rig), *self.conditions)):
            for name, text in condition.describe(self._described).items():
                try:
                    description = description.set_condition(str(number), name, text)
                except ValueError as error:
                    raise FitError(str(error)) from None
            throws.append(self._tracks(str(number), condition, simulator))
            found[number] = condition.values()
        return RigModel(tuple(throws), self.rig, description, simulator, found)

    def _tracks(self, name: str, condition: Condition, simulator: ThrowSimulator) -> ThrowTracks:
        """Make tracks that are seen when those of a throw would be."""
        try:
            rig = changed_rig(self.rig, condition.values())
        except ValueError as error:
            raise FitError(str(error)) from None
        duration = self.sight.duration
        time = np.arange(-_REST / rig.engine.frequency, duration, 1.0 / self.sight.rate)
        landing = simulator.landing_time(rig, duration)
        flying = time[time < _IN_FLIGHT * landing]
        if flying.size < FEWEST:
            raise FitError(f'{flying.size} samples of a throw, where {FEWEST} are needed')
        plate, projectile = (
            Track(time=each, position=np.zeros_like(each), known_noise=self.sight.noise)
            for each in (time, flying)
        )
        return ThrowTracks(name=name, plate=plate, projectile=projectile)

    @cached_property
    def _values(self) -> Floats:
        return self._model.start([])

    @cached_property
    def _shared(self) -> dict[str, int]:
        """Names of what throws share, and places among the values."""
        shared = {}
        for place, ((name, key), throws) in enumerate(self._model.groups.items()):
            if not isinstance(key, int):
                is_own = key is None or _TARGET in throws
                shared[name if is_own else f'{name}[{self._values[place]:.9g}]'] = place
        return shared

    @property
    def names(self) -> tuple[str, ...]:
        """Parameters that throws share."""
        return tuple(self._shared)

    @cached_property
    def information(self) -> tuple[Floats, ...]:
        """Return what each condition tells of them."""
        jacobian = self._model.jacobian(self._values) / self.sight.noise
        shared = list(self._shared.values())
        told = []
        for number in range(1, len(self.conditions) + 1):
            own = [
                place
                for place, ((_, key), throws) in enumerate(self._model.groups.items())
                if isinstance(key, int) and number in throws
            ]
            known = np.array([1.0 / self._model.known[p].error if p in self._model.known else 0.0
                              for p in own])
            seen = jacobian[self._model.rows == number]
            of_shared = np.concatenate([seen[:, shared], np.zeros((len(own), len(shared)))])
            basis, _ = np.linalg.qr(np.concatenate([seen[:, own], np.diag(known)]))
            left = of_shared - basis @ (basis.T @ of_shared)
            told.append(left.T @ left)
        return tuple(told)

    def start(self) -> Knowledge:
        """Say what is known before."""
        measured = self.measured.names if self.measured else ()
        errors = [
            self._model.known[place].error
            if place in self._model.known and name not in measured
            else self._weak_error(name)
            for name, place in self._shared.items()
        ]
        information = np.diag(np.array(errors) ** -2.0)
        if self.measured:
            kept = [number for number, name in enumerate(measured) if name in self._shared]
            here = [self.names.index(measured[number]) for number in kept]
            covariance = self.measured.covariance[np.ix_(kept, kept)]
            information[np.ix_(here, here)] += np.linalg.inv(covariance)
        return Knowledge(names=self.names, information=information)

    def judge(self, known: Knowledge) -> list[PlannedThrow]:
        """Say of each throw that can be made next what it would tell, the best one first."""
        return [self._planned(number, after) for number, after in self._ranked(known)]

    def choose(self, known: Knowledge) -> Iterator[PlannedThrow]:
        """Choose throws one after the other, without end."""
        while True:
            (best, known), *_ = self._ranked(known)
            yield self._planned(best, known)

    def _ranked(self, known: Knowledge) -> list[tuple[int, Knowledge]]:
        """Add what each throw tells, the best one first."""
        after = [(number, known.after(each)) for number, each in enumerate(self.information)]
        return sorted(after, key=lambda each: each[1].volume)

    def energy_transfer(self, known: Knowledge) -> tuple[float, float]:
        """Return alpha of the rig, and its standard error over alpha."""
        places = list(self._shared.values())
        # Where little is known yet, steps of an error would leave what rigs can be
        largest = np.array([self._weak_error(name) for name in self.names])
        powers, axes = np.linalg.eigh(known.covariance / np.outer(largest, largest))
        rigs = [self._model.rig_of(self._values, _TARGET)]
        for step in (np.sqrt(np.maximum(powers, 0.0)) * axes).T:
            for sign in (1.0, -1.0):
                changed = self._values.copy()
                changed[places] += sign * np.clip(step, -_LARGEST_STEP, _LARGEST_STEP) * largest
                # Neither loss nor damping becomes negative
                signed = [self._shared[name] for name in _WEAK_ERRORS if name in self._shared]
                changed[signed] = np.maximum(changed[signed], 0.0)
                rigs.append(self._model.rig_of(changed, _TARGET))
        alpha = first_releases(rigs).energy_transfer
        if not np.isfinite(alpha[0]):
            raise FitError('the projectile of the rig that is planned for does not leave')
        change = np.abs(np.nan_to_num(alpha[1:] / alpha[0] - 1.0, nan=1.0)).reshape(-1, 2)
        return float(alpha[0]), float(np.sqrt(np.sum(change.max(axis=1) ** 2)))

    def _weak_error(self, name: str) -> float:
        """Return an error that says next to nothing, of the size of what a parameter may be."""
        place = self._shared[name]
        value = _WEAKLY_KNOWN * abs(float(self._values[place]))
        known = self._model.known.get(place)
        return _WEAK_ERRORS.get(name, value or (known.error if known else 1.0))

    def _planned(self, number: int, known: Knowledge) -> PlannedThrow:
        """Say what is known after a throw."""
        condition = self.conditions[number]
        rig = changed_rig(self.rig, condition.values())
        model = 'finite_difference' if rig.layer.needs_cells else 'travelling_wave'
        throw = simulate(rig, model=model, until=self.sight.duration)
        return PlannedThrow(
            condition=condition,
            errors=known.errors(),
            energy_transfer_error=self.energy_transfer(known)[1],
            peak_strain=throw.peak_strain,
            leaves_linear_range=throw.leaves_linear_range,
        )


def seeking_loss(description: FitDescription) -> FitDescription:
    """Have the loss sought unless it is held."""
    loss = 'layer.loss_tangent'
    return description.see(loss) if loss in description.if_seen else description
