# SPDX-License-Identifier: Apache-2.0
"""One throw with all that a user asks of it: ejections, loads, energies, trajectories, fields."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import partial
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray
from soft_throw_ros.core import checks
from soft_throw_ros.core.grid_history import GridHistory
from soft_throw_ros.core.method_of_steps import Event, follow, WaveHistory
from soft_throw_ros.core.models import MODELS
from soft_throw_ros.core.plate import PlateMotion
from soft_throw_ros.core.rig import Rig

Floats = NDArray[np.float64]

_MOST_TIMES = 4000  # at which peaks are looked for on a grid


class Peak(NamedTuple):
    """A largest magnitude, and where and when it occurs."""

    value: float
    depth: float
    time: float


class Energies(NamedTuple):
    """What the plate has done, and where it is: the sum of the others and of heat. [J]"""

    plate_work: float
    layer: float
    projectile: float


class Trajectory(NamedTuple):
    """Positions [m] and velocities [m/s] over `time` [s], each of its shape; z up."""

    time: Floats
    plate_position: Floats
    top_position: Floats
    projectile_position: Floats
    plate_velocity: Floats
    projectile_velocity: Floats


class Fields(NamedTuple):
    """Strain [-] and velocity [m/s] of shape (time, depth), with their axes [s], [m]."""

    time: Floats
    depth: Floats
    strain: Floats
    velocity: Floats


@dataclass(frozen=True, kw_only=True)
class Throw:
    """
    What became of one throw. Made by `simulate`.

    Times count from the start of the plate's clock, heights from the plate's rest position.
    """

    rig: Rig
    model: str
    max_strain: float
    peak_plate_speed: float
    """:math:`V_p^*`. [m/s]"""
    peak_strain: Peak
    """Largest strain magnitude in the layer up to the first release. [-]"""
    peak_plate_strain: float
    """Largest strain magnitude at the plate up to the first release. [-]"""
    peak_contact_strain: float
    """Largest strain magnitude at the projectile up to the first release. [-]"""
    peak_acceleration: float
    """Largest magnitude of the projectile's acceleration up to the first release. [m/s2]"""
    peak_plate_force: float
    """Largest magnitude of the layer's force on the plate up to the first release. [N]"""
    energies: Energies
    """At the first release, more than at rest. [J]"""
    heat: float = 0.0
    """What internal loss has taken up to the first release. [J]"""
    history: WaveHistory | GridHistory = field(repr=False)

    @property
    def events(self) -> tuple[Event, ...]:
        """Releases and landings in order; the first is a release."""
        return self.history.events

    @property
    def ejections(self) -> tuple[Event, ...]:
        """Releases before the projectile falls back (a landing on its way down) for good."""
        found: list[Event] = []
        for event in self.events:
            if event.kind == 'release':
                found.append(event)
            elif event.velocity <= 0.0 and self.rig.gravity > 0.0:
                break
        return tuple(found)

    @property
    def first_release(self) -> Event:
        """When the projectile first leaves the layer."""
        return self.ejections[0]

    @property
    def last_release(self) -> Event:
        """When it leaves for the last time, after all re-contacts that were followed."""
        return self.ejections[-1]

    @property
    def recontacts(self) -> int:
        """How often the layer caught up with the projectile between the two."""
        return len(self.ejections) - 1

    @property
    def ejection_time(self) -> float:
        """:math:`t_e` of the first release, since the plate began to move. [s]"""
        return self.first_release.time - float(self.history.motion.knots[0])

    @property
    def ejection_speed(self) -> float:
        """:math:`V_e` of the first release. [m/s]"""
        return self.first_release.velocity

    @property
    def energy_transfer(self) -> float:
        r""":math:`\alpha = (V_e / V_p^*)^2` of the first release. [-]"""
        return (self.ejection_speed / self.peak_plate_speed) ** 2

    @property
    def last_energy_transfer(self) -> float:
        r""":math:`\alpha` of the last release. [-]"""
        return (self.last_release.velocity / self.peak_plate_speed) ** 2

    @property
    def leaves_linear_range(self) -> bool:
        """Whether the peak strain is above `max_strain`, so that the result is doubtful."""
        return self.peak_strain.value > self.max_strain

    @property
    def apex_height(self) -> float:
        """
        Height that the projectile's lower face reaches in free flight. [m]

        Infinite without gravity.
        """
        last = self.last_release
        if self.rig.gravity == 0.0:
            return float('inf')
        return last.position + max(last.velocity, 0.0) ** 2 / (2.0 * self.rig.gravity)

    def trajectory(self, time: ArrayLike) -> Trajectory:
        """
        Give positions and velocities at any times up to the end of the history.

        Parameters
        ----------
        time : array_like
            [s]

        Returns
        -------
        Trajectory

        Raises
        ------
        ValueError
            For times after `history.end_time`.

        """
        time = np.asarray(time, dtype=np.float64)
        past = self.history
        return Trajectory(
            time,
            past.motion.position(time),
            past.top_position(time),
            past.projectile_position(time),
            past.motion.velocity(time),
            past.projectile_velocity(time),
        )

    def fields(self, time: ArrayLike, *, points: int = 64) -> Fields:
        """
        Give strain and velocity over the layer at given times.

        Parameters
        ----------
        time : array_like, shape (n,)
            [s]
        points : int
            Depths from plate to top, both included.

        Returns
        -------
        Fields
            Of shape (n, points).

        Raises
        ------
        ValueError
            For times after `history.end_time`, or less than 2 points.

        """
        if points < 2:
            raise ValueError(f'points must be at least 2, got {points}')
        time = np.asarray(time, dtype=np.float64)
        depth = np.linspace(0.0, self.rig.layer.thickness, points)
        at = (depth[None, :], time[:, None])
        return Fields(time, depth, self.history.strain(*at), self.history.velocity(*at))


def simulate(
    rig: Rig,
    motion: PlateMotion | None = None,
    *,
    model: str = 'travelling_wave',
    cells: int | None = None,
    step: float | None = None,
    until: float | None = None,
    max_events: int | None = None,
    max_strain: float = 0.1,
) -> Throw:
    """
    Throw once.

    Parameters
    ----------
    rig : Rig
        The throwing rig.
    motion : PlateMotion, optional
        How the plate moves; that of the rig's engine if not given.
    model : str
        One of `models.MODELS`, see below.
    cells : int, optional
        Of the layer, for finite differences; chosen for errors of about 1e-4 if not given.
    step : float, optional
        Time step of finite differences, the longest stable one if not given. [s]
    until, max_events
        When to stop, as for `method_of_steps.follow`.
    max_strain : float
        Strain magnitude up to which the layer is taken to be linear. [-]

    Returns
    -------
    Throw

    Raises
    ------
    ValueError
        For an unknown model, or a rig, a bound or a step that the model refuses.
    ThrowUnfinishedError
        If the projectile is not released by the time that `until` or the plate's samples set.

    Notes
    -----
    `travelling_wave` is exact, for a rigid projectile on a layer of one material without loss.
    `finite_difference` takes any layer, with loss; `finite_difference_elastic` an elastic
    projectile, too, whose speed is that of its centre of mass; `finite_difference_glued` has the
    layer glued to the projectile and thrown along, as in [1]_, and speeds of their common centre
    of mass. All three are of second order. `spring_mass` is a layer without mass (App. A of
    [2]_), for any plate and with gravity, to 1e-5.

    References
    ----------
    .. [1] Celestini, Raufaste et al. (2020), reference 27 of [2]_.
    .. [2] "Use of compliant actuators for throwing rigid projectiles", Phys. Rev. E (2022).

    Examples
    --------
    >>> from soft_throw_ros.core.rig import Layer, Rig
    >>> throw = simulate(Rig(layer=Layer(thickness=16.8e-3)))
    >>> round(throw.ejection_time * 1e3, 3), round(throw.energy_transfer, 3)
    (7.647, 3.637)

    The same gelatin with a loss tangent of 0.05, and glued to the projectile instead of the plate:

    >>> layer = Layer(thickness=16.8e-3, loss_tangent=0.05)
    >>> round(simulate(Rig(layer=layer), model='finite_difference').energy_transfer, 3)
    3.256
    >>> round(simulate(Rig(layer=layer), model='finite_difference_glued').energy_transfer, 3)
    1.996

    """
    if model not in MODELS:
        raise ValueError(f'model must be one of {", ".join(MODELS)}, got {model!r}')
    checks.positive('max_strain', max_strain)
    history: WaveHistory | GridHistory
    if model == 'travelling_wave':
        for name, value in (('cells', cells), ('step', step)):
            if value is not None:
                raise ValueError(f'{name} is for finite differences only, got {value!r}')
        history = follow(rig, motion, until=until, max_events=max_events)
    else:
        history = GridHistory(
            rig,
            motion,
            model=model,
            cells=cells,
            step=step,
            until=until,
            max_events=max_events,
        )
    if not history.events:
        raise ThrowUnfinishedError(
            f'the projectile is not released by {history.end_time:g} s; follow it for longer'
        )
    describe = _describe_grid if isinstance(history, GridHistory) else _describe_waves
    return Throw(
        rig=rig,
        model=model,
        max_strain=max_strain,
        peak_plate_speed=history.motion.peak_velocity,
        history=history,
        **describe(history),  # type: ignore[arg-type]  # as checked above
    )


def _describe_waves(history: WaveHistory) -> dict[str, Any]:
    """Find peaks and energies."""
    rig = history.rig
    end = history.events[0].time
    times = history.sample_times(end)
    mass = rig.projectile.mass

    def contact_strain(time: Floats) -> Floats:
        return history.strain(rig.layer.thickness, time)

    def acceleration(time: Floats) -> Floats:
        return history.contact_force(time) / mass - rig.gravity

    plate_force = _largest_in_time(history.plate_force, times)[0]
    return {
        'peak_strain': _peak_strain(history, end),
        'peak_plate_strain': plate_force / (rig.layer.youngs_modulus * rig.layer.section),
        'peak_contact_strain': _largest_in_time(contact_strain, times)[0],
        'peak_acceleration': _largest_in_time(acceleration, times)[0],
        'peak_plate_force': plate_force,
        'energies': Energies(
            history.plate_work(end), history.layer_energy(end), history.projectile_energy(end)
        ),
    }


def _describe_grid(history: GridHistory) -> dict[str, Any]:
    """Find peaks, at whole steps if these are not too many, and energies."""
    rig, start = history.rig, float(history.motion.knots[0])
    end = history.events[0].time
    times = np.linspace(start, end, 2 + min(int((end - start) / history.step), _MOST_TIMES))
    depth, strain = history.strains(times)
    row, column = np.unravel_index(np.argmax(np.abs(strain)), strain.shape)
    push = history.contact_force(times) / rig.projectile.mass - rig.gravity
    return {
        'peak_strain': Peak(
            float(abs(strain[row, column])), float(depth[column]), float(times[row])
        ),
        'peak_plate_strain': float(np.abs(strain[:, 0]).max()),
        'peak_contact_strain': float(np.abs(strain[:, -1]).max()),
        'peak_acceleration': float(np.abs(push).max()),
        'peak_plate_force': float(np.abs(history.plate_force(times)).max()),
        'energies': Energies(
            history.plate_work(end), history.layer_energy(end), history.projectile_energy(end)
        ),
        'heat': history.heat(end),
    }


class ThrowUnfinishedError(RuntimeError):
    """The time given ended before the projectile was released."""


def _peak_strain(history: WaveHistory, end: float) -> Peak:
    """
    Find the largest strain magnitude until `end`.

    The strain is a difference of two waves, one of time a when it left the top downwards, one of
    time b when it will reach the top. So the grid is one of a and b, each as dense as its wave
    asks for, and inside it is a peak of both; else it is at the plate, the top, or the end.
    """
    crossing = history.rig.crossing_time
    thickness = history.rig.layer.thickness
    speed = history.rig.layer.wave_speed

    def strain(a: Floats, b: Floats) -> Floats:
        values = history.strain_of_waves(a[None, :], b[:, None])
        time, from_top = 0.5 * (a[None, :] + b[:, None]), 0.5 * (b[:, None] - a[None, :])
        inside = (from_top >= 0.0) & (from_top <= crossing) & (time <= end)
        return np.where(inside, values, 0.0)

    left = history.sample_times(end)
    reaches = history.sample_times(end + crossing)
    value, a, b = _largest(strain, left, reaches)
    found = [Peak(value, thickness - 0.5 * speed * (b - a), 0.5 * (a + b))]
    for depth in (0.0, thickness):
        value, time = _largest_in_time(partial(history.strain, depth), left)
        found.append(Peak(value, depth, time))
    # At the end, ordered by when the downward wave left the top
    departures = np.append(end - crossing, left[left > end - crossing])
    value, a = _largest_in_time(lambda a: history.strain_of_waves(a, 2.0 * end - a), departures)
    found.append(Peak(value, thickness - speed * (end - a), end))
    return max(found)


def _largest_in_time(function: Callable[[Floats], Floats], times: Floats) -> tuple[float, float]:
    """Find the largest magnitude over times, and when it is reached."""
    value, _, time = _largest(lambda _, time: function(time)[:, None], np.zeros(1), times)
    return value, time


def _largest(
    function: Callable[[Floats, Floats], Floats], columns: Floats, rows: Floats
) -> tuple[float, float, float]:
    """
    Find the largest magnitude over columns and rows by a grid and zooming into its best places.

    `function` takes the values along both and returns an array of shape (rows, columns). Kinks
    do no harm: nothing is differentiated.
    """
    values = np.abs(function(columns, rows))
    padded = np.pad(values, 1, constant_values=-np.inf)
    height, width = values.shape
    neighbours = np.max(
        [
            padded[1 + i : 1 + i + height, 1 + j : 1 + j + width]
            for i in (-1, 0, 1)
            for j in (-1, 0, 1)
        ],
        axis=0,
    )
    is_top = values >= neighbours
    best_first = np.argsort(values[is_top])[::-1][:6]
    found = []
    for i, j in np.argwhere(is_top)[best_first]:
        best, x, y = values[i, j], columns[j], rows[i]
        left, right = columns[max(j - 1, 0)], columns[min(j + 1, width - 1)]
        low, high = rows[max(i - 1, 0)], rows[min(i + 1, height - 1)]
        while max(high - low, right - left) > 1e-10 * rows[-1]:
            near = np.linspace(left, right, 7 if right > left else 1)
            then = np.linspace(low, high, 7)
            local = np.abs(function(near, then))
            at = np.unravel_index(np.argmax(local), local.shape)
            if local[at] >= best:
                best, x, y = local[at], near[at[1]], then[at[0]]
            left, right = _narrowed(left, right, x)
            low, high = _narrowed(low, high, y)
        found.append((float(best), float(x), float(y)))
    return max(found)


def _narrowed(low: float, high: float, middle: float) -> tuple[float, float]:
    """Interval of less than half the length around a point of the first one, and within it."""
    reach = 0.2 * (high - low)
    return max(low, middle - reach), min(high, middle + reach)
