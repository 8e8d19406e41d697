# SPDX-License-Identifier: Apache-2.0
"""A layer of more than one material: slabs on each other, or a gradual change, or both."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from itertools import pairwise
import math

import numpy as np
from numpy.typing import NDArray
from soft_throw_ros.core import checks
from soft_throw_ros.core.rig import Layer

Floats = NDArray[np.float64]

_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(12)


@dataclass(frozen=True, eq=False)
class Piece:
    """
    A part of a layer without jumps, linear between heights.

    Parameters
    ----------
    heights : ndarray, shape (n,)
        Above the plate. [m]
    materials : ndarray, shape (3, n)
        Density [kg/m3], Young's modulus [Pa] and loss tangent [-] there.

    """

    heights: Floats
    materials: Floats

    @property
    def is_uniform(self) -> bool:
        """Whether it is of one material."""
        return not np.ptp(self.materials, axis=1).any()

    @property
    def crossing_time(self) -> float:
        """What a wave needs for it. [s]"""
        return float(self._sums[0, -1])

    @cached_property
    def _sums(self) -> Floats:
        """Integrals, as below, up to the heights of the table."""
        segments = self._integrate(self.heights[:-1], self.heights[1:])
        return np.concatenate((np.zeros((4, 1)), np.cumsum(segments, axis=1)), axis=1)

    def integrals(self, heights: Floats) -> Floats:
        """
        Integrate from the bottom of the piece to given heights.

        Parameters
        ----------
        heights : ndarray, shape (n,)
            Within the piece. [m]

        Returns
        -------
        ndarray, shape (4, n)
            Of slowness, that is travel time [s]; density [kg/m2]; compliance [m/Pa]; compliance
            times loss tangent [m/Pa].

        """
        below = np.searchsorted(self.heights, heights, side='right') - 1
        below = np.clip(below, 0, self.heights.size - 2)
        return np.asarray(self._sums[:, below] + self._integrate(self.heights[below], heights))

    def _integrate(self, low: Floats, high: Floats) -> Floats:
        """Integrate over intervals without a height of the table inside."""
        half = 0.5 * (high - low)[:, None]
        nodes = 0.5 * (high + low)[:, None] + half * _NODES
        rho, E, tangent = (np.interp(nodes, self.heights, values) for values in self.materials)
        integrands = np.stack((np.sqrt(rho / E), rho, 1.0 / E, tangent / E))
        return np.asarray(np.sum(half * _WEIGHTS * integrands, axis=2))

    def cut(self, count: int) -> Floats:
        """
        Divide into parts for which a wave needs the same time each.

        Returns
        -------
        ndarray, shape (count + 1,)
            The heights of their edges. [m]

        """
        ends = self.heights[[0, -1]]
        if self.is_uniform:
            return np.linspace(ends[0], ends[1], count + 1)
        times = np.linspace(0.0, self.crossing_time, count + 1)[1:-1]
        after = np.searchsorted(self._sums[0], times)
        start, left, right = self.heights[after - 1], self.heights[after - 1], self.heights[after]
        times = times - self._sums[0, after - 1]
        for _ in range(60):  # bisection, to the last digit
            middle = 0.5 * (left + right)
            is_before = self._integrate(start, middle)[0] < times
            left, right = np.where(is_before, middle, left), np.where(is_before, right, middle)
        return np.concatenate((ends[:1], 0.5 * (left + right), ends[1:]))


@dataclass(frozen=True, kw_only=True)
class GradedLayer(Layer):
    r"""
    A cylinder whose material changes from plate to top.

    Only finite differences know how to throw with it. Make it with `stack` or `sample`, or from a
    table. What it has in common with a layer of one material are means.

    Parameters
    ----------
    heights : sequence of float
        Where the material is known, from 0 at the plate to the thickness; in between all is
        linear. The same height twice is a jump. [m]
    densities, youngs_moduli : sequence of float
        :math:`\rho_s` and :math:`E_s` there. [kg/m3], [Pa]
    loss_tangents : sequence of float
        At the engine's frequency; none if not given. [-]
    diameter : float
        Of the section :math:`S`. [m]

    Attributes
    ----------
    thickness : float
        :math:`L_s`, the last height. [m]
    wave_speed : float
        Thickness over crossing time. [m/s]
    density : float
        Mass over volume. [kg/m3]
    loss_tangent : float
        Of the whole layer when it is squeezed slowly. [-]

    Raises
    ------
    ValueError
        If the table does not begin at 0, does not increase, its columns differ in length, or a
        value is not finite and positive (loss: not negative).

    Examples
    --------
    A stiff slab of 2 mm on a soft one of 10 mm:

    >>> from soft_throw_ros.core.rig import Layer
    >>> layer = GradedLayer.stack(
    ...     Layer(thickness=10e-3, wave_speed=8.0), Layer(thickness=2e-3, wave_speed=20.0)
    ... )
    >>> round(layer.thickness, 6), round(1e3 * layer.crossing_time, 6)
    (0.012, 1.35)

    """

    heights: tuple[float, ...]
    densities: tuple[float, ...]
    youngs_moduli: tuple[float, ...]
    loss_tangents: tuple[float, ...] = ()
    thickness: float = field(init=False)
    wave_speed: float = field(init=False)
    density: float = field(init=False)
    loss_tangent: float = field(init=False)

    def __post_init__(self) -> None:
        count = len(self.heights)
        if not self.loss_tangents:
            object.__setattr__(self, 'loss_tangents', (0.0,) * count)
        for name, check in (
            ('heights', checks.not_negative),
            ('densities', checks.positive),
            ('youngs_moduli', checks.positive),
            ('loss_tangents', checks.not_negative),
        ):
            column: Sequence[float] = getattr(self, name)
            if len(column) != count or count < 2:
                raise ValueError(
                    f'layer.{name} must have as many values as layer.heights, and at least 2, '
                    f'got {len(column)} and {count}'
                )
            values = tuple(check(f'layer.{name}', value) for value in column)
            object.__setattr__(self, name, values)
        object.__setattr__(self, 'diameter', checks.positive('layer.diameter', self.diameter))
        if self.heights[0] != 0.0:
            raise ValueError(f'layer.heights must begin at 0, got {self.heights[0]:g}')
        steps = np.diff(self.heights)
        wrong = (steps < 0.0) | ((steps == 0.0) & (np.append(steps[1:], 0.0) == 0.0))
        if wrong.any() or steps[0] == 0.0:
            first = int(np.argmax(wrong))
            raise ValueError(
                'layer.heights must increase, with no more than two the same and a slab at both '
                f'ends, got {self.heights[first + 1]:g} after {self.heights[first]:g}'
            )
        wholes = [piece.integrals(piece.heights[-1:])[:, 0] for piece in self.pieces()]
        time, mass, compliance, loss = np.sum(wholes, axis=0).tolist()
        for name, value in (
            ('thickness', self.heights[-1]),
            ('wave_speed', self.heights[-1] / time),
            ('density', mass / self.heights[-1]),
            ('loss_tangent', loss / compliance),
        ):
            object.__setattr__(self, name, value)

    @classmethod
    def stack(cls, *slabs: Layer) -> GradedLayer:
        """
        Put slabs on each other, the first one on the plate.

        Parameters
        ----------
        *slabs : Layer
            Of one diameter.

        Raises
        ------
        ValueError
            If there is none, or their diameters differ.

        """
        if not slabs:
            raise ValueError('a stack needs at least one slab, got none')
        for slab in slabs[1:]:
            if slab.diameter != slabs[0].diameter:
                raise ValueError(
                    'slabs must be of one diameter, '
                    f'got {slabs[0].diameter:g} m and {slab.diameter:g} m'
                )
        edges = np.cumsum([0.0, *(slab.thickness for slab in slabs)]).tolist()
        return cls(
            heights=tuple(edge for pair in pairwise(edges) for edge in pair),
            densities=tuple(slab.density for slab in slabs for _ in range(2)),
            youngs_moduli=tuple(slab.youngs_modulus for slab in slabs for _ in range(2)),
            loss_tangents=tuple(slab.loss_tangent for slab in slabs for _ in range(2)),
            diameter=slabs[0].diameter,
        )

    @classmethod
    def sample(
        cls,
        *,
        thickness: float,
        youngs_modulus: Callable[[float], float],
        density: Callable[[float], float],
        loss_tangent: Callable[[float], float] = lambda _height: 0.0,
        diameter: float = 12e-3,
        points: int = 257,
    ) -> GradedLayer:
        """
        Tabulate functions of the height, which should be smooth.

        Parameters
        ----------
        thickness : float
            [m]
        youngs_modulus, density, loss_tangent : callable
            Of the height above the plate [m]. [Pa], [kg/m3], [-]
        diameter : float
            [m]
        points : int
            Heights of the table.

        Raises
        ------
        ValueError
            As the class, or if there are less than 2 points.

        """
        checks.positive('thickness', thickness)
        if points < 2:
            raise ValueError(f'points must be at least 2, got {points}')
        heights = np.linspace(0.0, thickness, points).tolist()
        return cls(
            heights=tuple(heights),
            densities=tuple(map(density, heights)),
            youngs_moduli=tuple(map(youngs_modulus, heights)),
            loss_tangents=tuple(map(loss_tangent, heights)),
            diameter=diameter,
        )

    def pieces(self) -> Iterator[Piece]:
        """Yield the parts between jumps, from plate to top."""
        heights = np.array(self.heights)
        starts = np.concatenate(([0], np.flatnonzero(np.diff(heights) == 0.0) + 1, [heights.size]))
        materials = np.array([self.densities, self.youngs_moduli, self.loss_tangents])
        for start, end in pairwise(starts):
            yield Piece(heights[start:end], materials[:, start:end])

    @cached_property
    def _compliance(self) -> float:
        """Change of thickness over stress, at rest. [m/Pa]"""
        return float(sum(piece.integrals(piece.heights[-1:])[2, 0] for piece in self.pieces()))

    @property
    def youngs_modulus(self) -> float:
        """That of a uniform layer which is squeezed as much at rest. [Pa]"""
        return self.thickness / self._compliance

    @property
    def impedance(self) -> float:
        """Of the top, force over speed of a travelling wave. [kg/s]"""
        return math.sqrt(self.densities[-1] * self.youngs_moduli[-1]) * self.section

    @property
    def is_uniform(self) -> bool:
        """It is not, even if all values are the same."""
        return False
