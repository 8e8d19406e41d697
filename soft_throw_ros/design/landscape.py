# SPDX-License-Identifier: Apache-2.0
r"""
When and with how much energy a projectile leaves, over any two parameters of a rig.

Notes
-----
A few ratios decide a throw, and every axis is a way through their space. The axes of [1]_ are
other names for two of them, the mass ratio :math:`\mu` and the speed ratio :math:`\kappa`:

.. math::

    x = \frac{L_s}{L_s + L_r}, \quad C = \frac{c_s}{(L_s + L_r) f}: \qquad
    \mu = \frac{\rho_r}{\rho_s} \frac{1 - x}{x}, \quad \kappa = \frac{C}{x},

for which one has to know the ratio of the densities of projectile and layer. The maps of [1]_ are
those of equal densities, though its rig has 1.3.

References
----------
.. [1] "Use of compliant actuators for throwing rigid projectiles", Phys. Rev. E (2022).

"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import Executor
from dataclasses import asdict, dataclass
import functools
import itertools
import json
import math
from operator import attrgetter
from pathlib import Path
from typing import Any, get_args, Literal, NamedTuple, TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.io import netcdf_file
import soft_throw_ros
from soft_throw_ros.configuration import TWIN
from soft_throw_ros.core import (
    checks,
    finite_difference,
    normal_modes,
    spring_mass,
    travelling_wave,
)
from soft_throw_ros.core.grid_stepper import cells_per_layer, GridStepper
from soft_throw_ros.core.plate import peak_velocity_ratio
from soft_throw_ros.core.rig import Engine, Layer, Projectile, Rig
from soft_throw_ros.core.stepper import Stepper
from soft_throw_ros.core.stepping import (
    Event,
    EventLimitError,
    PROJECTILE_POSITION,
    ThrowStepper,
)
from soft_throw_ros.design.sweep import Checkpoint, Progress, sweep, whole_file

if TYPE_CHECKING:
    import xarray

Floats = NDArray[np.float64]

Release = Literal['first', 'last']


class Quantity(NamedTuple):
    """What numbers are: their symbol (as TeX), their unit (SI, empty if none), their meaning."""

    symbol: str
    unit: str
    meaning: str


_SYMBOLS = {
    'engine.frequency': 'f',
    'engine.amplitude': 'A',
    'engine.damping_ratio': r'\zeta',
    'layer.thickness': 'L_s',
    'layer.wave_speed': 'c_s',
    'layer.density': r'\rho_s',
    'layer.diameter': 'D',
    'layer.loss_tangent': r'\tan\delta',
    'projectile.mass': 'm',
    'gravity': 'g',
}

AXES: Mapping[str, Quantity] = {
    'x': Quantity('x = L_s/(L_s+L_r)', '', 'Layer over total length'),
    'C': Quantity('C = c_s/(L_s+L_r)f', '', 'Crossings of the total length per plate period'),
    'mu': Quantity(r'\mu = m/\rho_sSL_s', '', 'Projectile over layer mass'),
    'kappa': Quantity(r'\kappa = c_s/L_sf', '', 'Crossings of the layer per plate period'),
    **{
        name: Quantity(symbol, TWIN.by_name[name].unit, TWIN.by_name[name].meaning)
        for name, symbol in _SYMBOLS.items()
    },
}
"""What can be an axis: those of the paper, the ratios behind them, and parameters of the rig."""

RESULTS: Mapping[str, Quantity] = {
    'ejection_phase': Quantity('t_e f', '', 'Ejection time in plate periods'),
    'energy_transfer': Quantity(r'\alpha', '', 'Energy transfer factor'),
}
"""What a landscape has at every point, by the names of its arrays."""

_SAME = ({'x', 'mu'}, {'C', 'kappa'})
_BESIDE_RATIOS = ('engine.amplitude', 'engine.damping_ratio', 'layer.loss_tangent', 'gravity')
_LAST_CELLS = 128  # of the layer, at least, where throws are followed to the last release
_LOOKS = 64  # at the top of the layer per window
_MAX_WINDOWS = 50  # of two periods of the plate and more, in which the projectile may be gone
_DECIDES = {
    'engine.damping_ratio': 'damping_ratio',
    'engine.amplitude': 'gravity_ratio',
    'gravity': 'gravity_ratio',
    'layer.loss_tangent': 'loss_tangent',
}
"""Parameters that not every model knows, and the ratio that they are for."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Axis:
    """
    An axis of a landscape.

    Parameters
    ----------
    name : str
        One of `AXES`.
    values : array_like, shape (n,)
        Increasing, in SI units.

    Raises
    ------
    ValueError
        If there is no such axis, or a value is not allowed.

    """

    name: str
    values: Floats

    def __post_init__(self) -> None:
        if self.name not in AXES:
            raise ValueError(f'no axis is named {self.name!r}; there are: {", ".join(AXES)}')
        values = checks.not_negative_array(self.name, self.values)
        if values.ndim != 1 or not values.size:
            raise ValueError(f'{self.name} must be a row of numbers, got shape {values.shape}')
        for before, after in itertools.pairwise(values.tolist()):
            if after <= before:
                raise ValueError(f'{self.name} must increase, got {before:g} and then {after:g}')
        if self.name in TWIN.by_name:
            for value in (values[0], values[-1]):
                TWIN.check_value(self.name, float(value))
        else:
            checks.positive(self.name, values[0])
        if self.name == 'x':
            checks.below_one(self.name, values[-1])
        object.__setattr__(self, 'values', values)

    @property
    def quantity(self) -> Quantity:
        """What it shows."""
        return AXES[self.name]

    @property
    def key(self) -> str:
        """Its name as an identifier, for files and data sets."""
        return self.name.replace('.', '_')


class Summit(NamedTuple):
    """The highest point of a landscape: where it is on each axis, and what it gives."""

    place: tuple[float, float]
    ejection_phase: float
    energy_transfer: float


@dataclass(frozen=True, kw_only=True, eq=False)
class Landscape:
    r"""
    Ejection phase and energy transfer over two axes. Made by `survey`.

    Parameters
    ----------
    rig : Rig
        What all throws have in common, apart from the axes.
    axes : tuple of Axis
        The two.
    ejection_phase : ndarray, shape (n, m)
        :math:`t_e f` along the first and the second axis, in plate periods. NaN where the
        projectile does not leave, or the model cannot tell when. [-]
    energy_transfer : ndarray, shape (n, m)
        :math:`\alpha = (V_e / V_p^*)^2`, NaN as above. [-]
    model : str
        One of `MODELS`.
    release : {'first', 'last'}
        Which release it is.
    density_ratio : float
        Projectile over layer, for the axes x and C. [-]

    """

    rig: Rig
    axes: tuple[Axis, Axis]
    ejection_phase: Floats
    energy_transfer: Floats
    model: str
    release: Release
    density_ratio: float

    @property
    def summit(self) -> Summit | None:
        """Where the energy transfer is largest; None if all is NaN."""
        if np.isnan(self.energy_transfer).all():
            return None
        i, j = np.unravel_index(np.nanargmax(self.energy_transfer), self.energy_transfer.shape)
        return Summit(
            (float(self.axes[0].values[i]), float(self.axes[1].values[j])),
            float(self.ejection_phase[i, j]),
            float(self.energy_transfer[i, j]),
        )

    def place(self, rig: Rig) -> tuple[float, float]:
        """Tell where on the axes a rig is; on x and C, with the landscape's density ratio."""
        x = self.density_ratio / (self.density_ratio + rig.mass_ratio)
        ratios = {'x': x, 'C': x * rig.speed_ratio, 'mu': rig.mass_ratio, 'kappa': rig.speed_ratio}
        first, second = (
            ratios[axis.name] if axis.name in ratios else float(attrgetter(axis.name)(rig))
            for axis in self.axes
        )
        return first, second

    @property
    def left_out(self) -> tuple[str, ...]:
        """Name the parameters of the rig that would count, but not in this model."""
        known = MODELS[self.model][self.release].ratios
        return tuple(
            name
            for name in ('engine.damping_ratio', 'gravity')
            if attrgetter(name)(self.rig) > 0.0 and _DECIDES[name] not in known
        )

    @property
    def attributes(self) -> dict[str, str | float]:
        """All but the arrays, flat: what files and data sets note down."""
        parts = asdict(self.rig)
        gravity = parts.pop('gravity')
        return {
            'title': f'{self.release.capitalize()} release over {self.axes[0].name} and '
            f'{self.axes[1].name}',
            'source': f'soft_throw_ros {soft_throw_ros.__version__}',
            'model': self.model,
            'left_out': ', '.join(self.left_out),
            'release': self.release,
            'density_ratio': self.density_ratio,
            **{f'{part}_{name}': parts[part][name] for part in parts for name in parts[part]},
            'gravity': gravity,
        }

    def to_xarray(self) -> xarray.Dataset:
        """
        Return it as a data set of xarray, which nothing else needs.

        Raises
        ------
        ModuleNotFoundError
            If xarray is not installed.

        """
        import xarray

        variables = {
            name: (dimensions, values, _described(quantity))
            for name, dimensions, values, quantity in _variables(self)
        }
        return xarray.Dataset(variables, attrs=self.attributes)

    def save(self, path: Path) -> None:
        """
        Write it into a file, which is there as a whole or not at all.

        Parameters
        ----------
        path : Path
            Ends on `.npz` (NumPy) or `.nc` (NetCDF 3, which xarray, MATLAB and others read).

        Raises
        ------
        ValueError
            For another ending.
        OSError
            If it cannot be written.

        """
        write = _WRITERS.get(path.suffix)
        if write is None:
            raise ValueError(f'a landscape is saved as {" or ".join(_WRITERS)}, got {str(path)!r}')
        with whole_file(path) as unfinished:
            write(self, unfinished)


def _variables(landscape: Landscape) -> Iterator[tuple[str, tuple[str, ...], Floats, Quantity]]:
    """Give name, dimensions, values and meaning of axes and results."""
    keys = tuple(axis.key for axis in landscape.axes)
    for axis in landscape.axes:
        yield axis.key, (axis.key,), axis.values, axis.quantity
    for name, quantity in RESULTS.items():
        yield name, keys, getattr(landscape, name), quantity


def _write_npz(landscape: Landscape, path: Path) -> None:
    arrays: dict[str, Any] = {name: values for name, _, values, _ in _variables(landscape)}
    attributes = {'dimensions': [axis.key for axis in landscape.axes], **landscape.attributes}
    with path.open('wb') as file:
        np.savez(file, attributes=np.array(json.dumps(attributes)), **arrays)


def _write_netcdf(landscape: Landscape, path: Path) -> None:
    with netcdf_file(path, 'w', version=2) as data:
        for name, value in {'Conventions': 'CF-1.11', **landscape.attributes}.items():
            setattr(data, name, value)
        for axis in landscape.axes:
            data.createDimension(axis.key, axis.values.size)
        for name, dimensions, values, quantity in _variables(landscape):
            variable = data.createVariable(name, 'f8', dimensions)
            variable[:] = values
            for attribute, text in _described(quantity).items():
                setattr(variable, attribute, text)


_WRITERS = {'.npz': _write_npz, '.nc': _write_netcdf}


def _described(quantity: Quantity) -> dict[str, str]:
    """Describe a quantity as the conventions of NetCDF ask for."""
    return {'long_name': quantity.meaning, 'units': quantity.unit or '1'}


def survey(
    rig: Rig,
    axes: Mapping[str, ArrayLike],
    *,
    model: str = 'travelling_wave',
    release: Release = 'first',
    density_ratio: float | None = None,
    executor: Executor | None = None,
    progress: Progress | None = None,
    checkpoint: Checkpoint | None = None,
) -> Landscape:
    r"""
    Compute a landscape.

    Parameters
    ----------
    rig : Rig
        What all throws have in common, apart from the axes.
    axes : mapping of str to array_like
        Two of `AXES` with their values, increasing. x, C, mu and kappa replace whatever the rig
        says about them, and go with each other and with the plate's amplitude and damping, the
        loss tangent, and gravity.
    model : str
        One of `MODELS`.
    release : {'first', 'last'}
        The first one, or the last one before the projectile falls back for good.
    density_ratio : float, optional
        Projectile over layer, for the axes x and C; that of the rig if not given. [-]
    executor, progress, checkpoint
        As for `soft_throw_ros.design.sweep.sweep`; the results do not depend on them.

    Returns
    -------
    Landscape

    Raises
    ------
    ValueError
        If an axis, a value, a model or an option is refused.

    Notes
    -----
    ========================= ============================================= =======
    model                     is for                                        error
    ========================= ============================================= =======
    travelling_wave           a rigid projectile on a lossless layer        1e-9
    normal_modes              a rigid projectile on a layer with loss       1e-8
    finite_difference         either                                        1e-3
    finite_difference_elastic an elastic projectile                         1e-3
    spring_mass               a layer without mass, a harmonic plate,       large
                              no gravity
    ========================= ============================================= =======

    Last releases are followed in steps: by the travelling wave to 1e-6, by finite differences to
    some 1e-3. But a projectile that chatters on the layer is beyond any model: neighbouring points
    may then differ at random.

    Examples
    --------
    Thickness and wave speed of the layer, by a coarse net:

    >>> landscape = survey(
    ...     Rig(), {'layer.thickness': [0.01, 0.015, 0.02], 'layer.wave_speed': [6.0, 9.0]}
    ... )
    >>> landscape.energy_transfer.round(2)
    array([[3.61, 3.45],
           [3.04, 3.92],
           [2.8 , 3.67]])
    >>> landscape.summit.place
    (0.015, 9.0)

    """
    if model not in MODELS:
        raise ValueError(f'model must be one of {", ".join(MODELS)}, got {model!r}')
    if release not in get_args(Release):
        raise ValueError(f"release must be 'first' or 'last', got {release!r}")
    if release not in MODELS[model]:
        able = ', '.join(name for name, methods in MODELS.items() if release in methods)
        raise ValueError(f'the {release} release is known to {able}, got model {model!r}')
    if len(axes) != 2:
        raise ValueError(f'a landscape has two axes, got {", ".join(axes) or "none"}')
    first, second = (Axis(name=name, values=np.asarray(axes[name])) for name in axes)
    _check_axes(first.name, second.name)
    method = MODELS[model][release]
    for name, ratio in _DECIDES.items():
        if name in axes and ratio not in method.ratios:
            raise ValueError(f'{name} is an axis, but the model {model} does not know it')
    if type(rig.layer) is not Layer:  # a graded one is a kind of it
        raise ValueError(f'landscapes are of layers of one material, got {rig.layer!r}')
    if rig.layer.loss_tangent > 0.0 and 'loss_tangent' not in method.ratios:
        raise ValueError(
            f'layer.loss_tangent must be 0 for the model {model}, which is lossless, '
            f'got {rig.layer.loss_tangent:g}'
        )
    if density_ratio is None:
        projectile = rig.projectile
        density_ratio = projectile.mass / (rig.layer.section * projectile.length)
        density_ratio /= rig.layer.density
    checks.positive('density_ratio', density_ratio)
    shape = (first.values.size, second.values.size)
    along = {first.name: first.values[:, None], second.name: second.values[None, :]}
    ratios = _ratios(rig, along, density_ratio)
    cases = np.empty((len(method.ratios), *shape))
    for row, name in zip(cases, method.ratios, strict=True):
        row[:] = ratios[name]
    results = sweep(
        functools.partial(_compute, model, release, None if executor is None else 1),
        cases.reshape(len(method.ratios), -1),
        outputs=len(RESULTS),
        block=method.block,
        executor=executor,
        progress=progress,
        checkpoint=checkpoint,
        request=f'{soft_throw_ros.__version__} {model} {release}',
    )
    phase, transfer = results.reshape(len(RESULTS), *shape)
    return Landscape(
        rig=rig,
        axes=(first, second),
        ejection_phase=phase,
        energy_transfer=transfer,
        model=model,
        release=release,
        density_ratio=density_ratio,
    )


def _check_axes(first: str, second: str) -> None:
    """Refuse two axes of which one decides the other."""
    if {first, second} in _SAME:
        raise ValueError(f'{first} and {second} are one and the same, so they make no landscape')
    ratios = {name for same in _SAME for name in same}
    for ratio, other in ((first, second), (second, first)):
        if ratio in ratios and other not in ratios and other not in _BESIDE_RATIOS:
            allowed = sorted(next(ratios - same for same in _SAME if ratio in same))
            raise ValueError(
                f'{ratio} goes with {", ".join([*allowed, *_BESIDE_RATIOS])}, got {other}'
            )


def _ratios(rig: Rig, along: Mapping[str, Floats], density_ratio: float) -> dict[str, Any]:
    """Compute what decides a throw, as `Rig` does, from its parameters and those that vary."""

    def parameter(name: str) -> Any:
        return along[name] if name in along else attrgetter(name)(rig)

    section = 0.25 * math.pi * parameter('layer.diameter') ** 2
    thickness, mass = parameter('layer.thickness'), parameter('projectile.mass')
    mu = mass / (parameter('layer.density') * section * thickness)
    frequency = parameter('engine.frequency')
    kappa = 1.0 / (thickness / parameter('layer.wave_speed') * frequency)
    omega = 2.0 * math.pi * frequency
    if 'x' in along:
        mu = density_ratio * (1.0 - along['x']) / along['x']
    mu = along.get('mu', mu)
    if 'C' in along:
        kappa = along['C'] / along.get('x', density_ratio / (density_ratio + mu))
    kappa = along.get('kappa', kappa)
    projectile = rig.projectile
    crossing = np.sqrt(projectile.length * mass / (projectile.youngs_modulus * section))
    return {
        'mass_ratio': mu,
        'speed_ratio': kappa,
        'damping_ratio': parameter('engine.damping_ratio'),
        'gravity_ratio': parameter('gravity') / (parameter('engine.amplitude') * omega * omega),
        'loss_tangent': parameter('layer.loss_tangent'),
        'crossing_ratio': crossing * frequency * kappa,
    }


class _Method(NamedTuple):
    """A way to the releases of a block of cases."""

    compute: Callable[[dict[str, Any], int | None], Floats]
    ratios: tuple[str, ...]  # that it is given: the rows of the cases
    block: int  # cases that take some tenths of a second, and seconds at worst


def _compute(model: str, release: Release, threads: int | None, cases: Floats) -> Floats:
    """Compute a block of cases; on its own, so that other processes find it by name."""
    method = MODELS[model][release]
    return method.compute(dict(zip(method.ratios, cases, strict=True)), threads)


def _first_by_travelling_wave(case: dict[str, Any], threads: int | None) -> Floats:
    return _of(travelling_wave.first_releases(**case, unresolved='nan', threads=threads))


def _first_by_normal_modes(case: dict[str, Any], threads: int | None) -> Floats:
    """Without loss modes converge slowly, and the travelling wave is the same model."""
    found = np.empty((len(RESULTS), case['loss_tangent'].size))
    for lossy in (False, True):
        chosen = (case['loss_tangent'] > 0.0) == lossy
        part = {name: ratios[chosen] for name, ratios in case.items()}
        if lossy:
            releases = normal_modes.first_releases(**part, unresolved='nan')
            found[:, chosen] = _of(releases)
        else:
            del part['loss_tangent']
            found[:, chosen] = _first_by_travelling_wave(part, threads)
    return found


def _first_by_finite_difference(case: dict[str, Any], threads: int | None) -> Floats:
    return _of(finite_difference.first_releases(**case, unresolved='nan', threads=threads))


def _last_by_travelling_wave(case: dict[str, Any], _threads: int | None) -> Floats:
    return _last(functools.partial(Stepper, field_points=2), case)


def _last_by_finite_difference(case: dict[str, Any], _threads: int | None) -> Floats:
    model = 'finite_difference_elastic' if 'crossing_ratio' in case else 'finite_difference'

    def make(rig: Rig) -> GridStepper:
        cells = max(_LAST_CELLS, cells_per_layer(rig, model))
        return GridStepper(rig, model=model, cells=cells, field_points=2)

    return _last(make, case)


def _last(make: Callable[[Rig], ThrowStepper], case: dict[str, Any]) -> Floats:
    rows = [
        _last_release(make, **dict(zip(case, ratios, strict=True)))
        for ratios in zip(*case.values(), strict=True)
    ]
    return np.asarray([*zip(*rows, strict=True)], dtype=np.float64)


def _last_release(
    make: Callable[[Rig], ThrowStepper],
    *,
    mass_ratio: float,
    speed_ratio: float,
    damping_ratio: float,
    gravity_ratio: float,
    loss_tangent: float = 0.0,
    crossing_ratio: float = 1.0,
) -> tuple[float, float]:
    """Follow one throw, in units of the layer, until the projectile is gone or falls back."""
    engine = Engine(frequency=1.0 / speed_ratio, amplitude=1.0, damping_ratio=damping_ratio)
    omega = engine.angular_frequency
    rig = Rig(
        engine=engine,
        layer=Layer(
            thickness=1.0,
            wave_speed=1.0,
            density=1.0,
            diameter=2.0 / math.sqrt(math.pi),
            loss_tangent=loss_tangent,
        ),
        projectile=Projectile(
            mass=mass_ratio, length=1.0, youngs_modulus=mass_ratio / crossing_ratio**2
        ),
        gravity=gravity_ratio * omega * omega,
    )
    try:
        released = _follow(make(rig), gravity=rig.gravity, window=8.0 + 2.0 * speed_ratio)
    except (ValueError, EventLimitError):  # the projectile is too light, or chatters for ever
        released = []
    if not released:
        return math.nan, math.nan
    peak = engine.speed_scale * peak_velocity_ratio(damping_ratio)
    return released[-1].time / speed_ratio, (released[-1].velocity / peak) ** 2


def _follow(stepper: ThrowStepper, *, gravity: float, window: float) -> list[Event]:
    """Return the releases until the projectile falls back, or is out of reach for a window."""
    released: list[Event] = []
    for i in range(_MAX_WINDOWS):
        heights = []
        count = stepper.event_count
        for time in np.linspace(i * window, (i + 1) * window, _LOOKS):
            stepper.advance_to(time)
            heights.append(stepper.surface_position)
        events = stepper.events()
        rising = list(
            itertools.takewhile(
                lambda event: event.kind == 'release' or event.velocity > 0.0 or not gravity,
                events,
            )
        )
        released = [event for event in rising if event.kind == 'release']
        ahead = stepper.state[PROJECTILE_POSITION] - max(heights)
        is_gone = (
            not gravity
            and stepper.event_count == count
            and not stepper.in_contact
            and released[-1].velocity > 0.0
            and ahead > np.ptp(heights)
        )
        if is_gone or len(rising) < len(events):
            break
    return released


def _first_by_spring_mass(case: dict[str, Any], _threads: int | None) -> Floats:
    return _of(spring_mass.first_release(frequency_ratio=spring_mass.frequency_ratio(**case)))


def _of(found: travelling_wave.FirstRelease) -> Floats:
    """Return what of releases is in `RESULTS`."""
    return np.asarray((found.ejection_phase, found.energy_transfer), dtype=np.float64)


_RATIOS = ('mass_ratio', 'speed_ratio')
_DAMPED = (*_RATIOS, 'damping_ratio', 'gravity_ratio')
_LOSSY = (*_DAMPED, 'loss_tangent')
_ELASTIC = (*_LOSSY, 'crossing_ratio')

MODELS: Mapping[str, Mapping[str, _Method]] = {
    'travelling_wave': {
        'first': _Method(_first_by_travelling_wave, _DAMPED, 1 << 16),
        'last': _Method(_last_by_travelling_wave, _DAMPED, 32),
    },
    'normal_modes': {'first': _Method(_first_by_normal_modes, _LOSSY, 4096)},
    'finite_difference': {
        'first': _Method(_first_by_finite_difference, _LOSSY, 256),
        'last': _Method(_last_by_finite_difference, _LOSSY, 8),
    },
    'finite_difference_elastic': {
        'first': _Method(_first_by_finite_difference, _ELASTIC, 256),
        'last': _Method(_last_by_finite_difference, _ELASTIC, 8),
    },
    'spring_mass': {'first': _Method(_first_by_spring_mass, _RATIOS, 1 << 16)},
}
"""Models by name, and the releases that each can tell."""
