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
r"""
Find the layer with the highest score within a range of thickness and wave speed.

Notes
-----
Scores are a landscape with cliffs, wherever the release jumps across 3, 5, 7 ... crossings or to
another swing of the plate, and a limit is one more cliff; and it has several maxima. So nothing
here takes it for smooth. It is computed on a grid of equal steps in the logarithms, from coarse to
fine, at last near the highest points only. Then patches of points around the highest local maxima
move to their best points, and shrink where these are inside. In a patch the wave speed grows with
the thickness, for ridges and cliffs run along lines of equal :math:`\kappa = c_s / (L_s f)`.

What is narrower than the grid's steps may be missed. Such teeth have been seen where no layer
reaches :math:`\alpha = 0.02`, heavy projectiles on slow layers; and where gravity exceeds the
plate's acceleration: there a layer that is 4 % off throws a tenth.

"""

from __future__ import annotations

from collections.abc import Callable
import itertools
from typing import NamedTuple, Protocol, TypeVar

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
_Number = TypeVar('_Number', np.float64, np.bool_)

_FEWEST, _MOST = 9, 512  # points of the grid along an axis
_STRIDES = (8, 4, 2, 1)  # of points computed in turn
_STEEPEST = 2.0  # slope, in logarithms, with which a score is expected to rise at most, ...
_UNSURE = 0.2  # and by which part it may rise beside a cliff, however fine the grid
_CANDIDATES = 4  # maxima of the grid that are looked at closely
_CLOSE = 0.1  # part by which they may be lower than the highest, at first
_SHRINK, _GROW = 0.4, 2.0  # of a patch whose best point is inside, or at the edge
_MAX_ROUNDS = 40
_EQUAL = 1e-9  # scores so close are the same; the thinner layer is kept
_PATCH = (-1.0, -0.65, -0.3, 0.0, 0.3, 0.65, 1.0)


class Score(Protocol):
    """What is to be as large as it can; 0 where there is nothing, or less than `least`."""

    def __call__(self, thickness: Floats, wave_speed: Floats, *, least: Floats) -> Floats:
        """Compute the scores of layers, shape (n,) each."""


class LayerRange(NamedTuple):
    """Smallest and largest thickness [m] and wave speed [m/s]; what is twice the same is fixed."""

    thickness: tuple[float, float]
    wave_speed: tuple[float, float]

    def contains(self, thickness: float, wave_speed: float) -> bool:
        """Tell whether a layer is within."""
        return (
            self.thickness[0] <= thickness <= self.thickness[1]
            and self.wave_speed[0] <= wave_speed <= self.wave_speed[1]
        )


class Optimum(NamedTuple):
    """The best layer: its thickness [m], its wave speed [m/s], and its score."""

    thickness: float
    wave_speed: float
    score: float


def find_best_layer(
    score: Score,
    layers: LayerRange,
    *,
    step: float,
    starts: tuple[Optimum, ...] = (),
    tolerance: float = 1e-5,
    least: float = 0.0,
    is_whole: bool = False,
) -> Optimum | None:
    """
    Find the layer with the highest score.

    Parameters
    ----------
    score : Score
        Of layers.
    layers : LayerRange
        Where to look.
    step : float
        Of the grid, in logarithms. [-]
    starts : tuple of Optimum
        Layers within the range whose scores are known, around which to look as well.
    tolerance : float
        How closely the place is found, relative. [-]
    least : float
        What is lower does not matter. [-]
    is_whole : bool
        Whether the whole grid is computed, for scores that may rise from nothing anywhere.

    Returns
    -------
    Optimum or None
        None if all scores are 0, or below `least`. Where they are equal to 1e-9, the thinner
        layer.

    """
    low, high = np.log(np.array(layers).T)
    sizes = np.clip(np.ceil((high - low) / step).astype(int) + 1, _FEWEST, _MOST)
    axes = [
        np.linspace(low[i], high[i], int(sizes[i]) if low[i] < high[i] else 1) for i in range(2)
    ]
    spacing = np.array([axis[1] - axis[0] if axis.size > 1 else 0.0 for axis in axes])

    def at(places: Floats, least: Floats) -> Floats:
        """Compute scores at places, the logarithms of thickness and wave speed."""
        thickness, wave_speed = (
            np.clip(np.exp(places[..., i].ravel()), *layers[i]) for i in range(2)
        )
        return score(thickness, wave_speed, least=least.ravel()).reshape(places.shape[:-1])

    grid = np.stack(np.meshgrid(*axes, indexing='ij'), axis=-1)
    highest = max((least, *(start.score for start in starts)))
    slope = np.inf if is_whole else _STEEPEST * float(spacing.max())
    heights = _climb(at, grid, highest, slope)
    indices = _highest_maxima(heights)
    places = [grid[i, j] for i, j in indices]
    values = [heights[i, j] for i, j in indices]
    for start in starts:
        if start.score > 0.0:
            places.append(np.log(start[:2]))
            values.append(start.score)
    if not places:
        return None
    place, value = _zoom(at, np.array(places), np.array(values), spacing, (low, high), tolerance)
    thickness, wave_speed = (float(np.clip(np.exp(place[i]), *layers[i])) for i in range(2))
    return Optimum(thickness, wave_speed, value) if value >= least else None


def _climb(
    at: Callable[[Floats, Floats], Floats], grid: Floats, highest: float, slope: float
) -> Floats:
    """
    Compute scores on a grid from coarse to fine; those not worth it stay 0.

    A point is worth it if a known one nearby may rise to the highest known with the `slope`, in
    parts of the highest per step of the grid.
    """
    heights = np.zeros(grid.shape[:2])
    is_known = np.zeros(heights.shape, dtype=np.bool_)
    worth = 0.0
    for stride in _STRIDES:
        chosen = np.zeros_like(is_known)
        chosen[::stride, ::stride] = True
        chosen &= ~is_known
        if stride < _STRIDES[0]:
            is_close = is_known & (heights >= worth * highest)
            chosen &= _largest_nearby(is_close, 2 * stride - 1)
        worth = max(1.0 - max(stride * slope, _UNSURE), 0.0)  # in the next round
        least = (1.0 - _CLOSE) * highest if np.isinf(slope) else worth * highest
        heights[chosen] = at(grid[chosen], np.full(np.count_nonzero(chosen), least))
        is_known |= chosen
        highest = max(highest, heights.max())
    return heights


def _largest_nearby(values: NDArray[_Number], reach: int) -> NDArray[_Number]:
    """Return the largest value within so many steps of each point of a grid, both ways."""
    for axis in (0, 1):
        width = [(reach, reach) if each == axis else (0, 0) for each in (0, 1)]
        padded = np.pad(values, width, mode='edge')
        values = np.lib.stride_tricks.sliding_window_view(padded, 2 * reach + 1, axis)
        values = values.max(axis=-1)
    return values


def _highest_maxima(heights: Floats) -> list[tuple[int, int]]:
    """List the highest points of the grid that no neighbour exceeds, the highest first."""
    is_maximum = (heights >= _largest_nearby(heights, 1)) & (heights > 0.0)
    found = np.argwhere(is_maximum & (heights > (1.0 - _CLOSE) * heights.max()))
    order = np.argsort(-heights[tuple(found.T)], kind='stable')
    return [(int(i), int(j)) for i, j in found[order[:_CANDIDATES]]]


def _zoom(
    at: Callable[[Floats, Floats], Floats],
    places: Floats,
    values: Floats,
    spacing: Floats,
    box: tuple[Floats, Floats],
    tolerance: float,
) -> tuple[Floats, float]:
    """
    Move patches to their best points and shrink them, until they are as small as asked.

    One that has its best point at its edge does not shrink, and grows unless it is the best of
    all; one that has come to a better one is left.
    """
    varies = spacing > 0.0
    axes = [_PATCH if free else (0.0,) for free in varies]
    offsets = np.array([offset for offset in itertools.product(*axes) if any(offset)])
    offsets = offsets.reshape(-1, 2)
    is_edge = np.abs(offsets).max(axis=1) == 1.0
    moves = offsets * spacing
    if varies.all():
        moves[:, 1] += moves[:, 0]  # at equal kappa
    reach = np.ones(len(places))
    for _ in range(_MAX_ROUNDS):
        if not len(offsets) or reach.max() * spacing.max() < tolerance:
            break
        patches = np.clip(places[:, None] + reach[:, None, None] * moves, *box)
        found = at(patches, np.repeat(values[:, None], len(moves), axis=1))
        best = found.argmax(axis=1)
        rows = np.arange(len(places))
        is_better = found[rows, best] > values
        places = np.where(is_better[:, None], patches[rows, best], places)
        values = np.where(is_better, found[rows, best], values)
        grow = np.where(values < values.max(), _GROW, 1.0)
        reach *= np.where(is_better & is_edge[best], grow, _SHRINK)
        order = np.lexsort((places[:, 0], -values))  # the best first, the thinner of equals
        places, values, reach = places[order], values[order], reach[order]
        # The closer one looks, the less a candidate can still gain.
        alive = values >= (1.0 - _CLOSE * np.minimum(reach, 1.0)) * values[0]
        apart = places[:, None] - places
        apart[..., 1] -= apart[..., 0] * varies.all()
        is_near = (np.abs(apart) <= (reach[:, None] * spacing)[:, None]).all(axis=-1)
        alive &= ~np.tril(is_near, -1).any(axis=1)
        places, values, reach = places[alive], values[alive], reach[alive]
    is_best = values >= (1.0 - _EQUAL) * values.max()
    thinnest = np.flatnonzero(is_best)[places[is_best, 0].argmin()]
    return places[thinnest], float(values[thinnest])
