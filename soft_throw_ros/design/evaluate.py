# SPDX-License-Identifier: Apache-2.0
"""
Throws by the thousand: the one way from a rig's ratios to releases and loads for all of design.

A release is always found by the same method whether its loads are asked for or not. A layer that
was chosen at the edge of a jump would otherwise fall off it when it is looked at again.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
import math
import os
from typing import NamedTuple

import numba as nb
import numpy as np
from numpy.typing import ArrayLike, NDArray
from soft_throw_ros.core import (
    finite_difference,
    normal_modes,
    peak,
    spring_mass,
    swings,
    travelling_wave,
)
from soft_throw_ros.core.grid_stepper import cells_per_layer, GridStepper
from soft_throw_ros.core.rig import Rig
from soft_throw_ros.core.stepper import Stepper
from soft_throw_ros.core.stepping import (
    Event,
    EventLimitError,
    PROJECTILE_POSITION,
    PROJECTILE_VELOCITY,
    ThrowStepper,
)
from soft_throw_ros.core.travelling_wave import ThrowUnresolvedError

Floats = NDArray[np.float64]

Cancelled = Callable[[], bool]
"""Is asked between batches whether nobody waits for the result any more."""

LATEST = 6.0
"""Plate periods after the wave's arrival within which a projectile has to leave, if gravity is
strong or the layer has loss."""

_STRONG_GRAVITY = 0.1  # of the plate's acceleration; the closed form slows down beyond
_LAST_CELLS = 128  # of the layer, at least, where throws are followed to the last release
_LOOKS = 64  # at the top of the layer per window
_MAX_WINDOWS = 50  # of two periods of the plate and more, in which the projectile may be gone

# Throws per batch: what takes some tenths of a second at worst, so that a search ends soon after
# it is cancelled.
_CLOSED_FORM_BATCH, _STEPS_BATCH, _CELLS_BATCH = 1 << 16, 1 << 13, 1 << 10

_jit = nb.njit(cache=True, nogil=True, error_model='numpy')


class SearchCancelledError(RuntimeError):
    """Nobody waits for the result any more."""


class Ratios(NamedTuple):
    r"""
    What decides throws: arrays that broadcast against each other.

    Attributes
    ----------
    mass_ratio, speed_ratio : array_like
        :math:`\mu` and :math:`\kappa`. [-]
    damping_ratio : array_like
        Of the plate, :math:`\zeta`. [-]
    gravity_ratio : array_like
        :math:`g / (A \omega^2)`. [-]
    loss_tangent : array_like
        Of the layer at the plate's frequency. [-]
    crossing_ratio : array_like
        What a wave needs through the projectile over what it needs through the layer; for the
        elastic model. [-]

    """

    mass_ratio: ArrayLike
    speed_ratio: ArrayLike
    damping_ratio: ArrayLike = 0.0
    gravity_ratio: ArrayLike = 0.0
    loss_tangent: ArrayLike = 0.0
    crossing_ratio: ArrayLike = 0.0


class FirstThrows(NamedTuple):
    r"""
    Throws up to their first releases, NaN where there is none.

    Attributes
    ----------
    ejection_phase : ndarray
        :math:`t_e f`, in plate periods. [-]
    speed : ndarray
        :math:`V_e / (A \omega)`. [-]
    energy_transfer : ndarray
        :math:`\alpha = (V_e / V_p^*)^2`. [-]
    peak_strain : ndarray
        Largest magnitude anywhere in the layer. In :math:`A \omega / c_s`. [-]
    peak_acceleration : ndarray
        Largest magnitude of the projectile's. In :math:`A \omega^2`. [-]
    peak_plate_force : ndarray
        Largest magnitude of the layer's force on the plate. In :math:`A \omega E_s S / c_s`. [-]
    plate_work : ndarray
        Work of the plate up to the release. In :math:`m (A \omega)^2`. [-]

    """

    ejection_phase: Floats
    speed: Floats
    energy_transfer: Floats
    peak_strain: Floats
    peak_acceleration: Floats
    peak_plate_force: Floats
    plate_work: Floats


def first_throws(
    ratios: Ratios,
    *,
    model: str = 'travelling_wave',
    loads: bool = False,
    threads: int | None = None,
    cancelled: Cancelled | None = None,
) -> FirstThrows:
    """
    Compute throws up to their first releases.

    Parameters
    ----------
    ratios : Ratios
        A throw per element.
    model : str
        One of the models of `core.throw`. The travelling wave gives way to finite differences
        wherever the layer has loss.
    loads : bool
        Whether strains, accelerations, forces and work are wanted; they are NaN otherwise. Only
        the travelling wave tells them.
    threads : int, optional
        Largest number of threads, all cores if not given. Results do not depend on it.
    cancelled : callable, optional
        Asked between batches of some tenths of a second.

    Returns
    -------
    FirstThrows
        Of arrays with the common shape.

    Raises
    ------
    ValueError
        If a ratio is out of its range.
    SearchCancelledError
        If `cancelled` says so.

    """
    shape = np.broadcast_shapes(*map(np.shape, ratios))
    cases = np.empty((len(ratios), math.prod(shape)))
    for row, values in zip(cases, ratios, strict=True):
        row.reshape(shape)[...] = values
    found = np.full((len(FirstThrows._fields), cases.shape[1]), math.nan)
    threads = threads or os.cpu_count() or 1
    for part, batch in _batches(cases, model=model, loads=loads):
        if cancelled is not None and cancelled():
            raise SearchCancelledError('the search was cancelled')
        found[:2, batch] = _release(part, cases[:, batch], model, threads)
        if loads:
            kernel = _lossy_loads if part == 'cells' else _lossless_loads
            found[3:, batch] = _in_threads(kernel, cases[:, batch], 4, threads)
    found[1:, np.isnan(found[0])] = math.nan  # whatever else is said of throws without release
    found[2] = (found[1] / _peak_velocity_ratio(cases[2])) ** 2
    return FirstThrows(*found.reshape(len(found), *shape))


def _peak_velocity_ratio(damping_ratio: Floats) -> Floats:
    """Compute the largest plate speed over A w, Eq. (D4), as `plate.peak_velocity_ratio`."""
    decay: Floats = -damping_ratio / np.sqrt(1.0 - damping_ratio**2) * np.arccos(damping_ratio)
    return np.exp(decay)


def _batches(cases: Floats, *, model: str, loads: bool) -> Iterator[tuple[str, NDArray[np.int64]]]:
    """Sort throws by the method that they need, and cut them into batches."""
    if model in ('travelling_wave', 'spring_mass'):
        with_loss = (cases[4] > 0.0) & (model == 'travelling_wave')
        strong = ~with_loss & (cases[3] > _STRONG_GRAVITY) & (model == 'travelling_wave')
        parts = {'closed_form': ~with_loss & ~strong, 'steps': strong, 'cells': with_loss}
    else:
        parts = {'cells': np.ones(cases.shape[1], dtype=np.bool_)}
    sizes = {'closed_form': _CLOSED_FORM_BATCH, 'steps': _STEPS_BATCH, 'cells': _CELLS_BATCH}
    for part, chosen in parts.items():
        indices = np.flatnonzero(chosen)
        size = min(sizes[part], _STEPS_BATCH) if loads else sizes[part]
        for start in range(0, indices.size, size):
            yield part, indices[start : start + size]


def _release(part: str, cases: Floats, model: str, threads: int) -> Floats:
    """Compute (t_e f, V_e / (A w)) of throws that need the same method."""
    mu, kappa, zeta, gravity, loss, crossing = cases
    ratios = {'mass_ratio': mu, 'speed_ratio': kappa}
    if model == 'spring_mass':
        found = spring_mass.first_release(frequency_ratio=spring_mass.frequency_ratio(**ratios))
        return np.asarray(found[:2])
    if model == 'travelling_wave' and part == 'cells':
        return _in_threads(_lossy_releases, cases, 2, threads)
    if part == 'steps':
        return _in_threads(_strong_gravity_releases, cases, 2, threads)
    ratios |= {'damping_ratio': zeta, 'gravity_ratio': gravity}
    if part == 'closed_form':
        found = travelling_wave.first_releases(**ratios, unresolved='nan', threads=threads)
    else:
        found = finite_difference.first_releases(
            **ratios,
            loss_tangent=loss,
            crossing_ratio=crossing if model == 'finite_difference_elastic' else 0.0,
            glued_to='projectile' if model == 'finite_difference_glued' else 'plate',
            unresolved='nan',
            threads=threads,
        )
    return np.asarray(found[:2])


def _in_threads(
    kernel: Callable[[Floats, Floats], None], cases: Floats, rows: int, threads: int
) -> Floats:
    """Have a kernel fill rows of results, every thread some columns."""
    results = np.empty((rows, cases.shape[1]))
    with ThreadPoolExecutor(threads) as pool:
        parts = [slice(part, None, threads) for part in range(threads)]
        list(pool.map(lambda part: kernel(cases[:, part], results[:, part]), parts))
    return results


@_jit
def _strong_gravity_releases(cases: Floats, results: Floats) -> None:
    for i in range(cases.shape[1]):
        phase, speed, status = swings.first_release_kernel(
            cases[0, i], cases[1, i], cases[2, i], cases[3, i], LATEST
        )
        results[0, i] = phase if status == 0 else math.nan
        results[1, i] = speed if status == 0 else math.nan


@_jit
def _lossy_releases(cases: Floats, results: Floats) -> None:
    for i in range(cases.shape[1]):
        phase, speed, status = normal_modes.first_release_kernel(
            cases[0, i], cases[1, i], cases[2, i], cases[3, i], cases[4, i], LATEST
        )
        results[0, i] = phase if status == 0 else math.nan
        results[1, i] = speed if status == 0 else math.nan


@_jit
def _lossless_loads(cases: Floats, results: Floats) -> None:
    for i in range(cases.shape[1]):
        found = peak.first_peaks_kernel(cases[0, i], cases[1, i], cases[2, i], cases[3, i])
        results[0, i], results[1, i] = found[3], found[7]
        results[2, i], results[3, i] = found[8], found[9]


@_jit
def _lossy_loads(cases: Floats, results: Floats) -> None:
    for i in range(cases.shape[1]):
        found = normal_modes.first_peaks_kernel(
            cases[0, i], cases[1, i], cases[2, i], cases[3, i], cases[4, i]
        )
        results[0, i], results[1, i] = found[3], found[7]
        results[2, i], results[3, i] = found[8], found[9]


class LastRelease(NamedTuple):
    """When a projectile leaves for good [s], how fast [m/s], and how far it has risen [m]."""

    time: float
    speed: float
    rise: float


def last_release(rig: Rig, *, model: str = 'travelling_wave') -> LastRelease:
    """
    Follow one throw until the projectile has left for good.

    Parameters
    ----------
    rig : Rig
        What throws.
    model : str
        One of the models of `core.throw` but the spring. The travelling wave gives way to finite
        differences where the layer has loss.

    Returns
    -------
    LastRelease
        The rise counts from where the projectile rested.

    Raises
    ------
    ThrowUnresolvedError
        If the projectile does not leave, or chatters without end.

    """
    if model == 'travelling_wave' and rig.layer.loss_tangent > 0.0:
        model = 'finite_difference'
    try:
        stepper = _make_stepper(rig, model)
        released = _follow(stepper, rig)
    except (ValueError, EventLimitError) as error:  # too light, or it chatters
        raise ThrowUnresolvedError(f'the last release cannot be told: {error}') from error
    if not released:
        raise ThrowUnresolvedError('gravity holds the projectile on the layer')
    last = released[-1]
    stepper.reset()
    stepper.advance_to(last.time)
    rise = float(stepper.state[PROJECTILE_POSITION]) - stepper.rest_position
    return LastRelease(last.time, last.velocity, rise)


def _make_stepper(rig: Rig, model: str) -> ThrowStepper:
    if model == 'travelling_wave':
        return Stepper(rig, field_points=2)
    try:
        cells = max(_LAST_CELLS, cells_per_layer(rig, model))
    except ValueError:  # too many for real time, which matters to nobody here
        cells = _LAST_CELLS
    return GridStepper(rig, model=model, cells=cells, field_points=2)


def _follow(stepper: ThrowStepper, rig: Rig) -> list[Event]:
    """Return the releases until the projectile falls back, or is out of the layer's reach."""
    window = 8.0 * rig.crossing_time + 2.0 / rig.engine.frequency
    released: list[Event] = []
    for i in range(_MAX_WINDOWS):
        heights = []
        count = stepper.event_count
        for time in np.linspace(i * window, (i + 1) * window, _LOOKS):
            stepper.advance_to(time)
            heights.append(stepper.surface_position)
        released = []
        for event in stepper.events():
            if event.kind == 'release':
                released.append(event)
            elif event.velocity <= 0.0 and rig.gravity > 0.0:
                return released  # it has come down
        if stepper.in_contact or not released:
            continue
        if rig.gravity > 0.0 and stepper.state[PROJECTILE_VELOCITY] <= 0.0:
            return released  # whatever it meets now, it meets on its way down
        ahead = stepper.state[PROJECTILE_POSITION] - max(heights)
        if rig.gravity == 0.0 and stepper.event_count == count and ahead > np.ptp(heights):
            return released
    return released
