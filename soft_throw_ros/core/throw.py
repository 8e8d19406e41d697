# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Throws: one with all its results, and the first releases and loads of many, in SI units."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, fields, replace
from itertools import takewhile
import math
from typing import Any, NamedTuple, TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray
from soft_throw_ros.core import cell_stepper, checks, closed_form, wave_stepper
from soft_throw_ros.core.batch import Cancelled, check_cancelled, run_batches, ThrowUnresolvedError
from soft_throw_ros.core.plate import motion_of, peak_velocity_ratio
from soft_throw_ros.core.rig import Engine, Layer, RANGES, Rig, scales_of, values_of
from soft_throw_ros.core.stepper import Event, Loads, Stepper, TIME

Floats = NDArray[np.float64]

_LONGEST = 60.0
"""Longest that a throw is followed if nothing else ends it. [s]"""

_BUDGET = 0.5
"""Time of a processor after which a throw ends that `until` does not end. [s]"""

_QUIET_CROSSINGS, _QUIET_PERIODS = 8.0, 2.0
"""Crossings plus periods after a release that show how far up the free top swings."""

_LOSSLESS_CELLS, _MAX_CELLS = 256, 2048
"""Cells of a lossless layer between which the step is halved; fewer miss short releases. [-]"""

_HALVING = 1e-4
"""Largest relative change of time and speed at which halving the step ends. [-]"""


class Trajectory(NamedTuple):
    """
    Positions [m] and velocities [m/s] over `time` [s], arrays of one shape; z up.

    `strain` [-] and `layer_velocity` [m/s] have the shape (time, depth), with `depth` [m] from the
    plate to the top of the layer.
    """

    time: Floats
    plate_position: Floats
    top_position: Floats
    projectile_position: Floats
    plate_velocity: Floats
    projectile_velocity: Floats
    depth: Floats
    strain: Floats
    layer_velocity: Floats


def ejections(events: Iterable[Event]) -> tuple[Event, ...]:
    """Return the ejections: the releases before the projectile has come down on the layer."""
    before = takewhile(lambda event: event.kind != 'landing', events)
    return tuple(event for event in before if event.kind == 'release')


def apex_height(ejection: Event, gravity: float) -> float:
    """Compute how high the lower face flies, infinite without gravity [m]."""
    if gravity == 0.0:
        return math.inf
    return ejection.position + max(ejection.velocity, 0.0) ** 2 / (2.0 * gravity)


def make_stepper(
    rig: Rig, *, is_measured: bool = False, cells: int | None = None, field_points: int = 64
) -> Stepper:
    """
    Make a stepper: cells if the layer needs them, otherwise travelling waves.

    The plate of a measured one moves by `append_plate_states`, and not by the rig's engine; the
    layer is read at `field_points` heights. ThrowUnresolvedError if the rig cannot be stepped in
    real time, ValueError if an option is out of range.
    """
    options: dict[str, Any] = {'is_measured': is_measured, 'field_points': field_points}
    if rig.layer.needs_cells:
        return cell_stepper.CellStepper(rig, cells=cells, **options)
    if cells is not None:
        raise ValueError(f'cells are for layers that need them only, got {cells!r}')
    return wave_stepper.WaveStepper(rig, **options)


def _make_settled_stepper(
    rig: Rig, cells: int | None, cancelled: Cancelled | None
) -> tuple[Stepper, int | None]:
    """
    Make a stepper for results to 1e-4, and return its number of cells, too.

    Nothing smooths the waves in cells without loss. There the step is halved until the first
    release settles, and the stepper stands after it.
    """
    if cells is not None or not rig.layer.needs_cells or rig.layer.loss_tangent > 0.0:
        return make_stepper(rig, cells=cells, field_points=2), cells
    cells, before = _LOSSLESS_CELLS, (math.inf, math.inf)
    while True:
        stepper = make_stepper(rig, cells=cells, field_points=2)
        event = stepper.advance_to_release(latest=rig.longest_wait, cancelled=cancelled)
        now = (math.nan, math.nan) if event is None else (event.time, event.velocity)
        is_settled = np.allclose(now, before, rtol=_HALVING, atol=0.0, equal_nan=True)
        if is_settled or cells == _MAX_CELLS:
            return stepper, cells
        cells, before = 2 * cells, now


@dataclass(frozen=True, kw_only=True)
class Throw:
    """
    Result of one throw. Made by `simulate`.

    Times count from the start of the plate's motion, heights from the plate's rest position; loads
    and energies are those up to the first release.
    """

    rig: Rig
    cells: int | None = field(repr=False)
    rest_height: float
    """Height of the projectile's lower face before the throw. [m]"""
    events: tuple[Event, ...]
    """Releases, re-contacts and landings in order; the first one is the first release."""
    end_time: float
    """Time until which it was followed. [s]"""
    loads: Loads
    plate_work: float
    """Work of the plate. [J]"""
    heat: float
    """Work that is not stored in layer and projectile. [J]"""

    @property
    def peak_plate_speed(self) -> float:
        """:math:`V_p^*` [m/s]."""
        return motion_of(self.rig.engine).peak_velocity

    @property
    def peak_strain(self) -> float:
        """Largest strain magnitude in the layer [-]."""
        return self.loads.strain

    @property
    def ejections(self) -> tuple[Event, ...]:
        """Releases before the projectile has come down on the layer."""
        return ejections(self.events)

    @property
    def last_release(self) -> Event:
        """Event at which it leaves for the last time, after all re-contacts that were followed."""
        return self.ejections[-1]

    @property
    def ejection_time(self) -> float:
        """:math:`t_e` of the first release [s]."""
        return self.events[0].time

    @property
    def ejection_speed(self) -> float:
        """:math:`V_e` of the first release [m/s]."""
        return self.events[0].velocity

    @property
    def energy_transfer(self) -> float:
        r""":math:`\alpha = (V_e / V_p^*)^2` of the first release [-]."""
        return (self.ejection_speed / self.peak_plate_speed) ** 2

    @property
    def last_energy_transfer(self) -> float:
        r""":math:`\alpha` of the last release [-]."""
        return (self.last_release.velocity / self.peak_plate_speed) ** 2

    @property
    def apex_height(self) -> float:
        """Highest position of the projectile's lower face, see `apex_height` [m]."""
        return apex_height(self.last_release, self.rig.gravity)

    @property
    def flight_height(self) -> float:
        """Height of the apex above where the projectile rested, infinite without gravity [m]."""
        return self.apex_height - self.rest_height

    def trajectory(self, time: ArrayLike, *, points: int = 2) -> Trajectory:
        """
        Return the motion at increasing times [s], following the throw again.

        The layer is read at so many `points` from plate to top, both included, at least 2.
        """
        time = np.atleast_1d(np.asarray(time, dtype=np.float64))
        stepper = make_stepper(self.rig, cells=self.cells, field_points=points)
        rows, layer = np.empty((time.size, 5)), np.empty((time.size, 4, points))
        for row, heights, moment in zip(rows, layer, time.tolist(), strict=True):
            stepper.advance_to(moment)
            heights[:] = stepper.read_layer()
            plate, projectile, plate_velocity, velocity = stepper.state[1:5]
            row[:] = plate, stepper.surface_position, projectile, plate_velocity, velocity
        depth = np.linspace(0.0, self.rig.layer.thickness, points)
        columns: Any = (time, *rows.T, depth, layer[:, 3], layer[:, 1])
        return Trajectory(*columns)


def simulate(
    rig: Rig, *, cells: int | None = None, until: float | None = None,
    cancelled: Cancelled | None = None,
) -> Throw:
    """
    Simulate a throw to its end, by travelling waves or, if the layer needs them, by cells.

    Parameters
    ----------
    rig : Rig
        The throwing rig.
    cells : int, optional
        Number of cells of a layer that needs them; by default for errors of 1e-4.
    until : float, optional
        Stop at this time. If not given, stop when the projectile has come down on the layer, since
        a lossless bounce has no end, or after half a second of computing. Where the projectile
        cannot come down until then, stop when it is far above every height that the free top
        reached in eight crossings and two periods of the plate. [s]
    cancelled : callable, optional
        See `batch.Cancelled`.

    Returns
    -------
    Throw

    Raises
    ------
    ThrowUnresolvedError
        If the rig cannot be stepped in real time, or the projectile is not released by `until`, or
        within 16 periods of the plate or of its own on the layer, or does not leave for good.
    ValueError
        If `cells` or `until` is out of range.
    SearchCancelledError
        If `cancelled` returns True.

    Examples
    --------
    >>> throw = simulate(Rig(layer=Layer(thickness=16.8e-3)))
    >>> round(throw.ejection_time * 1e3, 3), round(throw.energy_transfer, 3)
    (7.647, 3.637)

    The same gelatin with a loss tangent of 0.05:

    >>> layer = Layer(thickness=16.8e-3, loss_tangent=0.05)
    >>> round(simulate(Rig(layer=layer)).energy_transfer, 3)
    3.256

    """
    if until is not None:
        checks.require_all('until', until, 'positive')
    stepper, cells = _make_settled_stepper(rig, cells, cancelled)
    stepper.reset()
    _run(stepper, until, cancelled)
    events = tuple(stepper.events())
    end_time = float(stepper.state[TIME])
    if not events:
        largest = rig.engine.speed_scale * rig.engine.angular_frequency
        if rig.engine.motion is None and largest < rig.gravity:
            raise ThrowUnresolvedError(
                f"the plate's acceleration, at most {largest:.3g} m/s2, is below gravity, "
                f'{rig.gravity:g} m/s2, and the projectile stays on the layer'
            )
        raise ThrowUnresolvedError(
            f'the projectile is not released by {end_time:g} s; follow it for longer'
        )
    stepper.reset()
    stepper.advance_to(events[0].time)
    work, stored = stepper.plate_work, stepper.stored_energy()
    is_lossless = rig.layer.loss_tangent == 0.0 and rig.layer.stress_strain_law == 'linear'
    return Throw(
        rig=rig, cells=cells, rest_height=stepper.rest_position, events=events, end_time=end_time,
        loads=stepper.loads, plate_work=work, heat=0.0 if is_lossless else max(0.0, work - stored),
    )


def _run(stepper: Stepper, until: float | None, cancelled: Cancelled | None) -> None:
    """Go to the end of a throw as `simulate` defines it."""
    rig = stepper.rig
    affordable = max(_BUDGET / stepper.cost, 2.0 / rig.engine.frequency)
    latest = min(_LONGEST, affordable) if until is None else until
    quiet = _QUIET_CROSSINGS * rig.crossing_time + _QUIET_PERIODS / rig.engine.frequency
    tick = 0.25 / max(rig.engine.frequency, rig.natural_frequency)
    low = high = stepper.rest_position
    time, ticks, event_count = 0.0, 0, 0
    while time < latest:
        check_cancelled(cancelled)
        ticks += 1
        time = min(ticks * tick, latest)
        count = stepper.advance_to(time)
        if until is not None:
            continue
        surface = stepper.surface_position
        if count > event_count:
            event_count, last = count, stepper.events(count - 1)[0]
            if last.kind == 'landing':
                return
            low = high = surface
        low, high = min(low, surface), max(high, surface)
        if not count and time > rig.longest_wait:
            return
        if count and not stepper.in_contact and time - last.time > quiet:
            _, _, height, _, speed, _, _ = stepper.state.tolist()
            returns = rig.gravity > 0.0 and time + 2.0 * speed / rig.gravity <= latest
            if height - high > high - low and speed > 0.0 and not returns:
                return


Changes: TypeAlias = Mapping[str, Floats | float]
"""Other values of a rig by name: of engine and layer, `mass` of the projectile, `gravity` [SI]."""

_KINDS = {
    **{name: kind for name, kind in RANGES.items() if name != 'length'},
    **dict.fromkeys(('thickness', 'wave_speed', 'mass'), 'finite'),  # no layer, no throw: NaN
}
"""Names of `Changes`, and their ranges for `checks.require_all`."""

SEARCH_CELLS = 16
"""Cells of a layer with loss in a search: a sixth of the time of the default, and 1e-3 exact."""

RELEASED, HELD, REFUSED = range(3)
"""Values of `Throws.status`."""


class Throws(NamedTuple):
    """First releases and loads of many throws, arrays of one shape; NaN without a release."""

    ejection_time: Floats
    """:math:`t_e`. [s]"""
    ejection_speed: Floats
    """:math:`V_e`. [m/s]"""
    energy_transfer: Floats
    r""":math:`\alpha`. [-]"""
    peak_strain: Floats
    """Largest magnitude of the strain in the layer. [-]"""
    peak_acceleration: Floats
    """Largest magnitude of the projectile's acceleration. [m/s2]"""
    peak_plate_force: Floats
    """Largest magnitude of the layer's force on the plate. [N]"""
    plate_work: Floats
    """Work of the plate up to the release. [J]"""
    status: NDArray[np.int8]
    """
    `RELEASED`; `HELD` if no release was found; `REFUSED` if a thickness, a wave speed or a mass is
    not positive, or a throw that needs a stepper cannot be followed in time.
    """


def throw_many(
    rig: Rig, changes: Changes | None = None, *, loads: bool = False, cells: int | None = None,
    threads: int | None = None, cancelled: Cancelled | None = None,
) -> Throws:
    """
    Compute the first releases of a rig, or of rigs with other values.

    Throws without loss have the exact closed form, and waves for the loads. Cells compute those
    with loss, and steppers those of a sampled motion, or of cells without loss.

    Parameters
    ----------
    rig : Rig
        The throwing rig.
    changes : mapping of str to float or ndarray, optional
        Values that replace values of the rig; arrays broadcast against each other.
    loads : bool
        Whether strains, accelerations, forces and work are needed; they may be NaN otherwise.
    cells : int, optional
        Number of cells of layers that need them; chosen for errors of 1e-4 if not given.
    threads : int, optional
        Largest number of threads, all cores if not given. The number does not change the results.
    cancelled : callable, optional
        See `batch.Cancelled`.

    Returns
    -------
    Throws
        Arrays of the common shape.

    Raises
    ------
    ValueError
        If a change has an unknown name or is out of range.
    SearchCancelledError
        If `cancelled` returns True.

    """
    changes = changes or {}
    for name in changes.keys() - _KINDS.keys():
        raise ValueError(f'changes must be of {", ".join(_KINDS)}, got {name!r}')
    new = {name: checks.require_all(name, item, _KINDS[name]) for name, item in changes.items()}
    shape = np.broadcast_shapes(*map(np.shape, new.values()))
    given: dict[str, Any] = {**values_of(rig), **new}
    values = {name: np.broadcast_to(item, shape).ravel() for name, item in given.items()}
    exist = (values['thickness'] > 0.0) & (values['wave_speed'] > 0.0) & (values['mass'] > 0.0)
    status = np.where(exist, HELD, REFUSED)
    results = np.full((6, exist.size), math.nan)

    def selected(batch: NDArray[np.int64]) -> dict[str, Floats]:
        return {name: column[batch] for name, column in values.items()}

    def by_closed_form(batch: NDArray[np.int64]) -> None:
        own = selected(batch)
        scales = scales_of(own)
        phase, speed, _ = closed_form.first_releases(
            mass_ratio=scales.mass_ratio, speed_ratio=scales.speed_ratio, threads=1,
            damping_ratio=own['damping_ratio'], gravity_ratio=scales.gravity_ratio,
        )
        results[0, batch] = phase / own['frequency']
        results[1, batch] = speed * own['amplitude'] * scales.engine.angular_frequency
        if loads:
            known = batch[~np.isnan(phase)]
            results[2:, known] = wave_stepper.throw_batch(
                selected(known), until=results[0, known], cancelled=cancelled
            )[2:]

    def by_cells(batch: NDArray[np.int64]) -> None:
        results[:, batch] = cell_stepper.throw_batch(
            selected(batch), rig.layer, cells=cells, cancelled=cancelled
        )

    def by_steppers(batch: NDArray[np.int64]) -> None:
        for n in batch.tolist():
            changed = rig_with(rig, {name: values[name][n].item() for name in new})
            own_cells = cells if changed.layer.needs_cells else None
            try:
                stepper, _ = _make_settled_stepper(changed, own_cells, cancelled)
                release = stepper.advance_to_release(
                    latest=changed.longest_wait, cancelled=cancelled
                )
            except ThrowUnresolvedError:
                status[n] = REFUSED
                continue
            if release is not None:
                row = release.time, release.velocity, *stepper.loads, stepper.plate_work
                results[:, n] = row

    is_lossy, is_linear = values['loss_tangent'] > 0.0, rig.layer.stress_strain_law == 'linear'
    needs_cells = is_lossy | bool(rig.layer.parts or not is_linear)
    is_settled = is_lossy | (cells is not None)
    needs_stepper = (needs_cells & ~is_settled) | (rig.engine.motion is not None)
    for run, chosen, size in (  # of a batch, some milliseconds
        (by_closed_form, ~needs_stepper & ~needs_cells, 256),
        (by_cells, ~needs_stepper & needs_cells, 32),
        (by_steppers, needs_stepper, 8),
    ):
        run_batches(
            run, np.flatnonzero(chosen & exist), size=size, threads=threads, cancelled=cancelled
        )
    status[~np.isnan(results[0])] = RELEASED
    results[:, status != RELEASED] = math.nan  # loads without a release, which a method may have
    if rig.engine.motion is None:
        peak_speed = peak_velocity_ratio(values['damping_ratio'])
    else:
        peak_speed = rig.engine.motion.peak_velocity / rig.engine.speed_scale
    peak_speed = peak_speed * 2.0 * math.pi * values['frequency'] * values['amplitude']
    rows = np.insert(results, 2, (results[1] / peak_speed) ** 2, axis=0).reshape(7, *shape)
    numbers: Any = (*rows, status.astype(np.int8).reshape(shape))
    return Throws(*numbers)


def rig_with(rig: Rig, changes: Mapping[str, Any]) -> Rig:
    """Return a rig with other values; a stack and a motion of the plate change in proportion."""
    of_engine, of_layer = (
        {item.name: changes[item.name] for item in fields(kind) if item.name in changes}
        for kind in (Engine, Layer)
    )
    engine = replace(rig.engine, **of_engine)
    if engine.motion and (of_engine.keys() & {'frequency', 'amplitude'}):
        motion = engine.motion.scaled(
            time=rig.engine.frequency / engine.frequency,
            height=engine.amplitude / rig.engine.amplitude,
        )
        engine = replace(engine, motion=motion)
    return replace(
        rig,
        engine=engine,
        layer=replace(rig.layer, **of_layer),
        projectile=replace(rig.projectile, mass=changes.get('mass', rig.projectile.mass)),
        gravity=changes.get('gravity', rig.gravity),
    )
