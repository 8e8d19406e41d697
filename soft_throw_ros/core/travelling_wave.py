# SPDX-License-Identifier: Apache-2.0
"""
When and how fast a rigid projectile first leaves the layer, exactly (Sec. IV of the paper).

In closed form and for any number of crossings of the wave. What happens later, peak strains,
fields and measured plates are `soft_throw_ros.core.method_of_steps`.

Notes
-----
Time in crossings :math:`t_s`, speed in units of the plate's `velocity_factor`, so that
:math:`V_p = \\Im e^{\\lambda t}`. In the wave interval :math:`k`, that is
:math:`t = 2 k + 1 + \\sigma` with :math:`0 \\le \\sigma \\le 2`, upward wave and mass move with

.. math::

    v_+ &= \\Im\\, Q_k e^{\\lambda \\sigma} - \\sum_{j<k} c_{k-1-j}\\, \\phi_j(\\sigma / \\mu) \\\\
    V_m &= \\Im\\, \\frac{2 Q_k}{1 + \\lambda \\mu} e^{\\lambda \\sigma}
           + \\sum_{j \\le k} (c_{k-j} - c_{k-1-j})\\, \\phi_j(\\sigma / \\mu)

where :math:`\\phi_j(u) = e^{-u} L_j(2 u)` are Laguerre functions. They are what the powers of the
all-pass response :math:`r(s) = (\\tau s - 1)/(\\tau s + 1)` look like in time, never exceed 1, and
so nothing cancels, however small :math:`\\mu` is. With :math:`Q_k = e^{2 k \\lambda} +
r(\\lambda) Q_{k-1}`, and :math:`c_k` from the continuity of :math:`V_m`,

.. math::

    c_k = \\sum_{j<k} (c_{k-1-j} - c_{k-2-j})\\, \\phi_j(2 / \\mu)
          - \\Im \\frac{2 r(\\lambda)^k}{1 + \\lambda \\mu},

one more interval costs :math:`O(k)` and no transcendental function. The contact force is
:math:`F = (m / \\tau) G` with :math:`G = 2 v_+ - V_m`, and the projectile leaves when G first
falls to :math:`-g \\tau`. The paper's Eqs. (11)-(13) are :math:`k = 0`, its Eq. (14) is
:math:`k = 1`, where it stops.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numba as nb
import numpy as np
from numpy.typing import ArrayLike, NDArray

from soft_throw_ros.core import checks
from soft_throw_ros.core.plate import peak_velocity_ratio

MAX_INTERVALS = 2048
"""Wave intervals (two crossings each) that are followed before a named error is raised."""

_RELEASED = 0
_NOT_WITHIN = 1
_INACCURATE = 2

_GROWTH_LIMIT = 1e4  # largest steady amplitude that leaves 1e-11 of G (which is of order 1)
_SEARCH_EFFORT = 200_000  # in squares of k, some milliseconds
_INVERSE = 1.0 / np.maximum(np.arange(MAX_INTERVALS + 1), 1)

_jit = nb.njit(cache=True, nogil=True, error_model='numpy')


class ThrowUnresolvedError(ValueError):
    """No release within the intervals that are followed, or none to the promised accuracy."""


class FirstRelease(NamedTuple):
    """
    When and how fast the projectile first leaves the layer.

    Attributes
    ----------
    ejection_phase : float or ndarray
        :math:`t_e f`, in plate periods. [-]
    speed : float or ndarray
        :math:`V_e / (A \\omega)`. [-]
    energy_transfer : float or ndarray
        :math:`\\alpha = (V_e / V_p^*)^2`. [-]

    """

    ejection_phase: float | NDArray[np.float64]
    speed: float | NDArray[np.float64]
    energy_transfer: float | NDArray[np.float64]


def first_release(
    *,
    mass_ratio: float,
    speed_ratio: float,
    damping_ratio: float = 0.0,
    gravity_ratio: float = 0.0,
) -> FirstRelease:
    """
    Find when a rigid projectile first leaves the layer, and how fast.

    The plate moves as `plate.Underdamped`; the layer is lossless.

    Parameters
    ----------
    mass_ratio : float
        Projectile over layer mass, :math:`\\mu = m / (\\rho_s S L_s)`. [-]
    speed_ratio : float
        Crossings of the wave per plate period, :math:`\\kappa = c_s / (L_s f)`. [-]
    damping_ratio : float
        Of the plate, :math:`\\zeta`. [-]
    gravity_ratio : float
        :math:`g / (A \\omega^2)`. [-]

    Returns
    -------
    FirstRelease
        Of floats. Errors: 1e-9 in the ejection phase and relative in the energy transfer for
        :math:`\\mu` in [0.003, 100], :math:`\\kappa` in [0.15, 120], :math:`\\zeta` in [0, 0.3];
        a few roundings in practice.

    Raises
    ------
    ValueError
        If a ratio is not finite and positive (damping: in [0, 1); gravity: not negative).
    ThrowUnresolvedError
        If the projectile does not leave within `MAX_INTERVALS`, or rounding would spoil the
        promised accuracy (thousands of crossings with damping).

    Notes
    -----
    See the module. Within an interval the root is bracketed and polished by Halley's method. In
    interval 0, G decreases from the plate's fastest moment on, so the bracket is certain. Later
    a release inside an interval at whose end G is positive again is rare (k >= 2 and stiff
    layers). A dense scan of 10^5 throws met it only with G at one end of the interval below
    0.28 :math:`\omega t_s` and rising at its end; wherever G comes below 1 :math:`\omega t_s`
    and does not clearly fall, and always with gravity, every minimum is looked for.

    Examples
    --------
    The largest energy transfer that a layer can give to a harmonic plate:

    >>> release = first_release(mass_ratio=0.234231, speed_ratio=8.242210)
    >>> round(release.ejection_phase, 6), round(release.energy_transfer, 6)
    (0.39944, 4.123215)

    """
    checks.positive('mass_ratio', mass_ratio)
    checks.positive('speed_ratio', speed_ratio)
    checks.below_one('damping_ratio', damping_ratio)
    checks.not_negative('gravity_ratio', gravity_ratio)
    phase, speed, status = _one_release(
        float(mass_ratio), float(speed_ratio), float(damping_ratio), float(gravity_ratio)
    )
    if status != _RELEASED:
        case = (
            f'mass_ratio {mass_ratio:g}, speed_ratio {speed_ratio:g}, '
            f'damping_ratio {damping_ratio:g}, gravity_ratio {gravity_ratio:g}'
        )
        if status == _NOT_WITHIN:
            raise ThrowUnresolvedError(f'no release within {phase:.0f} crossings for {case}')
        raise ThrowUnresolvedError(
            f'the release cannot be computed to 1e-9 in double precision for {case}; '
            'fewer crossings or less damping can'
        )
    return FirstRelease(phase, speed, (speed / peak_velocity_ratio(damping_ratio)) ** 2)


@_jit
def first_release_kernel(mu, kappa, zeta, gravity, work):
    """
    Compute one release without checks: (t_e f, V_e / (A w), status), status 0 when found.

    With another status the first value is the number of crossings that were followed. `work` is a float array of shape (2, MAX_INTERVALS). For use inside compiled code.
    """
    root = math.sqrt(1.0 - zeta * zeta)
    crossing = 2.0 * math.pi / kappa  # w t_s
    lam = complex(-zeta * crossing, root * crossing)
    turn = lam.imag
    weight = gravity * crossing * mu * root  # g tau in velocity factors
    below = 1.0 + lam * mu
    inverse = complex(below.real, -below.imag) / (below.real**2 + below.imag**2)
    reflection = (lam * mu - 1.0) * inverse
    to_force = 2.0 * lam * mu * inverse
    c = work[0]
    c[0] = -2.0 * inverse.imag
    steady = complex(1.0, 0.0)  # Q_k
    b = work[1]  # phi_j at the end of an interval
    step = _phasor(lam, 2.0)
    b[0] = math.exp(-2.0 / mu)
    force = (to_force * step).imag - c[0] * b[0] + weight
    # Interval 0: G falls from the plate's fastest moment on, at least until the plate stops.
    low = math.acos(zeta) / turn
    high = min(2.0, math.pi / turn)
    at_high = force
    if high < 2.0:
        at_high = _attached(0, high, _phasor(lam, high), math.exp(-high / mu), mu, lam,
                            steady, to_force, c)[0] + weight
    if at_high <= 0.0:
        guess = _steady_guess(turn * mu) / turn
        if not low < guess < high:
            guess = 0.5 * (low + high)
        return _polish(0, low, guess, high, kappa, mu, weight, lam, steady, to_force, root, c)
    if weight > 0.0:  # gravity holds the projectile longer, and G may dip below its weight between
        low, high = _search(0, low, mu, weight, lam, steady, to_force, c)
        if high > 0.0:
            guess = 0.5 * (low + high)
            return _polish(0, low, guess, high, kappa, mu, weight, lam, steady, to_force, root, c)
    effort = 0
    arriving = complex(1.0, 0.0)  # e^{2 k lambda}
    power = complex(1.0, 0.0)  # r^k
    margin = turn  # where a dip inside an interval is looked for, see the Notes
    rising = -0.25 * turn
    if gravity > 0.0:
        margin = math.inf
        rising = -math.inf
    for k in range(1, MAX_INTERVALS):
        arriving *= step
        power *= reflection
        steady = arriving + reflection * steady
        size = steady.real * steady.real + steady.imag * steady.imag
        if size > _GROWTH_LIMIT**2 or _underflows(k, mu):
            return math.nan, math.nan, _INACCURATE
        _next_laguerre(b, k, 4.0 / mu)
        # one pass for c_k and for the transient of G at the end of the interval
        speed = 0.0
        transient = 0.0
        newer = c[k - 1]
        for j in range(k - 1):
            older = c[k - 2 - j]
            speed += (newer - older) * b[j]
            transient += (newer + older) * b[j + 1]
            newer = older
        speed += newer * b[k - 1]
        c[k] = speed - 2.0 * (power * inverse).imag
        transient += newer * b[k] + (c[k] + c[k - 1]) * b[0]
        before = force
        force = (to_force * steady * step).imag - transient + weight
        if force > 0.0 and min(before, force) > margin:
            continue
        slope_start, slope_end = _end_slopes(k, mu, lam, to_force * steady, step, c, b)
        low, high = 0.0, 2.0
        if force > 0.0 or gravity > 0.0:
            if slope_end < rising:
                continue
            low, high = _search(k, 0.0, mu, weight, lam, steady, to_force, c)
            effort += (k + 4) * (k + 4)
            if high < 0.0:
                if effort > _SEARCH_EFFORT:
                    return 2.0 * k + 3.0, math.nan, _NOT_WITHIN
                continue
        guess = _hermite_root(before, force, slope_start, slope_end)
        if not low < guess < high:
            guess = 0.5 * (low + high)
        return _polish(k, low, guess, high, kappa, mu, weight, lam, steady, to_force, root, c)
    return 2.0 * MAX_INTERVALS + 1.0, math.nan, _NOT_WITHIN


@_jit
def _one_release(mu, kappa, zeta, gravity):
    """Run the kernel on memory of its own."""
    return first_release_kernel(mu, kappa, zeta, gravity, np.empty((2, MAX_INTERVALS)))


@_jit
def _phasor(lam, sigma):
    """Compute e^{lambda sigma}."""
    size = 1.0 if lam.real == 0.0 else math.exp(lam.real * sigma)
    angle = lam.imag * sigma
    return complex(math.cos(angle) * size, math.sin(angle) * size)


@_jit
def _next_laguerre(phi, k, x):
    """Append phi_k to phi_0 ... phi_{k-1}, where x is twice their argument (k >= 1)."""
    older = phi[k - 2] if k > 1 else 0.0
    phi[k] = ((2 * k - 1 - x) * phi[k - 1] - (k - 1) * older) * _INVERSE[k]


@_jit
def _underflows(k, mu):
    """Tell whether e^{-2/mu} is lost although phi_k is not negligible."""
    return mu < 2.0 / 700.0 and k > 0.5 / mu


@_jit
def _attached(k, sigma, phasor, decay, mu, lam, steady, to_force, c):
    """Compute G, G', G'' and v_+ in interval k, given e^{lambda sigma} and e^{-sigma / mu}."""
    value = to_force * steady * phasor
    slope = lam * value
    curve = (lam * slope).imag
    rate = 1.0 / mu
    upward = (steady * phasor).imag
    phi = decay
    if k == 0:
        fading = c[0] * phi
        return (
            value.imag - fading,
            slope.imag + fading * rate,
            curve - fading * rate * rate,
            upward,
        )
    x = 2.0 * sigma * rate
    before = 0.0
    dphi = -phi
    ddphi = phi
    older = c[k - 1]
    factor = c[k] + older
    g = factor * phi
    dg = factor * dphi
    ddg = factor * ddphi
    upward -= older * phi
    for j in range(1, k + 1):
        following = ((2 * j - 1 - x) * phi - (j - 1) * before) * _INVERSE[j]
        dfollowing = dphi - phi - following
        ddphi += -dphi - dfollowing
        before, phi, dphi = phi, following, dfollowing
        factor = older
        if j < k:
            older = c[k - j - 1]
            factor += older
            upward -= older * phi
        g += factor * phi
        dg += factor * dphi
        ddg += factor * ddphi
    return value.imag - g, slope.imag - dg * rate, curve - ddg * rate * rate, upward


@_jit
def _steady_guess(turn_mu):
    """Angle of release if the start were forgotten, pi/2 + atan(w tau), to a few percent."""
    if turn_mu < 1.0:
        return 0.5 * math.pi + turn_mu / (1.0 + 0.28 * turn_mu * turn_mu)
    return math.pi - turn_mu / (turn_mu * turn_mu + 0.28)


@_jit
def _end_slopes(k, mu, lam, factor, step, c, b):
    """Compute G' just after the start and at the end of interval k from what is at hand."""
    weight = c[k] + c[k - 1]
    dphi = -b[0]
    at_start = weight
    at_end = weight * dphi
    for j in range(1, k + 1):
        dphi -= b[j - 1] + b[j]
        weight = c[k - j]
        if j < k:
            weight += c[k - j - 1]
        at_start += (2 * j + 1) * weight
        at_end += weight * dphi
    return (lam * factor).imag + at_start / mu, (lam * factor * step).imag - at_end / mu


@_jit
def _hermite_root(start, end, slope_start, slope_end):
    """Root in [0, 2] of the cubic with these values and slopes at 0 and 2."""
    slope_start *= 2.0
    slope_end *= 2.0
    square = 3.0 * (end - start) - 2.0 * slope_start - slope_end
    cube = 2.0 * (start - end) + slope_start + slope_end
    t = start / (start - end)
    for _ in range(3):
        value = ((cube * t + square) * t + slope_start) * t + start
        following = t - value / ((3.0 * cube * t + 2.0 * square) * t + slope_start)
        if not 0.0 < following < 1.0:
            break
        t = following
    return 2.0 * t


@_jit
def _polish(k, low, guess, high, kappa, mu, weight, lam, steady, to_force, root, c):
    """Halley's method within a bracket: (t_e f, V_e / (A w), status)."""
    sigma = guess
    speed = 0.0
    near = 1e-4 * min(1.0, mu)  # the cubic convergence leaves 1e-12 of it
    for _ in range(100):
        g, dg, ddg, upward = _attached(
            k, sigma, _phasor(lam, sigma), math.exp(-sigma / mu), mu, lam, steady, to_force, c
        )
        excess = g + weight
        if excess > 0.0:
            low = sigma
        else:
            high = sigma
        change = -2.0 * excess * dg / (2.0 * dg * dg - excess * ddg)
        speed = 2.0 * upward - g
        following = sigma + change
        if not low <= following <= high:
            following = 0.5 * (low + high)
            change = following - sigma
            if high - low > 4e-16 * high:
                sigma = following
                continue
        sigma = following
        if abs(change) < near:
            # tau V' = G carries the speed over the last, tiny step
            speed += change * (g + change * (0.5 * dg + change * ddg / 6.0)) / mu
            break
    return (2 * k + 1 + sigma) / kappa, speed / root, _RELEASED


@_jit
def _search(k, start, mu, weight, lam, steady, to_force, c):
    """Bracket the first root of G + weight in an interval after `start`; (0, -1) if none."""
    layer = min(2.0 - start, (4 * k + 8) * mu)  # the Laguerre functions live here
    fine = 32 + 12 * k
    coarse = 0
    if start + layer < 2.0:
        coarse = 4 + int(8.0 * lam.imag * (2.0 - start - layer) / math.pi)
    low = start
    low_slope = 0.0
    for i in range(fine + coarse + 1):
        if i <= fine:
            high = start + layer * (i / fine) ** 2
        else:
            high = start + layer + (2.0 - start - layer) * ((i - fine) / coarse)
        g, slope, _, _ = _attached(
            k, high, _phasor(lam, high), math.exp(-high / mu), mu, lam, steady, to_force, c
        )
        if g + weight <= 0.0 and i > 0:
            return low, high
        if low_slope < 0.0 < slope:
            left, right = low, high
            while right - left > 1e-12 * right:
                middle = 0.5 * (left + right)
                g, at_middle, _, _ = _attached(
                    k, middle, _phasor(lam, middle), math.exp(-middle / mu), mu, lam,
                    steady, to_force, c,
                )
                if g + weight <= 0.0:
                    return low, middle
                if at_middle < 0.0:
                    left = middle
                else:
                    right = middle
        low = high
        low_slope = slope
    return 0.0, -1.0
