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
from soft_throw_ros.core.plate import motion_of
from soft_throw_ros.core.rig import (
    Engine,
    Layer,
    Ratios,
    ratios_of,
    Rig,
    section_of,
    Stack,
    values_of,
)
from soft_throw_ros.core.stepper import EventLimitError
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

_CLOSED_FORM_BATCH, _LIGHT_BATCH, _STEPPER_BATCH = 1 << 16, 1 << 5, 1 << 10
"""Throws per batch: some tenths of a second of the closed form, with weak and strong gravity."""

_WAIT = 8.0
"""Longest wait for a release after a sampled motion, in periods of plate and projectile. [-]"""


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
        Arrays of the common shape; NaN without a release, or where a thickness, a wave speed or a
        mass is not positive.

    Raises
    ------
    ValueError
        If there is no rig, rigs differ in more than the values of `Changes`, or a change has an
        unknown name or is out of range.
    SearchCancelledError
        If `cancelled` returns True.

    """
    changes = _checked(changes or {})
    if any(single.engine.motion for single in ([rig] if isinstance(rig, Rig) else rig)):
        return _throw_sampled(rig, changes, cells, threads, cancelled)
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
    values: dict[str, Floats | float] = {**values_of(rig), **changes}
    shape = np.broadcast_shapes(*map(np.shape, values.values()))
    results = np.full((len(Throws._fields), math.prod(shape)), math.nan)
    rows = results.reshape(len(results), *shape)
    ratios = Ratios(*(np.broadcast_to(ratio, shape).ravel() for ratio in ratios_of(rig, values)))
    for name, chosen in _methods(rig, ratios).items():
        size = {'closed_form': _CLOSED_FORM_BATCH, 'light': _LIGHT_BATCH}.get(name, _STEPPER_BATCH)
        for batch in _batches(chosen, size, cancelled):
            selected = Ratios(*(row[batch] for row in ratios))
            if name == 'cells':
                results[:, batch] = cell_stepper.throw_batch(
                    selected, rig.layer, cells=cells, threads=threads, cancelled=cancelled
                )
            elif name == 'waves':
                results[:, batch] = wave_stepper.throw_batch(
                    selected, threads=threads, cancelled=cancelled
                )
            else:
                results[:, batch] = _throw_by_closed_form(selected, loads, threads, cancelled)
    results[1:, np.isnan(results[0])] = math.nan  # a method may have loads without a release
    for n, unit in enumerate(units_of(values)):
        rows[n] *= unit
    return Throws(*rows)


def _checked(changes: Changes) -> dict[str, Floats]:
    """Return changes as arrays, or raise ValueError."""
    for name in changes.keys() - _KINDS.keys():
        raise ValueError(f'changes must be of {", ".join(_KINDS)}, got {name!r}')
    return {name: checks.require_all(name, item, _KINDS[name]) for name, item in changes.items()}


def _kind_of(rig: Rig) -> tuple[Hashable, ...]:
    """Return the properties of a rig that are no values of `Changes`."""
    layer = rig.layer
    sheets = len(layer.sheets) if isinstance(layer, Stack) else 0
    return sheets, layer.stress_strain_law, layer.loss


def units_of(values: Mapping[str, Any]) -> tuple[Any, ...]:
    """Return the units of the rows of `cell_stepper.throw_batch`, for the numbers of a rig."""
    omega = 2.0 * math.pi * values['frequency']
    speed = values['amplitude'] * omega
    impedance = values['density'] * values['wave_speed'] * section_of(values['diameter'])
    return (
        1.0 / values['frequency'], speed, 1.0, speed / values['wave_speed'],
        speed * omega, speed * impedance, values['mass'] * speed**2,
    )


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
        layer=_layer_with(rig.layer, _of(Layer, changes)),
        projectile=replace(rig.projectile, mass=changes.get('mass', rig.projectile.mass)),
        gravity=changes.get('gravity', rig.gravity),
    )


def _of(kind: type[Engine] | type[Layer], changes: Mapping[str, float]) -> dict[str, Any]:
    """Return the changes of an engine or of a layer."""
    return {item.name: changes[item.name] for item in fields(kind) if item.name in changes}


def _layer_with(layer: Layer, changes: Mapping[str, Any]) -> Layer:
    """Return a layer with other values, in proportion for each sheet of a stack."""
    if not isinstance(layer, Stack):
        return replace(layer, **changes)

    def of_sheet(sheet: Layer, name: str) -> Any:
        whole = getattr(layer, name)
        return changes[name] * getattr(sheet, name) / whole if whole else changes[name]

    return Stack(
        sheets=tuple(
            replace(sheet, **{name: of_sheet(sheet, name) for name in changes})
            for sheet in layer.sheets
        )
    )


def _batches(
    chosen: NDArray[np.bool_], size: int, cancelled: Cancelled | None
) -> Iterator[NDArray[np.int64]]:
    """Yield the indices of batches; raise before one if the search is cancelled."""
    indices = np.flatnonzero(chosen)
    for start in range(0, indices.size, size):
        check_cancelled(cancelled)
        yield indices[start:start + size]


def _methods(rig: Rig, ratios: Ratios) -> dict[str, NDArray[np.bool_]]:
    """Return the throws that each method computes."""
    mu, kappa, gravity = ratios.mass_ratio, ratios.speed_ratio, ratios.gravity_ratio
    exist = (mu > 0.0) & (mu < math.inf) & (kappa > 0.0) & (kappa < math.inf)
    with np.errstate(invalid='ignore', divide='ignore'):  # layers that do not exist
        # about the lowest frequency of projectile and layer over the plate's
        q = kappa / (2.0 * math.pi * np.sqrt(np.abs(mu) + 4.0 / math.pi**2))
    exist &= (q <= 2.0) | (gravity <= _HOLDING_GRAVITY)
    is_strong = gravity > STRONG_GRAVITY
    is_lossy = ratios.loss_tangent > 0.0
    needs_cells = is_lossy | (not rig.layer.is_uniform or rig.layer.stress_strain_law != 'linear')
    return {
        'closed_form': exist & ~needs_cells & ~is_strong,
        'light': exist & ~needs_cells & is_strong & (mu < _LIGHT),
        'waves': exist & ~needs_cells & is_strong & (mu >= _LIGHT),
        'cells': exist & needs_cells,
    }


def _throw_by_closed_form(
    ratios: Ratios, loads: bool, threads: int | None, cancelled: Cancelled | None
) -> Floats:
    """
    Compute rows as of `cell_stepper.throw_batch` by the closed form, and loads by waves.

    Under strong gravity waves also find the releases that the closed form gives up on.
    """
    results = np.full((len(Throws._fields), ratios.mass_ratio.size), math.nan)
    results[:3] = closed_form.first_releases(**ratios.lossless, threads=threads)
    unresolved = np.isnan(results[0]) & (ratios.gravity_ratio > STRONG_GRAVITY)
    chosen = unresolved | (loads and ~np.isnan(results[0]))
    selected = Ratios(*(row[chosen] for row in ratios))
    waves = wave_stepper.throw_batch(
        selected, until=results[0, chosen], threads=threads, cancelled=cancelled
    )
    results[3:, chosen] = waves[3:]
    results[:, unresolved] = waves[:, unresolved[chosen]]
    return results


def _throw_sampled(
    rig: Rig | Sequence[Rig],
    changes: Changes,
    cells: int | None,
    threads: int | None,
    cancelled: Cancelled | None,
) -> Throws:
    """Compute throws with sampled motions of the plate, each with a stepper of its own."""
    rigs, numbers = ([rig], np.array(0)) if isinstance(rig, Rig) else (rig, np.arange(len(rig)))
    shape = np.broadcast_shapes(numbers.shape, *map(np.shape, changes.values()))
    numbers = np.broadcast_to(numbers, shape).ravel()
    columns = {name: np.broadcast_to(item, shape).ravel() for name, item in changes.items()}
    results = np.full((len(Throws._fields), numbers.size), math.nan)
    for batch in _batches(np.ones(numbers.size, np.bool_), _STEPPER_BATCH, cancelled):

        def run(first: int, stride: int, batch: NDArray[np.int64] = batch) -> None:
            for n in batch[first::stride].tolist():
                values = {name: column[n].item() for name, column in columns.items()}
                try:
                    other = rig_with(rigs[numbers[n]], values)
                    results[:, n] = _throw_with_stepper(other, cells, cancelled)
                except (ValueError, EventLimitError):  # this throw cannot be followed
                    continue

        in_threads(run, count=batch.size, per_thread=16, threads=threads)
    return Throws(*results.reshape(len(results), *shape))


def _throw_with_stepper(
    rig: Rig, cells: int | None, cancelled: Cancelled | None
) -> tuple[float, ...]:
    """Follow one throw to its first release; without one it is NaN."""
    motion = motion_of(rig.engine)
    cells = cells if rig.layer.needs_cells else None
    stepper = make_stepper(rig, cells=cells, field_points=2)
    own_period = 1.0 / rig.natural_frequency + rig.crossing_time
    release = stepper.advance_to_release(
        latest=getattr(motion, 'end_time', 0.0) + _WAIT * own_period, step=0.25 * own_period,
        cancelled=cancelled,
    )
    if release is None:
        return (math.nan,) * len(Throws._fields)
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
    if isinstance(rig.layer, Stack):
        count = len(rig.layer.sheets)
        raise ValueError(f'only layers of one material are designed, got a stack of {count}')
    return rig
