# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
First releases and loads of many throws, in SI units, by a suitable method for each throw.

Without loss the closed form is exact; steppers compute throws with loss or strong gravity, and
loads. The method of a release is the same with and without loads; otherwise the release of a layer
near a discontinuity could jump when its loads are computed.
"""

from __future__ import annotations

from collections.abc import Hashable, Iterator, Mapping, Sequence
from dataclasses import fields, replace
import math
from typing import Any, NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray
from soft_throw_ros.core import cell_stepper, checks, closed_form, wave_stepper
from soft_throw_ros.core.batch import (
    Cancelled,
    check_cancelled,
    in_threads,
    ThrowUnresolvedError,
)
from soft_throw_ros.core.cell_stepper import settled_cells
from soft_throw_ros.core.plate import motion_of, peak_velocity_ratios
from soft_throw_ros.core.rig import Engine, Layer, Rig, Scales, scales_of, values_of
from soft_throw_ros.core.stepper import EventLimitError, RateError
from soft_throw_ros.core.throw import make_stepper, simulate, ThrowUnfinishedError

Floats = NDArray[np.float64]

Changes: TypeAlias = Mapping[str, Floats | float]
"""Other values of a rig by name: of engine and layer, `mass` of the projectile, `gravity` [SI]."""

_KINDS = {
    **dict.fromkeys(('frequency', 'amplitude', 'density', 'diameter'), 'positive'),
    **dict.fromkeys(('loss_tangent', 'gravity'), 'not_negative'),
    **dict.fromkeys(('thickness', 'wave_speed', 'mass'), 'finite'),  # no layer, no throw: NaN
    'damping_ratio': 'in_unit_interval',
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

_BATCHES = {'closed_form': 1 << 16, 'light': 1 << 5, 'waves': 1 << 10, 'cells': 1 << 10}
"""Throws per batch by method: some tenths of a second. [-]"""

_NUMBERS = 7
"""Number of the results of a throw besides its status."""

_WAIT = 8.0
"""Longest wait for a release after a sampled motion, in periods of plate and projectile. [-]"""


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
    changes = checked = _checked(changes or {})
    if any(single.engine.motion for single in ([rig] if isinstance(rig, Rig) else rig)):
        return _throw_sampled(rig, checked, cells, threads, cancelled)
    if not isinstance(rig, Rig):
        kinds = {_kind_of(single) for single in rig}
        if len(kinds) != 1:
            raise ValueError(
                'rigs must differ in the values of `Changes` only, got '
                f'{len(kinds)} kinds of layers'
            )
        tables = [values_of(single) for single in rig]
        columns = {name: np.array([row[name] for row in tables]) for name in tables[0]}
        changes = {**columns, **changes}
        rig = rig[0]
    given: dict[str, Any] = {**values_of(rig), **changes}
    shape = np.broadcast_shapes(*map(np.shape, given.values()))
    values = {name: np.broadcast_to(item, shape).ravel() for name, item in given.items()}
    scales = scales_of(values)
    exist = (values['thickness'] > 0.0) & (values['wave_speed'] > 0.0) & (values['mass'] > 0.0)
    results = np.full((_NUMBERS, exist.size), math.nan)
    for name, chosen in _methods(rig, values, scales).items():
        for batch in _batches(chosen & exist, _BATCHES[name], cancelled):
            selected = {name: column[batch] for name, column in values.items()}
            if name == 'cells':
                rows = cell_stepper.throw_batch(
                    selected, rig.layer, cells=cells, threads=threads, cancelled=cancelled
                )
            elif name == 'waves':
                rows = wave_stepper.throw_batch(selected, threads=threads, cancelled=cancelled)
            else:
                rows = _throw_by_closed_form(selected, loads, threads, cancelled)
            results[[0, 1, 3, 4, 5, 6], batch[:, None]] = rows.T
    peak_speed = values['amplitude'] * scales.angular_frequency
    results[2] = (results[1] / (peak_speed * peak_velocity_ratios(values['damping_ratio']))) ** 2
    return _throws(results, np.where(exist, HELD, REFUSED), shape)


def _throws(results: Floats, status: NDArray[np.int64], shape: tuple[int, ...]) -> Throws:
    """Return the results of throws; no loads without a release, which a method may have."""
    status = np.where(np.isnan(results[0]), status, RELEASED)
    results[1:, status != RELEASED] = math.nan
    numbers: Any = (*results.reshape(_NUMBERS, *shape), status.astype(np.int8).reshape(shape))
    return Throws(*numbers)


def _checked(changes: Changes) -> dict[str, Floats]:
    """Return changes as arrays, or raise ValueError."""
    for name in changes.keys() - _KINDS.keys():
        raise ValueError(f'changes must be of {", ".join(_KINDS)}, got {name!r}')
    return {name: checks.require_all(name, item, _KINDS[name]) for name, item in changes.items()}


def _kind_of(rig: Rig) -> tuple[Hashable, ...]:
    """Return the properties of a rig that are no values of `Changes`."""
    return len(rig.layer.parts), rig.layer.stress_strain_law, rig.layer.loss


def rig_with(rig: Rig, changes: Mapping[str, float]) -> Rig:
    """
    Return a rig with other values.

    Parameters
    ----------
    rig : Rig
        Sheets of a stack, and a motion of the plate, change in proportion to the whole.
    changes : mapping of str to float
        See `Changes`.

    """
    of_engine = _of(Engine, changes)
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
        layer=replace(rig.layer, **_of(Layer, changes)),
        projectile=replace(rig.projectile, mass=changes.get('mass', rig.projectile.mass)),
        gravity=changes.get('gravity', rig.gravity),
    )


def _of(kind: type[Engine] | type[Layer], changes: Mapping[str, float]) -> dict[str, Any]:
    """Return the changes of an engine or of a layer."""
    return {item.name: changes[item.name] for item in fields(kind) if item.name in changes}


def _batches(
    chosen: NDArray[np.bool_], size: int, cancelled: Cancelled | None
) -> Iterator[NDArray[np.int64]]:
    """Yield the indices of batches; raise before one if the search is cancelled."""
    indices = np.flatnonzero(chosen)
    for start in range(0, indices.size, size):
        check_cancelled(cancelled)
        yield indices[start:start + size]


def _methods(
    rig: Rig, values: Mapping[str, Floats], scales: Scales
) -> dict[str, NDArray[np.bool_]]:
    """Return the throws that each method computes."""
    mu, gravity = scales.mass_ratio, scales.gravity_ratio
    with np.errstate(invalid='ignore', divide='ignore'):  # layers that do not exist
        # about the lowest frequency of projectile and layer over the plate's
        q = scales.speed_ratio / (2.0 * math.pi * np.sqrt(np.abs(mu) + 4.0 / math.pi**2))
    moves = (q <= 2.0) | (gravity <= _HOLDING_GRAVITY)
    is_strong = gravity > STRONG_GRAVITY
    layer = replace(rig.layer, loss_tangent=0.0)
    needs_cells = (values['loss_tangent'] > 0.0) | layer.needs_cells
    return {
        'closed_form': moves & ~needs_cells & ~is_strong,
        'light': moves & ~needs_cells & is_strong & (mu < _LIGHT),
        'waves': moves & ~needs_cells & is_strong & (mu >= _LIGHT),
        'cells': moves & needs_cells,
    }


def _throw_by_closed_form(
    values: Mapping[str, Floats], loads: bool, threads: int | None, cancelled: Cancelled | None
) -> Floats:
    """
    Compute rows as of `cell_stepper.throw_batch` by the closed form, and loads by waves.

    Under strong gravity waves also find the releases that the closed form gives up on.
    """
    scales = scales_of(values)
    phase, speed, _ = (np.asarray(row) for row in closed_form.first_releases(
        mass_ratio=scales.mass_ratio, speed_ratio=scales.speed_ratio,
        damping_ratio=values['damping_ratio'], gravity_ratio=scales.gravity_ratio,
        threads=threads,
    ))
    results = np.full((6, phase.size), math.nan)
    results[0] = phase / values['frequency']
    results[1] = speed * values['amplitude'] * scales.angular_frequency
    unresolved = np.isnan(phase) & (scales.gravity_ratio > STRONG_GRAVITY)
    chosen = unresolved | (loads and ~np.isnan(phase))
    waves = wave_stepper.throw_batch(
        {name: column[chosen] for name, column in values.items()}, until=results[0, chosen],
        threads=threads, cancelled=cancelled,
    )
    results[2:, chosen] = waves[2:]
    results[:, unresolved] = waves[:, unresolved[chosen]]
    return results


def _throw_sampled(
    rig: Rig | Sequence[Rig],
    changes: Mapping[str, Floats],
    cells: int | None,
    threads: int | None,
    cancelled: Cancelled | None,
) -> Throws:
    """Compute throws with sampled motions of the plate, each with a stepper of its own."""
    rigs, numbers = ([rig], np.array(0)) if isinstance(rig, Rig) else (rig, np.arange(len(rig)))
    shape = np.broadcast_shapes(numbers.shape, *map(np.shape, changes.values()))
    numbers = np.broadcast_to(numbers, shape).ravel()
    columns: dict[str, Any] = {
        name: np.broadcast_to(item, shape).ravel() for name, item in changes.items()
    }
    results = np.full((_NUMBERS, numbers.size), math.nan)
    status = np.full(numbers.size, HELD)
    for name in columns.keys() & {'thickness', 'wave_speed', 'mass'}:
        status[columns[name] <= 0.0] = REFUSED
    for batch in _batches(status == HELD, _BATCHES['waves'], cancelled):

        def run(first: int, stride: int, batch: NDArray[np.int64] = batch) -> None:
            for n in batch[first::stride].tolist():
                values = {name: column[n].item() for name, column in columns.items()}
                other = rig_with(rigs[numbers[n]], values)
                try:
                    results[:, n] = _throw_with_stepper(other, cells, cancelled)
                except (RateError, EventLimitError):
                    status[n] = REFUSED

        in_threads(run, count=batch.size, per_thread=16, threads=threads)
    return _throws(results, status, shape)


def _throw_with_stepper(
    rig: Rig, cells: int | None, cancelled: Cancelled | None
) -> tuple[float, ...]:
    """Follow one throw to its first release; without one it is NaN."""
    motion = motion_of(rig.engine)
    own_period = 1.0 / rig.natural_frequency + rig.crossing_time
    latest = getattr(motion, 'end_time', 0.0) + _WAIT * own_period
    if not rig.layer.needs_cells:
        cells = None
    elif cells is None:
        cells = settled_cells(rig, latest=latest, cancelled=cancelled)
    stepper = make_stepper(rig, cells=cells, field_points=2)
    release = stepper.advance_to_release(
        latest=latest, step=0.25 * own_period, cancelled=cancelled
    )
    if release is None:
        return (math.nan,) * _NUMBERS
    loads, transfer = stepper.loads, (release.velocity / motion.peak_velocity) ** 2
    return (
        release.time, release.velocity, transfer, loads.strain, loads.acceleration,
        loads.plate_force, stepper.plate_work,
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

    Parameters
    ----------
    rig, cancelled
        The rig, and a callback as for `throw_many`.

    Raises
    ------
    ThrowUnresolvedError
        If the projectile does not leave, or cannot be followed.
    SearchCancelledError
        If `cancelled` returns True.

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


def require_uniform(rig: Rig) -> Rig:
    """Return the rig if its layer is of one material, or raise ValueError."""
    if rig.layer.parts:
        count = len(rig.layer.parts)
        raise ValueError(f'only layers of one material are designed, got {count} sheets')
    return rig
