# SPDX-License-Identifier: Apache-2.0
r"""
When and how fast a rigid projectile first leaves the layer, exactly (Sec. IV of the paper).

In closed form and for any number of crossings of the wave. What happens later, peak strains,
fields and measured plates are `soft_throw_ros.core.method_of_steps`.

Notes
-----
Time in crossings :math:`t_s`, speed in units of the plate's `velocity_factor`, so that
:math:`V_p = \Im e^{\lambda t}`. In the wave interval :math:`k`, that is
:math:`t = 2 k + 1 + \sigma` with :math:`0 \le \sigma \le 2`, upward wave and mass move with

.. math::

    v_+ &= \Im\, Q_k e^{\lambda \sigma} - \sum_{j<k} c_{k-1-j}\, \phi_j(\sigma / \mu) \\
    V_m &= \Im\, \frac{2 Q_k}{1 + \lambda \mu} e^{\lambda \sigma}
           + \sum_{j \le k} (c_{k-j} - c_{k-1-j})\, \phi_j(\sigma / \mu)

where :math:`\phi_j(u) = e^{-u} L_j(2 u)` are Laguerre functions. They are what the powers of the
all-pass response :math:`r(s) = (\tau s - 1)/(\tau s + 1)` look like in time, never exceed 1, and
so nothing cancels, however small :math:`\mu` is. With :math:`Q_k = e^{2 k \lambda} +
r(\lambda) Q_{k-1}`, and :math:`c_k` from the continuity of :math:`V_m`,

.. math::

    c_k = S_k - S_{k-1} - \Im \frac{2 r(\lambda)^k}{1 + \lambda \mu}, \qquad
    S_k = \sum_{j<k} c_{k-1-j}\, \phi_j(2 / \mu),

one more interval costs :math:`O(k)` and no transcendental function. The contact force is
:math:`F = (m / \tau) G` with :math:`G = 2 v_+ - V_m`, and the projectile leaves when G first
falls to :math:`-g \tau`. The paper's Eqs. (11)-(13) are :math:`k = 0`, its Eq. (14) is
:math:`k = 1`, where it stops.

Many throws at once go through the same functions, side by side in the lanes of a vector. Numba
vectorises a loop over lanes if what it calls is inlined and has no branch, calls no C library,
and if it knows when it is compiled how far apart is what it reads and writes; hence `_inline`,
`_decay`, `_phasor` and `_copy_coefficients`.

"""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
import math
import os
from typing import Literal, NamedTuple

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

_GROWTH_LIMIT = 1e4  # of |Q_k|; alpha loses at most 1e-14 of it, and has 34 within the box
_SEARCH_EFFORT = 1e6  # terms of Laguerre sums, some milliseconds
_THROWS_PER_THREAD = 2048  # fewer are done before a thread has started
_LANES = 32
_LANES_K = 15  # releases in later intervals are polished one at a time, ...
_FEW = 8  # and so are fewer than these in one interval

_INVERSE = 1.0 / np.maximum(np.arange(MAX_INTERVALS + 1), 1)
_HALVES = 2.0 ** -np.arange(1100.0)

_jit = nb.njit(cache=True, nogil=True, error_model='numpy')
_inline = nb.njit(cache=True, nogil=True, error_model='numpy', forceinline=True)
_peak_velocity_ratio = nb.vectorize(cache=True)(peak_velocity_ratio)


class ThrowUnresolvedError(ValueError):
    """No release within the intervals that are followed, or none to the promised accuracy."""


class FirstRelease(NamedTuple):
    r"""
    When and how fast the projectile first leaves the layer.

    Attributes
    ----------
    ejection_phase : float or ndarray
        :math:`t_e f`, in plate periods. [-]
    speed : float or ndarray
        :math:`V_e / (A \omega)`. [-]
    energy_transfer : float or ndarray
        :math:`\alpha = (V_e / V_p^*)^2`. [-]

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
    r"""
    Find when a rigid projectile first leaves the layer, and how fast.

    The plate moves as `plate.Underdamped`; the layer is lossless.

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
    FirstRelease
        Of floats. Errors: 1e-9 in the ejection phase and relative in the energy transfer for
        :math:`\mu` in [0.003, 100], :math:`\kappa` in [0.15, 120], :math:`\zeta` in [0, 0.3];
        a few roundings in practice.

    Raises
    ------
    ValueError
        If a ratio is not finite and positive (damping: in [0, 1); gravity: not negative).
    ThrowUnresolvedError
        If the projectile does not leave within `MAX_INTERVALS` (fewer if gravity makes many of
        them worth a search), or rounding would spoil the promised accuracy (strong damping and
        many crossings).

    Notes
    -----
    See the module. The interval of release is found from G at the ends of intervals; within it the
    root is bracketed and polished by Householder's iteration of fourth order, whose error is
    bounded by how far Halley's, of third order, is from it.

    In interval 0 the bracket is certain: G rises at most until the plate is fastest, falls through
    0 before the plate stops, and with gravity falls at least until the plate brakes hardest.
    Later, G may dip to 0 in an interval at whose end it is positive again (k >= 2 and stiff
    layers). In dense scans of 10^5 throws it did so only with G at one end of the interval below
    0.28 :math:`\omega t_s` and rising at its end. Hence every minimum is looked for if G comes
    below 1 :math:`\omega t_s` and does not clearly fall. With gravity the limit found is 0.8
    :math:`\omega t_s` times the largest steady amplitude so far, and 2 is taken; and as G may
    also be negative at the end for the second time (never seen for k <= 3 and
    :math:`\kappa > 4`), those intervals are searched as well.

    Examples
    --------
    The largest energy transfer that a layer can give to a harmonic plate:

    >>> release = first_release(mass_ratio=0.234231, speed_ratio=8.242210)
    >>> round(release.ejection_phase, 6), round(release.energy_transfer, 6)
    (0.39944, 4.123215)

    """
    case = (
        checks.positive('mass_ratio', mass_ratio),
        checks.positive('speed_ratio', speed_ratio),
        checks.below_one('damping_ratio', damping_ratio),
        checks.not_negative('gravity_ratio', gravity_ratio),
    )
    phase, speed, status = _one_release(*case)
    if status != _RELEASED:
        raise _unresolved(status, phase, *case)
    return FirstRelease(phase, speed, (speed / peak_velocity_ratio(case[2])) ** 2)


def first_releases(
    *,
    mass_ratio: ArrayLike,
    speed_ratio: ArrayLike,
    damping_ratio: ArrayLike = 0.0,
    gravity_ratio: ArrayLike = 0.0,
    unresolved: Literal['raise', 'nan'] = 'raise',
    threads: int | None = None,
) -> FirstRelease:
    """
    Find when and how fast rigid projectiles first leave their layers, for many throws.

    Parameters
    ----------
    mass_ratio, speed_ratio, damping_ratio, gravity_ratio : array_like
        As for `first_release`; broadcast against each other. [-]
    unresolved : {'raise', 'nan'}
        What becomes of throws that are not resolved: the first is raised, or all are NaN.
    threads : int, optional
        Largest number of threads, all cores if not given. Results do not depend on it.

    Returns
    -------
    FirstRelease
        Of arrays with the common shape.

    Raises
    ------
    ValueError
        As for `first_release`, or if the shapes do not fit or an option is not one of its values.
    ThrowUnresolvedError
        As for `first_release`, unless `unresolved` is 'nan'.

    Examples
    --------
    Layers of one material, twice as thick from one to the next, under the same projectile:

    >>> thickness = np.array([1.0, 2.0, 4.0])
    >>> throws = first_releases(mass_ratio=0.8 / thickness, speed_ratio=24.0 / thickness)
    >>> throws.energy_transfer.round(4)
    array([2.003 , 3.546 , 3.8322])

    """
    if unresolved not in ('raise', 'nan'):
        raise ValueError(f"unresolved must be 'raise' or 'nan', got {unresolved!r}")
    if threads is not None and not (type(threads) is int and threads > 0):
        raise ValueError(f'threads must be a positive whole number or None, got {threads!r}')
    damping_ratio = checks.below_one_array('damping_ratio', damping_ratio)
    cases = np.broadcast_arrays(
        checks.positive_array('mass_ratio', mass_ratio),
        checks.positive_array('speed_ratio', speed_ratio),
        damping_ratio,
        checks.not_negative_array('gravity_ratio', gravity_ratio),
    )
    shape = cases[0].shape
    mu, kappa, zeta, gravity = (case.flatten() for case in cases)
    phase, speed = np.empty((2, mu.size))
    status = np.empty(mu.size, dtype=np.int8)
    parts = max(1, min(threads or os.cpu_count() or 1, mu.size // _THROWS_PER_THREAD))

    def run(part: int) -> None:
        _release_lanes(mu, kappa, zeta, gravity, phase, speed, status, part, parts)

    if parts == 1:
        run(0)
    else:
        # Threads of our own, because numba's may not be entered from two threads at a time.
        with ThreadPoolExecutor(parts - 1) as pool:
            others = pool.map(run, range(1, parts))
            run(0)
            list(others)  # raises what they raised
    failed = np.flatnonzero(status != _RELEASED)
    if failed.size:
        if unresolved == 'raise':
            first = int(failed[0])
            case = mu[first], kappa[first], zeta[first], gravity[first]
            raise _unresolved(status[first], phase[first], *case)
        phase[failed] = np.nan
    phase = phase.reshape(shape)
    speed = speed.reshape(shape)
    energy_transfer = (speed / _peak_velocity_ratio(damping_ratio)) ** 2
    return FirstRelease(phase, speed, energy_transfer)


def _unresolved(
    status: int,
    crossings: float,
    mass_ratio: float,
    speed_ratio: float,
    damping_ratio: float,
    gravity_ratio: float,
) -> ThrowUnresolvedError:
    case = (
        f'mass_ratio {mass_ratio:g}, speed_ratio {speed_ratio:g}, '
        f'damping_ratio {damping_ratio:g}, gravity_ratio {gravity_ratio:g}'
    )
    if status == _NOT_WITHIN:
        return ThrowUnresolvedError(f'no release within {crossings:.0f} crossings for {case}')
    return ThrowUnresolvedError(
        f'the release cannot be computed to 1e-9 in double precision for {case}; '
        'fewer crossings or less damping can'
    )


@_jit
def first_release_kernel(
    mu: float, kappa: float, zeta: float, gravity: float, work: NDArray[np.float64]
) -> tuple[float, float, int]:
    """
    Compute one release without checks: (t_e f, V_e / (A w), status), status 0 when found.

    With another status the first value is the number of crossings that were followed, the second
    is NaN. `work` is a float array of shape (2, MAX_INTERVALS), which afterwards holds c_0 ... c_k
    of the interval of release in its first row. For use inside compiled code.
    """
    c = work[0]
    wave = _wave(mu, kappa, zeta, gravity)
    found = _find(wave, c, work[1])
    phase = 2.0 * found.k + 1.0
    speed = math.nan
    status = found.status
    if status == _RELEASED:
        guess = _guess(found.k, wave, found)
        phase, speed, status = _polish(found.k, guess, wave, found, c, 0, 1)
    return phase, speed, status


@_jit
def _one_release(mu, kappa, zeta, gravity):
    """Run the kernel on memory of its own."""
    return first_release_kernel(mu, kappa, zeta, gravity, np.empty((2, MAX_INTERVALS)))


class _Wave(NamedTuple):
    """What stays the same from interval to interval."""

    mu: float
    rate: float  # 1 / mu
    kappa: float
    root: float  # sqrt(1 - zeta^2)
    weight: float  # g tau
    lam: complex  # lambda
    inverse: complex  # 1 / (1 + lambda mu)
    reflection: complex  # r(lambda)
    to_force: complex  # from the steady upward wave to the steady G
    step: complex  # e^{2 lambda}
    fade: float  # e^{-2 / mu}


class _Sums(NamedTuple):
    """What fades within an interval: sums up to a phi_j, and what the next one is made of."""

    before: float  # phi_{j-1}
    phi: float  # phi_j and its derivatives
    dphi: float
    ddphi: float
    dddphi: float
    g: float  # of G and its derivatives
    dg: float
    ddg: float
    dddg: float
    upward: float  # of v_+


class _Interval(NamedTuple):
    """The interval of release, and where in it G + weight falls through 0."""

    status: int
    k: int
    low: float  # the bracket
    high: float
    steady: complex  # Q_k
    start: float  # G + weight at both ends of the interval, and its slopes
    end: float
    start_slope: float
    end_slope: float


@_inline
def _decay(u):
    """Compute e^{-u} for u >= 0 without a branch."""
    u = min(760.0, u)  # in this order NaN becomes 760 too, for n is an index
    n = math.floor(u * 1.4426950408889634 + 0.5)
    r = (n * 6.93147180369123816e-1 - u) + n * 1.90821492927058770e-10  # ln 2 in two parts
    r2 = r * r
    r4 = r2 * r2
    low = (1.0 + r) + r2 * (1 / 2 + r * (1 / 6))
    middle = (1 / 24 + r * (1 / 120)) + r2 * (1 / 720 + r * (1 / 5040))
    high = (1 / 40320 + r * (1 / 362880)) + r2 * (1 / 3628800 + r * (1 / 39916800))
    return (low + r4 * (middle + r4 * (high + r4 * (1 / 479001600)))) * _HALVES[n]


@_inline
def _phasor(lam, sigma):
    """Compute e^{lambda sigma} without a branch, for angles up to 10^6."""
    size = _decay(-lam.real * sigma)
    angle = lam.imag * sigma
    n = math.floor(angle * 0.63661977236758138 + 0.5)
    r = (angle - n * 1.57079632673412561) - n * 6.07710050650619225e-11  # pi/2 in two parts
    # the polynomials of fdlibm's k_sin.c and k_cos.c
    z = r * r
    z2 = z * z
    z4 = z2 * z2
    s = -1.66666666666666324e-1 + z * 8.33333333332248946e-3
    s += z2 * (-1.98412698298579493e-4 + z * 2.75573137070700677e-6)
    s += z4 * (-2.50507602534068634e-8 + z * 1.58969099521155010e-10)
    s = r + r * z * s
    c = 4.16666666666666019e-2 - z * 1.38888888888741096e-3
    c += z2 * (2.48015872894767294e-5 - z * 2.75573143513906633e-7)
    c += z4 * (2.08757232129817483e-9 - z * 1.13596475577881948e-11)
    c = 1.0 - 0.5 * z + z2 * c
    sine = c if n & 1 else s
    cosine = s if n & 1 else c
    sine = -sine if n & 2 else sine
    cosine = -cosine if (n + 1) & 2 else cosine
    return complex(cosine * size, sine * size)


@_inline
def _wave(mu, kappa, zeta, gravity):
    root = math.sqrt(1.0 - zeta * zeta)
    rate = 1.0 / mu
    crossing = 2.0 * math.pi / kappa  # w t_s
    lam = complex(-zeta * crossing, root * crossing)
    below = 1.0 + lam * mu
    scale = 1.0 / (below.real * below.real + below.imag * below.imag)
    inverse = complex(below.real * scale, -below.imag * scale)
    return _Wave(
        mu,
        rate,
        kappa,
        root,
        gravity * crossing * mu * root,
        lam,
        inverse,
        (lam * mu - 1.0) * inverse,
        2.0 * (lam * mu) * inverse,
        _phasor(lam, 2.0),
        _decay(2.0 * rate),
    )


@_inline
def _find(wave, c, b):
    """Go through the intervals to that of the release; fill c with c_j, b with phi_j(2 / mu)."""
    turn = wave.lam.imag
    weight = wave.weight
    steady = complex(1.0, 0.0)  # Q_k
    c[0] = -2.0 * wave.inverse.imag
    b[0] = wave.fade
    s_now = 0.0
    s_next = c[0] * b[0]
    force = (wave.to_force * wave.step).imag - s_next + weight  # at the end of the interval
    if weight == 0.0:
        # G rises, at most until the plate is fastest, and falls through 0 before it stops.
        high = min(2.0, math.pi / turn)
        if high < 2.0 or force <= 0.0:
            return _bracket(0, 0.0, high, steady)
    else:
        # G falls at least until the plate brakes hardest, and later periods push it off less
        # than the first.
        high = min(2.0, 2.0 * math.acos(-wave.lam.real / math.hypot(turn, wave.lam.real)) / turn)
        if _force(0, high, wave, steady, c)[0] <= 0.0:
            return _bracket(0, 0.0, high, steady)
        if high < 2.0:
            low, high = _search(0, high, min(2.0, 2.0 * math.pi / turn), wave, steady, c)
            if high > 0.0:
                return _bracket(0, low, high, steady)
    effort = 0.0
    arriving = complex(1.0, 0.0)  # e^{2 k lambda}
    power = complex(1.0, 0.0)  # r^k
    largest = 1.0
    margin = turn
    for k in range(1, MAX_INTERVALS):
        arriving *= wave.step
        power *= wave.reflection
        steady = arriving + wave.reflection * steady
        if _size(steady) > _GROWTH_LIMIT**2 or _underflows(k, wave.mu):
            return _failure(_INACCURATE, k)
        older = b[k - 2] if k > 1 else 0.0
        b[k] = ((2 * k - 1 - 4.0 * wave.rate) * b[k - 1] - (k - 1) * older) * _INVERSE[k]
        s_before, s_now = s_now, s_next
        c[k] = s_now - s_before - 2.0 * (power * wave.inverse).imag
        s_next = c[k] * b[0]
        for j in range(1, k + 1):
            s_next += c[k - j] * b[j]
        pull = wave.to_force * steady
        before = force
        force = (pull * wave.step).imag - s_next - s_now + weight
        # Where may G + weight come down to 0 and rise again within the interval? See the Notes.
        smooth = True
        if weight > 0.0:
            smooth = k <= 3 and turn < 0.5 * math.pi
            largest = max(largest, _size(pull))
            margin = 2.0 * turn * math.sqrt(largest)
        if force > 0.0 and min(before, force) > margin:
            continue
        start_slope, end_slope = _end_slopes(k, wave, pull, c, b)
        if force <= 0.0 and smooth:
            return _Interval(_RELEASED, k, 0.0, 2.0, steady, before, force, start_slope, end_slope)
        if smooth and end_slope < -0.25 * turn:
            continue
        effort += (16 + 8 * k + 6.0 * turn) * (k + 8)
        if effort > _SEARCH_EFFORT:
            return _failure(_NOT_WITHIN, k)
        low, high = _search(k, 0.0, 2.0, wave, steady, c)
        if high > 0.0:
            return _bracket(k, low, high, steady)
    return _failure(_NOT_WITHIN, MAX_INTERVALS)


@_inline
def _bracket(k, low, high, steady):
    """Make an interval of which a bracket alone is known, not what is at the ends."""
    return _Interval(_RELEASED, k, low, high, steady, 1.0, -1.0, 0.0, 0.0)


@_inline
def _failure(status, k):
    """Make what tells that the intervals before k have no release."""
    return _Interval(status, k, 0.0, 0.0, complex(0.0, 0.0), 0.0, 0.0, 0.0, 0.0)


@_inline
def _size(z):
    """Compute |z|^2."""
    return z.real * z.real + z.imag * z.imag


@_inline
def _underflows(k, mu):
    """Tell whether e^{-sigma / mu} may be lost where phi_k is not negligible."""
    return k > 250 and mu < 2.0 / 700.0


@_inline
def _end_slopes(k, wave, pull, c, b):
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
    slope = wave.lam * pull
    return slope.imag + at_start * wave.rate, (slope * wave.step).imag - at_end * wave.rate


@_inline
def _guess(k, wave, found):
    """Guess where in the bracket G + weight is 0, to a few percent as a rule."""
    if k == 0:
        x = wave.lam.imag * wave.mu
        # pi/2 + atan(w tau), were the start forgotten
        angle = x / (1.0 + 0.28 * x * x) if x < 1.0 else 0.5 * math.pi - x / (x * x + 0.28)
        guess = (0.5 * math.pi + angle) / wave.lam.imag
    else:
        guess = _hermite_root(found.start, found.end, found.start_slope, found.end_slope)
    return guess if found.low < guess < found.high else 0.5 * (found.low + found.high)


@_inline
def _hermite_root(start, end, start_slope, end_slope):
    """Root in [0, 2] of the cubic with these values and slopes at 0 and 2."""
    start_slope *= 2.0
    end_slope *= 2.0
    square = 3.0 * (end - start) - 2.0 * start_slope - end_slope
    cube = 2.0 * (start - end) + start_slope + end_slope
    t = start / (start - end)
    for _ in range(3):
        value = ((cube * t + square) * t + start_slope) * t + start
        following = t - value / ((3.0 * cube * t + 2.0 * square) * t + start_slope)
        t = following if 0.0 < following < 1.0 else t
    return 2.0 * t


@_inline
def _steady_part(sigma, wave, steady):
    """Compute what does not fade of G and three derivatives, and of v_+."""
    phasor = _phasor(wave.lam, sigma)
    value = wave.to_force * steady * phasor
    slope = wave.lam * value
    curve = wave.lam * slope
    jerk = wave.lam * curve
    return value.imag, slope.imag, curve.imag, jerk.imag, (steady * phasor).imag


@_inline
def _first_term(sigma, wave, newer, older):
    """Begin the sums over phi_j with j = 0, whose coefficients are c_k and c_{k-1}."""
    weight = newer + older
    phi = _decay(sigma * wave.rate)
    fading = weight * phi
    return _Sums(0.0, phi, -phi, phi, -phi, fading, -fading, fading, -fading, older * phi)


@_inline
def _next_term(j, sigma, wave, newer, older, s):
    """Add phi_j, whose coefficients are c_{k-j} and c_{k-j-1}."""
    weight = newer + older
    x = 2.0 * sigma * wave.rate
    phi = ((2 * j - 1 - x) * s.phi - (j - 1) * s.before) * _INVERSE[j]
    dphi = s.dphi - s.phi - phi
    ddphi = s.ddphi - s.dphi - dphi
    dddphi = s.dddphi - (s.ddphi + ddphi)
    return _Sums(
        s.phi,
        phi,
        dphi,
        ddphi,
        dddphi,
        s.g + weight * phi,
        s.dg + weight * dphi,
        s.ddg + weight * ddphi,
        s.dddg + weight * dddphi,
        s.upward + older * phi,
    )


@_inline
def _total(wave, steady_part, s):
    """Put together G, three derivatives, and v_+."""
    rate = wave.rate
    g, dg, ddg, dddg, upward = steady_part
    return (
        g - s.g,
        dg - s.dg * rate,
        ddg - s.ddg * (rate * rate),
        dddg - s.dddg * (rate * rate * rate),
        upward - s.upward,
    )


@_inline
def _attached(k, sigma, wave, steady, c, first, stride):
    """Compute G, three derivatives, and v_+ in interval k; c_j is c[first + j * stride]."""
    newer = c[first + k * stride]
    older = c[first + (k - 1) * stride] if k > 0 else 0.0
    sums = _first_term(sigma, wave, newer, older)
    for j in range(1, k + 1):
        newer = older
        older = c[first + (k - j - 1) * stride] if j < k else 0.0
        sums = _next_term(j, sigma, wave, newer, older, sums)
    return _total(wave, _steady_part(sigma, wave, steady), sums)


@_inline
def _improve(sigma, low, high, wave, attached):
    """Take a step of fourth order within the bracket: (sigma, low, high, V_m there, error)."""
    g, dg, ddg, dddg, upward = attached
    excess = g + wave.weight
    low = sigma if excess > 0.0 else low
    high = high if excess > 0.0 else sigma
    halley = 2.0 * dg * dg - excess * ddg
    change = -3.0 * excess * halley
    change /= 6.0 * dg * (dg * dg - excess * ddg) + excess * excess * dddg
    following = sigma + change
    # The error of Halley's step, which is of third order, bounds that of this one.
    error = abs(change + 2.0 * excess * dg / halley)
    trusted = (low <= following <= high) & (error <= 0.5 * abs(change))
    error = error if trusted else 1.0
    following = following if trusted else 0.5 * (low + high)
    change = following - sigma
    # tau V' = G carries the speed over the step
    gained = g + change * (1 / 2 * dg + change * (1 / 6 * ddg + change * (1 / 24 * dddg)))
    return following, low, high, 2.0 * upward - g + change * wave.rate * gained, error


@_inline
def _tolerance(wave):
    """Error of Halley's step at which that of the next order is far below 1e-13."""
    return max(1e-11 * min(1.0, wave.mu, 1.0 / wave.lam.imag), 4e-16)


@_jit
def _polish(k, sigma, wave, found, c, first, stride):
    """Find the root in a bracket: (t_e f, V_e / (A w), status)."""
    low, high = found.low, found.high
    speed = 0.0
    tolerance = _tolerance(wave)
    for i in range(160):
        if i > 40:  # it goes round in circles
            sigma = 0.5 * (low + high)
        attached = _attached(k, sigma, wave, found.steady, c, first, stride)
        sigma, low, high, speed, error = _improve(sigma, low, high, wave, attached)
        if error <= tolerance:
            break
    phase = (2 * k + 1 + sigma) / wave.kappa
    speed /= wave.root
    if not (min(error, high - low) <= 1e-9 * wave.kappa and math.isfinite(phase * speed)):
        return 2.0 * k + 1.0, math.nan, _INACCURATE
    return phase, speed, _RELEASED


@_jit
def _force(k, sigma, wave, steady, c):
    """Compute G + weight and G' in interval k."""
    g, dg, _, _, _ = _attached(k, sigma, wave, steady, c, 0, 1)
    return g + wave.weight, dg


@_jit
def _search(k, start, stop, wave, steady, c):
    """Bracket the first root of G + weight between two points of interval k; (0, -1) if none."""
    layer = min(stop - start, (4 * k + 8) * wave.mu)  # the Laguerre functions live here
    rest = stop - start - layer
    fine = 16 + 8 * k
    coarse = 4 + int(8.0 * wave.lam.imag * rest / math.pi) if rest > 0.0 else 0
    low = start
    low_force = 0.0
    low_slope = 0.0
    for i in range(fine + coarse + 1):
        high = start + layer * min(1.0, i / fine) ** 2
        if i > fine:
            high += rest * ((i - fine) / coarse)
        force, slope = _force(k, high, wave, steady, c)
        if force <= 0.0 and i > 0:
            return low, high
        width = high - low
        # a minimum in between, and not above where the tangents are at the other end
        lowest = min(low_force + low_slope * width, force - slope * width)
        if low_slope < 0.0 < slope and lowest <= 0.0:
            left, right = low, high
            while right - left > 1e-12 * right:
                middle = 0.5 * (left + right)
                force_there, slope_there = _force(k, middle, wave, steady, c)
                if force_there <= 0.0:
                    return low, middle
                if slope_there < 0.0:
                    left = middle
                else:
                    right = middle
        low = high
        low_force = force
        low_slope = slope
    return 0.0, -1.0


# Rows of the flat arrays of lanes: what `_Wave` holds, what of `_Interval` differs, the iteration
# and its sums, c_j.
_LOW = 16 * _LANES
_HIGH = 17 * _LANES
_SIGMA = 24 * _LANES
_SPEED = 25 * _LANES
_ERROR = 26 * _LANES
_STEADY = 27 * _LANES
_SUMS = 32 * _LANES
_NEWER = 42 * _LANES
_OLDER = 43 * _LANES
_C = 44 * _LANES
_QUEUE = _C + (_LANES_K + 1) * _LANES


@_inline
def _pair(rows, i):
    return complex(rows[i], rows[i + _LANES])


@_inline
def _set_pair(rows, i, value):
    rows[i] = value.real
    rows[i + _LANES] = value.imag


@_inline
def _set_wave(rows, i, wave):
    rows[i] = wave.mu
    rows[i + _LANES] = wave.rate
    rows[i + 2 * _LANES] = wave.kappa
    rows[i + 3 * _LANES] = wave.root
    rows[i + 4 * _LANES] = wave.weight
    rows[i + 5 * _LANES] = wave.fade
    _set_pair(rows, i + 6 * _LANES, wave.lam)
    _set_pair(rows, i + 8 * _LANES, wave.inverse)
    _set_pair(rows, i + 10 * _LANES, wave.reflection)
    _set_pair(rows, i + 12 * _LANES, wave.to_force)
    _set_pair(rows, i + 14 * _LANES, wave.step)


@_inline
def _get_wave(rows, i):
    return _Wave(
        rows[i],
        rows[i + _LANES],
        rows[i + 2 * _LANES],
        rows[i + 3 * _LANES],
        rows[i + 4 * _LANES],
        _pair(rows, i + 6 * _LANES),
        _pair(rows, i + 8 * _LANES),
        _pair(rows, i + 10 * _LANES),
        _pair(rows, i + 12 * _LANES),
        _pair(rows, i + 14 * _LANES),
        rows[i + 5 * _LANES],
    )


@_inline
def _set_interval(rows, i, found):
    rows[i + _LOW] = found.low
    rows[i + _HIGH] = found.high
    _set_pair(rows, i + 18 * _LANES, found.steady)
    rows[i + 20 * _LANES] = found.start
    rows[i + 21 * _LANES] = found.end
    rows[i + 22 * _LANES] = found.start_slope
    rows[i + 23 * _LANES] = found.end_slope


@_inline
def _get_interval(k, rows, i):
    return _Interval(
        _RELEASED,
        k,
        rows[i + _LOW],
        rows[i + _HIGH],
        _pair(rows, i + 18 * _LANES),
        rows[i + 20 * _LANES],
        rows[i + 21 * _LANES],
        rows[i + 22 * _LANES],
        rows[i + 23 * _LANES],
    )


@_inline
def _set_sums(rows, i, s):
    rows[i + _SUMS] = s.before
    rows[i + _SUMS + _LANES] = s.phi
    rows[i + _SUMS + 2 * _LANES] = s.dphi
    rows[i + _SUMS + 3 * _LANES] = s.ddphi
    rows[i + _SUMS + 4 * _LANES] = s.dddphi
    rows[i + _SUMS + 5 * _LANES] = s.g
    rows[i + _SUMS + 6 * _LANES] = s.dg
    rows[i + _SUMS + 7 * _LANES] = s.ddg
    rows[i + _SUMS + 8 * _LANES] = s.dddg
    rows[i + _SUMS + 9 * _LANES] = s.upward


@_inline
def _get_sums(rows, i):
    return _Sums(
        rows[i + _SUMS],
        rows[i + _SUMS + _LANES],
        rows[i + _SUMS + 2 * _LANES],
        rows[i + _SUMS + 3 * _LANES],
        rows[i + _SUMS + 4 * _LANES],
        rows[i + _SUMS + 5 * _LANES],
        rows[i + _SUMS + 6 * _LANES],
        rows[i + _SUMS + 7 * _LANES],
        rows[i + _SUMS + 8 * _LANES],
        rows[i + _SUMS + 9 * _LANES],
    )


@_inline
def _copy_coefficients(k, j, rows):
    """Bring those of phi_j to rows that do not depend on j, so that what follows vectorises."""
    for i in range(_LANES):
        rows[i + _NEWER] = rows[i + _C + (k - j) * _LANES]
    if j < k:
        for i in range(_LANES):
            rows[i + _OLDER] = rows[i + _C + (k - j - 1) * _LANES]
    else:
        for i in range(_LANES):
            rows[i + _OLDER] = 0.0


@_jit
def _polish_lanes(k, rows):
    """Find the roots of a queue; an error above the tolerance tells which are not there yet."""
    for _ in range(6):
        _copy_coefficients(k, 0, rows)
        for i in range(_LANES):
            wave, sigma = _get_wave(rows, i), rows[i + _SIGMA]
            g, dg, ddg, dddg, upward = _steady_part(sigma, wave, _get_interval(k, rows, i).steady)
            rows[i + _STEADY] = g
            rows[i + _STEADY + _LANES] = dg
            rows[i + _STEADY + 2 * _LANES] = ddg
            rows[i + _STEADY + 3 * _LANES] = dddg
            rows[i + _STEADY + 4 * _LANES] = upward
            newer, older = rows[i + _NEWER], rows[i + _OLDER]
            _set_sums(rows, i, _first_term(sigma, wave, newer, older))
        for j in range(1, k + 1):
            _copy_coefficients(k, j, rows)
            for i in range(_LANES):
                wave, sigma = _get_wave(rows, i), rows[i + _SIGMA]
                newer, older = rows[i + _NEWER], rows[i + _OLDER]
                sums = _next_term(j, sigma, wave, newer, older, _get_sums(rows, i))
                _set_sums(rows, i, sums)
        for i in range(_LANES):
            wave, before = _get_wave(rows, i), rows[i + _SIGMA]
            steady_part = (
                rows[i + _STEADY],
                rows[i + _STEADY + _LANES],
                rows[i + _STEADY + 2 * _LANES],
                rows[i + _STEADY + 3 * _LANES],
                rows[i + _STEADY + 4 * _LANES],
            )
            attached = _total(wave, steady_part, _get_sums(rows, i))
            sigma, low, high, speed, error = _improve(
                before, rows[i + _LOW], rows[i + _HIGH], wave, attached
            )
            # once there, a lane stands still, so that nothing depends on its neighbours
            going = rows[i + _ERROR] > _tolerance(wave)
            rows[i + _SIGMA] = sigma if going else before
            rows[i + _LOW] = low
            rows[i + _HIGH] = high
            rows[i + _SPEED] = speed if going else rows[i + _SPEED]
            rows[i + _ERROR] = error if going else rows[i + _ERROR]
        count = 0
        for i in range(_LANES):
            count += rows[i + _ERROR] > _tolerance(_get_wave(rows, i))
        if count == 0:
            break


@_jit
def _flush(k, queues, indices, count, phase, speed, status):
    """Polish the throws queued for interval k and hand them over."""
    rows = queues[k * _QUEUE : (k + 1) * _QUEUE]
    for i in range(_LANES):
        rows[i + _SIGMA] = _guess(k, _get_wave(rows, i), _get_interval(k, rows, i))
        rows[i + _ERROR] = 1.0
    if count >= _FEW:
        _polish_lanes(k, rows)
    for i in range(count):
        at = indices[k * _LANES + i]
        wave = _get_wave(rows, i)
        phase[at] = (2 * k + 1 + rows[i + _SIGMA]) / wave.kappa
        speed[at] = rows[i + _SPEED] / wave.root
        status[at] = _RELEASED
        if rows[i + _ERROR] > _tolerance(wave):
            found = _get_interval(k, rows, i)
            phase[at], speed[at], status[at] = _polish(
                k, rows[i + _SIGMA], wave, found, rows, i + _C, _LANES
            )


@_jit
def _release_lanes(
    mass_ratio, speed_ratio, damping_ratio, gravity_ratio, phase, speed, status, part, parts
):
    """Compute one block of releases in every `parts`."""
    work = np.empty((2, MAX_INTERVALS))
    c = work[0]
    inputs = np.ones(4 * _LANES)
    waves = np.empty(16 * _LANES)
    queues = np.ones((_LANES_K + 1) * _QUEUE)
    indices = np.zeros((_LANES_K + 1) * _LANES, dtype=np.int64)
    counts = np.zeros(_LANES_K + 1, dtype=np.int64)
    for row in range(-(-phase.size // (parts * _LANES))):
        # which one changes without a period, lest one part have the slow columns of a landscape
        start = (row * parts + (part + (row * 40503 >> 8)) % parts) * _LANES
        size = min(_LANES, phase.size - start)  # none, if the last row is not full
        for i in range(size):
            inputs[i] = mass_ratio[start + i]
            inputs[i + _LANES] = speed_ratio[start + i]
            inputs[i + 2 * _LANES] = damping_ratio[start + i]
            inputs[i + 3 * _LANES] = gravity_ratio[start + i]
        for i in range(_LANES):
            mu, kappa = inputs[i], inputs[i + _LANES]
            zeta, gravity = inputs[i + 2 * _LANES], inputs[i + 3 * _LANES]
            _set_wave(waves, i, _wave(mu, kappa, zeta, gravity))
        for i in range(size):
            at = start + i
            wave = _get_wave(waves, i)
            found = _find(wave, c, work[1])
            k = found.k
            status[at] = found.status
            if found.status != _RELEASED:
                phase[at] = 2.0 * k + 1.0
                speed[at] = math.nan
            elif k > _LANES_K:
                phase[at], speed[at], status[at] = _polish(
                    k, _guess(k, wave, found), wave, found, c, 0, 1
                )
            else:
                lane = counts[k]
                indices[k * _LANES + lane] = at
                place = k * _QUEUE + lane
                _set_wave(queues, place, wave)
                _set_interval(queues, place, found)
                for j in range(k + 1):
                    queues[place + _C + j * _LANES] = c[j]
                counts[k] = lane + 1
                if lane + 1 == _LANES:
                    _flush(k, queues, indices, _LANES, phase, speed, status)
                    counts[k] = 0
    for k in range(_LANES_K + 1):
        _flush(k, queues, indices, counts[k], phase, speed, status)
