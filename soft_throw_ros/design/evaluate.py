# Copyright 2026 soft_throw_ros developers
#
# Licensed under the Apache License, Version 2.0 (the "License");
# you may not use this file except in compliance with the License.
# You may obtain a copy of the License at
#
#     http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software
# distributed under the License is distributed on an "AS IS" BASIS,
# WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied.
# See the License for the specific language governing permissions and
# limitations under the License.
"""
Throws by the thousand: the one way from a rig to releases and loads for all of design.

Without loss and strong gravity the closed form is exact and fast; the steppers are for the rest.
A release is always found by the same method whether its loads are asked for or not. A layer that
was chosen at the edge of a jump would otherwise fall off it when it is looked at again.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
import contextlib
from dataclasses import fields, replace
import math
from typing import Any, NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray
from soft_throw_ros.core import cell_stepper, closed_form, spring_mass, wave_stepper
from soft_throw_ros.core.batch import in_threads
from soft_throw_ros.core.closed_form import ThrowUnresolvedError
from soft_throw_ros.core.plate import peak_velocity_ratios
from soft_throw_ros.core.rig import Engine, Layer, Rig, Stack
from soft_throw_ros.core.stepper import EventLimitError, FirstThrows
from soft_throw_ros.core.throw import apex_height, make_stepper, simulate, ThrowUnfinishedError

Floats = NDArray[np.float64]

Cancelled = Callable[[], bool]
"""Is asked between batches whether nobody waits for the result any more."""

Changes: TypeAlias = Mapping[str, Floats | float]
"""Other values of a rig by name: of engine and layer, `mass` of the projectile, `gravity` [SI]."""

SEARCH_CELLS = 16
"""Cells of a layer with loss in a search: a sixth of the time of the default, and 1e-3 exact."""

_STRONG_GRAVITY = 0.2  # of the plate's acceleration; the closed form slows down beyond

# Throws per batch: what takes some tenths of a second, so that a search ends soon after it is
# cancelled.
_CLOSED_FORM_BATCH, _STEPPER_BATCH, _SAMPLED_BATCH = 1 << 16, 1 << 10, 1 << 8
_WAIT = 8.0  # periods of plate and projectile, beyond the motion, in which a release is waited for

_RIGID = ('mass_ratio', 'speed_ratio', 'damping_ratio', 'gravity_ratio')


class SearchCancelledError(RuntimeError):
    """Nobody waits for the result any more."""


def check_cancelled(cancelled: Cancelled | None) -> None:
    """Raise SearchCancelledError if nobody waits any more."""
    if cancelled is not None and cancelled():
        raise SearchCancelledError('the search was cancelled')


class Throws(NamedTuple):
    r"""
    First releases of many throws and what they take; arrays of one shape, NaN without a release.

    Ejection time :math:`t_e` [s] and speed :math:`V_e` [m/s], :math:`\alpha` [-], the largest
    strain in the layer [-], the projectile's largest acceleration [m/s2], the largest force on the
    plate [N], and the work of the plate up to the release [J].
    """

    ejection_time: Floats
    ejection_speed: Floats
    energy_transfer: Floats
    peak_strain: Floats
    peak_acceleration: Floats
    peak_force: Floats
    plate_work: Floats


def first_throws(
    rig: Rig,
    changes: Changes | None = None,
    *,
    model: str = 'travelling_wave',
    loads: bool = False,
    cells: int | None = None,
    threads: int | None = None,
    cancelled: Cancelled | None = None,
) -> Throws:
    """
    Compute throws of a rig in which some values are others, up to their first releases.

    Parameters
    ----------
    rig : Rig
        What all throws have in common.
    changes : mapping of str to array_like, optional
        What is other, see `Changes`; arrays broadcast against each other.
    model : str
        Of the layer; the travelling wave gives way to finite differences where it must.
    loads : bool
        Whether strains, accelerations, forces and work are wanted; they may be NaN otherwise.
    cells : int, optional
        Of the layer for finite differences; as many as it takes for 1e-4 if not given.
    threads : int, optional
        All cores if not given. Results do not depend on it.
    cancelled : callable, optional
        Asked between batches of some tenths of a second.

    Returns
    -------
    Throws
        Of arrays with the common shape; NaN where there is no release, or no layer: where an
        error takes more of a layer than there is.

    Raises
    ------
    SearchCancelledError
        If `cancelled` says so.

    """
    changes = changes or {}
    values = _values(rig, changes)
    shape = np.broadcast_shapes(*map(np.shape, values.values()))
    found = np.full((len(Throws._fields), math.prod(shape)), math.nan)
    rows = found.reshape(len(found), *shape)
    if rig.engine.motion:
        cases = {name: np.broadcast_to(each, shape).ravel() for name, each in changes.items()}
        for batch in _batches(np.ones(found.shape[1], np.bool_), _SAMPLED_BATCH, cancelled):
            part = {name: each[batch].tolist() for name, each in cases.items()}
            found[:, batch] = _throw_with_steppers(rig, part, batch.size, model, cells, threads)
        return Throws(*rows)
    ratios = _ratios(rig, values)
    cases = {name: _row(each, shape) for name, each in ratios.items()}
    for method, chosen in _methods(rig, cases, model).items():
        is_fast = method in ('closed_form', 'spring_mass') and not loads
        size = _CLOSED_FORM_BATCH if is_fast else _STEPPER_BATCH
        for batch in _batches(chosen, size, cancelled):
            part = {name: each[batch] for name, each in cases.items()}
            if method == 'cells':
                found[:, batch] = _throw_with_cells(rig, part, model, cells, threads)
            elif method == 'spring_mass':
                found[:3, batch] = spring_mass.first_release(
                    frequency_ratio=part['speed_ratio']
                    / (2.0 * math.pi * np.sqrt(part['mass_ratio']))
                )
            else:
                found[:, batch] = _throw_with_waves(part, method, loads, threads)
    found[1:, np.isnan(found[0])] = math.nan  # whatever else is said of throws without a release
    # Releases and loads come without units
    omega = 2.0 * math.pi * values['frequency']
    speed = values['amplitude'] * omega
    impedance = values['density'] * values['wave_speed'] * _section(values)
    units = (
        1.0 / values['frequency'], speed, 1.0, speed / values['wave_speed'],
        speed * omega, speed * impedance, values['mass'] * speed**2,
    )
    for n, unit in enumerate(units if loads else units[:2]):
        rows[n] *= unit
    return Throws(*rows)


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


def _of(part: type[Engine] | type[Layer], changes: Mapping[str, float]) -> dict[str, Any]:
    """Return the changes of an engine or of a layer."""
    return {each.name: changes[each.name] for each in fields(part) if each.name in changes}


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


def _values(rig: Rig, changes: Changes) -> dict[str, Floats | float]:
    """Return the numbers of a rig that count, with changes."""
    values = {**vars(rig.engine), **vars(rig.layer), 'gravity': rig.gravity}
    values = {name: value for name, value in values.items() if isinstance(value, float)}
    return {**values, 'mass': rig.projectile.mass, **changes}


def _row(value: Floats | float, shape: tuple[int, ...]) -> Floats:
    """Repeat what is the same for several throws."""
    row = np.empty(shape)
    row[...] = value
    return row.ravel()


def _section(values: Changes) -> Floats | float:
    return 0.25 * math.pi * values['diameter'] ** 2


def _ratios(rig: Rig, values: Changes) -> dict[str, Floats | float]:
    """Return what decides throws with these values: arguments of `cell_stepper.first_throws`."""
    projectile, section = rig.projectile, _section(values)
    mass, thickness, frequency = values['mass'], values['thickness'], values['frequency']
    omega = 2.0 * math.pi * frequency
    spring = projectile.youngs_modulus * section / projectile.length
    with np.errstate(divide='ignore'):  # a layer that an error leaves nothing of
        speed_ratio = values['wave_speed'] / (thickness * frequency)
        mass_ratio = mass / (values['density'] * section * thickness)
    is_linear = rig.layer.elasticity == 'linear'
    return {
        'mass_ratio': mass_ratio,
        'speed_ratio': speed_ratio,
        'damping_ratio': values['damping_ratio'],
        'gravity_ratio': values['gravity'] / (values['amplitude'] * omega * omega),
        'loss_tangent': values['loss_tangent'],
        'crossing_ratio': np.sqrt(mass / spring) * frequency * speed_ratio,
        'strain_ratio': 0.0 if is_linear else values['amplitude'] * omega / values['wave_speed'],
        'constant_loss': float(rig.layer.loss == 'constant'),
    }


def _batches(
    chosen: NDArray[np.bool_], size: int, cancelled: Cancelled | None
) -> Iterator[NDArray[np.int64]]:
    """Cut throws into batches, and ask before each whether to go on."""
    indices = np.flatnonzero(chosen)
    for start in range(0, indices.size, size):
        check_cancelled(cancelled)
        yield indices[start:start + size]


def _methods(rig: Rig, cases: Mapping[str, Floats], model: str) -> dict[str, NDArray[np.bool_]]:
    """Tell which throws need which method."""
    mu, kappa, gravity = cases['mass_ratio'], cases['speed_ratio'], cases['gravity_ratio']
    exist = (mu > 0.0) & (mu < math.inf) & (kappa > 0.0) & (kappa < math.inf)
    if model == 'spring_mass':
        return {'spring_mass': exist}
    # A spring under a mass that starts with the plate makes its acceleration 2 q^2 / (q^2 - 1)
    # times the plate's at most. At q = 2 and beyond that is 2.7; waves add to it, and 3.1 is the
    # largest seen. So gravity holds these, which a stepper takes longest to find out.
    exist &= (_stiffness(mu, kappa) <= 2.0) | (gravity <= 4.0)
    if model != 'travelling_wave':
        return {'cells': exist}
    is_strong = gravity > _STRONG_GRAVITY
    needs_cells = cases['loss_tangent'] > 0.0
    if not rig.layer.is_uniform or rig.layer.elasticity != 'linear':
        needs_cells = np.ones_like(needs_cells)
    return {
        'closed_form': exist & ~needs_cells & ~is_strong,
        'waves': exist & ~needs_cells & is_strong,
        'cells': exist & needs_cells,
    }


def _stiffness(mass_ratio: Floats, speed_ratio: Floats) -> Floats:
    """Return about the lowest frequency of projectile and layer over the plate's, q."""
    with np.errstate(invalid='ignore'):  # no layer has no frequency
        return speed_ratio / (2.0 * math.pi * np.sqrt(np.abs(mass_ratio) + 4.0 / math.pi**2))


def highest_transfers(rig: Rig, changes: Changes) -> Floats:
    r"""
    Bound the energy transfers of stiff layers, which take longest to compute.

    On a spring the projectile is faster than the plate by :math:`A \omega / (q - 1)` at most,
    q > 1 being the ratio of their frequencies. Waves add to it: of 200,000 random throws from
    layers with q > 1.2, with and without gravity and damping, none had more than 1.45 times that.

    Parameters
    ----------
    rig, changes
        As for `first_throws`.

    Returns
    -------
    ndarray
        Infinite for layers that are not stiff. [-]

    """
    ratios = {name: np.asarray(each) for name, each in _ratios(rig, _values(rig, changes)).items()}
    stiffness = _stiffness(ratios['mass_ratio'], ratios['speed_ratio'])
    excess = 1.5 / np.maximum(stiffness - 1.0, 1e-9)
    fastest = peak_velocity_ratios(ratios['damping_ratio'])
    more = 1.0 + ratios['strain_ratio']  # for what stiffening adds
    return np.where(stiffness > 1.2, more * (1.0 + excess / fastest) ** 2, math.inf)


def _throw_with_waves(
    part: Mapping[str, Floats], method: str, loads: bool, threads: int | None
) -> Floats:
    """Compute the rows of `FirstThrows` without loss; the closed form has the last word."""
    ratios = {name: part[name] for name in _RIGID}
    found = np.full((len(FirstThrows._fields), part['mass_ratio'].size), math.nan)
    if loads or method == 'waves':
        found[:] = wave_stepper.first_throws(**ratios, unresolved='nan', threads=threads)
    if method == 'closed_form':
        found[:3] = closed_form.first_releases(**ratios, unresolved='nan', threads=threads)
    return found


def _throw_with_cells(
    rig: Rig, part: Mapping[str, Floats], model: str, cells: int | None, threads: int | None
) -> Floats:
    """Compute the rows of `FirstThrows` by finite differences."""
    ratios = dict(part)
    if model != 'finite_difference_elastic':
        del ratios['crossing_ratio']
    return np.asarray(
        cell_stepper.first_throws(
            **ratios,
            glued_to='projectile' if model == 'finite_difference_glued' else 'plate',
            cells=cells,
            stack=rig.layer if isinstance(rig.layer, Stack) else None,
            unresolved='nan',
            threads=threads,
        )
    )


def _throw_with_steppers(
    rig: Rig,
    changes: Mapping[str, list[float]],
    count: int,
    model: str,
    cells: int | None,
    threads: int | None,
) -> Floats:
    """Compute the rows of `Throws` for the motion of a file, throw by throw."""
    found = np.full((len(Throws._fields), count), math.nan)

    def run(first: int, parts: int) -> None:
        for n in range(first, count, parts):
            with contextlib.suppress(ValueError, EventLimitError):  # what cannot be followed
                there = rig_with(rig, {name: each[n] for name, each in changes.items()})
                found[:, n] = _throw_with_stepper(there, model, cells)

    in_threads(run, count=count, per_thread=16, threads=threads)
    return found


def _throw_with_stepper(rig: Rig, model: str, cells: int | None) -> tuple[float, ...]:
    """Follow one throw of a sampled motion to its first release; without one it is NaN."""
    motion = rig.engine.motion
    assert motion is not None
    model = model_for(rig, model)
    cells = None if model == 'travelling_wave' else cells
    stepper = make_stepper(rig, model=model, cells=cells, field_points=2)
    latest = motion.end_time + _WAIT * (1.0 / rig.natural_frequency + rig.crossing_time)
    time, tick = 0.0, 0.25 * (1.0 / rig.natural_frequency + rig.crossing_time)
    while not stepper.advance_to(time):
        if time > latest:
            return (math.nan,) * len(Throws._fields)
        time += tick
    first, loads = stepper.events()[0], stepper.loads
    transfer = (first.velocity / motion.peak_velocity) ** 2
    return (
        first.time, first.velocity, transfer, loads.strain, loads.acceleration, loads.plate_force,
        stepper.plate_work,
    )


class LastRelease(NamedTuple):
    """When and how fast a projectile leaves for good, and how high it flies."""

    time: float
    """From the start of the throw. [s]"""
    speed: float
    """[m/s]"""
    rise: float
    """Above where it rested on the layer. [m]"""
    height: float
    """Of its apex, above the same; infinite without gravity. [m]"""


def last_release(rig: Rig, *, model: str = 'travelling_wave') -> LastRelease:
    """
    Follow one throw until the projectile has left for good.

    Parameters
    ----------
    rig : Rig
        What throws.
    model : str
        Of the layer; the travelling wave gives way to finite differences where it must.

    Raises
    ------
    ThrowUnresolvedError
        If the projectile does not leave, or the model cannot follow it.

    Examples
    --------
    >>> last = last_release(Rig())
    >>> round(last.speed, 4), round(1e3 * last.height, 2)
    (1.375, 100.51)

    """
    try:
        last = simulate(rig, model=model_for(rig, model)).last_release
    except (ValueError, EventLimitError, ThrowUnfinishedError) as error:
        raise ThrowUnresolvedError(f'the last release cannot be told: {error}') from error
    rest = rig.layer.thickness - rig.static_sag
    height = apex_height(last, rig.gravity) - rest
    return LastRelease(last.time, last.velocity, last.position - rest, height)


def model_for(rig: Rig, model: str) -> str:
    """Return the model, or finite differences where the travelling wave must give way."""
    is_for_cells = model == 'travelling_wave' and rig.layer.needs_cells
    return 'finite_difference' if is_for_cells else model


def require_uniform(rig: Rig) -> Rig:
    """Return the rig if its layer is of one material, or raise ValueError."""
    if isinstance(rig.layer, Stack):
        count = len(rig.layer.sheets)
        raise ValueError(f'only layers of one material are designed, got a stack of {count}')
    return rig
