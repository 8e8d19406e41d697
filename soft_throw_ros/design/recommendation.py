# SPDX-License-Identifier: Apache-2.0
"""
Recommend a layer for a rig: the one that throws the projectile fastest.

What counts is the first release, for that is what can be relied on; see
`soft_throw_ros.design.search` for how it is looked for, and for how gravity counts.
"""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
import functools
import math
from typing import get_args, Literal

from soft_throw_ros.core import checks
from soft_throw_ros.core.peak import first_peaks
from soft_throw_ros.core.rig import Rig
from soft_throw_ros.core.travelling_wave import first_release, ThrowUnresolvedError
from soft_throw_ros.design.search import find_summit

Vary = Literal['thickness', 'wave_speed', 'both']

Limits = tuple[float, float]

PAPER_RATIOS = (0.32, 8.4)
"""What the paper quotes for the best mass and speed ratio. See `Optimum`. [-]"""

_EQUAL = 1e-9  # relative, in the energy transfer
_LARGE_GRAVITY = 0.2  # of the plate's largest acceleration


@dataclass(frozen=True, kw_only=True)
class Optimum:
    r"""
    Mass and speed ratio, and what they give without gravity and loss.

    Parameters
    ----------
    damping_ratio : float
        Of the plate, :math:`\zeta`. [-]
    mass_ratio : float
        Projectile over layer mass, :math:`\mu = m / (\rho_s S L_s)`. [-]
    speed_ratio : float
        Crossings of the wave per plate period, :math:`\kappa = c_s / (L_s f)`. [-]
    ejection_phase : float
        :math:`t_e f`, in plate periods. [-]
    energy_transfer : float
        :math:`\alpha`. [-]

    Notes
    -----
    [1]_ has its optimum for a projectile and a layer of equal density, and gives it as
    :math:`L_s / (L_s + L_r) = 0.8` and :math:`c_s / (L f) = 6.7`. Its :math:`\mu = 0.32` and
    :math:`\kappa = 8.4` are made of these, but :math:`\mu` with the density ratio 1.3 of its own
    rig, so that the two do not belong together. Without damping they transfer 4.110 instead of
    4.123, which takes 0.234 and 8.242.

    References
    ----------
    .. [1] "Use of compliant actuators for throwing rigid projectiles", Phys. Rev. E (2022).

    """

    damping_ratio: float
    mass_ratio: float
    speed_ratio: float
    ejection_phase: float
    energy_transfer: float

    @classmethod
    def at(cls, *, mass_ratio: float, speed_ratio: float, damping_ratio: float) -> Optimum:
        """Find out what given ratios give."""
        release = first_release(
            mass_ratio=mass_ratio, speed_ratio=speed_ratio, damping_ratio=damping_ratio
        )
        return cls(
            damping_ratio=damping_ratio,
            mass_ratio=mass_ratio,
            speed_ratio=speed_ratio,
            ejection_phase=float(release.ejection_phase),
            energy_transfer=float(release.energy_transfer),
        )


@functools.lru_cache(maxsize=64)
def best_ratios(damping_ratio: float) -> Optimum:
    r"""
    Find the mass and speed ratio that transfer the most energy, were there no limits.

    Parameters
    ----------
    damping_ratio : float
        Of the plate, :math:`\zeta`. [-]

    Returns
    -------
    Optimum
        Ratios to 1e-5.

    Raises
    ------
    ValueError
        If `damping_ratio` is not in [0, 1).

    Notes
    -----
    For all :math:`\zeta` from 0 to 0.99 the best of :math:`\mu` from 0.001 to 1000 and
    :math:`\kappa` from 0.15 to 500 is at :math:`\mu` from 0.23 to 0.44 and :math:`\kappa` from
    8.2 to 12.3; it is looked for nearby.

    Examples
    --------
    >>> best = best_ratios(0.064)
    >>> round(best.mass_ratio, 5), round(best.speed_ratio, 5), round(best.energy_transfer, 6)
    (0.2554, 8.57592, 4.142897)

    """
    checks.below_one('damping_ratio', damping_ratio)
    summit = find_summit(
        mass_ratio=0.3,
        speed_ratio=10.0,
        damping_ratio=float(damping_ratio),
        gravity_ratio=0.0,
        thickness_factors=(0.5, 2.0),
        wave_speed_factors=(0.4, 2.5),
        tolerance=1e-7,
    )
    return Optimum.at(
        mass_ratio=0.3 / summit.thickness_factor,
        speed_ratio=10.0 * summit.wave_speed_factor / summit.thickness_factor,
        damping_ratio=float(damping_ratio),
    )


@dataclass(frozen=True, kw_only=True)
class Prediction:
    r"""
    What a throw gives, with the rig's damping and gravity, up to the first release.

    Parameters
    ----------
    thickness : float
        Of the layer, :math:`L_s`. [m]
    wave_speed : float
        Of the layer, :math:`c_s`. [m/s]
    youngs_modulus : float
        Of the layer, :math:`\rho_s c_s^2`. [Pa]
    mass_ratio : float
        Projectile over layer mass, :math:`\mu`. [-]
    speed_ratio : float
        :math:`\kappa = c_s / (L_s f)`. [-]
    ejection_time : float
        :math:`t_e`. [s]
    ejection_speed : float
        :math:`V_e`. [m/s]
    energy_transfer : float
        :math:`\alpha = (V_e / V_p^*)^2`. [-]
    peak_strain : float
        Largest magnitude of the strain anywhere in the layer. [-]
    peak_strain_time : float
        When. [s]
    peak_strain_depth : float
        At which distance from the plate. [m]
    peak_contact_strain : float
        Largest magnitude of the strain at the projectile. [-]
    peak_acceleration : float
        Largest magnitude of the projectile's acceleration. [m/s2]
    peak_force : float
        Largest magnitude of the layer's force on the plate. [N]
    plate_work : float
        Work of the plate from its start to the release, which an actuator has to deliver. [J]
    kinetic_energy : float
        Of the projectile, which is what the throw is for. [J]

    """

    thickness: float
    wave_speed: float
    youngs_modulus: float
    mass_ratio: float
    speed_ratio: float
    ejection_time: float
    ejection_speed: float
    energy_transfer: float
    peak_strain: float
    peak_strain_time: float
    peak_strain_depth: float
    peak_contact_strain: float
    peak_acceleration: float
    peak_force: float
    plate_work: float
    kinetic_energy: float


def predict(rig: Rig) -> Prediction:
    """
    Predict one throw of a rig.

    Parameters
    ----------
    rig : Rig
        Without loss in the layer.

    Raises
    ------
    ValueError
        If the layer has loss.
    ThrowUnresolvedError
        If the projectile does not leave, or only after more crossings than are followed.

    Examples
    --------
    >>> throw = predict(Rig())
    >>> round(1e3 * throw.ejection_time, 3), round(throw.energy_transfer, 3)
    (7.647, 3.637)
    >>> f'{throw.peak_strain:.1%}, {throw.peak_acceleration / 9.81:.0f} g'
    '11.6%, 40 g'

    """
    _check_lossless(rig)
    engine, layer, mass = rig.engine, rig.layer, rig.projectile.mass
    peaks = first_peaks(
        mass_ratio=rig.mass_ratio,
        speed_ratio=rig.speed_ratio,
        damping_ratio=engine.damping_ratio,
        gravity_ratio=rig.gravity_ratio,
    )
    speed_scale = engine.speed_scale
    strain_scale = speed_scale / layer.wave_speed
    speed = float(peaks.release.speed) * speed_scale
    return Prediction(
        thickness=layer.thickness,
        wave_speed=layer.wave_speed,
        youngs_modulus=layer.youngs_modulus,
        mass_ratio=rig.mass_ratio,
        speed_ratio=rig.speed_ratio,
        ejection_time=float(peaks.release.ejection_phase) / engine.frequency,
        ejection_speed=speed,
        energy_transfer=float(peaks.release.energy_transfer),
        peak_strain=peaks.strain * strain_scale,
        peak_strain_time=peaks.strain_phase / engine.frequency,
        peak_strain_depth=peaks.strain_height * layer.thickness,
        peak_contact_strain=peaks.contact_strain * strain_scale,
        peak_acceleration=peaks.acceleration * speed_scale * engine.angular_frequency,
        peak_force=peaks.plate_force * speed_scale * layer.impedance,
        plate_work=peaks.plate_work * mass * speed_scale**2,
        kinetic_energy=0.5 * mass * speed**2,
    )


@dataclass(frozen=True, kw_only=True)
class Recommendation(Prediction):
    """
    What the recommended layer gives, and what it is to be compared with.

    Parameters
    ----------
    vary : {'thickness', 'wave_speed', 'both'}
        What was allowed to change.
    now : Prediction
        The rig as it is.
    by_thickness, by_wave_speed, by_both : Prediction
        The best layer if this may change; that for `vary` is the recommended one.
    optimum : Optimum
        The best ratios for the engine's damping, were there no limits.
    paper : Optimum
        The paper's ratios with the engine's damping.
    why : str
        What changes and what is gained, in a sentence.
    note : str
        What has to be known besides, about the paper's numbers and about gravity.

    """

    vary: Vary
    now: Prediction
    by_thickness: Prediction
    by_wave_speed: Prediction
    by_both: Prediction
    optimum: Optimum
    paper: Optimum
    why: str
    note: str

    @property
    def gain(self) -> float:
        """Part by which the energy of the projectile would grow. [-]"""
        return self.energy_transfer / self.now.energy_transfer - 1.0

    def values(self) -> dict[str, float | str]:
        """Return everything by name, with a dot between the name of a part and of its value."""
        flat: dict[str, float | str] = {}
        for item in fields(self):
            value = getattr(self, item.name)
            if isinstance(value, (Prediction, Optimum)):
                flat.update({f'{item.name}.{name}': part for name, part in vars(value).items()})
            else:
                flat[item.name] = value
        return flat


def recommend(
    rig: Rig,
    *,
    vary: Vary,
    thickness_min: float,
    thickness_max: float,
    wave_speed_min: float,
    wave_speed_max: float,
    objective: Literal['peak'] = 'peak',
) -> Recommendation:
    """
    Recommend the layer that throws the projectile fastest.

    All of the rig but thickness and wave speed of the layer stays, its density too: another wave
    speed is another modulus.

    Parameters
    ----------
    rig : Rig
        With the layer that it has now, without loss.
    vary : {'thickness', 'wave_speed', 'both'}
        What may change. All three are computed.
    thickness_min, thickness_max : float
        Between which the thickness may be. What may not change need not be within limits. [m]
    wave_speed_min, wave_speed_max : float
        Between which the wave speed may be. [m/s]
    objective : {'peak'}
        What is to be largest: the energy of one throw.

    Returns
    -------
    Recommendation
        The present layer if no other is better, and the thinner one of equals.

    Raises
    ------
    ValueError
        If a choice is unknown, limits are not positive and increasing, or the layer has loss.
    ThrowUnresolvedError
        If no throw with a layer within the limits can be computed, or none of the rig as it is:
        too many crossings, or gravity holds the projectile.

    Notes
    -----
    The energy transfer is not lower than the highest of a scan of 10^4 layers by more than 1e-3,
    in 10^3 random rigs and limits, except as said in `soft_throw_ros.design.search`, for strong
    gravity above all. All numbers returned but those of `Optimum` are with gravity.

    Examples
    --------
    >>> best = recommend(
    ...     Rig(), vary='thickness', thickness_min=1e-3, thickness_max=50e-3,
    ...     wave_speed_min=1.0, wave_speed_max=50.0,
    ... )
    >>> best.why
    'thickness 16.8 -> 13.41 mm: 5.4 % more energy (alpha 3.64 -> 3.83)'

    """
    _check_lossless(rig)
    if objective != 'peak':
        raise ValueError(f"objective must be 'peak', got {objective!r}")
    if vary not in get_args(Vary):
        raise ValueError(f'vary must be one of {", ".join(get_args(Vary))}, got {vary!r}')
    thickness = _checked_limits('thickness', thickness_min, thickness_max)
    wave_speed = _checked_limits('wave_speed', wave_speed_min, wave_speed_max)
    now = predict(rig)
    found: dict[str, Prediction] = {
        'thickness': _best(rig, now, thickness, None),
        'wave_speed': _best(rig, now, None, wave_speed),
        'both': _best(rig, now, thickness, wave_speed),
    }
    best = found[vary]
    optimum = best_ratios(rig.engine.damping_ratio)
    paper = _paper_ratios(rig.engine.damping_ratio)
    return Recommendation(
        **vars(best),
        vary=vary,
        now=now,
        by_thickness=found['thickness'],
        by_wave_speed=found['wave_speed'],
        by_both=found['both'],
        optimum=optimum,
        paper=paper,
        why=_why(now, best, vary, thickness, wave_speed),
        note=_note(optimum, paper, rig.gravity_ratio),
    )


def _checked_limits(name: str, low: float, high: float) -> Limits:
    """Return limits as floats, or raise ValueError."""
    low = checks.positive(f'{name}_min', low)
    high = checks.positive(f'{name}_max', high)
    if low >= high:
        raise ValueError(f'{name}_min must be below {name}_max, got {low:g} and {high:g}')
    return low, high


def _check_lossless(rig: Rig) -> None:
    """Raise ValueError if the layer has internal loss."""
    if rig.layer.loss_tangent > 0.0:
        raise ValueError(
            'layer.loss_tangent must be 0, got '
            f'{rig.layer.loss_tangent:g}: loss lowers the best energy transfer and moves it '
            'elsewhere, and the travelling-wave model has none'
        )


@functools.lru_cache(maxsize=64)
def _paper_ratios(damping_ratio: float) -> Optimum:
    mass_ratio, speed_ratio = PAPER_RATIOS
    return Optimum.at(mass_ratio=mass_ratio, speed_ratio=speed_ratio, damping_ratio=damping_ratio)


def _best(
    rig: Rig, now: Prediction, thickness: Limits | None, wave_speed: Limits | None
) -> Prediction:
    """Predict the best throw within limits; None for what may not change."""
    layer = rig.layer
    thickness = thickness or (layer.thickness, layer.thickness)
    wave_speed = wave_speed or (layer.wave_speed, layer.wave_speed)
    summit = find_summit(
        mass_ratio=rig.mass_ratio,
        speed_ratio=rig.speed_ratio,
        damping_ratio=rig.engine.damping_ratio,
        gravity_ratio=rig.gravity_ratio,
        thickness_factors=(thickness[0] / layer.thickness, thickness[1] / layer.thickness),
        wave_speed_factors=(wave_speed[0] / layer.wave_speed, wave_speed[1] / layer.wave_speed),
    )
    is_within = (
        thickness[0] <= layer.thickness <= thickness[1]
        and wave_speed[0] <= layer.wave_speed <= wave_speed[1]
    )
    if math.isnan(summit.speed):
        if is_within:
            return now
        raise ThrowUnresolvedError(
            f'no throw with a thickness from {thickness[0]:g} to {thickness[1]:g} m and a wave '
            f'speed from {wave_speed[0]:g} to {wave_speed[1]:g} m/s can be computed: the '
            'projectile stays on the layer for too many crossings, or gravity '
            f'({rig.gravity_ratio:.2g} of the largest acceleration of the plate) holds it'
        )
    best = predict(
        replace(
            rig,
            layer=replace(
                layer,
                thickness=_within(thickness, layer.thickness * summit.thickness_factor),
                wave_speed=_within(wave_speed, layer.wave_speed * summit.wave_speed_factor),
            ),
        )
    )
    if is_within and now.energy_transfer >= best.energy_transfer * (1.0 - _EQUAL):
        return now
    return best


def _within(limits: Limits, value: float) -> float:
    return min(max(value, limits[0]), limits[1])


def _why(
    now: Prediction, best: Prediction, vary: Vary, thickness: Limits, wave_speed: Limits
) -> str:
    """Say what changes and what that gives."""
    alpha = f'alpha {now.energy_transfer:.2f}'
    if best is now:
        return f'the layer as it is cannot be bettered within the limits ({alpha})'
    changes = []
    if vary != 'wave_speed':
        limit = _at_limit(best.thickness, thickness)
        changes.append(
            f'thickness {1e3 * now.thickness:.4g} -> {1e3 * best.thickness:.4g} mm{limit}'
        )
    if vary != 'thickness':
        limit = _at_limit(best.wave_speed, wave_speed)
        changes.append(
            f'wave speed {now.wave_speed:.4g} -> {best.wave_speed:.4g} m/s{limit}, that is '
            f'modulus {1e-3 * now.youngs_modulus:.4g} -> {1e-3 * best.youngs_modulus:.4g} kPa'
        )
    gain = best.energy_transfer / now.energy_transfer - 1.0
    percent = 100.0 * abs(gain)
    amount = f'{percent:.1f} %' if percent < 9.95 else f'{percent:.0f} %'
    if gain >= 1.0:
        words = f'{1.0 + gain:.3g} times the energy'
    elif percent < 0.05:
        words = 'practically the same energy'
    elif gain > 0.0:
        words = f'{amount} more energy'
    else:
        words = f'{amount} less energy, for the layer as it is exceeds the limits'
    return f'{" and ".join(changes)}: {words} ({alpha} -> {best.energy_transfer:.2f})'


def _at_limit(value: float, limits: Limits) -> str:
    """Say which limit a value has run into, if any."""
    for limit, name in zip(limits, ('smallest', 'largest'), strict=True):
        if math.isclose(value, limit, rel_tol=1e-4):
            return f' (the {name} allowed)'
    return ''


def _note(optimum: Optimum, paper: Optimum, gravity_ratio: float) -> str:
    """Say what has to be known besides."""
    note = (
        f'for a plate of damping {optimum.damping_ratio:g} the best is a projectile of '
        f'{optimum.mass_ratio:.3f} times the mass of the layer and c_s / (L_s f) = '
        f'{optimum.speed_ratio:.3f}, with alpha {optimum.energy_transfer:.3f}; '
        f'the paper says {paper.mass_ratio:g} and {paper.speed_ratio:g}, which mix two density '
        f'ratios and give {paper.energy_transfer:.3f}'
    )
    if gravity_ratio > _LARGE_GRAVITY:
        note += (
            f'; gravity is {gravity_ratio:.2g} of the largest acceleration of the plate, and '
            'throws that it holds back to a later swing of the plate were not looked for'
        )
    return note
