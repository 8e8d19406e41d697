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

_MIN_POINTS, _MAX_POINTS = 9, 512
"""Bounds of the number of grid points along an axis that is free."""

_MAX_CANDIDATES = 4
"""Number of pattern searches, each from a local maximum of the grid."""

_CANDIDATE_TOLERANCE = 0.1
"""Part of the highest score that a candidate may lack while its patch is a grid step wide. [-]"""

_SHARE = 32
"""One of so many grid points is computed before the others, to exclude most of them."""

_MAX_ROUNDS = 40
"""Upper bound of the rounds of a pattern search, which usually needs 6 to 15."""

_PATCH = np.linspace(-1.0, 1.0, 7)
"""Points of a patch along an axis, in half widths."""

_FAN = tuple(itertools.product((-1.0, 1.0), np.linspace(-1.0, 1.0, 15).tolist()))
"""Far points: along a ridge in roots of half widths, and across it in half widths."""

_SHRINK = 0.3
"""Size of the next patch over that of a patch with its best point inside. [-]"""

_EQUAL = 1e-9
"""Relative difference of scores that count as equal; then the thinner layer is chosen. [-]"""

_ROUNDING = 1e-13
"""Relative difference of scores that may be rounding; a patch does not move for less. [-]"""

Score: TypeAlias = Callable[[Floats, Floats, Floats | float], Floats]
"""
Score by thickness and wave speed; 0 for layers that throw nothing or break a limit.

Where the score is below the third argument, any number between them may be returned.
"""


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
    score: Score,
    box: Box,
    *,
    step: float,
    starts: Sequence[tuple[float, float]] = (),
    tolerance: float = 1e-5,
) -> Optimum | None:
    """
    Find the layer with the highest score.

    Parameters
    ----------
    score : Score
        Function to maximise.
    box : Box
        Range of the search.
    step : float
        Step of the grid in the logarithms. [-]
    starts : sequence of (float, float)
        Thickness [m] and wave speed [m/s] of layers that start a search if they beat the grid.
    tolerance : float
        Relative error of thickness and wave speed. [-]

    Returns
    -------
    Optimum or None
        None if all scores are 0. Of scores that are equal to 1e-9, the thinner layer.

    """
    low, high = np.log(np.array(box).T)
    sizes = np.clip(np.ceil((high - low) / step).astype(int) + 1, _MIN_POINTS, _MAX_POINTS)
    sizes = np.where(high > low, sizes, 1)
    spacing = (high - low) / np.maximum(sizes - 1, 1)

    def at(points: Floats, needed: Floats | float = 0.0) -> Floats:
        """Compute scores at points, the logarithms of thickness and wave speed."""
        thickness, wave_speed = (
            np.clip(np.exp(points[..., i].ravel()), *box[i]) for i in range(2)
        )
        needed = np.broadcast_to(needed, points.shape[:-1]).ravel()
        return score(thickness, wave_speed, needed).reshape(points.shape[:-1])

    axes = [np.linspace(low[i], high[i], sizes[i]) for i in range(2)]
    grid = np.stack(np.meshgrid(*axes, indexing='ij'), axis=-1)
    points = grid.reshape(-1, 2)
    scores = at(points, np.inf)
    first = np.argsort(-scores)[: 1 + scores.size // _SHARE]
    needed = (1.0 - _CANDIDATE_TOLERANCE) * at(points[first]).max()
    is_near = scores >= needed
    scores[is_near] = at(points[is_near], needed)
    indices = _highest_maxima(scores.reshape(grid.shape[:-1]))
    points, values = points[indices], scores[indices]
    if starts:
        others = np.log(np.array(starts))
        scores = at(others)
        is_better = scores > values.max(initial=0.0)
        points = np.concatenate([points, others[is_better]])
        values = np.append(values, scores[is_better])
    if not (values > 0.0).any():
        return None
    point, value = points[0], float(values[0])
    if (high > low).any():
        point, value = _pattern_search(at, points, values, spacing, (low, high), tolerance)
    thickness, wave_speed = (float(np.clip(np.exp(point[i]), *box[i])) for i in range(2))
    return Optimum(thickness, wave_speed, value)


def _highest_maxima(scores: Floats) -> NDArray[np.intp]:
    """Return the flat indices of the highest grid points that no neighbour exceeds."""
    around = scipy.ndimage.maximum_filter(scores, 3)
    is_high = scores > (1.0 - _CANDIDATE_TOLERANCE) * scores.max()
    maxima = np.flatnonzero((scores >= around) & is_high)
    order = np.argsort(-scores.ravel()[maxima], kind='stable')
    return maxima[order[:_MAX_CANDIDATES]]


def _pattern_search(
    at: Callable[..., Floats],
    points: Floats,
    values: Floats,
    spacing: Floats,
    box: tuple[Floats, Floats],
    tolerance: float,
) -> tuple[Floats, float]:
    """Move patches to their best points and shrink them; return the best point and its score."""
    is_free = spacing > 0.0
    near = np.array(list(itertools.product(*(_PATCH if free else (0.0,) for free in is_free))))
    far = np.array(_FAN if is_free.all() else []).reshape(-1, 2)
    is_edge = np.abs(np.concatenate([near, far])).max(axis=1) == 1.0
    widths = np.ones(len(points))
    for _ in range(_MAX_ROUNDS):
        if widths.max() * spacing.max() < tolerance:
            break
        scale = widths[:, None, None]
        moves = np.concatenate(
            [scale * near, np.concatenate([scale**0.5, scale], axis=2) * far], axis=1
        ) * spacing
        if is_free.all():
            moves[..., 1] += moves[..., 0]  # along a line of equal kappa
        patches = np.clip(points[:, None] + moves, *box)
        scores = at(patches, values[:, None])
        best = scores.argmax(axis=1)
        rows = np.arange(len(points))
        is_better = scores[rows, best] > (1.0 + _ROUNDING) * values
        points = np.where(is_better[:, None], patches[rows, best], points)
        values = np.where(is_better, scores[rows, best], values)
        widths = np.where(is_better & is_edge[best], widths, _SHRINK * widths)
        is_candidate = values >= (1.0 - _CANDIDATE_TOLERANCE * widths) * values.max()
        points, values, widths = points[is_candidate], values[is_candidate], widths[is_candidate]
    is_best = values >= (1.0 - _EQUAL) * values.max()
    thinnest = np.flatnonzero(is_best)[points[is_best, 0].argmin()]
    return points[thinnest], float(values[thinnest])
