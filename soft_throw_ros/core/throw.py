# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Throws: one with all its results, and the first releases and loads of many, in SI units."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from itertools import takewhile
import math
from typing import Any, NamedTuple, TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray
from soft_throw_ros.core import cell_stepper, checks, closed_form, wave_stepper
from soft_throw_ros.core.batch import Cancelled, check_cancelled, run_batches, ThrowUnresolvedError
from soft_throw_ros.core.kernels import Floats
from soft_throw_ros.core.plate import motion_of, peak_velocity_ratio
from soft_throw_ros.core.rig import RANGES, Rig, scales_of, values_of
from soft_throw_ros.core.stepper import Event, Loads, Stepper, TIME

_BUDGET = 0.5
"""Time of a processor after which a throw ends that `until` does not end. [s]"""

_LOSSLESS_CELLS, _SETTLED = (256, 512, 1024, 2048), 1e-4
"""
Numbers of cells of a lossless layer until time and speed of the release change by less than this;
fewer miss short releases. [-]
"""


def ejections(events: Iterable[Event]) -> tuple[Event, ...]:
    """Return the ejections: the releases before the projectile has come down on the layer."""
    before = takewhile(lambda event: event.kind != 'landing', events)
    return tuple(event for event in before if event.kind == 'release')


def apex_height(ejection: Event, gravity: float) -> float:
    """Compute how high the lower face flies, infinite without gravity [m]."""
    if gravity == 0.0:
        return math.inf
    return ejection.position + max(ejection.velocity, 0.0) ** 2 / (2.0 * gravity)


def make_stepper(rig: Rig, *, cells: int | None = None, **options: Any) -> Stepper:
    """
    Make a stepper: cells if the layer needs them, otherwise travelling waves.

    With the option `is_measured` the plate moves by `append_plate_states`, and not by the rig's
    engine; the layer is read at `field_points` heights, by default 64. ThrowUnresolvedError if the
    rig cannot be stepped in real time, ValueError if an option is out of range.
    """
    if rig.layer.needs_cells:
        return cell_stepper.CellStepper(rig, cells=cells, **options)
    if cells is not None:
        raise ValueError(f'cells are for layers that need them only, got {cells!r}')
    return wave_stepper.WaveStepper(rig, **options)


def _make_settled_stepper(
    rig: Rig, cells: int | None, cancelled: Cancelled | None
) -> tuple[Stepper, int | None]:
    """Make a stepper for results to 1e-4, and return the cells that settle a lossless release."""
    if cells is not None or not rig.layer.needs_cells or rig.layer.loss_tangent > 0.0:
        return make_stepper(rig, cells=cells, field_points=2), cells
    before = math.inf, math.inf
    for count in _LOSSLESS_CELLS:
        stepper = make_stepper(rig, cells=count, field_points=2)
        event = stepper.advance_to_release(latest=rig.longest_wait, cancelled=cancelled)
        now = (event.time, event.velocity) if event else (math.nan, math.nan)
        if np.allclose(now, before, rtol=_SETTLED, atol=0.0, equal_nan=True):
            break
        before = now
    return stepper, count


@dataclass(frozen=True, kw_only=True)
class Throw:
    """
    Result of one throw. Made by `simulate`.

    Times count from the start of the plate's motion, heights from the plate's rest position; loads
    and energies are those up to the first release.
    """

    rig: Rig
    cells: int | None = field(repr=False)
    events: tuple[Event, ...]
    """Releases, re-contacts and landings in order; the first one is the first release."""
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
    def apex_height(self) -> float:
        """Highest position of the projectile's lower face, see `apex_height` [m]."""
        return apex_height(self.last_release, self.rig.gravity)

    @property
    def flight_height(self) -> float:
        """Height of the apex above where the projectile rested, infinite without gravity [m]."""
        return self.apex_height - self.rig.rest_height

    def trajectory(self, time: ArrayLike, *, points: int = 2) -> tuple[Floats, Floats]:
        """
        Return the states and the layer at increasing times [s], following the throw again.

        The rows are `Stepper.state` and, at `points` from plate to top, `Stepper.read_layer`; the
        shapes are (n, 7) and (n, 4, points).
        """
        times = np.atleast_1d(np.asarray(time, dtype=np.float64))
        stepper = make_stepper(self.rig, cells=self.cells, field_points=points)
        states, layers = np.empty((times.size, 7)), np.empty((times.size, 4, points))
        for state, layer, moment in zip(states, layers, times.tolist(), strict=True):
            stepper.advance_to(moment)
            state[:], layer[:] = stepper.state, stepper.read_layer()
        return states, layers


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
        Stop at this time [s]. If not given, stop when the projectile has come down on the layer,
        since a lossless bounce has no end, or after half a second of computing; without gravity
        also after 16 periods of the plate or of the projectile on the layer without an event.
    cancelled : callable, optional
        See `batch.Cancelled`.

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
    The paper's rig, with gelatin that has a loss tangent of 0.05:

    >>> from soft_throw_ros.core import Layer
    >>> throw = simulate(Rig(layer=Layer(thickness=16.8e-3, loss_tangent=0.05)))
    >>> round(throw.ejection_time * 1e3, 3), round(throw.energy_transfer, 3)
    (7.336, 3.256)

    """
    if until is not None:
        checks.require_all('until', until, 'positive')
    stepper, cells = _make_settled_stepper(rig, cells, cancelled)
    stepper.reset()
    _run(stepper, until, cancelled)
    events = tuple(stepper.events())
    if not events:
        largest = rig.engine.speed_scale * rig.engine.angular_frequency
        end, remedy = stepper.state[TIME], 'follow it for longer'
        if rig.engine.motion is None and largest < rig.gravity:
            remedy = f"the plate's acceleration, at most {largest:.3g} m/s2, is below gravity"
        raise ThrowUnresolvedError(f'the projectile is not released by {end:g} s; {remedy}')
    stepper.reset()
    stepper.advance_to(events[0].time)
    work, stored = stepper.plate_work, stepper.stored_energy()
    is_lossless = rig.layer.loss_tangent == 0.0 and rig.layer.stress_strain_law == 'linear'
    return Throw(
        rig=rig, cells=cells, events=events, loads=stepper.loads, plate_work=work,
        heat=0.0 if is_lossless else max(0.0, work - stored),
    )


def _run(stepper: Stepper, until: float | None, cancelled: Cancelled | None) -> None:
    """Go to the end of a throw as `simulate` defines it."""
    rig = stepper.rig
    latest = until or max(_BUDGET / stepper.cost, 2.0 / rig.engine.frequency)
    tick = 0.25 / max(rig.engine.frequency, rig.natural_frequency)
    time = last_time = 0.0
    while time < latest:
        check_cancelled(cancelled)
        time = min(time + tick, latest)
        count = stepper.advance_to(time)
        if until is not None:
            continue
        if count:
            last = stepper.events(count - 1)[0]
            last_time = last.time
            if last.kind == 'landing':
                return
        if time - last_time > rig.longest_wait and not (count and rig.gravity):
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
    r"""
    First releases and loads of many throws, arrays of one shape; NaN without a release.

    Times [s], speeds [m/s] and :math:`\alpha` [-] of the releases; until then the largest
    magnitudes of strain [-], of acceleration of the projectile [m/s2] and of force on the plate
    [N], and the work of the plate [J]. The status is `RELEASED`; `HELD` if no release was found;
    `REFUSED` if a thickness, a wave speed or a mass is not positive, or a throw that needs a
    stepper cannot be followed in time.
    """

    ejection_time: Floats
    ejection_speed: Floats
    energy_transfer: Floats
    peak_strain: Floats
    peak_acceleration: Floats
    peak_plate_force: Floats
    plate_work: Floats
    status: NDArray[np.int8]


def throw_many(
    rig: Rig, changes: Changes | None = None, *, loads: bool = False, cells: int | None = None,
    cancelled: Cancelled | None = None,
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
        rigs, own = scales_of(selected(batch)), np.empty((2, batch.size))
        zeta = rigs.engine.damping_ratio
        ratios = np.stack((rigs.mass_ratio, rigs.speed_ratio, zeta, rigs.gravity_ratio))
        closed_form.release_series(ratios, own, 0, batch.size)
        results[0, batch] = own[0] / rigs.engine.frequency
        results[1, batch] = own[1] * rigs.engine.amplitude * rigs.engine.angular_frequency
        if loads:
            known = batch[~np.isnan(own[0])]
            waves = wave_stepper.throw_batch(selected(known), results[0, known], cancelled)
            results[2:, known] = waves[2:]

    def by_cells(batch: NDArray[np.int64]) -> None:
        results[:, batch] = cell_stepper.throw_batch(selected(batch), rig.layer, cells, cancelled)

    def by_steppers(batch: NDArray[np.int64]) -> None:
        for n in batch.tolist():
            other = rig_with(rig, {name: values[name][n].item() for name in new})
            own_cells = cells if other.layer.needs_cells else None
            try:
                stepper, _ = _make_settled_stepper(other, own_cells, cancelled)
                event = stepper.advance_to_release(latest=other.longest_wait, cancelled=cancelled)
            except ThrowUnresolvedError:
                status[n] = REFUSED
                continue
            if event:
                results[:, n] = event.time, event.velocity, *stepper.loads, stepper.plate_work

    is_lossy = values['loss_tangent'] > 0.0
    has_cells = is_lossy | bool(rig.layer.parts) | (rig.layer.stress_strain_law != 'linear')
    has_stepper = (has_cells & ~is_lossy & (cells is None)) | (rig.engine.motion is not None)
    for run, chosen, size in (  # of a batch, some milliseconds
        (by_closed_form, ~has_stepper & ~has_cells, 256),
        (by_cells, ~has_stepper & has_cells, 128),
        (by_steppers, has_stepper, 8),
    ):
        run_batches(run, np.flatnonzero(chosen & exist), size=size, cancelled=cancelled)
    status[~np.isnan(results[0])] = RELEASED
    results[:, status != RELEASED] = math.nan  # loads without a release, which a method may have
    motion, zeta = rig.engine.motion, values['damping_ratio']
    peak = motion.peak_velocity / rig.engine.speed_scale if motion else peak_velocity_ratio(zeta)
    peak_speed = peak * 2.0 * math.pi * values['frequency'] * values['amplitude']
    rows = np.insert(results, 2, (results[1] / peak_speed) ** 2, axis=0).reshape(7, *shape)
    numbers: Any = (*rows, status.astype(np.int8).reshape(shape))
    return Throws(*numbers)


def rig_with(rig: Rig, changes: Mapping[str, Any]) -> Rig:
    """Return a rig with other values; a stack and a motion of the plate change in proportion."""
    parts: Iterable[Any] = (rig.engine, rig.layer, rig.projectile)
    engine, layer, projectile = (
        replace(part, **{name: changes[name] for name in vars(part).keys() & changes.keys()})
        for part in parts
    )
    if engine.motion and engine != rig.engine:
        motion = engine.motion.scaled(
            time=rig.engine.frequency / engine.frequency,
            height=engine.amplitude / rig.engine.amplitude,
        )
        engine = replace(engine, motion=motion)
    gravity = changes.get('gravity', rig.gravity)
    return Rig(engine=engine, layer=layer, projectile=projectile, gravity=gravity)
