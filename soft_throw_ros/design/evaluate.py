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
Throws by the thousand: the one way from a rig's ratios to releases and loads for all of design.

Without loss and strong gravity the closed form is exact and fast; the steppers are for the rest.
A release is always found by the same method whether its loads are asked for or not. A layer that
was chosen at the edge of a jump would otherwise fall off it when it is looked at again.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
import contextlib
from dataclasses import replace
import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from soft_throw_ros.core import cell_stepper, closed_form, spring_mass, wave_stepper
from soft_throw_ros.core.batch import in_threads
from soft_throw_ros.core.closed_form import ThrowUnresolvedError
from soft_throw_ros.core.plate import peak_velocity_ratios, SampledMotion
from soft_throw_ros.core.rig import Engine, Layer, Projectile, Rig, Stack
from soft_throw_ros.core.stepper import EventLimitError, FirstThrows
from soft_throw_ros.core.throw import apex_height, make_stepper, simulate, ThrowUnfinishedError

Floats = NDArray[np.float64]

Cancelled = Callable[[], bool]
"""Is asked between batches whether nobody waits for the result any more."""

SEARCH_CELLS = 16
"""Cells of a layer with loss in a search: a sixth of the time of the default, and 1e-3 exact."""

_STRONG_GRAVITY = 0.2  # of the plate's acceleration; the closed form slows down beyond

# Throws per batch: what takes some tenths of a second, so that a search ends soon after it is
# cancelled.
_CLOSED_FORM_BATCH, _STEPPER_BATCH, _SAMPLED_BATCH = 1 << 16, 1 << 10, 1 << 8
_WAIT = 8.0  # periods of plate and projectile, beyond the motion, in which a release is waited for


class SearchCancelledError(RuntimeError):
    """Nobody waits for the result any more."""


class Ratios(NamedTuple):
    r"""
    What decides throws: arrays that broadcast against each other.

    They are :math:`\mu`, :math:`\kappa`, :math:`\zeta`, :math:`g / (A \omega^2)`, the layer's loss
    tangent at the plate's frequency; for the elastic model, what a wave needs through the
    projectile over what it needs through the layer; :math:`A \omega / c_s` if the layer is not
    linear, else 0; and 1 if the loss tangent is constant, else 0. [-]
    """

    mass_ratio: Floats | float
    speed_ratio: Floats | float
    damping_ratio: Floats | float = 0.0
    gravity_ratio: Floats | float = 0.0
    loss_tangent: Floats | float = 0.0
    crossing_ratio: Floats | float = 0.0
    strain_ratio: Floats | float = 0.0
    constant_loss: Floats | float = 0.0

    @classmethod
    def of(cls, rig: Rig, *, stacks: bool = False, **changes: Floats | float) -> Ratios:
        """
        Return what decides throws of a rig in which some values are others.

        Parameters
        ----------
        rig : Rig
            With a layer of one material, unless
        stacks : bool
            says that `first_throws` will be told of its stack.
        **changes : ndarray or float
            Fields of the engine and of the layer, `mass` of the projectile, and `gravity`; they
            broadcast against each other. [SI]

        Raises
        ------
        ValueError
            If the layer is not of one material.

        """
        engine, projectile = rig.engine, rig.projectile
        layer = rig.layer if stacks else require_uniform(rig).layer
        values = {**vars(engine), **vars(layer), 'mass': projectile.mass, 'gravity': rig.gravity}
        values |= changes
        del values['motion']
        mass, thickness, frequency = values['mass'], values['thickness'], values['frequency']
        section = 0.25 * math.pi * values['diameter'] ** 2
        omega = 2.0 * math.pi * frequency
        spring = projectile.youngs_modulus * section / projectile.length
        with np.errstate(divide='ignore'):  # a layer that an error leaves nothing of
            speed_ratio = values['wave_speed'] / (thickness * frequency)
            mass_ratio = mass / (values['density'] * section * thickness)
        return cls(
            mass_ratio=mass_ratio,
            speed_ratio=speed_ratio,
            damping_ratio=values['damping_ratio'],
            gravity_ratio=values['gravity'] / (values['amplitude'] * omega * omega),
            loss_tangent=values['loss_tangent'],
            crossing_ratio=np.sqrt(mass / spring) * frequency * speed_ratio,
            strain_ratio=0.0
            if layer.elasticity == 'linear'
            else values['amplitude'] * omega / values['wave_speed'],
            constant_loss=float(layer.loss == 'constant'),
        )


def first_throws(
    ratios: Ratios,
    *,
    motion: SampledMotion | None = None,
    model: str = 'travelling_wave',
    loads: bool = False,
    cells: int | None = None,
    stack: Stack | None = None,
    threads: int | None = None,
    cancelled: Cancelled | None = None,
) -> FirstThrows:
    """
    Compute throws up to their first releases.

    Parameters
    ----------
    ratios : Ratios
        A throw per element.
    motion : SampledMotion, optional
        Of the plate, in units of its period and amplitude, see `unit_motion`; without, the plate
        is underdamped.
    model : str
        Of the layer; the travelling wave gives way to finite differences where it must.
    loads : bool
        Whether strains, accelerations, forces and work are wanted; they may be NaN otherwise.
    cells : int, optional
        Of the layer for finite differences; as many as it takes for 1e-4 if not given.
    stack : Stack, optional
        Of which the layers are, if they are no layers of one material.
    threads : int, optional
        All cores if not given. Results do not depend on it.
    cancelled : callable, optional
        Asked between batches of some tenths of a second.

    Returns
    -------
    FirstThrows
        Of arrays with the common shape; NaN where there is no release, or no layer: where an
        error takes more of a layer than there is, a ratio is negative or infinite.

    Raises
    ------
    SearchCancelledError
        If `cancelled` says so.

    """
    shape = np.broadcast_shapes(*map(np.shape, ratios))
    cases = np.empty((len(ratios), math.prod(shape)))
    for row, values in zip(cases, ratios, strict=True):
        row.reshape(shape)[...] = values
    found = np.full((len(FirstThrows._fields), cases.shape[1]), math.nan)
    methods = _batches(
        cases,
        model=model,
        loads=loads,
        is_stack=stack is not None,
        is_sampled=motion is not None,
    )
    for method, batch in methods:
        if cancelled is not None and cancelled():
            raise SearchCancelledError('the search was cancelled')
        part = Ratios(*cases[:, batch])
        if method == 'steppers':
            assert motion is not None
            found[:, batch] = _throw_with_steppers(part, motion, model, cells, stack, threads)
        elif method == 'spring':
            ratio = spring_mass.frequency_ratio(
                mass_ratio=part.mass_ratio, speed_ratio=part.speed_ratio
            )
            found[:3, batch] = spring_mass.first_release(frequency_ratio=ratio)
        elif method == 'cells':
            found[:, batch] = _throw_with_cells(part, model, cells, stack, threads)
        else:
            found[:, batch] = _throw_with_waves(part, method, loads, threads)
    found[1:, np.isnan(found[0])] = math.nan  # whatever else is said of throws without a release
    return FirstThrows(*found.reshape(len(found), *shape))


def _batches(
    cases: Floats, *, model: str, loads: bool, is_stack: bool, is_sampled: bool
) -> Iterator[tuple[str, NDArray[np.int64]]]:
    """Sort throws by the method that they need, and cut them into batches."""
    exist = ((cases[:2] > 0.0) & (cases[:2] < math.inf)).all(axis=0)
    every = exist & ~_are_held(cases[0], cases[1], cases[3])
    if is_sampled:
        parts = {'steppers': exist}
    elif model == 'travelling_wave':
        needs_cells = is_stack | (cases[4] > 0.0) | (cases[6] > 0.0)
        is_strong = cases[3] > _STRONG_GRAVITY
        parts = {
            'closed_form': every & ~needs_cells & ~is_strong,
            'waves': every & ~needs_cells & is_strong,
            'cells': every & needs_cells,
        }
    else:
        parts = {'spring' if model == 'spring_mass' else 'cells': every}
    for method, chosen in parts.items():
        indices = np.flatnonzero(chosen)
        is_fast = method in ('closed_form', 'spring') and not loads
        size = _CLOSED_FORM_BATCH if is_fast else _STEPPER_BATCH
        size = _SAMPLED_BATCH if is_sampled else size
        for start in range(0, indices.size, size):
            yield method, indices[start:start + size]


def _stiffness(mass_ratio: Floats, speed_ratio: Floats) -> Floats:
    """Return about the lowest frequency of projectile and layer over the plate's, q."""
    with np.errstate(invalid='ignore'):  # no layer has no frequency
        return speed_ratio / (2.0 * math.pi * np.sqrt(np.abs(mass_ratio) + 4.0 / math.pi**2))


def _are_held(mass_ratio: Floats, speed_ratio: Floats, gravity_ratio: Floats) -> NDArray[np.bool_]:
    """
    Tell which projectiles gravity holds for sure, which a stepper takes longest to find out.

    A spring under a mass that starts with the plate makes its acceleration 2 q^2 / (q^2 - 1)
    times the plate's at most. At q = 2 and beyond that is 2.7; waves add to it, and 3.1 is the
    largest seen.
    """
    return (_stiffness(mass_ratio, speed_ratio) > 2.0) & (gravity_ratio > 4.0)


def highest_transfers(ratios: Ratios) -> Floats:
    r"""
    Bound the energy transfers of stiff layers, which take longest to compute.

    On a spring the projectile is faster than the plate by :math:`A \omega / (q - 1)` at most,
    q > 1 being the ratio of their frequencies. Waves add to it: of 200,000 random throws from
    layers with q > 1.2, with and without gravity and damping, none had more than 1.45 times that.

    Parameters
    ----------
    ratios : Ratios
        Arrays of one shape.

    Returns
    -------
    ndarray
        Of the same shape; infinite for layers that are not stiff. [-]

    """
    stiffness = _stiffness(np.asarray(ratios.mass_ratio), np.asarray(ratios.speed_ratio))
    excess = 1.5 / np.maximum(stiffness - 1.0, 1e-9)
    fastest = peak_velocity_ratios(np.asarray(ratios.damping_ratio))
    more = 1.0 + np.asarray(ratios.strain_ratio)  # for what stiffening adds
    return np.where(stiffness > 1.2, more * (1.0 + excess / fastest) ** 2, math.inf)


def _throw_with_waves(part: Ratios, method: str, loads: bool, threads: int | None) -> Floats:
    """Compute the rows of `FirstThrows` without loss; the closed form has the last word."""
    ratios = part._asdict()
    for name in Ratios._fields[4:]:
        del ratios[name]
    found = np.full((len(FirstThrows._fields), np.size(part.mass_ratio)), math.nan)
    if loads or method == 'waves':
        found[:] = wave_stepper.first_throws(**ratios, unresolved='nan', threads=threads)
    if method == 'closed_form':
        found[:3] = closed_form.first_releases(**ratios, unresolved='nan', threads=threads)
    return found


def _throw_with_cells(
    part: Ratios, model: str, cells: int | None, stack: Stack | None, threads: int | None
) -> Floats:
    """Compute the rows of `FirstThrows` by finite differences."""
    ratios = part._asdict()
    if model != 'finite_difference_elastic':
        del ratios['crossing_ratio']
    return np.asarray(
        cell_stepper.first_throws(
            **ratios,
            glued_to='projectile' if model == 'finite_difference_glued' else 'plate',
            cells=cells,
            stack=stack,
            unresolved='nan',
            threads=threads,
        )
    )


def unit_motion(engine: Engine) -> SampledMotion | None:
    """Return the motion of an engine, if it has one, in units of its period and amplitude."""
    if engine.motion is None:
        return None
    return engine.motion.scaled(time=engine.frequency, height=1.0 / engine.amplitude)


def unit_rig(
    case: Sequence[float], motion: SampledMotion | None = None, stack: Stack | None = None
) -> Rig:
    """Return a rig with these `Ratios`, in units of its layer, or of that of its stack."""
    ratios = Ratios(*case)
    mu, kappa, strain = (float(value) for value in (ratios[0], ratios[1], ratios.strain_ratio))
    omega = 2.0 * math.pi / kappa
    amplitude = strain / omega or 1.0  # what makes the strains of a layer that stiffens true ones
    return Rig(
        engine=Engine(
            frequency=1.0 / kappa,
            amplitude=amplitude,
            damping_ratio=float(ratios.damping_ratio),
            motion=motion.scaled(time=kappa, height=amplitude) if motion else None,
        ),
        layer=_unit_layer(ratios, stack),
        projectile=Projectile(
            mass=mu, length=1.0, youngs_modulus=mu / (float(ratios.crossing_ratio) or 1.0) ** 2
        ),
        gravity=float(ratios.gravity_ratio) * amplitude * omega**2,
    )


def _unit_layer(ratios: Ratios, stack: Stack | None) -> Layer:
    """Return a layer with these ratios whose thickness, wave speed and mass are 1."""
    whole = Layer(
        thickness=1.0,
        wave_speed=1.0,
        density=1.0,
        diameter=2.0 / math.sqrt(math.pi),
        loss_tangent=float(ratios.loss_tangent),
        elasticity='neo_hookean' if ratios.strain_ratio else 'linear',
        loss='constant' if ratios.constant_loss else 'kelvin_voigt',
    )
    if stack is None:
        return whole
    return Stack(
        sheets=tuple(
            replace(
                whole,
                thickness=sheet.thickness / stack.thickness,
                wave_speed=sheet.wave_speed / stack.wave_speed,
                density=sheet.density / stack.density,
                loss_tangent=whole.loss_tangent * sheet.loss_tangent / (stack.loss_tangent or 1.0),
            )
            for sheet in stack.sheets
        )
    )


def _throw_with_steppers(
    part: Ratios,
    motion: SampledMotion,
    model: str,
    cells: int | None,
    stack: Stack | None,
    threads: int | None,
) -> Floats:
    """Compute the rows of `FirstThrows` for any motion, throw by throw."""
    cases = np.column_stack(part).tolist()
    found = np.full((len(FirstThrows._fields), len(cases)), math.nan)

    def run(first: int, parts: int) -> None:
        for n in range(first, len(cases), parts):
            with contextlib.suppress(ValueError, EventLimitError):  # what cannot be followed
                rig = unit_rig(cases[n], motion, stack)
                found[:, n] = _throw_with_stepper(rig, model, cells)

    in_threads(run, count=len(cases), per_thread=16, threads=threads)
    return found


def _throw_with_stepper(rig: Rig, model: str, cells: int | None) -> tuple[float, ...]:
    """Follow one throw of a sampled motion to its first release; without one it is NaN."""
    engine, motion = rig.engine, rig.engine.motion
    assert motion is not None
    if model == 'travelling_wave' and rig.layer.needs_cells:
        model = 'finite_difference'
    elif model == 'travelling_wave':
        cells = None
    stepper = make_stepper(rig, model=model, cells=cells, field_points=2)
    latest = motion.end_time + _WAIT * (1.0 / rig.natural_frequency + rig.crossing_time)
    time, tick = 0.0, 0.25 * (1.0 / rig.natural_frequency + rig.crossing_time)
    while not stepper.advance_to(time):
        if time > latest:
            return (math.nan,) * len(FirstThrows._fields)
        time += tick
    first, loads, scale = stepper.events()[0], stepper.loads, engine.speed_scale
    return (
        first.time * engine.frequency,
        first.velocity / scale,
        (first.velocity / motion.peak_velocity) ** 2,
        loads.strain / scale,
        loads.acceleration / (scale * engine.angular_frequency),
        loads.plate_force / scale,
        stepper.plate_work / (rig.projectile.mass * scale**2),
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
    if model == 'travelling_wave' and rig.layer.needs_cells:
        model = 'finite_difference'
    try:
        last = simulate(rig, model=model).last_release
    except (ValueError, EventLimitError, ThrowUnfinishedError) as error:
        raise ThrowUnresolvedError(f'the last release cannot be told: {error}') from error
    rest = rig.layer.thickness - rig.static_sag
    height = apex_height(last, rig.gravity) - rest
    return LastRelease(last.time, last.velocity, last.position - rest, height)


def stack_of(layer: Layer) -> Stack | None:
    """Return the layer if it is a stack."""
    return layer if isinstance(layer, Stack) else None


def require_uniform(rig: Rig) -> Rig:
    """Return the rig if its layer is of one material, or raise ValueError."""
    if isinstance(rig.layer, Stack):
        count = len(rig.layer.sheets)
        raise ValueError(f'only layers of one material are designed, got a stack of {count}')
    return rig
