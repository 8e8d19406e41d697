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
from concurrent.futures import as_completed, Executor
from dataclasses import asdict, dataclass
import functools
import itertools
import json
import math
from operator import attrgetter
from pathlib import Path
from typing import get_args, Literal, NamedTuple, TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.io import netcdf_file
import soft_throw_ros
from soft_throw_ros.configuration import TWIN
from soft_throw_ros.configuration.atomic_file import atomic_file
from soft_throw_ros.core import checks
from soft_throw_ros.core.closed_form import ThrowUnresolvedError
from soft_throw_ros.core.plate import peak_velocity_ratio
from soft_throw_ros.core.rig import Engine, Layer, Projectile, Rig
from soft_throw_ros.design.evaluate import first_throws, last_release, Ratios

if TYPE_CHECKING:
    import xarray

Floats = NDArray[np.float64]

Release = Literal['first', 'last']

Progress = Callable[[int], object]
"""Is told that so many more throws are done."""


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
_RATIO_OF = {
    'engine.damping_ratio': 'damping_ratio',
    'engine.amplitude': 'gravity_ratio',
    'gravity': 'gravity_ratio',
    'layer.loss_tangent': 'loss_tangent',
}
"""Parameters that not every model knows, and the ratio that they are for."""


class Model(NamedTuple):
    """
    A model of the layer, as landscapes use it.

    Attributes
    ----------
    ratios : tuple of str
        Fields of `Ratios` that it knows.
    blocks : mapping of str to int
        Throws per call, by the releases that it can tell: some tenths of a second.

    """

    ratios: tuple[str, ...]
    blocks: Mapping[Release, int]


_RIGID = ('mass_ratio', 'speed_ratio', 'damping_ratio', 'gravity_ratio')
_LOSSY = (*_RIGID, 'loss_tangent')
_CELLS: Mapping[Release, int] = {'first': 256, 'last': 8}

MODELS: Mapping[str, Model] = {
    'travelling_wave': Model(_RIGID, {'first': 1 << 16, 'last': 32}),
    'finite_difference': Model(_LOSSY, _CELLS),
    'finite_difference_elastic': Model(Ratios._fields, _CELLS),
    'finite_difference_glued': Model(_LOSSY, _CELLS),
    'spring_mass': Model(('mass_ratio', 'speed_ratio'), {'first': 1 << 16}),
}
"""Models by name."""


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
        values = checks.require_not_negative_array(self.name, self.values)
        if values.ndim != 1 or not values.size:
            raise ValueError(f'{self.name} must be a row of numbers, got shape {values.shape}')
        for before, after in itertools.pairwise(values.tolist()):
            if after <= before:
                raise ValueError(f'{self.name} must increase, got {before:g} and then {after:g}')
        if self.name in TWIN.by_name:
            for value in (values[0], values[-1]):
                TWIN.check_value(self.name, float(value))
        else:
            checks.require_positive(self.name, values[0])
        if self.name == 'x':
            checks.require_in_unit_interval(self.name, values[-1])
        object.__setattr__(self, 'values', values)

    @property
    def quantity(self) -> Quantity:
        """What it shows."""
        return AXES[self.name]

    @property
    def key(self) -> str:
        """Its name as an identifier, for files and data sets."""
        return self.name.replace('.', '_')


class HighestPoint(NamedTuple):
    """The best point of a landscape: where it is on each axis, and what it gives."""

    place: tuple[float, float]
    ejection_phase: float
    energy_transfer: float


@dataclass(frozen=True, kw_only=True, eq=False)
class Landscape:
    r"""
    Ejection phase and energy transfer over two axes. Made by `compute_landscape`.

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
    def optimum(self) -> HighestPoint | None:
        """Where the energy transfer is largest; None if all is NaN."""
        if np.isnan(self.energy_transfer).all():
            return None
        i, j = np.unravel_index(np.nanargmax(self.energy_transfer), self.energy_transfer.shape)
        return HighestPoint(
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
        known = MODELS[self.model].ratios
        return tuple(
            name
            for name in ('engine.damping_ratio', 'gravity')
            if attrgetter(name)(self.rig) > 0.0 and _RATIO_OF[name] not in known
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
        with atomic_file(path) as unfinished:
            write(self, unfinished)


def _variables(landscape: Landscape) -> Iterator[tuple[str, tuple[str, ...], Floats, Quantity]]:
    """Give name, dimensions, values and meaning of axes and results."""
    keys = tuple(axis.key for axis in landscape.axes)
    for axis in landscape.axes:
        yield axis.key, (axis.key,), axis.values, axis.quantity
    for name, quantity in RESULTS.items():
        yield name, keys, getattr(landscape, name), quantity


def _write_npz(landscape: Landscape, path: Path) -> None:
    arrays = {name: values for name, _, values, _ in _variables(landscape)}
    attributes = {'dimensions': [axis.key for axis in landscape.axes], **landscape.attributes}
    with path.open('wb') as file:
        np.savez(file, allow_pickle=False, attributes=np.array(json.dumps(attributes)), **arrays)


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


def compute_landscape(
    rig: Rig,
    axes: Mapping[str, ArrayLike],
    *,
    model: str = 'travelling_wave',
    release: Release = 'first',
    density_ratio: float | None = None,
    executor: Executor | None = None,
    progress: Progress | None = None,
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
    executor : Executor, optional
        Who computes blocks of throws; the caller if not given. Results do not depend on it.
    progress : callable, optional
        Told how many more throws are done.

    Returns
    -------
    Landscape

    Raises
    ------
    ValueError
        If an axis, a value, a model or an option is refused.

    Notes
    -----
    ========================= ==================================================== =======
    model                     is for                                               error
    ========================= ==================================================== =======
    travelling_wave           a rigid projectile on a lossless layer               1e-9
    finite_difference         a rigid projectile, with or without loss             1e-4
    finite_difference_elastic an elastic projectile                                1e-4
    finite_difference_glued   the layer on the projectile, thrown along            1e-4
    spring_mass               a layer without mass, a harmonic plate, no gravity   large
    ========================= ==================================================== =======

    Last releases are followed in steps. A projectile that chatters on the layer is beyond any
    model: neighbouring points may then differ at random.

    Examples
    --------
    Thickness and wave speed of the layer, by a coarse net:

    >>> landscape = compute_landscape(
    ...     Rig(), {'layer.thickness': [0.01, 0.015, 0.02], 'layer.wave_speed': [6.0, 9.0]}
    ... )
    >>> landscape.energy_transfer.round(2)
    array([[3.61, 3.45],
           [3.04, 3.92],
           [2.8 , 3.67]])
    >>> landscape.optimum.place
    (0.015, 9.0)

    """
    if len(axes) != 2:
        raise ValueError(f'a landscape has two axes, got {", ".join(axes) or "none"}')
    first, second = (Axis(name=name, values=np.asarray(axes[name])) for name in axes)
    _check_axes(first.name, second.name)
    _check_model(rig, axes, model, release)
    if density_ratio is None:
        projectile = rig.projectile
        density_ratio = projectile.mass / (rig.layer.section * projectile.length)
        density_ratio /= rig.layer.density
    checks.require_positive('density_ratio', density_ratio)
    shape = (first.values.size, second.values.size)
    along = {first.name: first.values[:, None], second.name: second.values[None, :]}
    cases = np.zeros((len(Ratios._fields), math.prod(shape)))
    for name, row, ratio in zip(
        Ratios._fields, cases, _ratios(rig, along, density_ratio), strict=True
    ):
        if name in MODELS[model].ratios:
            row.reshape(shape)[...] = ratio
    compute = functools.partial(_compute, model, release, None if executor is None else 1)
    size = MODELS[model].blocks[release]
    blocks = {start: cases[:, start : start + size] for start in range(0, cases.shape[1], size)}
    results = np.empty((len(RESULTS), cases.shape[1]))
    for start, part in _computed(compute, blocks, executor):
        results[:, start : start + size] = part
        if progress is not None:
            progress(part.shape[1])
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


def _check_model(rig: Rig, axes: Mapping[str, ArrayLike], model: str, release: Release) -> None:
    """Refuse what a model does not know."""
    if model not in MODELS:
        raise ValueError(f'model must be one of {", ".join(MODELS)}, got {model!r}')
    if release not in get_args(Release):
        raise ValueError(f"release must be 'first' or 'last', got {release!r}")
    if release not in MODELS[model].blocks:
        able = ', '.join(name for name, other in MODELS.items() if release in other.blocks)
        raise ValueError(f'the {release} release is known to {able}, got model {model!r}')
    for name, ratio in _RATIO_OF.items():
        if name in axes and ratio not in MODELS[model].ratios:
            raise ValueError(f'{name} is an axis, but the model {model} does not know it')
    if type(rig.layer) is not Layer:  # a graded one is a kind of it
        raise ValueError(f'landscapes are of layers of one material, got {rig.layer!r}')
    if rig.layer.loss_tangent > 0.0 and 'loss_tangent' not in MODELS[model].ratios:
        raise ValueError(
            f'layer.loss_tangent must be 0 for the model {model}, which is lossless, '
            f'got {rig.layer.loss_tangent:g}'
        )


def _computed(
    compute: Callable[[Floats], Floats], blocks: Mapping[int, Floats], executor: Executor | None
) -> Iterator[tuple[int, Floats]]:
    """Yield where blocks begin, and their results, in whatever order they come."""
    if executor is None:
        for start, block in blocks.items():
            yield start, compute(block)
        return
    futures = {executor.submit(compute, block): start for start, block in blocks.items()}
    try:
        for future in as_completed(futures):
            yield futures[future], future.result()
    finally:  # after Ctrl-C, or if the workers are lost
        for future in futures:
            future.cancel()


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


def _ratios(rig: Rig, along: Mapping[str, Floats], density_ratio: float) -> Ratios:
    """Compute what decides a throw, as `Rig` does, from its parameters and those that vary."""

    def parameter(name: str) -> Floats | float:
        return along[name] if name in along else float(attrgetter(name)(rig))

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
    return Ratios(
        mass_ratio=mu,
        speed_ratio=kappa,
        damping_ratio=parameter('engine.damping_ratio'),
        gravity_ratio=parameter('gravity') / (parameter('engine.amplitude') * omega * omega),
        loss_tangent=parameter('layer.loss_tangent'),
        crossing_ratio=crossing * frequency * kappa,
    )


def _compute(model: str, release: Release, threads: int | None, cases: Floats) -> Floats:
    """Compute a block of throws; on its own, so that other processes find it by name."""
    if release == 'first':
        throws = first_throws(Ratios(*cases), model=model, threads=threads)
        return np.stack([throws.ejection_phase, throws.energy_transfer])
    releases = [_last(model, *case) for case in cases.T.tolist()]
    return np.array(list(zip(*releases, strict=True)))


def _last(
    model: str,
    mass_ratio: float,
    speed_ratio: float,
    damping_ratio: float,
    gravity_ratio: float,
    loss_tangent: float,
    crossing_ratio: float,
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
            mass=mass_ratio, length=1.0, youngs_modulus=mass_ratio / (crossing_ratio or 1.0) ** 2
        ),
        gravity=gravity_ratio * omega * omega,
    )
    try:
        last = last_release(rig, model=model)
    except ThrowUnresolvedError:  # held, too light, or chattering for ever
        return math.nan, math.nan
    peak = engine.speed_scale * peak_velocity_ratio(damping_ratio)
    return last.time / speed_ratio, (last.speed / peak) ** 2
