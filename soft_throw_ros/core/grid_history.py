# SPDX-License-Identifier: Apache-2.0
"""
A throw by finite differences from rest to an end, to be asked for anything at any time of it.

Nothing is kept but the events: what is asked for is computed by throwing again, which gives the
same to the last bit.
"""

from __future__ import annotations

from collections.abc import Callable
import math

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.interpolate import PPoly
from soft_throw_ros.core import checks, stepping
from soft_throw_ros.core.grid_stepper import GridStepper, MAX_CELLS
from soft_throw_ros.core.method_of_steps import Event
from soft_throw_ros.core.plate import PlateMotion, Sampled, Underdamped
from soft_throw_ros.core.rig import Rig
from soft_throw_ros.core.stepping import (
    PLATE_FORCE,
    PLATE_POSITION,
    PROJECTILE_FORCE,
    PROJECTILE_POSITION,
    PROJECTILE_VELOCITY,
    TIME,
)

Floats = NDArray[np.float64]

_FEWEST_CELLS = 256
_CELLS_PER_RELAXATION = 8.0
_STEPS_PER_PERIOD = 160.0


class GridHistory:
    """
    All that happens in one throw, from rest to an end.

    Parameters
    ----------
    rig : Rig
        With any layer.
    motion : Underdamped or Sampled, optional
        How the plate moves; that of the rig's engine if not given.
    model : str
        One of `models.ON_GRIDS`.
    cells : int, optional
        Of the layer. If not given at least 256, 8 per relaxation time, and so many that there are
        160 steps in a plate period, for errors of about 1e-4; but no more than
        `grid_stepper.MAX_CELLS`.
    step : float, optional
        Time step, the longest stable one if not given. [s]
    until, max_events
        When to stop, as for `method_of_steps.follow`; but a sampled motion that does not hold
        ends at the last whole step before its last sample.

    Attributes
    ----------
    events : tuple of Event
        In order; the first is a release. Empty if the projectile never left in the time given.
    end_time : float
        Until when everything is known. [s]

    Raises
    ------
    ValueError
        If an argument is out of range, or the step is not stable.

    """

    def __init__(
        self,
        rig: Rig,
        motion: PlateMotion | None = None,
        *,
        model: str = 'finite_difference',
        cells: int | None = None,
        step: float | None = None,
        until: float | None = None,
        max_events: int | None = None,
    ) -> None:
        if until is not None:
            checks.positive('until', until)
        if max_events is not None and max_events < 1:
            raise ValueError(f'max_events must be at least 1, got {max_events}')
        self.rig = rig
        self.motion: PlateMotion = Underdamped.of(rig.engine) if motion is None else motion
        self._start = float(self.motion.knots[0])
        if cells is None:
            cells = cells_for(rig, model)
        cells = stepping.checked_count('cells', cells, low=1, high=MAX_CELLS)
        self._stepper = GridStepper(
            rig,
            _from_zero(self.motion),
            model=model,
            cells=cells,
            step=step,
            field_points=min(2 * cells + 1, 1025),
        )
        self._depth = np.linspace(0.0, rig.layer.thickness, self._stepper.field_points)
        limit = math.inf if until is None else until - self._start
        self._end = self._run(min(limit, self._stepper.horizon), until, max_events)
        self.events = self._located(self._stepper.events()[:max_events])

    @property
    def end_time(self) -> float:
        """Until when everything is known. [s]"""
        return self._start + self._end

    @property
    def step(self) -> float:
        """Time step. [s]"""
        return self._stepper.grid.step

    def _run(self, limit: float, until: float | None, max_events: int | None) -> float:
        """Advance until an end condition holds, and return the time."""
        stepper, rig = self._stepper, self.rig
        period = 1.0 / rig.engine.frequency
        stride = 0.125 * period
        patience = 100.0 * rig.crossing_time + 50.0 * period
        watch = 8.0 * rig.crossing_time + 2.0 * period
        high, low = -math.inf, math.inf  # of `_surface` since the last event
        seen = 0
        count, time = 0, 0.0
        while True:
            count += 1
            time = min(count * stride, limit)
            stepper.advance_to(time)
            events = stepper.events()
            if max_events is not None and len(events) >= max_events:
                return events[max_events - 1].time
            since = time - events[-1].time if events else time
            if time == limit or (until is None and not events and since > patience):
                break
            if not events or until is not None or max_events is not None:
                continue
            if rig.gravity > 0.0:
                falls = [e for e in events if e.kind == 'landing' and e.velocity <= 0.0]
                if falls:
                    return falls[0].time
                continue
            # without gravity it is over when all that could catch up is far below
            if len(events) > seen:
                seen, high, low = len(events), -math.inf, math.inf
            surface = self._surface()
            high, low = max(high, surface), min(low, surface)
            flies = not stepper.in_contact and events[-1].velocity > 0.0
            gap = float(stepper.state[PROJECTILE_POSITION]) - high
            if since > patience or (flies and since > watch and gap > high - low):
                break
        return float(stepper.state[TIME])

    def _surface(self) -> float:
        """Return how high up the projectile would touch what it has left, now. [m]"""
        if self._stepper.model == 'finite_difference_glued':
            return float(self._stepper.state[PLATE_POSITION]) + self.rig.layer.thickness
        return self._stepper.surface_position

    def _located(self, events: list[stepping.Event]) -> tuple[Event, ...]:
        """Add to events where they happened."""
        events = [event for event in events if event.time <= self._end]
        heights = self._walk(
            self._start + np.array([event.time for event in events]), self._height
        )
        return tuple(
            Event(event.kind, self._start + event.time, event.velocity, float(height))
            for event, height in zip(events, heights, strict=True)
        )

    def _walk(self, time: ArrayLike, read: Callable[[GridStepper], float | Floats]) -> Floats:
        """Throw again, and read something at given times."""
        time = np.asarray(time, dtype=np.float64)
        if time.size and not time.max() <= self.end_time:
            raise ValueError(
                f'time {time.max():g} s is after {self.end_time:g} s, where this history ends; '
                'follow the throw for longer (until, max_events)'
            )
        moments, places = np.unique(np.maximum(time - self._start, 0.0), return_inverse=True)
        self._stepper.reset()
        rows = []
        for moment in moments.tolist():
            self._stepper.advance_to(min(moment, self._end))
            rows.append(read(self._stepper))
        if not rows:
            return np.zeros(time.shape)
        return np.asarray(np.array(rows)[places.reshape(time.shape)])

    @staticmethod
    def _height(stepper: GridStepper) -> float:
        return float(stepper.state[PROJECTILE_POSITION])

    def projectile_position(self, time: ArrayLike) -> Floats:
        """Height of the projectile's lower face above the plate's rest position. [m]"""
        return self._walk(time, self._height)

    def projectile_velocity(self, time: ArrayLike) -> Floats:
        """Velocity of the projectile's lower face, upwards. [m/s]"""
        return self._walk(time, lambda stepper: float(stepper.state[PROJECTILE_VELOCITY]))

    def top_position(self, time: ArrayLike) -> Floats:
        """Height of the top of the layer above the plate's rest position. [m]"""
        return self._walk(time, lambda stepper: stepper.surface_position)

    def contact_force(self, time: ArrayLike) -> Floats:
        """Force of the layer on the projectile, upwards. [N]"""
        return self._walk(time, lambda stepper: float(stepper.state[PROJECTILE_FORCE]))

    def plate_force(self, time: ArrayLike) -> Floats:
        """Force of the layer on the plate, upwards: negative when the plate pushes. [N]"""
        return self._walk(time, lambda stepper: float(stepper.state[PLATE_FORCE]))

    def plate_work(self, time: float) -> float:
        """Work that the plate has done on layer and projectile until `time`. [J]"""
        return float(self._walk(time, lambda stepper: stepper.work))

    def heat(self, time: float) -> float:
        """Energy that the layer has turned to heat until `time`. [J]"""
        return float(self._walk(time, lambda stepper: stepper.dissipated))

    def projectile_energy(self, time: float) -> float:
        """Kinetic and potential energy of the projectile, more than at rest. [J]"""
        mass = self.rig.projectile.mass
        rise = float(self.projectile_position(time)) - self._stepper.rest_position
        speed = float(self.projectile_velocity(time))
        return mass * (0.5 * speed**2 + self.rig.gravity * rise)

    def layer_energy(self, time: float) -> float:
        """All other energy that is stored, more than at rest under the weight. [J]"""
        stored = float(self._walk(time, GridStepper.stored_energy))
        return stored - self.projectile_energy(time)

    def velocity(self, depth: ArrayLike, time: ArrayLike) -> Floats:
        """
        Velocity of the layer's material, upwards. [m/s]

        Parameters
        ----------
        depth : array_like
            Coordinate y in the layer, 0 at the plate, the thickness at the top. [m]
        time : array_like
            Broadcast against `depth`. [s]

        Returns
        -------
        ndarray
            Of the broadcast shape.

        Raises
        ------
        ValueError
            Outside the layer, or after `end_time`.

        """
        return self._field(depth, time, 1)

    def strain(self, depth: ArrayLike, time: ArrayLike) -> Floats:
        """
        Strain of the layer, negative in compression, with the weight's static part. [-]

        Parameters and errors as for `velocity`.
        """
        return self._field(depth, time, 0)

    def strains(self, time: Floats) -> tuple[Floats, Floats]:
        """
        Give the strain at many depths, from plate to top, at increasing times.

        Parameters
        ----------
        time : ndarray, shape (n,)
            [s]

        Returns
        -------
        depth : ndarray, shape (m,)
            [m]
        strain : ndarray, shape (n, m)
            [-]

        """
        strain = np.empty((time.size, self._depth.size))
        self._stepper.reset()
        self._stepper.sample_field(np.clip(time - self._start, 0.0, self._end), strain)
        return self._depth, strain

    def _field(self, depth: ArrayLike, time: ArrayLike, which: int) -> Floats:
        depth, time = np.broadcast_arrays(
            np.asarray(depth, dtype=np.float64), np.asarray(time, dtype=np.float64)
        )
        thickness = self.rig.layer.thickness
        if depth.size and not (depth.min() >= 0.0 and depth.max() <= thickness):
            outside = depth[~((depth >= 0.0) & (depth <= thickness))].flat[0]
            raise ValueError(f'depth must be in [0, {thickness:g}] m, got {outside:g}')
        fields = np.empty((2, self._depth.size))
        moments, places = np.unique(time, return_inverse=True)
        places = places.reshape(time.shape)

        def read(stepper: GridStepper) -> Floats:
            stepper.read_field(fields[0], fields[1])
            return np.array(fields[which])

        values = np.empty(depth.shape)
        for index, row in enumerate(self._walk(moments, read)):
            here = places == index
            values[here] = np.interp(depth[here], self._depth, row)
        return np.asarray(values)


def cells_for(rig: Rig, model: str) -> int:
    """Choose the cells of a layer for errors of about 1e-4."""
    if model == 'spring_mass':
        return 1
    wanted = max(
        _FEWEST_CELLS,
        _CELLS_PER_RELAXATION / rig.mass_ratio,
        _STEPS_PER_PERIOD * rig.crossing_time * rig.engine.frequency,
    )
    return min(math.ceil(wanted), MAX_CELLS)


def _from_zero(motion: PlateMotion) -> PlateMotion:
    """Shift a sampled motion so that it begins at time 0."""
    if not isinstance(motion, Sampled):
        return motion
    path = PPoly(motion.path.c, motion.path.x - motion.start_time)
    return Sampled(path=path, after=motion.after)
