# SPDX-License-Identifier: Apache-2.0
r"""
First releases under gravity, in steps and in bounded time: for searches.

A projectile that gravity holds on the layer through the first swing of the plate may leave in a
later one, and faster, for the layer has had time to swing up with it; or never. The closed form
of `soft_throw_ros.core.travelling_wave` needs milliseconds to tell, since its sums grow with
every crossing of the wave. Here a crossing costs the same however many there were.

Notes
-----
Time in crossings :math:`t_s`, from the wave's arrival at the top on, and the symbols of that
module. With :math:`v_+(t) = V_p(t) - v_-(t - 2)`, :math:`v_- = V_m - v_+` and
:math:`\mu \dot V_m + V_m = 2 v_+`, all that has to be remembered is :math:`v_-` of the last two
crossings. :math:`v_+` is taken as a parabola over every two steps, between kinks, which fall on
even times; for it the equation of the mass is solved exactly. So errors are of third order in
the step, about 1e-6 in the speed.

"""

from __future__ import annotations

import math

import numba as nb
import numpy as np

_PER_PERIOD = 96.0  # steps per plate period, at least, ...
_PER_RELAXATION = 8.0  # and per tau, ...
_FEWEST, _MOST = 8, 256  # between these per crossing

_jit = nb.njit(cache=True, nogil=True, error_model='numpy')


@_jit
def first_release_kernel(
    mu: float, kappa: float, zeta: float, gravity: float, latest: float
) -> tuple[float, float, int]:
    """
    Compute one release without checks: (t_e f, V_e / (A w), status), status 0 when found.

    It is looked for until `latest` plate periods after the wave's arrival. The layer is lossless,
    and the plate moves as `plate.Underdamped`. For use inside compiled code.
    """
    root = math.sqrt(1.0 - zeta * zeta)
    crossing = 2.0 * math.pi / kappa  # w t_s
    weight = gravity * crossing * mu * root
    half = int(0.5 * max(_PER_PERIOD / kappa, _PER_RELAXATION / mu, _FEWEST)) + 1
    memory = 4 * min(half, _MOST // 2)
    step = 2.0 / memory
    down = np.zeros(memory)  # v_- of the last two crossings
    lam = complex(-zeta * crossing, root * crossing)
    size = math.exp(lam.real * step)
    turn = complex(size * math.cos(lam.imag * step), size * math.sin(lam.imag * step))
    plate = complex(1.0, 0.0)
    fade = math.exp(-step / mu)
    speed = up = 0.0
    pairs = int(0.5 * latest * kappa / step) + 1
    at = 0
    for i in range(pairs):
        plate *= turn
        up_middle = plate.imag - down[at + 1]
        plate *= turn
        after = at + 2 if at + 2 < memory else 0
        up_end = plate.imag - down[after]
        # v_+ = up + slope s + curve s^2, V_m = 2 (v_+ - mu v_+' + mu^2 v_+'') + rest e^{-s/mu}
        curve = 0.5 * (up_end - 2.0 * up_middle + up) / (step * step)
        slope = (up_middle - up) / step - curve * step
        offset = 2.0 * mu * (2.0 * mu * curve - slope)
        rest = speed - 2.0 * up - offset
        speed_middle = 2.0 * up_middle + offset - 4.0 * mu * curve * step + rest * fade
        speed_end = 2.0 * up_end + offset - 8.0 * mu * curve * step + rest * fade * fade
        down[at + 1] = speed_middle - up_middle
        down[after] = speed_end - up_end
        low = high = 0.0
        if 2.0 * up_middle - speed_middle + weight <= 0.0:
            high = step
        else:
            # where the force is least, should that be within the pair of steps
            ratio = -4.0 * mu * mu * curve / rest if rest < 0.0 else 0.0
            if fade * fade < ratio < 1.0:
                high = -mu * math.log(ratio)
                if _force(high, mu, curve, offset, rest) + weight > 0.0:
                    high = 0.0
            if high == 0.0 and 2.0 * up_end - speed_end + weight <= 0.0:
                low, high = step, 2.0 * step
        if high > 0.0:
            while high - low > 1e-12:
                middle = 0.5 * (low + high)
                if _force(middle, mu, curve, offset, rest) + weight > 0.0:
                    low = middle
                else:
                    high = middle
            force = _force(high, mu, curve, offset, rest)
            speed = 2.0 * (up + high * (slope + high * curve)) - force
            time = 1.0 + 2.0 * i * step + high
            return time / kappa, speed / root, 0
        speed, up, at = speed_end, up_end, after
    return latest + 1.0 / kappa, math.nan, 1


@_jit
def _force(time, mu, curve, offset, rest):
    """Compute 2 v_+ - V_m within a pair of steps."""
    return 4.0 * mu * curve * time - offset - rest * math.exp(-time / mu)
