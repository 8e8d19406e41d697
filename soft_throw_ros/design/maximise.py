# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
r"""
Find the layer with the highest score within a box of thickness and wave speed.

Notes
-----
Scores have cliffs wherever the release jumps across 3, 5, 7 ... crossings or to another swing of
the plate, and wherever a limit is met, and they have several maxima. So the search takes no
derivative. It computes a grid of equal steps in the logarithms. From the highest local maxima it
starts a pattern search: a patch of points moves to its best point, and shrinks when that point is
inside. In a patch the wave speed grows with the thickness, because ridges and cliffs run along
lines of equal :math:`\kappa = c_s / (L_s f)`. Ridges between two throws that count run at some
angle to these lines, and rise slowly; so a patch has far points as well, in two narrow fans whose
angle shrinks with the patch.

The search may miss maxima that are narrower than a step of the grid. Such maxima exist where no
layer reaches :math:`\alpha = 0.02`, with heavy projectiles on slow layers, and where gravity
exceeds the plate's acceleration: there a layer that is 4 % off throws a tenth.

"""

from __future__ import annotations

from collections.abc import Callable, Sequence
import itertools
from typing import NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray
import scipy  # its parts are imported where they are first used, which takes 0.3 s

Floats = NDArray[np.float64]

Score: TypeAlias = Callable[[Floats, Floats, Floats | float], Floats]
"""
Score by thickness and wave speed; 0 for layers that throw nothing or break a limit.

Where the score is below the third argument, any number between them may be returned.
"""

NEAR = 0.1  # part of the highest score that a layer may lack to be searched near [-]
EQUAL = 1e-9  # relative difference of equal scores: the present or the thinner layer wins [-]

_CELL = 0.01  # area, or length with one free value, of a box in logarithms per grid point [-]
_SEARCHES = 4  # pattern searches, each from a local maximum of the grid
_MAX_ROUNDS = 40  # of a pattern search, which usually takes 6 to 15
_TOLERANCE = 1e-4  # relative error of thickness and wave speed [-]

# Points of a patch along an axis, in half widths
_PATCH = np.linspace(-1.0, 1.0, 7)

# Far points: along a ridge in roots of half widths, and across it in half widths
_FAN = list(itertools.product((-1.0, 1.0), np.linspace(-1.0, 1.0, 15).tolist()))


class Box(NamedTuple):
    """Smallest and largest thickness [m] and wave speed [m/s]; equal bounds fix a value."""

    thickness: tuple[float, float]
    wave_speed: tuple[float, float]

    def contains(self, thickness: float, wave_speed: float) -> bool:
        """Return whether a layer is within the box."""
        values = zip((thickness, wave_speed), self, strict=True)
        return all(low <= value <= high for value, (low, high) in values)


class Optimum(NamedTuple):
    """The best layer: its thickness [m], its wave speed [m/s], and its score."""

    thickness: float
    wave_speed: float
    score: float


def maximise(
    score: Score, box: Box, *, starts: Sequence[tuple[float, float]] = (), needed: float = 0.0,
    rough: Score | None = None, is_local: bool = False,
) -> Optimum | None:
    """
    Find the layer with the highest score; of scores that are equal to 1e-9, the thinner one.

    `starts` are thickness [m] and wave speed [m/s] of layers that start a search as well; a local
    search has no other ones. `rough` is a faster upper bound of the score, which chooses the
    points of the grid to search near. The result is None if no score is above `needed`.
    """
    bounds = np.transpose(box)
    low, high = np.log(bounds)
    is_free = high > low
    step = _CELL ** (1.0 / max(is_free.sum(), 1))
    sizes = np.ceil((high - low) / step).astype(int) + 1
    spacing = (high - low) / np.maximum(sizes - 1, 1)

    def at(points: Floats, needed: Floats | float = 0.0, score: Score = score) -> Floats:
        """Compute scores at points, the logarithms of thickness and wave speed."""
        thickness, wave_speed = np.clip(np.exp(points), *bounds).reshape(-1, 2).T
        needed = np.broadcast_to(needed, points.shape[:-1]).ravel()
        return score(thickness, wave_speed, needed).reshape(points.shape[:-1])

    points = np.reshape(np.log(starts), (-1, 2))
    if not is_local:
        axes = [np.linspace(low[i], high[i], sizes[i]) for i in range(2)]
        grid = np.stack(np.meshgrid(*axes, indexing='ij'), axis=-1).reshape(-1, 2)
        scores = at(grid, np.inf)
        best = max(needed, at(grid[np.argsort(-scores)[:_SEARCHES]]).max())
        is_near = scores >= (1.0 - NEAR) * best
        scores[is_near] = at(grid[is_near], score=rough or score)
        around = scipy.ndimage.maximum_filter(scores.reshape(sizes), 3).ravel()
        maxima = np.flatnonzero((scores >= around) & (scores > (1.0 - NEAR) * scores.max()))
        highest = maxima[np.argsort(-scores[maxima], kind='stable')[:_SEARCHES]]
        points = np.concatenate([grid[highest], points])
    points, values = _pattern_search(at, points, spacing, low, high)
    if not values.max(initial=0.0) > needed:
        return None
    is_best = values >= (1.0 - EQUAL) * values.max()
    thinnest = np.flatnonzero(is_best)[points[is_best, 0].argmin()]
    thickness, wave_speed = np.clip(np.exp(points[thinnest]), *bounds).tolist()
    return Optimum(thickness, wave_speed, float(values[thinnest]))


def _pattern_search(
    at: Callable[..., Floats], points: Floats, spacing: Floats, low: Floats, high: Floats
) -> tuple[Floats, Floats]:
    """Move patches to their best points and shrink them; return the points and their scores."""
    is_free = spacing > 0.0
    near = np.array(list(itertools.product(*(_PATCH if free else (0.0,) for free in is_free))))
    far = np.array(_FAN if is_free.all() else []).reshape(-1, 2)
    is_edge = np.abs(np.concatenate([near, far])).max(axis=1) == 1.0
    values, widths = at(points), np.ones(len(points))
    for _ in range(_MAX_ROUNDS):
        if widths.max(initial=0.0) * spacing.max() < _TOLERANCE:
            break
        scale = widths[:, None, None]
        moves = np.concatenate(
            [scale * near, np.concatenate([scale**0.5, scale], axis=2) * far], axis=1
        ) * spacing
        if is_free.all():
            moves[..., 1] += moves[..., 0]  # along a line of equal kappa
        patches = np.clip(points[:, None] + moves, low, high)
        scores = at(patches, values[:, None])
        best = scores.argmax(axis=1)
        rows = np.arange(len(points))
        is_better = scores[rows, best] > (1.0 + EQUAL) * values
        points = np.where(is_better[:, None], patches[rows, best], points)
        values = np.where(is_better, scores[rows, best], values)
        # the next patch lies between the points of this one
        widths = np.where(is_better & is_edge[best], widths, (_PATCH[1] - _PATCH[0]) * widths)
        order = np.argsort(-values, kind='stable')
        points, values, widths = points[order], values[order], widths[order]
        # end searches far below the best one, and those close to a better one
        inner = (_PATCH[1] - _PATCH[0]) * spacing * widths[:, None, None]
        is_inside = (np.abs(points[:, None] - points) <= inner).all(axis=2)
        is_candidate = values >= (1.0 - NEAR * widths) * values[0]
        is_candidate &= ~np.tril(is_inside, -1).any(axis=1)
        points, values, widths = points[is_candidate], values[is_candidate], widths[is_candidate]
    return points, values
