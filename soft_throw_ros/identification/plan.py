# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
r"""
Ranking of possible next throws by the errors of a rig that would remain after them.

Notes
-----
With the Jacobian :math:`J` of the heights that a throw would show, and white noise of
:math:`\sigma`, the throw adds :math:`J^T J / \sigma^2` to the information about the parameters.
The parameters of single throws (amplitude, start and zeros of the heights) are eliminated. The
inverse of the information of all throws and priors is the Cramer-Rao bound, which least squares
reach. Wave speed, loss and engine are the same in all throws; a thickness belongs to one
layer, a mass to one projectile.

Throws are chosen one by one. Each choice minimises the determinant of the covariance of the sought
parameters (D-optimal), which needs no scales; a throw may be chosen again. The error of
:math:`\alpha` is the spread over rigs drawn from the covariance, as in a fit, so that jumps of
:math:`\alpha` do not count as slopes.

"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from soft_throw_ros.core import checks
from soft_throw_ros.core.rig import Rig
from soft_throw_ros.core.throw import simulate
from soft_throw_ros.identification.fit_description import (
    changed_rig,
    FitDescription,
    LAYER,
    ParameterRole,
    PARAMETERS,
    ThrowConditions,
    Treatment,
    values_of,
)
from soft_throw_ros.identification.forward import first_releases, ThrowSimulator
from soft_throw_ros.identification.least_squares import FitError
from soft_throw_ros.identification.rig_fit import draw_normal, RigFit
from soft_throw_ros.identification.rig_model import IN_FLIGHT, RigModel
from soft_throw_ros.identification.tracks import FEWEST, ThrowTracks, Track
from soft_throw_ros.identification.unseen import ROUNDING, unseen_effects, UnseenEffect

Floats = NDArray[np.float64]

_CONDITIONS = ('projectile.mass', 'layer.thickness', 'engine.amplitude')
_WEAKLY_KNOWN = 1.0  # relative error of the weak prior of free parameters
_WEAK_ERRORS = {'layer.loss_tangent': 0.3, 'engine.damping_ratio': 0.3}  # absolute errors instead
_LARGEST_STEP = 0.5  # largest step of the derivatives of alpha, over these errors

_DRAWS = 2000
"""Number of drawn rigs for the error of alpha, whose own sampling error is then 1.6 %. [-]"""

_REST = 0.25  # length of the record before the start [plate periods]
_TARGET = 0  # index of the rig for alpha among the throws of the model


class Condition(NamedTuple):
    """A possible throw."""

    mass: float
    """Mass of the projectile. [kg]"""
    thickness: float
    """Thickness of the layer. [m]"""
    amplitude: float
    """Amplitude of the plate. [m]"""

    @classmethod
    def of(cls, rig: Rig) -> Condition:
        """Return the throw of a rig."""
        return cls(*values_of(rig, _CONDITIONS).values())

    def values(self) -> dict[str, float]:
        """Return the values by the names of the rig."""
        return dict(zip(_CONDITIONS, self, strict=True))

    def treatments(self, description: FitDescription) -> dict[str, Treatment]:
        """Return the treatments of a description, with the values of this throw."""
        treatments = {}
        for name, value in self.values().items():
            treatment = description.treatment(name)
            if description.is_free(name):
                treatment = Treatment(ParameterRole.PRIOR, error=_WEAKLY_KNOWN, is_relative=True)
            own = name == 'engine.amplitude' and treatment.is_varied
            treatments[name] = treatment._replace(value=value, is_per_throw=own)
        return treatments


@dataclass(frozen=True, kw_only=True)
class MeasurementSetup:
    """Sensors of the planned throws."""

    rate: float = 5000.0
    """Samples per second of both tracks [Hz]."""
    noise: float = 2e-5
    """Standard deviation of heights [m]."""
    duration: float = 0.05
    """Time from the start of a throw to the end of its measurement [s]."""

    def __post_init__(self) -> None:
        for name in ('rate', 'noise', 'duration'):
            checks.require_positive(name, getattr(self, name))


@dataclass(frozen=True, kw_only=True)
class ParameterInformation:
    """Information about the parameters that all throws share, and about k unseen causes."""

    names: tuple[str, ...]
    """Names of n parameters; thicknesses and masses unlike the rig's have values in brackets."""
    information: Floats
    """
    Information about the parameters and the causes, as if causes were parameters without a prior.

    Its shape is (n + k, n + k).
    """
    effects: tuple[UnseenEffect, ...] = ()
    """Unseen effects, in the order of their causes."""

    @classmethod
    def of_fit(cls, result: RigFit) -> ParameterInformation:
        """Return the information of earlier throws from their fit, including all priors."""
        names = tuple(name for name in result.fit.names if '[' not in name)
        indices = [result.fit.names.index(name) for name in names]
        # Rounding has many causes, of which none changes a release
        effects = tuple(
            effect._replace(presence='all', margin=1.0)
            for effect in result.effects
            if effect.name != ROUNDING
        )
        shifts = np.concatenate([
            np.zeros((0, len(names))),
            *(result.fit.unseen[effect.name][:, indices] for effect in effects),
        ])
        seen = result.fit.covariance[np.ix_(indices, indices)] - shifts.T @ shifts
        return cls(names=names, information=_information(seen, shifts), effects=effects)

    @cached_property
    def seen(self) -> tuple[Floats, Floats]:
        """Covariance without the effects, (n, n), and shifts by causes of size 1, (k, n)."""
        count = len(self.names)
        seen = _inverse(self.information[:count, :count])
        return seen, self.information[count:, :count] @ seen

    @cached_property
    def covariance(self) -> Floats:
        """Covariance of parameters and causes; the causes are independent, as in a fit."""
        count = len(self.names)
        seen, shifts = self.seen
        squares = np.diag(self.information)[count:]
        squares = squares - np.sum(shifts * self.information[count:, :count], axis=1)
        sizes, first = np.ones(len(shifts)), 0
        for effect in self.effects:
            causes = slice(first, first + effect.time.size)
            sizes[causes] = effect.sizes(squares[causes].clip(0.0), np.zeros(effect.time.size))
            first = causes.stop
        # A cause shifts the fitted values, so that their errors have the other sign
        combined = np.vstack([-shifts.T, np.eye(len(sizes))]) * sizes
        covariance = combined @ combined.T
        covariance[:count, :count] += seen
        return np.asarray(covariance)

    def errors(self) -> dict[str, float]:
        """Return standard errors by names."""
        return dict(zip(self.names, np.sqrt(np.diag(self.covariance)).tolist(), strict=False))

    def after(self, information: Floats) -> ParameterInformation:
        """Add the information of a throw."""
        return replace(self, information=self.information + information)

    @property
    def log_det_covariance(self) -> float:
        """Logarithm of the determinant of the covariance of the sought parameters."""
        sought = [k for k, name in enumerate(self.names) if name.partition('[')[0] in LAYER]
        return float(np.linalg.slogdet(self.covariance[np.ix_(sought, sought)])[1])


def _information(seen: Floats, shifts: Floats) -> Floats:
    """Return the information of a covariance (n, n) and of shifts by causes (k, n)."""
    combined = np.vstack([np.eye(len(seen)), shifts])
    return np.asarray(combined @ _inverse(seen) @ combined.T)


def _inverse(matrix: Floats) -> Floats:
    """Invert a positive matrix whose rows have different units."""
    scale = 1.0 / np.sqrt(np.diag(matrix))
    units = np.outer(scale, scale)
    return np.asarray(np.linalg.inv(matrix * units) * units)


@dataclass(frozen=True, kw_only=True)
class PlannedThrow:
    """A throw, and the errors after it."""

    condition: Condition
    errors: Mapping[str, float]
    """Standard errors of the shared parameters, by the names of the rig."""
    energy_transfer_error: float
    """Relative standard error of alpha of the planned rig [-]."""
    peak_strain: float
    """Largest strain of the layer in this throw [-]."""
    leaves_linear_range: bool
    """Whether this strain is beyond the range of the linear model."""


@dataclass(frozen=True)
class Planner:
    """
    Rank throws by the errors that would remain after them.

    Raises
    ------
    FitError
        If there is no condition, nothing is sought, or a throw cannot be followed.

    """

    rig: Rig
    """The assumed rig; alpha refers to its layer and projectile."""
    conditions: Sequence[Condition]
    """Possible throws."""
    setup: MeasurementSetup
    description: FitDescription
    """Free parameters and priors of the fit. The loss is sought unless it is held."""
    measured: ParameterInformation | None = None
    """Information from earlier throws, in the names of the rig, including all priors."""

    def __post_init__(self) -> None:
        if not self.conditions:
            raise FitError('there is no throw to choose from')
        if not any(self.description.treatment(name).is_varied for name in LAYER):
            raise FitError(f'nothing is sought: one of {", ".join(LAYER)} must be free')

    @cached_property
    def _model(self) -> RigModel:
        """Return a model of the rig and of all possible throws, as if they were measured."""
        simulator = ThrowSimulator()
        conditions = {
            str(number): condition
            for number, condition in enumerate((Condition.of(self.rig), *self.conditions))
        }
        throws = [
            self._tracks(name, condition, simulator) for name, condition in conditions.items()
        ]
        description = replace(self.description, throws={
            name: ThrowConditions(condition.treatments(self.description), {})
            for name, condition in conditions.items()
        })
        return RigModel(tuple(throws), self.rig, description, simulator)

    def _tracks(self, name: str, condition: Condition, simulator: ThrowSimulator) -> ThrowTracks:
        """Return empty tracks at the times at which a throw would be seen."""
        try:
            rig = changed_rig(self.rig, condition.values())
        except ValueError as error:
            raise FitError(str(error)) from None
        duration = self.setup.duration
        time = np.arange(-_REST / rig.engine.frequency, duration, 1.0 / self.setup.rate)
        landing = simulator.landing_time(rig, duration)
        flying = time[time < IN_FLIGHT * landing]
        if flying.size < FEWEST:
            raise FitError(f'{flying.size} samples of a throw, where {FEWEST} are needed')
        plate, projectile = (
            Track(time=item, position=np.zeros_like(item), known_noise=self.setup.noise)
            for item in (time, flying)
        )
        return ThrowTracks(name=name, plate=plate, projectile=projectile)

    @cached_property
    def _values(self) -> Floats:
        return self._model.start()

    @cached_property
    def _shared(self) -> dict[str, int]:
        """Names of shared parameters, and their indices among the values."""
        shared = {}
        for index, ((name, key), throws) in enumerate(self._model.layout.groups.items()):
            if not isinstance(key, int):
                is_own = key is None or _TARGET in throws
                shared[name if is_own else f'{name}[{self._values[index]:.9g}]'] = index
        return shared

    @property
    def names(self) -> tuple[str, ...]:
        """Parameters that throws share."""
        return tuple(self._shared)

    @cached_property
    def _effects(self) -> tuple[UnseenEffect, ...]:
        """
        Unseen effects of the throws; with a fit, those of its throws, which more reduce.

        Effects that only the residuals of measured throws can show are left out.
        """
        if self.measured:
            return self.measured.effects
        effects, _ = unseen_effects(self._model, self._values)
        return tuple(effect for effect in effects if effect.presence != 'any pair')

    @cached_property
    def information(self) -> tuple[Floats, ...]:
        """Information of each throw about the shared parameters and the unseen causes."""
        columns = self._model.jacobian(self._values)
        shared = columns[:, list(self._shared.values())]
        causes = [effect.heights.T for effect in self._effects]
        if self.measured:
            causes = [np.zeros((len(columns), effect.time.size)) for effect in self._effects]
        sought = np.concatenate([shared, *causes], axis=1)
        result = []
        for number in range(1, len(self.conditions) + 1):
            own = [
                index
                for index, ((_, key), throws) in enumerate(self._model.layout.groups.items())
                if isinstance(key, int) and number in throws
            ]
            known = np.array([1.0 / self._model.known[k].error if k in self._model.known else 0.0
                              for k in own])
            rows = self._model.throw_of_sample == number
            basis, _ = np.linalg.qr(
                np.concatenate([columns[rows][:, own] / self.setup.noise, np.diag(known)])
            )
            seen = np.concatenate(
                [sought[rows] / self.setup.noise, np.zeros((len(own), sought.shape[1]))]
            )
            residual = seen - basis @ (basis.T @ seen)
            result.append(residual.T @ residual)
        return tuple(result)

    def start(self) -> ParameterInformation:
        """Return the information before the next throw."""
        measured = self.measured.names if self.measured else ()
        errors = [  # the measured information includes the priors
            math.inf if name in measured else self._prior_error(name, index)
            for name, index in self._shared.items()
        ]
        count = sum(effect.time.size for effect in self._effects)
        information = np.diag(np.append(np.array(errors) ** -2.0, np.zeros(count)))
        if self.measured:
            kept = [k for k, name in enumerate(measured) if name in self._shared]
            here = [self.names.index(measured[k]) for k in kept]
            here += range(len(errors), len(errors) + count)
            seen, shifts = self.measured.seen
            information[np.ix_(here, here)] += _information(
                seen[np.ix_(kept, kept)], shifts[:, kept]
            )
        return ParameterInformation(
            names=self.names, information=information, effects=self._effects
        )

    def rank(self, known: ParameterInformation) -> list[PlannedThrow]:
        """Rank the throws that can be made next, the best one first."""
        return [self._planned(number, after) for number, after in self._ranked(known)]

    def choose(self, known: ParameterInformation) -> Iterator[PlannedThrow]:
        """Yield the best throws one after the other, without end."""
        while True:
            (best, known), *_ = self._ranked(known)
            yield self._planned(best, known)

    def _ranked(self, known: ParameterInformation) -> list[tuple[int, ParameterInformation]]:
        """Add the information of each throw, the best one first."""
        after = [known.after(information) for information in self.information]
        return sorted(enumerate(after), key=lambda item: item[1].log_det_covariance)

    def energy_transfer_error(self, known: ParameterInformation) -> float:
        """Return the relative standard error of alpha, from drawn rigs as in a fit [-]."""
        random = np.random.default_rng(0)
        steps = draw_normal(random, known.covariance, _DRAWS)
        first, slower = len(self.names), np.zeros(1 + _DRAWS)
        for effect in known.effects:
            causes = steps[:, first:first + effect.time.size]
            slower[1:] += effect.changes(random, causes)[:, 1]
            first += effect.time.size
        # Where little is known yet, steps of an error would leave the range of real rigs
        sizes = np.array([self._size(name) for name in self.names])
        limits = np.where(sizes > 0.0, _LARGEST_STEP * sizes, np.inf)
        values = np.tile(self._values, (1 + _DRAWS, 1))
        values[1:, list(self._shared.values())] += np.clip(
            steps[:, :len(self.names)], -limits, limits
        )
        # Neither loss nor damping becomes negative
        signed = [self._shared[name] for name in _WEAK_ERRORS if name in self._shared]
        values[:, signed] = np.maximum(values[:, signed], 0.0)
        result = first_releases([self._model.rig_of(item, _TARGET) for item in values])
        alpha = result._replace(speed=result.speed + slower).energy_transfer
        if not np.isfinite(alpha[0]):
            raise FitError('the projectile of the rig that is planned for does not leave')
        change = np.nan_to_num(alpha[1:] / alpha[0] - 1.0, nan=1.0)
        return float(np.std(change))

    def _size(self, name: str) -> float:
        """Return the usual size of a parameter, 0 if it may be 0 in a real rig."""
        is_of_rig = name.partition('[')[0] in PARAMETERS
        return _WEAK_ERRORS.get(name, is_of_rig * abs(float(self._values[self._shared[name]])))

    def _prior_error(self, name: str, index: int) -> float:
        """Return the standard error of a prior; a very large one if there is no prior."""
        known = self._model.known.get(index)
        return known.error if known else _WEAKLY_KNOWN * self._size(name) or 1.0

    def _planned(self, number: int, known: ParameterInformation) -> PlannedThrow:
        """Return the errors after a throw."""
        condition = self.conditions[number]
        rig = changed_rig(self.rig, condition.values())
        throw = simulate(rig, until=self.setup.duration)
        return PlannedThrow(
            condition=condition,
            errors=known.errors(),
            energy_transfer_error=self.energy_transfer_error(known),
            peak_strain=throw.peak_strain,
            leaves_linear_range=throw.leaves_linear_range,
        )
