# SPDX-License-Identifier: Apache-2.0
r"""
How hard a throw is on layer, projectile and plate, up to the first release.

In closed form, for the plate `soft_throw_ros.core.plate.Underdamped`.

Notes
-----
Time in crossings :math:`t_s`, speed in units of the plate's `velocity_factor`, and the symbols of
`soft_throw_ros.core.travelling_wave`. Up to the first release all is known from one function, the
downward wave at the top, :math:`M = V_m - v_+`. In the wave interval :math:`k`, at
:math:`t = 2 k + 1 + \sigma`, the series of that module add up to

.. math::

    M = -\Im\, r(\lambda)\, Q_k e^{\lambda \sigma} + \sum_{j \le k} c_{k-j}\, \phi_j(\sigma / \mu)

(zero before :math:`t = 1`), and the upward wave at the plate is
:math:`P(t) = V_p(t) - M(t - 1)`. With :math:`0 \le \eta \le 1` from plate to top, the strain is

.. math:: c_s\, \epsilon(\eta, t) = M(t - 1 + \eta) - P(t - \eta) - g \tau

where :math:`g \tau` is the static part, from the weight of the projectile (that of the layer is
left out, as everywhere). Acceleration of the projectile and force on the plate are this at the
top, without the static part, and at the plate.

So a table of :math:`M` and :math:`P` is a grid over the whole layer. Kinks of both start at whole
numbers of crossings, followed by transients of length :math:`\mu`; the table has the former and
resolves the latter. From the highest points the search goes on in :math:`(t, \eta)`, with eight
neighbours at ever shorter distances: kinks lie on the diagonals of these, so that nothing is lost
there, and maxima on the edges of the layer and at the release are found.

"""

from __future__ import annotations

import math
from typing import NamedTuple

import numba as nb
import numpy as np
from soft_throw_ros.core import checks
from soft_throw_ros.core.plate import peak_velocity_ratio
from soft_throw_ros.core.travelling_wave import (
    first_release,
    first_release_kernel,
    FirstRelease,
    MAX_INTERVALS,
)

_PER_CROSSING = 12  # points of the table, if these are not too many, ...
_PER_PERIOD = 24.0  # and in any case so many per plate period
_MAX_POINTS = 1024
_CANDIDATES = 6  # of the table, from which it is searched on, ...
_CLOSE = 0.9  # if they come so close to the highest
_SHORTEST = 1e-9  # step of the search
_MAX_MOVES = 1000

_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(16)

_jit = nb.njit(cache=True, nogil=True, error_model='numpy')


class FirstPeaks(NamedTuple):
    r"""
    Largest values up to the first release, that moment included.

    Attributes
    ----------
    release : FirstRelease
        The first release.
    strain : float
        Largest magnitude of the strain anywhere in the layer. In :math:`A \omega / c_s`. [-]
    strain_phase : float
        When, in plate periods. [-]
    strain_height : float
        Where, from 0 at the plate to 1 at the top. [-]
    contact_strain : float
        Largest magnitude of the strain at the top. In :math:`A \omega / c_s`. [-]
    acceleration : float
        Largest magnitude of the projectile's acceleration. In :math:`A \omega^2`. [-]
    plate_force : float
        Largest magnitude of the layer's force on the plate. In :math:`A \omega E_s S / c_s`. [-]
    plate_work : float
        Work of the plate from the start to the release. In :math:`m (A \omega)^2`. [-]

    """

    release: FirstRelease
    strain: float
    strain_phase: float
    strain_height: float
    contact_strain: float
    acceleration: float
    plate_force: float
    plate_work: float


def first_peaks(
    *,
    mass_ratio: float,
    speed_ratio: float,
    damping_ratio: float = 0.0,
    gravity_ratio: float = 0.0,
) -> FirstPeaks:
    r"""
    Find the largest strain, acceleration and force up to the first release.

    The projectile is rigid, the layer is lossless, the plate moves as `plate.Underdamped`.

    Parameters
    ----------
    mass_ratio : float
        Projectile over layer mass, :math:`\mu = m / (\rho_s S L_s)`. [-]
    speed_ratio : float
        Crossings of the wave per plate period, :math:`\kappa = c_s / (L_s f)`. [-]
    damping_ratio : float
        Of the plate, :math:`\zeta`. [-]
    gravity_ratio : float
        :math:`g / (A \omega^2)`. [-]

    Returns
    -------
    FirstPeaks
        To 1e-8 relative.

    Raises
    ------
    ValueError
        If a ratio is not finite and positive (damping: in [0, 1); gravity: not negative).
    ThrowUnresolvedError
        As `travelling_wave.first_release`.

    Notes
    -----
    See the module. The work is the energy at the release (the attached layer and projectile lose
    none): of the projectile, of the waves
    :math:`(m / \tau) \int (P^2 + M^2)\, dt` over the last crossing, by Gauss's rule on pieces
    that shrink towards kinks, and the weight lifted by the plate.

    The paper calls deformations below 10 %; its rig at 63.2 Hz comes to 12-20 %.

    Examples
    --------
    The largest strain of the paper's rig with 5.6 mm under a 16.3 mm projectile, and at the top:

    >>> peaks = first_peaks(mass_ratio=1.3 * 16.3 / 5.6, speed_ratio=7.8 / (5.6e-3 * 63.2))
    >>> unit = 2e-3 * 2.0 * math.pi * 63.2 / 7.8
    >>> round(peaks.strain * unit, 6), round(peaks.contact_strain * unit, 6)
    (0.18544, 0.159919)

    """
    checks.positive('mass_ratio', mass_ratio)
    checks.positive('speed_ratio', speed_ratio)
    checks.below_one('damping_ratio', damping_ratio)
    checks.not_negative('gravity_ratio', gravity_ratio)
    phase, speed, status, *rest = first_peaks_kernel(
        float(mass_ratio), float(speed_ratio), float(damping_ratio), float(gravity_ratio)
    )
    if status != 0:
        first_release(  # which says why
            mass_ratio=mass_ratio,
            speed_ratio=speed_ratio,
            damping_ratio=damping_ratio,
            gravity_ratio=gravity_ratio,
        )
    transfer = (speed / peak_velocity_ratio(damping_ratio)) ** 2
    return FirstPeaks(FirstRelease(phase, speed, transfer), *rest)


@_jit
def first_peaks_kernel(
    mu: float, kappa: float, zeta: float, gravity: float
) -> tuple[float, float, int, float, float, float, float, float, float, float]:
    """
    Compute (t_e f, V_e / (A w), status), then what follows `release` in FirstPeaks.

    Without checks, for use inside compiled code.
    """
    work = np.empty((2, MAX_INTERVALS))
    phase, speed, status = first_release_kernel(mu, kappa, zeta, gravity, work)
    if status != 0:
        return phase, speed, status, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    c = work[0]
    root = math.sqrt(1.0 - zeta * zeta)
    crossing = 2.0 * math.pi / kappa  # w t_s
    lam = complex(-zeta * crossing, root * crossing)
    relaxation = crossing * mu  # w tau
    weight = gravity * relaxation * root  # g tau in velocity factors
    end = phase * kappa
    last = int(0.5 * (end - 1.0))
    if last > 0 and end - (2 * last + 1) < 1e-12 * end:
        last -= 1  # released at the very end of an interval: c has no more elements
    steady = _steady(last, mu, lam)
    waves = (mu, lam, steady, c)

    parts = _parts(mu, kappa, end)
    size = (int(end) + 1) * parts.size
    times = np.empty(size)
    down = np.empty(size)
    up = np.empty(size)
    for i in range(size):
        times[i] = i // parts.size + parts[i % parts.size]
        if times[i] > end:
            size = i
            break
        down[i] = _down(times[i], waves)
        up[i] = _plate(times[i], lam) - (down[i - parts.size] if i >= parts.size else 0.0)
    grid = (times[:size], down[:size], up[:size], parts)
    best, when, where = _highest(0.0, 1.0, grid, end, weight, waves)
    at_plate, _, _ = _highest(0.0, 0.0, grid, end, weight, waves)
    at_top, _, _ = _highest(1.0, 1.0, grid, end, weight, waves)
    # the push on the projectile less its weight: from weightless at the release to this
    push = max(at_top - weight, weight)
    layer = _wave_energy(end, waves) / mu
    lift = ((_phasor(lam, end) - 1.0) / lam).imag * crossing / root  # of the plate, over A
    plate_work = 0.5 * speed * speed + layer / (root * root) + gravity * lift
    return (
        phase,
        speed,
        status,
        best / root,
        when / kappa,
        where,
        at_top / root,
        push / (relaxation * root),
        at_plate / root,
        plate_work,
    )


@_jit
def _phasor(lam, time):
    """Compute e^{lambda t}."""
    size = 1.0 if lam.real == 0.0 else math.exp(lam.real * time)
    angle = lam.imag * time
    return complex(math.cos(angle) * size, math.sin(angle) * size)


@_jit
def _steady(last, mu, lam):
    """Compute r(lambda) Q_k for k = 0 ... last."""
    below = 1.0 + lam * mu
    reflection = (lam * mu - 1.0) / below
    step = _phasor(lam, 2.0)
    steady = np.empty(last + 1, np.complex128)
    arriving = complex(1.0, 0.0)
    q = arriving
    for k in range(last + 1):
        if k > 0:
            arriving *= step
            q = arriving + reflection * q
        steady[k] = reflection * q
    return steady


@_jit
def _plate(time, lam):
    """Compute V_p."""
    return _phasor(lam, time).imag if time > 0.0 else 0.0


@_jit
def _down(time, waves):
    """Compute M, the downward wave at the top."""
    if time <= 1.0:
        return 0.0
    mu, lam, steady, c = waves
    k = min(int(0.5 * (time - 1.0)), steady.size - 1)
    sigma = time - (2 * k + 1)
    x = 2.0 * sigma / mu
    before = 0.0
    phi = math.exp(-0.5 * x)
    value = c[k] * phi
    for j in range(1, k + 1):
        before, phi = phi, ((2 * j - 1 - x) * phi - (j - 1) * before) / j
        value += c[k - j] * phi
    return value - (steady[k] * _phasor(lam, sigma)).imag


@_jit
def _strain(time, height, waves):
    """Compute c_s epsilon without its static part."""
    start = time - height
    upward = _plate(start, waves[1]) - _down(start - 1.0, waves)
    return _down(time - 1.0 + height, waves) - upward


@_jit
def _parts(mu, kappa, end):
    """Divide a crossing: evenly, and ever more finely towards the kink at its start."""
    even = min(_PER_CROSSING, int(_MAX_POINTS / end))
    even = max(1, even, min(int(_PER_PERIOD / kappa), int(20 * _MAX_POINTS / end)))
    parts = np.empty(even + 64)
    parts[0] = 0.0
    size = 1
    fine = 0.125 * max(mu, 1e-12)
    while fine < 0.75 / even:
        parts[size] = fine
        size += 1
        fine *= 2.0
    for i in range(1, even):
        parts[size] = i / even
        size += 1
    return parts[:size]


@_jit
def _highest(low, high, grid, end, weight, waves):
    """Find the largest magnitude from one height to another: (value, time, height)."""
    times, down, up, parts = grid
    size = parts.size
    from_plate, to_top = low < 0.5, high > 0.5
    # along each upward wave, its meeting with the downward wave that squeezes it most
    largest = np.full(times.size, -1.0)
    meeting = np.zeros((times.size, 2))
    for i in range(times.size):
        first = i - size if from_plate else i + size
        last = min(i + size if to_top else i - size, times.size - 1)
        if first < 0:  # before the first reflection nothing changes along the way
            largest[i] = abs(up[i] + weight)
            meeting[i, 0] = times[i]
        for j in range(max(first, 0), last + 1):
            time = 0.5 * (times[j] + times[i] + 1.0)
            if time > end:
                break
            value = abs(down[j] - up[i] - weight)
            if value > largest[i]:
                largest[i] = value
                meeting[i, 0] = time
                meeting[i, 1] = time - times[i]
    top = largest.max()
    best, when, where = 0.0, 0.0, 0.0
    for _ in range(_CANDIDATES):
        i = largest.argmax()
        if largest[i] < _CLOSE * top:
            break
        value, time, height = _climb(
            meeting[i, 0], meeting[i, 1], low < high, parts, end, weight, waves
        )
        if value > best:
            best, when, where = value, time, height
        # done with the whole hill
        left = right = i
        while left > 0 and largest[left - 1] <= largest[left]:
            left -= 1
        while right < times.size - 1 and largest[right + 1] <= largest[right]:
            right += 1
        largest[left : right + 1] = -1.0
    # the release itself, which is not on the grid
    step = 1.0 / size
    for i in range(0 if from_plate else size, (size if to_top else 0) + 1):
        value = abs(_strain(end, i * step, waves) - weight)
        if value > best:
            best, when, where = _climb(end, i * step, low < high, parts, end, weight, waves)
    return best, when, where


@_jit
def _climb(time, height, is_free, parts, end, weight, waves):
    """Go to the best of eight neighbours, or halve the step if none is better."""
    across = 1 if is_free else 0
    step = 1.0 - parts[-1]
    value = abs(_strain(time, height, waves) - weight)
    for _ in range(_MAX_MOVES):
        best, when, where = value, time, height
        for i in range(-1, 2):
            for j in range(-across, across + 1):
                if i == 0 and j == 0:
                    continue
                near = min(max(time + i * step, 0.0), end)
                beside = min(max(height + j * step, 0.0), 1.0)
                other = abs(_strain(near, beside, waves) - weight)
                if other > best:
                    best, when, where = other, near, beside
        if best > value:
            value, time, height = best, when, where
        else:
            step *= 0.5
            if step < _SHORTEST:
                break
    return value, time, height


@_jit
def _wave_energy(end, waves):
    """Integrate P^2 + M^2 over the last crossing."""
    return _square(end, 1.0, waves) + _square(end, 0.0, waves)


@_jit
def _square(end, shift, waves):
    """Integrate the square of M (kinks at odd times, shift 1) or P (at even ones, shift 0)."""
    start = end - 1.0
    kink = 2.0 * math.floor(0.5 * (end - shift)) + shift
    if kink <= start:
        return _graded(start, end, start - kink, shift, waves)
    before = _graded(start, kink, start - kink + 2.0, shift, waves)
    return before + _graded(kink, end, 0.0, shift, waves)


@_jit
def _graded(start, end, after, shift, waves):
    """Integrate over a smooth piece that begins so long after a kink."""
    mu, lam, steady, _ = waves
    widest = math.pi / abs(lam)  # half a plate period
    total = 0.0
    left = start
    while left < end:
        # Laguerre functions up to the last one change over mu at first, then ever more slowly
        width = 0.5 * (mu + after) / (1.0 + math.sqrt(steady.size * min(1.0, 1.0 / mu)))
        width = min(width, widest)
        right = left + width
        if right > end - 0.1 * width:
            right = end
        half = 0.5 * (right - left)
        for node in range(_NODES.size):
            time = left + half * (1.0 + _NODES[node])
            value = _down(time - 1.0 + shift, waves)
            if shift < 0.5:
                value -= _plate(time, lam)
            total += half * _WEIGHTS[node] * value * value
        after += right - left
        left = right
    return total
