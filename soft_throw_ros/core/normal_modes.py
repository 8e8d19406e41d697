# SPDX-License-Identifier: Apache-2.0
r"""
When and how fast a rigid projectile first leaves a layer with internal loss, exactly.

Kelvin-Voigt loss, :math:`\sigma = E_s (\epsilon + \theta \dot\epsilon)`, whose loss tangent at
the plate's frequency is :math:`\omega \theta`. Waves spread as they travel, so that the sums over
crossings of `soft_throw_ros.core.travelling_wave` do not hold; but the modes of layer and mass
are those without loss, each is damped by itself, and the sum over them converges the faster the
more loss there is.

Notes
-----
Time in crossings :math:`t_s`, speed in units of the plate's `velocity_factor`, so that
:math:`V_p = \Im e^{\lambda t}`. In the Laplace domain, with :math:`q^2 = s^2 / (1 + \theta s)`,

.. math::

    V_m = \frac{V_p}{D}, \qquad D = \cosh q + \mu\, q \sinh q, \qquad
    c_s\, \epsilon(\eta) = -\frac{q}{s}\,
    \frac{\sinh q (1 - \eta) + \mu\, q \cosh q (1 - \eta)}{D}\, V_p

from the plate, :math:`\eta = 0`, to the top, :math:`\eta = 1`. The poles are :math:`\lambda`,
which gives the steady motion :math:`\Im e^{\lambda t} / D(\lambda)`, and the modes
:math:`q = i \beta_n` with :math:`\beta \tan \beta = 1 / \mu`, two for each n:
:math:`s = -\theta \beta^2 / 2 \pm \sqrt{\theta^2 \beta^4 / 4 - \beta^2}`. The residue of
:math:`V_m` there is

.. math::

    \frac{s^3}{\beta^4 (2 + \theta s)}\, \frac{\Im \lambda}{(s - \lambda)(s - \bar\lambda)}\,
    \frac{2}{(1 + \mu) \sin \beta / \beta + \mu \cos \beta}

The contact force is :math:`m (\dot V_m + g)`, and the projectile leaves when it first falls to
0. A mode fades as :math:`e^{-\theta \beta^2 t / 2}`, so few are left when the wave arrives; with
very little loss `MAX_MODES` are summed, whose remainder is of order :math:`\beta^{-3}` in the
speed.

"""

from __future__ import annotations

import math
from typing import Literal

import numba as nb
import numpy as np
from numpy.typing import ArrayLike, NDArray
from soft_throw_ros.core import checks
from soft_throw_ros.core.peak import FirstPeaks
from soft_throw_ros.core.plate import peak_velocity_ratio
from soft_throw_ros.core.travelling_wave import FirstRelease, ThrowUnresolvedError

MAX_MODES = 400
"""Modes that are summed at most, each with its two poles."""

MAX_PERIODS = 64.0
"""Plate periods after the wave's arrival that are followed before a named error is raised."""

_RELEASED = 0
_HELD = 1  # by gravity, for good
_NOT_WITHIN = 2

_FADED = 37.0  # e-folds to rounding
_EARLY = 0.5  # the sums need not be complete before this time, when nothing has arrived yet
_HEIGHTS = 17  # of the table in which peaks are looked for, and ...
_TIMES = 512  # at most so many times
_CLIMBS = 3  # of the table's highest points, from which it is searched on, ...
_CLOSE = 0.98  # if they come so close to the highest found
_SHORTEST = 1e-3  # step of the search, over the distance of the table's points
_MAX_MOVES = 100

_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(16)

_jit = nb.njit(cache=True, nogil=True, error_model='numpy')


def first_release(
    *,
    mass_ratio: float,
    speed_ratio: float,
    loss_tangent: float,
    damping_ratio: float = 0.0,
    gravity_ratio: float = 0.0,
) -> FirstRelease:
    r"""
    Find when a rigid projectile first leaves the layer, and how fast.

    The plate moves as `plate.Underdamped`.

    Parameters
    ----------
    mass_ratio : float
        Projectile over layer mass, :math:`\mu = m / (\rho_s S L_s)`. [-]
    speed_ratio : float
        Crossings of the wave per plate period, :math:`\kappa = c_s / (L_s f)`. [-]
    loss_tangent : float
        Of the layer at the plate's frequency. [-]
    damping_ratio : float
        Of the plate, :math:`\zeta`. [-]
    gravity_ratio : float
        :math:`g / (A \omega^2)`. [-]

    Returns
    -------
    FirstRelease
        Of floats. Errors below 1e-7, relative, for :math:`\mu` from 0.01 on.

    Raises
    ------
    ValueError
        If a ratio or the loss tangent is not finite and positive (damping: in [0, 1); gravity:
        not negative).
    ThrowUnresolvedError
        If gravity holds the projectile, or it does not leave within `MAX_PERIODS`.

    Examples
    --------
    What a loss tangent of 0.02 makes of the best throw without loss, whose transfer is 4.123:

    >>> release = first_release(mass_ratio=0.234231, speed_ratio=8.242210, loss_tangent=0.02)
    >>> round(release.ejection_phase, 6), round(release.energy_transfer, 6)
    (0.387118, 3.79854)

    """
    releases = first_releases(
        mass_ratio=checks.finite('mass_ratio', mass_ratio),
        speed_ratio=checks.finite('speed_ratio', speed_ratio),
        loss_tangent=checks.finite('loss_tangent', loss_tangent),
        damping_ratio=checks.finite('damping_ratio', damping_ratio),
        gravity_ratio=checks.finite('gravity_ratio', gravity_ratio),
    )
    return FirstRelease(*map(float, releases))


def first_releases(
    *,
    mass_ratio: ArrayLike,
    speed_ratio: ArrayLike,
    loss_tangent: ArrayLike,
    damping_ratio: ArrayLike = 0.0,
    gravity_ratio: ArrayLike = 0.0,
    unresolved: Literal['raise', 'nan'] = 'raise',
) -> FirstRelease:
    """
    Find when and how fast rigid projectiles first leave their layers, for many throws.

    Parameters
    ----------
    mass_ratio, speed_ratio, loss_tangent, damping_ratio, gravity_ratio : array_like
        As for `first_release`; broadcast against each other. [-]
    unresolved : {'raise', 'nan'}
        What becomes of throws that are not resolved: the first is raised, or all are NaN.

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
    >>> throws = first_releases(mass_ratio=0.2, speed_ratio=8.0, loss_tangent=[0.01, 0.1, 1.0])
    >>> throws.energy_transfer.round(4)
    array([3.9274, 3.1474, 1.3289])

    """
    if unresolved not in ('raise', 'nan'):
        raise ValueError(f"unresolved must be 'raise' or 'nan', got {unresolved!r}")
    damping_ratio = checks.below_one_array('damping_ratio', damping_ratio)
    cases = np.broadcast_arrays(
        checks.positive_array('mass_ratio', mass_ratio),
        checks.positive_array('speed_ratio', speed_ratio),
        damping_ratio,
        checks.not_negative_array('gravity_ratio', gravity_ratio),
        checks.positive_array('loss_tangent', loss_tangent),
    )
    shape = cases[0].shape
    flat = np.stack([case.ravel() for case in cases])
    phase, speed, status = _releases(flat)
    failed = np.flatnonzero(status != _RELEASED)
    if failed.size and unresolved == 'raise':
        raise _unresolved(int(status[failed[0]]), flat[:, failed[0]])
    ratio = np.vectorize(peak_velocity_ratio, otypes=[np.float64])(damping_ratio)
    speed = speed.reshape(shape)
    return FirstRelease(phase.reshape(shape), speed, (speed / ratio) ** 2)


def first_peaks(
    *,
    mass_ratio: float,
    speed_ratio: float,
    loss_tangent: float,
    damping_ratio: float = 0.0,
    gravity_ratio: float = 0.0,
) -> FirstPeaks:
    r"""
    Find the largest strain, acceleration and force up to the first release.

    Parameters
    ----------
    mass_ratio, speed_ratio, loss_tangent, damping_ratio, gravity_ratio : float
        As for `first_release`. [-]

    Returns
    -------
    FirstPeaks
        As `peak.first_peaks` has it, to 1e-5 for loss tangents from 0.01 on. The force is that of
        the stress with its viscous part, and the work is also what has become heat.

    Raises
    ------
    ValueError, ThrowUnresolvedError
        As for `first_release`.

    Examples
    --------
    The part of the plate's work that goes to the projectile:

    >>> ratios = {'mass_ratio': 0.25, 'speed_ratio': 8.5}
    >>> for loss_tangent in (0.001, 0.1):
    ...     peaks = first_peaks(**ratios, loss_tangent=loss_tangent)
    ...     round(0.5 * peaks.release.speed**2 / peaks.plate_work, 3)
    0.317
    0.265

    """
    release = first_release(
        mass_ratio=mass_ratio,
        speed_ratio=speed_ratio,
        loss_tangent=loss_tangent,
        damping_ratio=damping_ratio,
        gravity_ratio=gravity_ratio,
    )
    _, _, _, *rest = first_peaks_kernel(
        float(mass_ratio),
        float(speed_ratio),
        float(damping_ratio),
        float(gravity_ratio),
        float(loss_tangent),
    )
    return FirstPeaks(release, *rest)


def first_rise(
    *,
    mass_ratio: float,
    speed_ratio: float,
    loss_tangent: float,
    damping_ratio: float = 0.0,
    gravity_ratio: float = 0.0,
) -> float:
    r"""
    Find how far the projectile has risen when it first leaves the layer.

    Parameters
    ----------
    mass_ratio, speed_ratio, loss_tangent, damping_ratio, gravity_ratio : float
        As for `first_release`. [-]

    Returns
    -------
    float
        From where it rested, in :math:`A`. [-]

    Raises
    ------
    ValueError, ThrowUnresolvedError
        As for `first_release`.

    """
    release = first_release(
        mass_ratio=mass_ratio,
        speed_ratio=speed_ratio,
        loss_tangent=loss_tangent,
        damping_ratio=damping_ratio,
        gravity_ratio=gravity_ratio,
    )
    time = float(release.ejection_phase) * speed_ratio
    return float(_rise(time, float(mass_ratio), float(speed_ratio), damping_ratio, loss_tangent))


def _unresolved(status: int, case: NDArray[np.float64]) -> ThrowUnresolvedError:
    mass_ratio, speed_ratio, damping_ratio, gravity_ratio, loss_tangent = case
    words = (
        f'mass_ratio {mass_ratio:g}, speed_ratio {speed_ratio:g}, damping_ratio '
        f'{damping_ratio:g}, gravity_ratio {gravity_ratio:g}, loss_tangent {loss_tangent:g}'
    )
    if status == _HELD:
        return ThrowUnresolvedError(f'gravity holds the projectile for {words}')
    return ThrowUnresolvedError(f'no release within {MAX_PERIODS:g} plate periods for {words}')


@_jit
def first_release_kernel(
    mu: float, kappa: float, zeta: float, gravity: float, loss: float, latest: float
) -> tuple[float, float, int]:
    """
    Compute one release without checks: (t_e f, V_e / (A w), status), status 0 when found.

    It is looked for until `latest` plate periods after the wave's arrival. For use inside
    compiled code.
    """
    lam, theta, weight, root = _units(kappa, zeta, gravity, loss)
    steady, rates, parts, _ = _modes(mu, lam, theta)
    time, speed, status = _release(mu, lam, theta, weight, steady, rates, parts, latest)
    return time / kappa, speed / root, status


@_jit
def _releases(cases):
    size = cases.shape[1]
    phase, speed = np.full(size, np.nan), np.full(size, np.nan)
    status = np.empty(size, np.int64)
    for i in range(size):
        t, v, status[i] = first_release_kernel(
            cases[0, i], cases[1, i], cases[2, i], cases[3, i], cases[4, i], MAX_PERIODS
        )
        if status[i] == _RELEASED:
            phase[i], speed[i] = t, v
    return phase, speed, status


@_jit
def _units(kappa, zeta, gravity, loss):
    """Compute lambda, theta, gravity as a change of speed per crossing, and sqrt(1 - zeta^2)."""
    root = math.sqrt(1.0 - zeta * zeta)
    crossing = 2.0 * math.pi / kappa  # w t_s
    lam = complex(-zeta * crossing, root * crossing)
    return lam, loss / crossing, gravity * crossing * root, root


@_jit
def _modes(mu, lam, theta):
    """Compute 1 / D(lambda), the poles of the modes, their parts in V_m, and their beta."""
    q, grown, fallen = _wave_number(lam, theta)
    steady = 2.0 / (grown + fallen + mu * q * (grown - fallen))
    # all that have not faded by then; and the slow poles of overdamped modes go as beta^-4
    beta_last = math.sqrt(2.0 * _FADED / (theta * _EARLY))
    size = min(MAX_MODES, max(16, int(beta_last / math.pi) + 2))
    if theta * _FADED > _EARLY:
        size = max(size, 40)
    rates = np.empty(2 * size, np.complex128)
    parts = np.empty(2 * size, np.complex128)
    betas = np.empty(2 * size)
    count = 0
    for n in range(size):
        beta = _root_of_mode(n, mu)
        shape = 2.0 / ((1.0 + mu) * math.sin(beta) / beta + mu * math.cos(beta))
        half = 0.5 * theta * beta * beta
        square = half * half - beta * beta
        if abs(square) < 1e-12 * beta * beta:
            square = 1e-12 * beta * beta  # the two poles may not be one
        pair = 2 if square > 0.0 else 1
        for i in range(pair):
            if square < 0.0:
                s = complex(-half, math.sqrt(-square))
            elif i == 0:
                s = complex(-half - math.sqrt(square), 0.0)
            else:  # the product of both is beta^2
                s = complex(-beta * beta / (half + math.sqrt(square)), 0.0)
            plate = lam.imag / ((s - lam) * (s - lam.conjugate()))
            rates[count] = s
            weight = shape * (3 - pair) / (beta * beta * beta * beta)
            parts[count] = s * s * s / (2.0 + theta * s) * plate * weight
            betas[count] = beta
            count += 1
    return steady, rates[:count], parts[:count], betas[:count]


@_jit
def _exp(z):
    """Compute e^z."""
    size = math.exp(z.real)
    return complex(size * math.cos(z.imag), size * math.sin(z.imag))


@_jit
def _wave_number(lam, theta):
    """Compute q, e^q and e^-q for s = lambda."""
    below = 1.0 + theta * lam
    real = math.sqrt(0.5 * (abs(below) + below.real))
    q = lam / complex(real, 0.5 * below.imag / real)
    return q, _exp(q), _exp(-q)


@_jit
def _root_of_mode(n, mu):
    """Find beta in [n pi, (n + 1/2) pi] with beta tan beta = 1 / mu."""
    beta = n * math.pi + min(0.5 * math.pi, 1.0 / math.sqrt(mu))
    for _ in range(50):
        x = 1.0 / (mu * beta)
        change = (beta - n * math.pi - math.atan(x)) / (1.0 + x / (beta * (1.0 + x * x)))
        beta -= change
        if abs(change) < 1e-9 * beta:  # the next one would be its square
            break
    return beta


@_jit
def _motion(time, lam, steady, rates, parts):
    """Compute V_m and its first two derivatives."""
    value = steady * _exp(lam * time)
    speed, push, jerk = value.imag, (lam * value).imag, (lam * lam * value).imag
    for i in range(rates.size):
        s = rates[i]
        if s.real * time > -_FADED:
            value = parts[i] * _exp(s * time)
            speed += value.real
            push += (s * value).real
            jerk += (s * s * value).real
    return speed, push, jerk


@_jit
def _release(mu, lam, theta, weight, steady, rates, parts, latest):
    """Step until the force has fallen to 0, and find out when: (time, V_m, status)."""
    crossing = abs(lam)
    step = min(max(0.5 * max(mu, math.sqrt(theta)), 1.0 / 64.0), 1.0 / 16.0, 0.2 / crossing)
    period = 2.0 * math.pi / lam.imag
    end = 1.0 + latest * 2.0 * math.pi / crossing
    # of every mode its part in V_m' now, and what it is multiplied by in a step
    count = rates.size
    now, turn, rate = np.empty_like(rates), np.empty_like(rates), rates.copy()
    for j in range(count):
        now[j], turn[j] = rates[j] * parts[j], _exp(rates[j] * step)
    remainder = abs(now[-1]) * count
    fade = math.exp(rates[-1].real * step)
    plate = lam * steady
    plate_turn = _exp(lam * step)
    low, low_push, low_jerk = 0.0, weight, 0.0
    is_armed = weight > 0.0
    i = 0
    while low < end:
        i += 1
        plate *= plate_turn
        remainder *= fade
        push, jerk, size = plate.imag + weight, (lam * plate).imag, 0.0
        left = 0
        for j in range(count):
            value = now[j] * turn[j]
            push += value.real
            jerk += (rate[j] * value).real
            magnitude = abs(value.real) + abs(value.imag)
            size += magnitude
            if magnitude > 1e-17 * crossing:  # else it is left out from now on
                now[left], turn[left], rate[left] = value, turn[j], rate[j]
                left += 1
        count = left
        high = i * step
        if not is_armed:
            # until the wave arrives, nothing is felt but what is left out of the sums
            is_armed = push > 10.0 * remainder + 1e-13 * size
        elif push <= 0.0:
            return _polish(low, high, weight, lam, steady, rates, parts)
        elif low_jerk < 0.0 < jerk:
            lowest = min(low_push + low_jerk * step, push - jerk * step)
            if lowest <= 0.0:
                middle, dip = _dip(low, high, weight, lam, steady, rates, parts)
                if dip <= 0.0:
                    return _polish(low, middle, weight, lam, steady, rates, parts)
        if weight > 0.0 and high > 1.0 + period and abs(plate) + size < weight:
            return high, math.nan, _HELD
        low, low_push, low_jerk = high, push, jerk
    return end, math.nan, _NOT_WITHIN


@_jit
def _dip(low, high, weight, lam, steady, rates, parts):
    """Find a minimum of the force within a step by bisection: (time, force)."""
    middle, push = low, weight
    while high - low > 1e-12 * high:
        middle = 0.5 * (low + high)
        _, push, jerk = _motion(middle, lam, steady, rates, parts)
        push += weight
        if push <= 0.0:
            break
        if jerk < 0.0:
            low = middle
        else:
            high = middle
    return middle, push


@_jit
def _polish(low, high, weight, lam, steady, rates, parts):
    """Find the root of the force in a bracket by Newton's iteration: (time, V_m, status)."""
    time = 0.5 * (low + high)
    speed = 0.0
    for i in range(80):
        speed, push, jerk = _motion(time, lam, steady, rates, parts)
        push += weight
        if push > 0.0:
            low = time
        else:
            high = time
        following = time - push / jerk
        if not low <= following <= high or i > 20:  # it goes round in circles
            following = 0.5 * (low + high)
        change = following - time
        time = following
        if abs(change) < 1e-14 * high:
            break
    return time, speed, _RELEASED


@_jit
def first_peaks_kernel(
    mu: float, kappa: float, zeta: float, gravity: float, loss: float
) -> tuple[float, float, int, float, float, float, float, float, float, float]:
    """Compute (t_e f, V_e / (A w), status), then what follows `release` in FirstPeaks."""
    lam, theta, weight, root = _units(kappa, zeta, gravity, loss)
    steady, rates, parts, betas = _modes(mu, lam, theta)
    end, speed, status = _release(mu, lam, theta, weight, steady, rates, parts, MAX_PERIODS)
    if status != _RELEASED:
        return end / kappa, math.nan, status, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    waves = (mu, lam, theta, rates, parts, betas)
    static = weight * mu
    size = _table_size(end, kappa)
    strain, when, where = _highest(static, end, size, waves)
    contact = _highest_at(1.0, 0.0, static, end, size, waves)
    push = _highest_at(1.0, theta, 0.0, end, size, waves)
    force = _highest_at(0.0, theta, static, end, size, waves)
    return (
        end / kappa,
        speed / root,
        status,
        strain / root,
        when / kappa,
        where,
        contact / root,
        push / (mu * root * abs(lam)),
        force / root,
        _work(end, static, waves) / (mu * root * root),
    )


@_jit
def first_loads_kernel(
    mu: float, kappa: float, zeta: float, gravity: float, loss: float, latest: float
) -> tuple[float, int, float, float]:
    """
    Compute (V_e / (A w), status, strain, acceleration), the last two as in FirstPeaks.

    For use inside compiled code that only asks whether a throw keeps limits.
    """
    lam, theta, weight, root = _units(kappa, zeta, gravity, loss)
    steady, rates, parts, betas = _modes(mu, lam, theta)
    end, speed, status = _release(mu, lam, theta, weight, steady, rates, parts, latest)
    if status != _RELEASED:
        return math.nan, status, math.nan, math.nan
    waves = (mu, lam, theta, rates, parts, betas)
    size = _table_size(end, kappa)
    strain, _, _ = _highest(weight * mu, end, size, waves)
    push = _highest_at(1.0, theta, 0.0, end, size, waves)
    return speed / root, status, strain / root, push / (mu * root * abs(lam))


@_jit
def _table_size(end, kappa):
    """Choose into how many steps the time until the release is cut."""
    return min(max(int(12.0 * end), int(24.0 * end / kappa), 16), _TIMES)


@_jit
def _shape(height, beta, mu):
    """Compute the strain of a mode at a height over its part in V_m, times s / beta."""
    angle = beta * (1.0 - height)
    return math.sin(angle) + mu * beta * math.cos(angle)


@_jit
def _steady_strain(height, waves):
    """Compute the strain at a height that goes with e^{lambda t}."""
    mu, lam, theta, _, _, _ = waves
    q, grown, fallen = _wave_number(lam, theta)
    below = grown + fallen + mu * q * (grown - fallen)
    grown, fallen = _exp(q * (1.0 - height)), _exp(-q * (1.0 - height))
    return -q / lam * (grown - fallen + mu * q * (grown + fallen)) / below


@_jit
def _strain(height, time, viscous, waves):
    """Compute the strain without the static part, or with `viscous` theta the stress over E."""
    mu, lam, _, rates, parts, betas = waves
    plate = _steady_strain(height, waves) * _exp(lam * time)
    total = (plate * (1.0 + viscous * lam)).imag
    for i in range(rates.size):
        s = rates[i]
        if s.real * time > -_FADED:
            value = parts[i] * _exp(s * time) * (1.0 + viscous * s) / s
            total += value.real * betas[i] * _shape(height, betas[i], mu)
    return total


@_jit
def _fill(values, height, viscous, static, end, waves):
    """Compute magnitudes as of `_strain` at even times from 0 to the end."""
    mu, lam, _, rates, parts, betas = waves
    step = end / (values.size - 1)
    plate = _steady_strain(height, waves) * (1.0 + viscous * lam)
    plate_turn = _exp(lam * step)
    now, turn = np.empty_like(rates), np.empty_like(rates)
    for j in range(rates.size):
        now[j] = parts[j] * (1.0 + viscous * rates[j]) / rates[j]
        now[j] *= betas[j] * _shape(height, betas[j], mu)
        turn[j] = _exp(rates[j] * step)
    count = rates.size
    for i in range(values.size):
        total = plate.imag - static
        left = 0
        for j in range(count):
            value = now[j]
            total += value.real
            if abs(value.real) + abs(value.imag) > 1e-12:  # else it is left out from now on
                now[left], turn[left] = value * turn[j], turn[j]
                left += 1
        count = left
        values[i] = abs(total)
        plate *= plate_turn


@_jit
def _rise(time, mu, kappa, zeta, loss):
    """Integrate V_m, in A."""
    lam, theta, _, root = _units(kappa, zeta, 0.0, loss)
    steady, rates, parts, _ = _modes(mu, lam, theta)
    total = (steady * (_exp(lam * time) - 1.0) / lam).imag
    for i in range(rates.size):
        total += (parts[i] * (_exp(rates[i] * time) - 1.0) / rates[i]).real
    return total * abs(lam) / root


@_jit
def _largest(values):
    """Find where the largest value is."""
    best = 0
    for i in range(values.size):
        if values[i] > values[best]:
            best = i
    return best


@_jit
def _highest_at(height, viscous, static, end, size, waves):
    """Find the largest magnitude at a height."""
    row = np.empty(size + 1)
    _fill(row, height, viscous, static, end, waves)
    i = _largest(row)
    return _climb(row[i], i * end / size, height, end / size, 0.0, viscous, static, end, waves)[0]


@_jit
def _highest(static, end, size, waves):
    """Find the largest strain anywhere: (strain, time, height)."""
    spread = 1.0 / (_HEIGHTS - 1.0)
    row = size + 1
    table = np.empty(_HEIGHTS * row)
    for i in range(_HEIGHTS):
        _fill(table[i * row : (i + 1) * row], i * spread, 0.0, static, end, waves)
    best, when, where = 0.0, 0.0, 0.0
    for _ in range(_CLIMBS):
        at = _largest(table)
        if table[at] < _CLOSE * best:
            break
        i, j = at // row, at % row
        value, time, height = _climb(
            table[at], j * end / size, i * spread, end / size, spread, 0.0, static, end, waves
        )
        if value > best:
            best, when, where = value, time, height
        for k in range(max(i - 2, 0), min(i + 3, _HEIGHTS)):  # done with
            for m in range(max(j - 2, 0), min(j + 3, row)):
                table[k * row + m] = 0.0
    return best, when, where


@_jit
def _climb(value, time, height, width, spread, viscous, static, end, waves):
    """Go to the best of eight neighbours, or halve the step if none is better."""
    step = 0.5
    for _ in range(_MAX_MOVES):
        best, when, where = value, time, height
        for i in range(-1, 2):
            for j in range(-1, 2) if spread > 0.0 else range(1):
                near = min(max(time + i * step * width, 0.0), end)
                beside = min(max(height + j * step * spread, 0.0), 1.0)
                if near != time or beside != height:
                    other = abs(_strain(beside, near, viscous, waves) - static)
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
def _work(end, static, waves):
    """Integrate force on the layer times speed of the plate, by Gauss's rule on short pieces."""
    _, lam, theta, _, _, _ = waves
    pieces = max(4, math.ceil(2.0 * end), math.ceil(end * abs(lam)))
    width = end / pieces
    total = 0.0
    for i in range(pieces):
        for node in range(_NODES.size):
            time = (i + 0.5 * (1.0 + _NODES[node])) * width
            force = static - _strain(0.0, time, theta, waves)
            total += 0.5 * width * _WEIGHTS[node] * force * _exp(lam * time).imag
    return total
