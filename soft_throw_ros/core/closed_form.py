# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
r"""
Exact time and speed of the first release of a rigid projectile (Sec. IV of the paper).

It takes any number of crossings of the wave. Later events and loads need `core.wave_stepper`.

Notes
-----
Time in crossings :math:`t_s`, speed in :math:`A \omega / \sqrt{1 - \zeta^2}`, so that
:math:`V_p = \Im e^{\lambda t}`. In the wave interval :math:`k`, that is
:math:`t = 2 k + 1 + \sigma` with :math:`0 \le \sigma \le 2`, upward wave and mass move with

.. math::

    v_+ &= \Im\, Q_k e^{\lambda \sigma} - \sum_{j<k} c_{k-1-j}\, \phi_j(\sigma / \mu) \\
    V_m &= \Im\, \frac{2 Q_k}{1 + \lambda \mu} e^{\lambda \sigma}
           + \sum_{j \le k} (c_{k-j} - c_{k-1-j})\, \phi_j(\sigma / \mu)

where :math:`\phi_j(u) = e^{-u} L_j(2 u)` are Laguerre functions: the powers of the all-pass
response :math:`r(s) = (\tau s - 1)/(\tau s + 1)` in the time domain. They never exceed 1, so
nothing cancels, however small :math:`\mu` is. With :math:`Q_k = e^{2 k \lambda} +
r(\lambda) Q_{k-1}`, and :math:`c_k` from the continuity of :math:`V_m`,

.. math::

    c_k = S_k - S_{k-1} - \Im \frac{2 r(\lambda)^k}{1 + \lambda \mu}, \qquad
    S_k = \sum_{j<k} c_{k-1-j}\, \phi_j(2 / \mu),

one more interval costs :math:`O(k)` and no transcendental function. The contact force is
:math:`F = (m / \tau) G` with :math:`G = 2 v_+ - V_m`, and the projectile leaves when G first
falls to :math:`-g \tau`. The paper's Eqs. (11)-(13) are :math:`k = 0`, its Eq. (14) is
:math:`k = 1`, where it stops.

The interval of release is found from G at the ends of intervals. After interval 0, G may dip to 0
in an interval at whose end it is positive again; in dense scans of 10^5 throws only with G at one
end below 0.28 :math:`\omega t_s` (with gravity: 0.8 times the largest steady amplitude so far) and
rising at its end. Hence every minimum is looked for if G comes below 1 (with gravity: 2) and does
not clearly fall. With gravity G may also be negative at the end for the second time (never seen
for k <= 3 and :math:`\kappa > 4`).

"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike
from soft_throw_ros.core import checks
from soft_throw_ros.core.batch import run_batches
from soft_throw_ros.core.kernels import Floats, inlined, kernel, subroutine
from soft_throw_ros.core.plate import peak_velocity_ratio
from soft_throw_ros.core.rig import MAX_PERIODS

MAX_INTERVALS = 2048
"""Most wave intervals (two crossings each) before the computation gives up with an error. [-]"""

_GROWTH_LIMIT = 1e4
"""Largest |Q_k|; alpha loses at most 1e-14 |Q_k|, and |Q_k| is 34 at most within the box. [-]"""

_ROUNDING = 2e-6
"""Rounding of the speed in an interval over the steady wave, over the promised 1e-9. [-]"""

_SEARCH_EFFORT = 1e6
"""Terms of Laguerre sums after which a search is given up: some milliseconds."""


class FirstRelease(NamedTuple):
    r"""
    Time, speed and energy of first releases in ratios, as arrays of one shape.

    They are :math:`t_e f`, :math:`V_e / (A \omega)` and :math:`\alpha = (V_e / V_p^*)^2`.
    """

    ejection_phase: Floats
    speed: Floats
    energy_transfer: Floats


def first_releases(
    *, mass_ratio: ArrayLike, speed_ratio: ArrayLike, damping_ratio: ArrayLike = 0.0,
    gravity_ratio: ArrayLike = 0.0,
) -> FirstRelease:
    r"""
    Compute times and speeds of the first releases of rigid projectiles.

    The plate moves as `plate.Underdamped`; the layer is lossless. `throw.throw_many` takes SI
    units.

    Parameters
    ----------
    mass_ratio : array_like
        Projectile over layer mass, :math:`\mu = m / (\rho_s S L_s)`. [-]
    speed_ratio : array_like
        Crossings of the wave per plate period, :math:`\kappa = c_s / (L_s f)`. [-]
    damping_ratio : array_like
        Damping ratio of the plate, :math:`\zeta`. [-]
    gravity_ratio : array_like
        :math:`g / (A \omega^2)`. [-]

    Returns
    -------
    FirstRelease
        Of arrays with the common shape; NaN where the projectile does not leave within 16 periods
        of the plate or of its own on the layer and `MAX_INTERVALS` (fewer if gravity makes many of
        them worth a search), or rounding would spoil the promised accuracy. Errors: 1e-9 in the
        ejection phase and relative in the energy transfer for :math:`\mu` in [0.003, 100],
        :math:`\kappa` in [0.15, 120], :math:`\zeta` in [0, 0.3]; a few roundings in practice.

    Raises
    ------
    ValueError
        If a ratio is not finite and positive (damping: in [0, 1); gravity: not negative), or the
        shapes do not fit.

    Examples
    --------
    The largest energy transfer that a layer can give to a harmonic plate:

    >>> release = first_releases(mass_ratio=0.234231, speed_ratio=8.242210)
    >>> round(float(release.ejection_phase), 6), round(float(release.energy_transfer), 6)
    (0.39944, 4.123215)

    """
    arrays = np.broadcast_arrays(
        checks.require_all('mass_ratio', mass_ratio, 'positive'),
        checks.require_all('speed_ratio', speed_ratio, 'positive'),
        checks.require_all('damping_ratio', damping_ratio, 'in_unit_interval'),
        checks.require_all('gravity_ratio', gravity_ratio, 'not_negative'),
    )
    ratios = np.stack(arrays).reshape(len(arrays), -1)
    results = np.empty((2, *arrays[0].shape))
    columns = results.reshape(2, -1)
    run_batches(
        lambda batch: release_series(ratios, columns, batch[0], batch.size),
        np.arange(ratios.shape[1]), size=2048,
    )
    phase, speed = results
    return FirstRelease(phase, speed, (speed / peak_velocity_ratio(arrays[2])) ** 2)


def spring_release(*, frequency_ratio: ArrayLike) -> FirstRelease:
    r"""
    Compute time and speed of the first release from a massless spring (App. A of the paper).

    The spring is the limit of a layer with a crossing time of zero: accurate for light, stiff
    layers, and a reference for others. The plate is harmonic (typical damping changes a throw by a
    few percent), and there is no gravity.

    `frequency_ratio` is :math:`q = f_0 / f`, `Rig.natural_frequency` over the frequency of the
    engine. ValueError if it is not finite and positive.

    Notes
    -----
    Eqs. (A2)-(A4), :math:`t_e f = 1 / (1 + q)` and

    .. math:: \frac{V_e}{V_p^*} = \frac{q}{q - 1} \sin \frac{2 \pi}{q + 1},

    written as :math:`\pi q / (q + 1)\, \mathrm{sinc}\, \pi (q - 1) / (q + 1)`, which is
    :math:`\pi / 2` at :math:`q = 1` instead of 0/0.

    Examples
    --------
    >>> release = spring_release(frequency_ratio=[0.5, 1.0, 2.0])
    >>> release.ejection_phase.round(4), release.energy_transfer.round(4)
    (array([0.6667, 0.5   , 0.3333]), array([0.75  , 2.4674, 3.    ]))

    """
    q = checks.require_all('frequency_ratio', frequency_ratio, 'positive')
    speed = math.pi * q / (q + 1.0) * np.sinc((q - 1.0) / (q + 1.0))
    return FirstRelease(1.0 / (1.0 + q), speed, speed**2)


@kernel
def release_series(ratios: Floats, results: Floats, first: int, count: int) -> None:
    """Compute some throws from number `first` on, unchecked, from rows of ratios."""
    c, b = np.empty(MAX_INTERVALS), np.empty(MAX_INTERVALS)
    for n in range(first, first + count):
        wave = _wave(ratios[0, n], ratios[1, n], ratios[2, n], ratios[3, n])
        k, low, high, guess, steady = _find(wave, c, b)
        results[0, n] = results[1, n] = math.nan
        if high > 0.0:
            sigma = guess if low < guess < high else 0.5 * (low + high)
            results[0, n], results[1, n] = _polish(k, low, high, sigma, wave, steady, c)


class _Wave(NamedTuple):
    """Constants of all intervals."""

    mu: float
    rate: float  # 1 / mu
    kappa: float
    root: float  # sqrt(1 - zeta^2)
    weight: float  # g tau
    lam: complex  # lambda
    inverse: complex  # 1 / (1 + lambda mu)
    reflection: complex  # r(lambda)
    to_force: complex  # from the steady upward wave to the steady G


@inlined
def _phasor(lam, sigma):
    """Compute e^{lambda sigma}."""
    size, angle = math.exp(lam.real * sigma), lam.imag * sigma
    return complex(size * math.cos(angle), size * math.sin(angle))


@inlined
def _wave(mu, kappa, zeta, gravity):
    root, rate = math.sqrt(1.0 - zeta * zeta), 1.0 / mu
    crossing = 2.0 * math.pi / kappa  # w t_s
    lam = complex(-zeta * crossing, root * crossing)
    below = 1.0 + lam * mu
    inverse = below.conjugate() * (1.0 / (below.real * below.real + below.imag * below.imag))
    return _Wave(
        mu, rate, kappa, root, gravity * crossing * mu * root, lam, inverse,
        (lam * mu - 1.0) * inverse, 2.0 * (lam * mu) * inverse,
    )


@inlined
def _find(wave, c, b):
    """
    Find the wave interval of the release; fill c with c_j, b with phi_j(2 / mu).

    Returns interval k, a bracket of the root (up to 0 if it is unknown), a guess, and Q_k.
    """
    turn, weight = wave.lam.imag, wave.weight
    first, steady = np.int64(0), complex(1.0, 0.0)  # k, of the type of later ones, and Q_k
    step = _phasor(wave.lam, 2.0)  # e^{2 lambda}
    c[0], b[0] = -2.0 * wave.inverse.imag, math.exp(-2.0 * wave.rate)
    s_now, s_next = 0.0, c[0] * b[0]
    force = (wave.to_force * step).imag - s_next + weight  # at the end of the interval
    if weight == 0.0:
        # G rises, at most until the plate is fastest, and falls through 0 before it stops.
        high = min(2.0, math.pi / turn)
        if high < 2.0 or force <= 0.0:
            return first, 0.0, high, _first_guess(wave), steady
    else:
        # G falls at least until the plate brakes hardest, and later periods push it off less
        # than the first.
        high = min(2.0, 2.0 * math.acos(-wave.lam.real / math.hypot(turn, wave.lam.real)) / turn)
        if _attached(first, high, wave, steady, c)[0] + weight <= 0.0:
            return first, 0.0, high, _first_guess(wave), steady
        if high < 2.0:
            low, high = _search(first, high, min(2.0, 2.0 * math.pi / turn), wave, steady, c)
            if high > 0.0:
                return first, low, high, math.nan, steady
    arriving = power = complex(1.0, 0.0)  # e^{2 k lambda}, r^k
    effort, largest, margin = 0.0, 1.0, turn
    longest = 0.5 * MAX_PERIODS * max(wave.kappa, 2.0 * math.pi * math.sqrt(wave.mu))
    for k in range(1, int(min(MAX_INTERVALS, 2.0 + longest))):
        arriving *= step
        power *= wave.reflection
        steady = arriving + wave.reflection * steady
        underflows = k > 250 and wave.mu < 2.0 / 700.0  # e^{-sigma / mu}, but not phi_k
        if steady.real**2 + steady.imag**2 > _GROWTH_LIMIT**2 or underflows:
            break
        older = (k - 1) * b[max(k - 2, 0)]
        b[k] = ((2 * k - 1 - 4.0 * wave.rate) * b[k - 1] - older) * (1.0 / k)
        s_before, s_now = s_now, s_next
        c[k] = s_now - s_before - 2.0 * (power * wave.inverse).imag
        s_next = c[k] * b[0]
        for j in range(1, k + 1):
            s_next += c[k - j] * b[j]
        pull = wave.to_force * steady
        before = force
        force = (pull * step).imag - s_next - s_now + weight
        # Where may G + weight come down to 0 and rise again? See the Notes of the module.
        smooth = True
        if weight > 0.0:
            smooth = k <= 3 and turn < 0.5 * math.pi
            largest = max(largest, abs(pull))
            margin = 2.0 * turn * largest
        if force > 0.0 and min(before, force) > margin:
            continue
        if force <= 0.0 and smooth:
            return k, 0.0, 2.0, 2.0 * before / (before - force), steady
        if smooth and _attached(k, 2.0, wave, steady, c)[1] < -0.25 * turn:
            continue
        effort += (16 + 8 * k + 6.0 * turn) * (k + 8)
        if effort > _SEARCH_EFFORT:
            break
        low, high = _search(k, 0.0, 2.0, wave, steady, c)
        if high > 0.0:
            return k, low, high, math.nan, steady
    return first, 0.0, 0.0, math.nan, steady


@inlined
def _first_guess(wave):
    """Guess the release in interval 0 to a few percent: pi/2 + atan(w tau), less the start."""
    x = wave.lam.imag * wave.mu
    angle = x / (1.0 + 0.28 * x * x) if x < 1.0 else 0.5 * math.pi - x / (x * x + 0.28)
    return (0.5 * math.pi + angle) / wave.lam.imag


@subroutine
def _attached(k, sigma, wave, steady, c):
    """Compute G, its derivative, and v_+ in interval k, while the projectile is attached."""
    phasor = steady * _phasor(wave.lam, sigma)
    pull = wave.to_force * phasor
    newer, older = c[k], c[k - 1] if k > 0 else 0.0
    x = 2.0 * sigma * wave.rate
    before, phi = 0.0, math.exp(-sigma * wave.rate)  # phi_{j-1}, phi_j
    dphi = -phi
    force, slope, upward = (newer + older) * phi, (newer + older) * dphi, older * phi
    for j in range(1, k + 1):
        newer, older = older, c[k - j - 1] if j < k else 0.0
        following = ((2 * j - 1 - x) * phi - (j - 1) * before) * (1.0 / j)  # faster
        dphi -= phi + following
        before, phi = phi, following
        force += (newer + older) * phi
        slope += (newer + older) * dphi
        upward += older * phi
    slope = (wave.lam * pull).imag - slope * wave.rate
    return pull.imag - force, slope, phasor.imag - upward


@subroutine
def _polish(k, low, high, sigma, wave, steady, c):
    """Find the root in a bracket by Newton's iteration within it: (t_e f, V_e / (A w))."""
    tolerance = max(1e-7 * min(1.0, wave.mu, 1.0 / wave.lam.imag), 4e-16)
    change, speed = high - low, math.nan
    for i in range(160):
        force, slope, upward = _attached(k, sigma, wave, steady, c)
        excess = force + wave.weight
        low, high = (sigma, high) if excess > 0.0 else (low, sigma)
        following = sigma - excess / slope if slope != 0.0 else low
        if not low <= following <= high or i > 40:  # it left the bracket, or goes round in circles
            following = 0.5 * (low + high)
        # mu V' = G, and G is -weight at the root
        gain = 0.5 * (following - sigma) * wave.rate * (force - wave.weight)
        speed = (2.0 * upward - force + gain) / wave.root
        change = abs(following - sigma)
        sigma = following
        if change <= tolerance:  # the next error is of second order in this one
            break
    phase = (2 * k + 1 + sigma) / wave.kappa
    is_found = min(change, high - low) <= 1e-6 * wave.kappa and math.isfinite(phase * speed)
    is_found = is_found and speed * speed > 0.0  # not below the smallest number
    # The steady wave is known relative to its phase; each interval adds to the error
    wave_size = abs(steady) * min(1.0, wave.lam.imag * (2.0 * k + 1.0 + sigma))
    if not is_found or _ROUNDING * (k + 1.0) * wave_size > abs(speed):
        return math.nan, math.nan
    return phase, speed


@subroutine
def _search(k, start, stop, wave, steady, c):
    """Bracket the first root of G + weight between two points of interval k; (0, -1) if none."""
    layer = min(stop - start, (4 * k + 8) * wave.mu)  # the Laguerre functions live here
    beyond = stop - start - layer
    fine = 16 + 8 * k
    coarse = 4 + int(8.0 * wave.lam.imag * beyond / math.pi) if beyond > 0.0 else 0
    low, low_force, low_slope = start, 0.0, 0.0
    for i in range(fine + coarse + 1):
        high = start + layer * min(1.0, i / fine) ** 2
        if i > fine:
            high += beyond * ((i - fine) / coarse)
        force, slope, _ = _attached(k, high, wave, steady, c)
        force += wave.weight
        if force <= 0.0 and i > 0:
            return low, high
        width = high - low
        # a minimum in between, and not above where the tangents are at the other end
        lowest = min(low_force + low_slope * width, force - slope * width)
        if low_slope < 0.0 < slope and lowest <= 0.0:
            before, after = low, high
            while after - before > 1e-12 * after:
                middle = 0.5 * (before + after)
                middle_force, middle_slope, _ = _attached(k, middle, wave, steady, c)
                if middle_force + wave.weight <= 0.0:
                    return low, middle
                before, after = (middle, after) if middle_slope < 0.0 else (before, middle)
        low, low_force, low_slope = high, force, slope
    return 0.0, -1.0
