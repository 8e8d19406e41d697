# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Simulated camera pictures with blur, pixels of finite size, and noise."""

from __future__ import annotations

import numpy as np
from scipy.ndimage import gaussian_filter

FINE = 5  # samples per pixel along each side
CONTRAST = 140.0  # difference of brightness between the background and a spot [grey levels]
NOISE = 4.0  # standard deviation of white noise [grey levels]
BLUR = 1.0  # standard deviation of the blur by the lens [px]
DIAMETER = 8.0  # of a spot [px]


def disc(shape, row, column, *, diameter=DIAMETER, blur=BLUR):
    """Return the fraction of each pixel that a blurred disc covers."""
    reach = int(0.5 * diameter + 5.0 * blur) + 2
    first = np.floor([row, column]).astype(int) - reach
    steps = (np.arange((2 * reach + 1) * FINE) + 0.5) / FINE - 0.5
    distance = np.hypot(
        *np.meshgrid(first[0] + steps - row, first[1] + steps - column, indexing='ij')
    )
    sharp = np.clip(0.5 - FINE * (distance - 0.5 * diameter), 0.0, 1.0)
    blurred = gaussian_filter(sharp, FINE * blur)
    pixels = blurred.reshape(2 * reach + 1, FINE, 2 * reach + 1, FINE).mean(axis=(1, 3))
    padded = np.zeros(np.add(shape, 2 * reach + 2))
    row, column = np.clip(first + reach + 1, 0, np.array(shape))
    padded[row:row + 2 * reach + 1, column:column + 2 * reach + 1] = pixels
    return padded[reach + 1:reach + 1 + shape[0], reach + 1:reach + 1 + shape[1]]


def exposed(levels, rng, *, noise=NOISE):
    """Return the noisy 8-bit picture of grey levels."""
    noisy = levels + noise * rng.normal(size=levels.shape)
    return np.clip(np.round(noisy), 0, 255).astype(np.uint8)


def picture(shape, centres, rng, *, around=200.0, contrast=CONTRAST, noise=NOISE, **disc_options):
    """Return a picture of spots with given centres (row, column)."""
    levels = np.broadcast_to(around, shape).astype(float)
    for row, column in centres:
        levels = levels - contrast * disc(shape, row, column, **disc_options)
    return exposed(levels, rng, noise=noise)
