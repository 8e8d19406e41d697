# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
Throws: one with all its results, and the first releases and loads of many, in SI units.

Of many throws, those without loss have the exact closed form; steppers compute throws with loss or
strong gravity, and loads. The method of a release is the same with and without loads; otherwise
the release of a layer near a discontinuity could jump when its loads are computed.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from functools import partial
from itertools import takewhile
import math
from typing import Any, NamedTuple, TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray
from soft_throw_ros.core import cell_stepper, checks, closed_form, wave_stepper
from soft_throw_ros.core.batch import (
    Cancelled,
    check_cancelled,
    run_batches,
    ThrowUnresolvedError,
)
from soft_throw_ros.core.plate import motion_of, peak_velocity_ratio, PlateMotion
from soft_throw_ros.core.rig import Engine, Layer, RANGES, Rig, scales_of, values_of
from soft_throw_ros.core.stepper import (
    Event,
    EventLimitError,
    Loads,
    MAX_EVENTS,
    PROJECTILE_POSITION,
    PROJECTILE_VELOCITY,
    RateError,
    Stepper,
    TIME,
)

Floats = NDArray[np.float64]

MAX_DURATION = 60.0
"""Longest that a throw is followed if nothing else ends it. [s]"""

_BUDGET = 0.5
"""Processor time after which a throw ends that `until` does not end. [s]"""

_QUIET_CROSSINGS, _QUIET_PERIODS = 8.0, 2.0
"""Crossings plus periods after a release that show how far up the free top swings."""

_LOSSLESS_CELLS, _MAX_CELLS = 256, 2048
"""Cells of lossless sheets between which the step is halved; fewer miss short releases. [-]"""

_HALVING = 1e-4
"""Largest relative change of time and speed at which halving the step ends. [-]"""


class ThrowUnfinishedError(RuntimeError):
    """The time given ended before the projectile was released."""


class Energies(NamedTuple):
    """
    Work of the plate, energy stored in layer and projectile, and heat [J].

    The heat is the difference, 0 for a layer that is linear and lossless.
    """

    plate_work: float
    stored: float
    heat: float


class Trajectory(NamedTuple):
    """Positions [m] and velocities [m/s] over `time` [s], arrays of one shape; z up."""

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
    layer is read at `field_points` heights. ValueError if the rig cannot be stepped in real time,
    or an option is out of range.
    """
    options: dict[str, Any] = {'is_measured': is_measured, 'field_points': field_points}
    if rig.layer.needs_cells:
        return cell_stepper.CellStepper(rig, cells=cells, **options)
    if cells is not None:
        raise ValueError(f'cells are for layers that need them only, got {cells!r}')
    return wave_stepper.WaveStepper(rig, **options)


def make_settled_stepper(
    rig: Rig, *, cells: int | None, field_points: int = 64, cancelled: Cancelled | None
) -> tuple[Stepper, int | None]:
    """
    Make a stepper for results to 1e-4, and return its number of cells, too.

    Nothing smooths the waves in sheets without loss, whose boundaries are between two steps. There
    the step is halved until the first release settles, and the stepper stands after it.
    """
    if cells is not None or not rig.layer.parts or rig.layer.loss_tangent > 0.0:
        return make_stepper(rig, cells=cells, field_points=field_points), cells
    before: tuple[float, float] | None = None
    cells, latest = _LOSSLESS_CELLS, rig.longest_wait
    while True:
        stepper = make_stepper(rig, cells=cells, field_points=field_points)
        event = stepper.advance_to_release(latest=latest, cancelled=cancelled)
        now = (math.nan, math.nan) if event is None else (event.time, event.velocity)
        is_settled = before is not None and np.allclose(
            now, before, rtol=_HALVING, atol=0.0, equal_nan=True
        )
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
    """Releases, re-contacts and landings in order; the first is a release."""
    end_time: float
    """Time until which it was followed. [s]"""
    loads: Loads
    energies: Energies

    @property
    def motion(self) -> PlateMotion:
        """Motion of the plate."""
        return motion_of(self.rig.engine)

    @property
    def peak_plate_speed(self) -> float:
        """:math:`V_p^*` [m/s]."""
        return self.motion.peak_velocity

    @property
    def peak_strain(self) -> float:
        """Largest strain magnitude in the layer [-]."""
        return self.loads.strain

    @property
    def ejections(self) -> tuple[Event, ...]:
        """Releases before the projectile has come down on the layer."""
        return ejections(self.events)

    @property
    def first_release(self) -> Event:
        """Event at which the projectile first leaves the layer."""
        return self.ejections[0]

    @property
    def last_release(self) -> Event:
        """Event at which it leaves for the last time, after all re-contacts that were followed."""
        return self.ejections[-1]

    @property
    def recontacts(self) -> int:
        """Number of re-contacts between the two."""
        return len(self.ejections) - 1

    @property
    def ejection_time(self) -> float:
        """:math:`t_e` of the first release [s]."""
        return self.first_release.time

    @property
    def ejection_speed(self) -> float:
        """:math:`V_e` of the first release [m/s]."""
        return self.first_release.velocity

    @property
    def energy_transfer(self) -> float:
        r""":math:`\alpha = (V_e / V_p^*)^2` of the first release [-]."""
        return (self.ejection_speed / self.peak_plate_speed) ** 2

    @property
    def last_energy_transfer(self) -> float:
        r""":math:`\alpha` of the last release [-]."""
        return (self.last_release.velocity / self.peak_plate_speed) ** 2

    @property
    def leaves_linear_range(self) -> bool:
        """Whether the peak strain is so large that the result is doubtful."""
        return self.peak_strain > self.rig.layer.linear_range

    @property
    def apex_height(self) -> float:
        """Highest position of the projectile's lower face, see `apex_height` [m]."""
        return apex_height(self.last_release, self.rig.gravity)

    def trajectory(self, time: ArrayLike) -> Trajectory:
        """Return positions and velocities at increasing times [s], following the throw again."""
        time = np.atleast_1d(np.asarray(time, dtype=np.float64))
        stepper = self._stepper()
        rows = np.empty((time.size, 5))
        for row, moment in zip(rows, time.tolist(), strict=True):
            stepper.advance_to(moment)
            plate, projectile, plate_velocity, velocity = stepper.state[1:5]
            row[:] = plate, stepper.surface_position, projectile, plate_velocity, velocity
        return Trajectory(time, *rows.T)

    def fields(self, time: ArrayLike, *, points: int = 64) -> Fields:
        """
        Return strain and velocity of the layer at increasing times [s], following the throw again.

        There are so many `points` from plate to top, both included, at least 2.
        """
        time = np.atleast_1d(np.asarray(time, dtype=np.float64))
        stepper = self._stepper(points)
        strain, velocity = np.empty((2, time.size, points))
        layer = np.empty((4, points))
        for row, moment in enumerate(time.tolist()):
            stepper.advance_to(moment)
            stepper.read_layer(layer)
            velocity[row], strain[row] = layer[1], layer[3]
        depth = np.linspace(0.0, self.rig.layer.thickness, points)
        return Fields(time, depth, strain, velocity)

    def _stepper(self, points: int = 2) -> Stepper:
        return make_stepper(self.rig, cells=self.cells, field_points=points)


def simulate(
    rig: Rig,
    *,
    cells: int | None = None,
    until: float | None = None,
    max_events: int | None = None,
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
        Stop at this time. [s]
    max_events : int, optional
        Stop after so many events. If not given, and neither is `until`, stop when the projectile
        has come down on the layer, since a lossless bounce has no end. Without gravity, or if the
        simulation until then would take more than about half a second, stop when the projectile
        is far above every height that the free top reached in eight crossings and two periods of
        the plate.
    cancelled : callable, optional
        See `batch.Cancelled`.

    Returns
    -------
    Throw

    Raises
    ------
    ValueError
        If the rig cannot be stepped in real time, or a bound is out of range.
    ThrowUnfinishedError
        If the projectile is not released by `until`, or within 16 periods of the plate or of its
        own on the layer.
    SearchCancelledError
        If `cancelled` returns True.

    Notes
    -----
    `wave_stepper.steps_per_crossing` and `cell_stepper.cells_per_layer` give the errors.

    Examples
    --------
    >>> from soft_throw_ros.core.rig import Layer, Rig
    >>> throw = simulate(Rig(layer=Layer(thickness=16.8e-3)))
    >>> round(throw.ejection_time * 1e3, 3), round(throw.energy_transfer, 3)
    (7.647, 3.637)

    The same gelatin with a loss tangent of 0.05:

    >>> layer = Layer(thickness=16.8e-3, loss_tangent=0.05)
    >>> round(simulate(Rig(layer=layer)).energy_transfer, 3)
    3.256

    """
    if until is not None:
        checks.require_positive('until', until)
    if max_events is not None and not 1 <= max_events <= MAX_EVENTS:
        raise ValueError(f'max_events must be from 1 to {MAX_EVENTS}, got {max_events}')
    stepper, cells = make_settled_stepper(rig, cells=cells, cancelled=cancelled)
    stepper.reset()
    _run(stepper, until, max_events, cancelled)
    events = tuple(stepper.events()[:max_events])
    end_time = float(stepper.state[TIME])
    if not events:
        largest = rig.engine.speed_scale * rig.engine.angular_frequency
        if rig.engine.motion is None and largest < rig.gravity:
            raise ThrowUnfinishedError(
                f"the plate's acceleration, at most {largest:.3g} m/s2, is below gravity, "
                f'{rig.gravity:g} m/s2, and the projectile stays on the layer'
            )
        raise ThrowUnfinishedError(
            f'the projectile is not released by {end_time:g} s; follow it for longer'
        )
    stepper.reset()
    stepper.advance_to(events[0].time)
    work, stored = stepper.plate_work, stepper.stored_energy()
    is_lossless = rig.layer.loss_tangent == 0.0 and rig.layer.stress_strain_law == 'linear'
    heat = 0.0 if is_lossless else max(0.0, work - stored)
    return Throw(
        rig=rig, cells=cells, rest_height=stepper.rest_position, events=events, end_time=end_time,
        loads=stepper.loads, energies=Energies(work, stored, heat),
    )


def _run(
    stepper: Stepper, until: float | None, max_events: int | None, cancelled: Cancelled | None
) -> None:
    """Go to the end of a throw as `simulate` defines it."""
    rig = stepper.rig
    latest = MAX_DURATION if until is None else until
    wait, affordable = rig.longest_wait, max(_BUDGET / stepper.cost, 2.0 / rig.engine.frequency)
    quiet = _QUIET_CROSSINGS * rig.crossing_time + _QUIET_PERIODS / rig.engine.frequency
    tick = 0.25 / max(rig.engine.frequency, rig.natural_frequency)
    low = high = stepper.rest_position
    time, ticks, event_count = 0.0, 0, 0
    while time < latest and (max_events is None or event_count < max_events):
        check_cancelled(cancelled)
        ticks += 1
        time = min(ticks * tick, latest)
        count = stepper.advance_to(time)
        if count > event_count:
            last = stepper.events(event_count)[-1]
            event_count = count
            low = high = stepper.surface_position
            if last.kind == 'landing' and max_events is None and until is None:
                return
        if until is not None:
            continue
        if time > affordable or (not event_count and time > wait):
            return
        low, high = min(low, stepper.surface_position), max(high, stepper.surface_position)
        if event_count and not stepper.in_contact and time - last.time > quiet:
            rise, speed = stepper.state[PROJECTILE_POSITION], stepper.state[PROJECTILE_VELOCITY]
            is_out_of_reach = rise - high > high - low and speed > 0.0
            if is_out_of_reach and (
                rig.gravity == 0.0 or time + 2.0 * speed / rig.gravity > min(affordable, latest)
            ):
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

STRONG_GRAVITY = 0.2
"""Gravity over the plate's acceleration beyond which the closed form slows down. [-]"""

_LIGHT = 1.0 / 64.0
"""
Projectile over layer mass below which strong gravity does not exclude the closed form. [-]

It may leave and be caught again between two of the 512 steps that waves cross a layer in.
"""

_HOLDING_GRAVITY = 4.0
r"""
Gravity over the plate's acceleration that holds every projectile on a stiff layer. [-]

On a spring the acceleration is :math:`2 q^2 / (q^2 - 1)` times the plate's at most, 2.7 for
frequencies :math:`q \ge 2` times the plate's. Waves increase it; 3.1 is the largest seen.
"""

_BATCHES = {
    'closed_form': 1 << 14, 'loads': 256, 'light': 64, 'waves': 256, 'cells': 32, 'steppers': 8,
}
"""Throws that a thread computes at once by each method: some milliseconds. [-]"""

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
    not positive, or a rig with a sampled motion cannot be stepped in time.
    """


def throw_many(
    rig: Rig | Sequence[Rig],
    changes: Changes | None = None,
    *,
    loads: bool = False,
    cells: int | None = None,
    threads: int | None = None,
    cancelled: Cancelled | None = None,
) -> Throws:
    """
    Compute the first releases of rigs, or of a rig with other values.

    Parameters
    ----------
    rig : Rig or sequence of Rig
        Several rigs may differ in the values of `Changes` only; in everything if a plate has a
        sampled motion.
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
        If there is no rig, rigs differ in more than the values of `Changes`, or a change has an
        unknown name or is out of range.
    SearchCancelledError
        If `cancelled` returns True.

    """
    changes = changes or {}
    for name in changes.keys() - _KINDS.keys():
        raise ValueError(f'changes must be of {", ".join(_KINDS)}, got {name!r}')
    new = {name: checks.require_all(name, item, _KINDS[name]) for name, item in changes.items()}
    rigs = [rig] if isinstance(rig, Rig) else list(rig)
    is_sampled = any(single.engine.motion for single in rigs)
    kinds = {
        (len(layer.parts), layer.stress_strain_law, layer.loss)
        for layer in (single.layer for single in rigs)
    }
    if not is_sampled and len(kinds) != 1:
        raise ValueError(
            f'rigs must differ in the values of `Changes` only, got {len(kinds)} kinds of layers'
        )
    tables = [values_of(single) for single in rigs]
    given = {name: np.array([table[name] for table in tables]) for name in tables[0]}
    given = {**given, 'rig': np.arange(len(rigs))}
    if isinstance(rig, Rig):
        given = {name: column[0] for name, column in given.items()}
    given.update(new)
    shape = np.broadcast_shapes(*map(np.shape, given.values()))
    values = {name: np.broadcast_to(item, shape).ravel() for name, item in given.items()}
    exist = (values['thickness'] > 0.0) & (values['wave_speed'] > 0.0) & (values['mass'] > 0.0)
    status = np.where(exist, HELD, REFUSED)
    peak_speed = 2.0 * math.pi * values['frequency'] * values['amplitude']
    peak_speed *= peak_velocity_ratio(values['damping_ratio'])
    results = np.full((6, exist.size), math.nan)

    def follow(batch: NDArray[np.int64]) -> None:
        for n in batch.tolist():
            changed = {name: values[name][n].item() for name in new}
            single = rig_with(rigs[values['rig'][n]], changed)
            peak_speed[n] = motion_of(single.engine).peak_velocity
            try:
                results[:, n] = _follow_one(single, cells, cancelled)
            except (RateError, EventLimitError):
                status[n] = REFUSED

    def compute(method: str, batch: NDArray[np.int64]) -> None:
        selected = {name: column[batch] for name, column in values.items()}
        if method == 'cells':
            rows = cell_stepper.throw_batch(
                selected, rigs[0].layer, cells=cells, cancelled=cancelled
            )
        elif method == 'waves':
            rows = wave_stepper.throw_batch(selected, cancelled=cancelled)
        else:
            rows = _throw_by_closed_form(selected, loads, cancelled)
        results[:, batch] = rows

    methods = {'steppers': exist} if is_sampled else _methods(rigs[0].layer, values, cells)
    for method, chosen in methods.items():
        run_batches(
            follow if method == 'steppers' else partial(compute, method),
            np.flatnonzero(chosen & exist),
            size=_BATCHES['loads' if loads and method == 'closed_form' else method],
            threads=threads, cancelled=cancelled,
        )
    status[~np.isnan(results[0])] = RELEASED
    results[:, status != RELEASED] = math.nan  # loads without a release, which a method may have
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


def _methods(
    layer: Layer, values: Mapping[str, Floats], cells: int | None
) -> dict[str, NDArray[np.bool_]]:
    """Return the throws that each method computes."""
    scales, loss = scales_of(values), values['loss_tangent']
    mu, gravity = scales.mass_ratio, scales.gravity_ratio
    with np.errstate(invalid='ignore', divide='ignore'):  # layers that do not exist
        # about the lowest frequency of projectile and layer over the plate's
        q = scales.speed_ratio / (2.0 * math.pi * np.sqrt(np.abs(mu) + 4.0 / math.pi**2))
    moves = (q <= 2.0) | (gravity <= _HOLDING_GRAVITY)
    is_strong = gravity > STRONG_GRAVITY
    needs_cells = (loss > 0.0) | replace(layer, loss_tangent=0.0).needs_cells
    is_settled = (loss > 0.0) | (cells is not None or not layer.parts)
    return {
        'closed_form': moves & ~needs_cells & ~is_strong,
        'light': moves & ~needs_cells & is_strong & (mu < _LIGHT),
        'waves': moves & ~needs_cells & is_strong & (mu >= _LIGHT),
        'cells': moves & needs_cells & is_settled,
        'steppers': moves & ~is_settled,
    }


def _throw_by_closed_form(
    values: Mapping[str, Floats], loads: bool, cancelled: Cancelled | None
) -> Floats:
    """
    Compute rows as of `cell_stepper.throw_batch` by the closed form, and loads by waves.

    Under strong gravity waves also find the releases that the closed form gives up on.
    """
    scales = scales_of(values)
    phase, speed, _ = (np.asarray(row) for row in closed_form.first_releases(
        mass_ratio=scales.mass_ratio, speed_ratio=scales.speed_ratio,
        damping_ratio=values['damping_ratio'], gravity_ratio=scales.gravity_ratio, threads=1,
    ))
    results = np.full((6, phase.size), math.nan)
    results[0] = phase / values['frequency']
    results[1] = speed * values['amplitude'] * scales.angular_frequency
    unresolved = np.isnan(phase) & (scales.gravity_ratio > STRONG_GRAVITY)
    chosen = unresolved | (loads and ~np.isnan(phase))
    waves = wave_stepper.throw_batch(
        {name: column[chosen] for name, column in values.items()}, until=results[0, chosen],
        cancelled=cancelled,
    )
    results[2:, chosen] = waves[2:]
    results[:, unresolved] = waves[:, unresolved[chosen]]
    return results


def _follow_one(rig: Rig, cells: int | None, cancelled: Cancelled | None) -> tuple[float, ...]:
    """Compute a row as of `cell_stepper.throw_batch` with a stepper."""
    cells = cells if rig.layer.needs_cells else None
    stepper, _ = make_settled_stepper(rig, cells=cells, field_points=2, cancelled=cancelled)
    release = stepper.advance_to_release(latest=rig.longest_wait, cancelled=cancelled)
    if release is None:
        return (math.nan,) * 6
    loads = stepper.loads
    return (
        release.time, release.velocity, loads.strain, loads.acceleration, loads.plate_force,
        stepper.plate_work,
    )


class LastRelease(NamedTuple):
    """Time and speed at which a projectile leaves for good, and its flight."""

    time: float
    """Since the start of the plate's motion. [s]"""
    speed: float
    """[m/s]"""
    height: float
    """Of its apex above where it rested on the layer; infinite without gravity. [m]"""


def last_release(rig: Rig, *, cancelled: Cancelled | None = None) -> LastRelease:
    """
    Follow one throw until the projectile has left for good.

    ThrowUnresolvedError if the projectile does not leave, or cannot be followed;
    SearchCancelledError if `cancelled` returns True.

    Examples
    --------
    >>> last = last_release(Rig())
    >>> round(last.speed, 4), round(1e3 * last.height, 2)
    (1.375, 100.51)

    """
    try:
        throw = simulate(rig, cancelled=cancelled)
    except (ValueError, EventLimitError, ThrowUnfinishedError) as error:
        raise ThrowUnresolvedError(f'the last release is unknown: {error}') from error
    last = throw.last_release
    return LastRelease(last.time, last.velocity, throw.apex_height - throw.rest_height)
