# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
First releases and loads of many throws, in SI units, by a suitable method for each throw.

Without loss the closed form is exact; steppers compute throws with loss or strong gravity, and
loads. The method of a release is the same with and without loads; otherwise the release of a layer
near a discontinuity could jump when its loads are computed.
"""

from __future__ import annotations

from collections.abc import Hashable, Mapping, Sequence
from dataclasses import fields, replace
from functools import partial
import math
from typing import Any, NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray
from soft_throw_ros.core import cell_stepper, checks, closed_form, wave_stepper
from soft_throw_ros.core.batch import Cancelled, run_batches, ThrowUnresolvedError
from soft_throw_ros.core.plate import motion_of, peak_velocity_ratio
from soft_throw_ros.core.rig import Engine, Layer, RANGES, Rig, scales_of, values_of
from soft_throw_ros.core.stepper import EventLimitError, RateError
from soft_throw_ros.core.throw import make_settled_stepper, simulate, ThrowUnfinishedError

Floats = NDArray[np.float64]

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
    changes = _checked(changes or {})
    rigs = [rig] if isinstance(rig, Rig) else list(rig)
    is_sampled = any(single.engine.motion for single in rigs)
    if not is_sampled and len(kinds := set(map(_kind_of, rigs))) != 1:
        raise ValueError(
            f'rigs must differ in the values of `Changes` only, got {len(kinds)} kinds of layers'
        )
    tables = [values_of(single) for single in rigs]
    given = {name: np.array([table[name] for table in tables]) for name in tables[0]}
    given = {**given, 'rig': np.arange(len(rigs))}
    if isinstance(rig, Rig):
        given = {name: column[0] for name, column in given.items()}
    given.update(changes)
    shape = np.broadcast_shapes(*map(np.shape, given.values()))
    values = {name: np.broadcast_to(item, shape).ravel() for name, item in given.items()}
    exist = (values['thickness'] > 0.0) & (values['wave_speed'] > 0.0) & (values['mass'] > 0.0)
    status = np.where(exist, HELD, REFUSED)
    peak_speed = 2.0 * math.pi * values['frequency'] * values['amplitude']
    peak_speed *= peak_velocity_ratio(values['damping_ratio'])
    results = np.full((6, exist.size), math.nan)

    def follow(batch: NDArray[np.int64]) -> None:
        for n in batch.tolist():
            changed = {name: values[name][n].item() for name in changes}
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


def _checked(changes: Changes) -> dict[str, Floats]:
    """Return changes as arrays, or raise ValueError."""
    for name in changes.keys() - _KINDS.keys():
        raise ValueError(f'changes must be of {", ".join(_KINDS)}, got {name!r}')
    return {name: checks.require_all(name, item, _KINDS[name]) for name, item in changes.items()}


def _kind_of(rig: Rig) -> tuple[Hashable, ...]:
    """Return the properties of a rig that are no values of `Changes`."""
    return len(rig.layer.parts), rig.layer.stress_strain_law, rig.layer.loss


def rig_with(rig: Rig, changes: Mapping[str, float]) -> Rig:
    """Return a rig with other values; a stack and a motion of the plate change in proportion."""
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


def require_uniform(rig: Rig) -> Rig:
    """Return the rig if its layer is of one material, or raise ValueError."""
    if rig.layer.parts:
        count = len(rig.layer.parts)
        raise ValueError(f'only layers of one material are designed, got {count} sheets')
    return rig
