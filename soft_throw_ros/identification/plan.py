# SPDX-License-Identifier: Apache-2.0
r"""
What to measure next: which throws would narrow the parameters of a rig most, and by how much.

Notes
-----
With the Jacobian :math:`J` of the heights that a throw would show, and white noise of
:math:`\sigma`, the throw adds :math:`J^T J / \sigma^2` to the information about the parameters.
What each throw has for itself, its amplitude, its start and the heights from which its tracks
count, is eliminated (Schur's complement). The inverse of the sum of the information of throws,
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
from dataclasses import dataclass, field
import itertools
import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from soft_throw_ros.core import checks
from soft_throw_ros.core.plate import Underdamped
from soft_throw_ros.core.rig import Rig
from soft_throw_ros.core.throw import simulate
from soft_throw_ros.identification.fit_description import changed_rig, values_of
from soft_throw_ros.identification.forward import first_releases, ThrowSimulator
from soft_throw_ros.identification.least_squares import FitError

Floats = NDArray[np.float64]

SOUGHT = ('layer.wave_speed', 'layer.thickness', 'layer.loss_tangent')
"""What throws are to narrow, as far as it is not known exactly."""

_OF_THROW = 'engine.amplitude'
_OF_PARTS = ('layer.thickness', 'projectile.mass')  # that may differ from throw to throw
_STEP = 3e-4  # relative, for derivatives: large against what steppers leave out ...
_LEAST_STEPS = {'engine.damping_ratio': 3e-5, 'layer.loss_tangent': 3e-4}  # ... and absolute
_WEAKLY_KNOWN = 1.0  # relative error with which all is known that is free, and ...
_WEAK_ERRORS = {'layer.loss_tangent': 0.3, 'engine.damping_ratio': 0.3}  # ... absolute
_LARGEST_STEP = 0.5  # relative, of parameters to see how alpha changes
_REST = 0.25  # plate periods before the start that are seen
_IN_FLIGHT = 0.97  # of the time until the landing that a fit looks at


class Condition(NamedTuple):
    """A throw that can be made."""

    mass: float
    """Of the projectile. [kg]"""
    thickness: float
    """Of the layer. [m]"""
    amplitude: float
    """Of the plate. [m]"""

    def rig_of(self, rig: Rig) -> Rig:
        """Change a rig so that it throws like this."""
        values = dict(zip((*_OF_PARTS[::-1], _OF_THROW), self, strict=True))
        try:
            return changed_rig(rig, values)
        except ValueError as error:
            raise FitError(str(error)) from None


@dataclass(frozen=True, kw_only=True)
class Sight:
    """
    How throws are seen.

    Parameters
    ----------
    rate : float
        Samples per second of both tracks. [Hz]
    noise : float
        Standard deviation of heights. [m]
    duration : float
        For how long after its start a throw is seen. [s]

    """

    rate: float = 5000.0
    noise: float = 2e-5
    duration: float = 0.05

    def __post_init__(self) -> None:
        for name in ('rate', 'noise', 'duration'):
            checks.require_positive(name, getattr(self, name))


@dataclass(frozen=True, kw_only=True)
class Knowledge:
    """
    What is known of the parameters that all throws share.

    Parameters
    ----------
    names : tuple of str
        Those of the rig; the thickness or mass of a part has its value in brackets.
    information : ndarray, shape (n, n)
        Inverse of the covariance.

    """

    names: tuple[str, ...]
    information: Floats

    @property
    def covariance(self) -> Floats:
        """Covariance of the parameters."""
        scale = 1.0 / np.sqrt(np.diag(self.information))
        scaled = self.information * np.outer(scale, scale)
        return np.linalg.inv(scaled) * np.outer(scale, scale)

    def errors(self) -> dict[str, float]:
        """Standard errors by names."""
        return dict(zip(self.names, np.sqrt(np.diag(self.covariance)).tolist(), strict=True))


@dataclass(frozen=True, kw_only=True)
class PlannedThrow:
    """
    A throw, and what would be known after it.

    Parameters
    ----------
    condition : Condition
    errors : mapping of str to float
        Standard errors of what all throws share, by the names of the rig.
    energy_transfer_error : float
        Standard error of alpha of the rig that the plan is for, over alpha. [-]
    peak_strain : float
        Of the layer in this throw. [-]
    leaves_linear_range : bool
        Whether that is more than the linear model takes.

    """

    condition: Condition
    errors: Mapping[str, float]
    energy_transfer_error: float
    peak_strain: float
    leaves_linear_range: bool


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
    errors : mapping of str to float
        Parameters that are not known exactly, and their standard errors; infinity if nothing is
        known. The amplitude is never known.
    measured : Knowledge, optional
        What earlier throws have told, in the names of the rig; it has their errors in it.

    Raises
    ------
    FitError
        If there is no condition, nothing is sought, or a throw cannot be followed.

    """

    rig: Rig
    conditions: Sequence[Condition]
    sight: Sight
    errors: Mapping[str, float]
    measured: Knowledge | None = None
    names: tuple[str, ...] = field(init=False)
    """Parameters that all throws share, those of parts with their value in brackets."""
    information: tuple[Floats, ...] = field(init=False)
    """What each condition tells of them."""

    def __post_init__(self) -> None:
        shared = [name for name in self.errors if name not in (_OF_THROW, *_OF_PARTS)]
        parts = []
        own = Condition(*values_of(self.rig, (*_OF_PARTS[::-1], _OF_THROW)).values())
        for name in _OF_PARTS:
            if name in self.errors:
                each = {_value(condition, name) for condition in (*self.conditions, own)}
                parts += [_of_part(name, value) for value in sorted(each)]
        object.__setattr__(self, 'names', (*shared, *parts))
        if not self.conditions:
            raise FitError('there is no throw to choose from')
        if not any(name in self.errors for name in SOUGHT):
            raise FitError(f'nothing is sought: one of {", ".join(SOUGHT)} must be free')
        told = tuple(self._inform(condition) for condition in self.conditions)
        object.__setattr__(self, 'information', told)

    def start(self) -> Knowledge:
        """Say what is known before."""
        values = values_of(self.rig, self.errors)
        information = np.zeros((len(self.names), len(self.names)))
        measured = self.measured.names if self.measured else ()
        for place, name in enumerate(self.names):
            plain, _, value = name.rstrip(']').partition('[')
            weak = _WEAK_ERRORS.get(plain, _WEAKLY_KNOWN * abs(float(value or values[plain])))
            error = math.inf if self._as_own(name) in measured else self.errors[plain]
            information[place, place] = 1.0 / min(error, weak) ** 2
        if self.measured:
            places = {self._as_own(name): place for place, name in enumerate(self.names)}
            kept = [number for number, name in enumerate(measured) if name in places]
            here = [places[measured[number]] for number in kept]
            covariance = self.measured.covariance[np.ix_(kept, kept)]
            information[np.ix_(here, here)] += np.linalg.inv(covariance)
        return Knowledge(names=self.names, information=information)

    def judge(self, known: Knowledge) -> list[PlannedThrow]:
        """Say of each throw that can be made next what it would tell, the best one first."""
        after = [self._after(known, number) for number in range(len(self.conditions))]
        order = sorted(range(len(after)), key=lambda number: self._volume(after[number]))
        return [self._planned(number, after[number]) for number in order]

    def choose(self, known: Knowledge) -> Iterator[PlannedThrow]:
        """Choose throws one after the other, without end."""
        while True:
            after = [self._after(known, number) for number in range(len(self.conditions))]
            best = min(range(len(after)), key=lambda number: self._volume(after[number]))
            known = after[best]
            yield self._planned(best, known)

    def energy_transfer(self, known: Knowledge) -> tuple[float, float]:
        """Return alpha of the rig, and its standard error."""
        names = [name for name in known.names if self._as_own(name) in self.errors]
        places = [known.names.index(name) for name in names]
        mean = values_of(self.rig, [self._as_own(name) for name in names])
        powers, axes = np.linalg.eigh(known.covariance[np.ix_(places, places)])
        steps = (np.sqrt(np.maximum(powers, 0.0)) * axes).T
        rigs = [self.rig]
        for step, sign in itertools.product(steps, (1.0, -1.0)):
            most = [
                _WEAK_ERRORS.get(name, _LARGEST_STEP * abs(value)) for name, value in mean.items()
            ]
            values = np.array([*mean.values()]) + sign * np.clip(step, np.negative(most), most)
            changes = dict(zip(mean, values, strict=True))
            rigs.append(changed_rig(self.rig, _within_bounds(changes)))
        alpha = first_releases(rigs).energy_transfer
        if not np.isfinite(alpha[0]):
            raise FitError('the projectile of the rig that is planned for does not leave')
        change = np.nan_to_num(alpha[1:].reshape(-1, 2) - alpha[0], nan=alpha[0])
        return float(alpha[0]), float(np.sqrt(np.sum(np.max(np.abs(change), axis=1) ** 2)))

    def _as_own(self, name: str) -> str:
        """Strip the value off the name of a part that is the rig's own."""
        plain = name.partition('[')[0]
        own = values_of(self.rig, [plain])[plain]
        return plain if name in (plain, _of_part(plain, own)) else name

    def _after(self, known: Knowledge, number: int) -> Knowledge:
        """Add what a throw tells."""
        return Knowledge(
            names=known.names, information=known.information + self.information[number]
        )

    def _volume(self, known: Knowledge) -> float:
        """Logarithm of the determinant of the covariance of what is sought."""
        places = [
            place for place, name in enumerate(known.names) if name.partition('[')[0] in SOUGHT
        ]
        return float(np.linalg.slogdet(known.covariance[np.ix_(places, places)])[1])

    def _planned(self, number: int, known: Knowledge) -> PlannedThrow:
        """Say what is known after a throw."""
        condition = self.conditions[number]
        alpha, error = self.energy_transfer(known)
        throw = simulate(condition.rig_of(self.rig), until=self.sight.duration)
        errors = {self._as_own(name): each for name, each in known.errors().items()}
        return PlannedThrow(
            condition=condition,
            errors=errors,
            energy_transfer_error=error / alpha,
            peak_strain=throw.peak_strain,
            leaves_linear_range=throw.leaves_linear_range,
        )

    def _inform(self, condition: Condition) -> Floats:
        """Compute what a throw tells of what all throws share."""
        rig = condition.rig_of(self.rig)
        time = np.arange(-_REST / rig.engine.frequency, self.sight.duration, 1.0 / self.sight.rate)
        by_cells = 'layer.loss_tangent' in self.errors or rig.layer.loss_tangent > 0.0
        simulator = ThrowSimulator(throws=len(self.errors) + 2)
        landing = simulator.landing_time(rig, self.sight.duration, by_cells=by_cells)
        flying = time[time < _IN_FLIGHT * landing]

        def heights(changed: Rig) -> Floats:
            plate = Underdamped.of(changed.engine).position(time)
            path = simulator.follow(changed, flying, by_cells=by_cells)
            rest = changed.layer.thickness - changed.static_sag
            return np.concatenate([plate, path.position - rest])

        varied = [*(name for name in self.errors if name != _OF_THROW), _OF_THROW]
        values = values_of(rig, varied)
        columns = []
        for name, value in values.items():
            step = max(_STEP * abs(value), _LEAST_STEPS.get(name, 0.0))
            above, below = (
                _within_bounds({name: value + sign * step})[name] for sign in (1.0, -1.0)
            )
            change = heights(changed_rig(rig, {name: above})) - heights(
                changed_rig(rig, {name: below})
            )
            columns.append(change / (above - below))
        velocity = np.concatenate(
            [
                Underdamped.of(rig.engine).velocity(time),
                simulator.follow(rig, flying, by_cells=by_cells).velocity,
            ]
        )
        is_plate = np.arange(velocity.size) < time.size
        jacobian = np.stack([*columns, -velocity, is_plate, ~is_plate], axis=1) / self.sight.noise
        count = len(varied) - 1
        told = _eliminate(jacobian, count)
        places = [self.names.index(self._name_in(condition, name)) for name in varied[:-1]]
        information = np.zeros((len(self.names), len(self.names)))
        information[np.ix_(places, places)] = told
        return information

    def _name_in(self, condition: Condition, name: str) -> str:
        """Name a parameter of a throw."""
        return _of_part(name, _value(condition, name)) if name in _OF_PARTS else name


def _eliminate(jacobian: Floats, count: int) -> Floats:
    """Compute the information about the first parameters if the others are free."""
    others, _ = np.linalg.qr(jacobian[:, count:])
    left = jacobian[:, :count] - others @ (others.T @ jacobian[:, :count])
    return np.asarray(left.T @ left)


def _value(condition: Condition, name: str) -> float:
    return condition.thickness if name == 'layer.thickness' else condition.mass


def _of_part(name: str, value: float) -> str:
    """Name a parameter of one of several layers or projectiles."""
    return f'{name}[{value:.9g}]' if name in _OF_PARTS else name


def _within_bounds(values: Mapping[str, float]) -> dict[str, float]:
    """Keep damping and loss from becoming negative."""
    return {
        name: max(float(value), 0.0) if name in _LEAST_STEPS else float(value)
        for name, value in values.items()
    }
