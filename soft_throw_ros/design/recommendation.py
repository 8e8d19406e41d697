# SPDX-License-Identifier: Apache-2.0
"""
Recommend a layer for a rig: the one that throws best, by the objective that is set.

What counts is the first release, for that is what can be relied on; see
`soft_throw_ros.design.search` for how it is looked for, and for how gravity counts.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
import contextlib
from dataclasses import dataclass, fields, replace
import functools
import math
from typing import get_args, Literal, NamedTuple, TypeAlias

import numpy as np
from soft_throw_ros.configuration.layers import Material
from soft_throw_ros.core import checks, normal_modes, peak
from soft_throw_ros.core.rig import Layer, Rig
from soft_throw_ros.core.travelling_wave import first_release, ThrowUnresolvedError
from soft_throw_ros.design.objective import Limits, Objective, Peak, problem_of, Robust
from soft_throw_ros.design.search import find_summit, LATEST, one_throw, Problem, score

Vary: TypeAlias = Literal['thickness', 'wave_speed', 'both', 'library']

PAPER_RATIOS = (0.32, 8.4)
"""What the paper quotes for the best mass and speed ratio. See `Optimum`. [-]"""

WITHIN = 0.05
"""Part of the best score that may be lost within a `Sensitivity`'s interval. [-]"""

TOLERATED = 0.02
"""Part that may be lost within its tolerance. [-]"""

Span: TypeAlias = tuple[float, float]

_EQUAL = 1e-9  # relative, in the energy transfer
_NEAR = 1e-3  # likewise; how near to what was found a layer must come ...
_BESIDE = (  # with thickness or wave speed, of which one may be at its limit, changed by this
    (0.0, 0.0),
    *(
        change
        for part in (1e-4, -1e-4, 5e-4, -5e-4, 2e-3, -2e-3)
        for change in ((0.0, part), (part, 0.0))
    ),
)
_LARGE_GRAVITY = 0.2  # of the plate's largest acceleration
_SLIGHT = 1e-4  # change of a parameter for its elasticity
_SMALL = 1e-3  # change of a parameter that ...
_DEAR = 0.01  # should not cost so much, else it is at an edge
_STEP = 0.01  # of the march to the ends of an interval, in logarithms, ...
_FARTHEST = math.log(2.0)  # and where it ends
_CANDIDATES = 8  # materials that are shown

UNITS = {
    'thickness': ('mm', 1e3),
    'wave_speed': ('m/s', 1.0),
    'mass': ('g', 1e3),
    'frequency': ('Hz', 1.0),
    'damping_ratio': ('', 1.0),
}
"""In which units people read the parameters of a `Sensitivity`, and how many make one in SI."""

_COLUMNS = {'mass': 0, 'frequency': 1, 'damping_ratio': 2, 'thickness': 3, 'wave_speed': 4}
"""Where in `Problem.throws` a parameter stands; the last two as what is added."""


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
    problem = Problem(
        mass_ratio=0.3,
        speed_ratio=10.0,
        gravity_ratio=0.0,
        loss_tangent=0.0,
        throws=one_throw(float(damping_ratio)),
    )
    summit = find_summit(
        problem,
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
    What a throw gives, with the rig's damping, gravity and loss, up to the first release.

    Parameters
    ----------
    thickness : float
        Of the layer, :math:`L_s`. [m]
    wave_speed : float
        Of the layer, :math:`c_s`. [m/s]
    density : float
        Of the layer, :math:`\rho_s`. [kg/m3]
    youngs_modulus : float
        Of the layer, :math:`\rho_s c_s^2`. [Pa]
    loss_tangent : float
        Of the layer. [-]
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
    density: float
    youngs_modulus: float
    loss_tangent: float
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
        With a layer of one material, with or without loss.

    Raises
    ------
    ValueError
        If the layer is graded.
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
    engine, layer, mass = rig.engine, rig.layer, rig.projectile.mass
    if not layer.is_uniform:
        raise ValueError(f'only layers of one material are predicted, got {layer!r}')
    ratios = {
        'mass_ratio': rig.mass_ratio,
        'speed_ratio': rig.speed_ratio,
        'damping_ratio': engine.damping_ratio,
        'gravity_ratio': rig.gravity_ratio,
    }
    if layer.loss_tangent > 0.0:
        peaks = normal_modes.first_peaks(**ratios, loss_tangent=layer.loss_tangent)
    else:
        peaks = peak.first_peaks(**ratios)
    speed_scale = engine.speed_scale
    strain_scale = speed_scale / layer.wave_speed
    speed = float(peaks.release.speed) * speed_scale
    return Prediction(
        thickness=layer.thickness,
        wave_speed=layer.wave_speed,
        density=layer.density,
        youngs_modulus=layer.youngs_modulus,
        loss_tangent=layer.loss_tangent,
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
class Sensitivity:
    r"""
    How much a parameter matters around the recommended layer, all others as they are.

    Parameters
    ----------
    name : {'thickness', 'wave_speed', 'mass', 'frequency', 'damping_ratio'}
        The parameter.
    value : float
        What it is.
    elasticity : float
        :math:`d \ln \alpha / d \ln` of the parameter, for the score. [-]
    low, high : float
        Between these at most `WITHIN` of the score is lost; looked for from half to twice `value`.
    tolerance : float
        What it may be off, up or down, for at most `TOLERATED` to be lost.
    edge : {'', 'less', 'more'}
        On which side, if any, the energy falls off at once.

    """

    name: str
    value: float
    elasticity: float
    low: float
    high: float
    tolerance: float
    edge: str

    @property
    def deviation(self) -> str:
        """The tolerance with its unit."""
        unit, scale = UNITS[self.name]
        return f'{scale * self.tolerance:.2g} {unit}'.rstrip()


@dataclass(frozen=True, kw_only=True)
class Candidate:
    """
    A layer from the library, and how good it would be.

    Parameters
    ----------
    layer : str
        Its name, for `layer.name`.
    thickness : float
        [m]
    score : float
        What it is ranked by. [-]

    """

    layer: str
    thickness: float
    score: float


@dataclass(frozen=True, kw_only=True)
class Recommendation(Prediction):
    """
    What the recommended layer gives, and what it is to be compared with.

    Parameters
    ----------
    rig : Rig
        The rig with the recommended layer.
    objective : str
        What was looked for.
    vary : {'thickness', 'wave_speed', 'both', 'library'}
        What was allowed to change.
    layer : str
        Name of the recommended layer in the library, if it was picked there.
    score : float
        The energy transfer that counts for the objective. [-]
    now : Prediction or None
        The rig as it is; None if it does not throw.
    now_score : float
        Its score, 0 if it does not throw. [-]
    by_thickness, by_wave_speed, by_both : Prediction or None
        The best layer if this may change; None if nothing is thrown within the limits, or if it
        was not looked for: another objective than the peak takes its time.
    candidates : tuple of Candidate
        Layers of the library that came near, if one was to be picked; the best first.
    sensitivities : tuple of Sensitivity
        How much the parameters matter around the recommended layer.
    optimum : Optimum
        The best ratios for the engine's damping, were there no limits and no loss.
    paper : Optimum
        The paper's ratios with the engine's damping.
    why : str
        What changes and what is gained, in a sentence.
    note : str
        What has to be known besides, about the paper's numbers, loss and gravity.

    """

    rig: Rig
    objective: str
    vary: Vary
    layer: str
    score: float
    now: Prediction | None
    now_score: float
    by_thickness: Prediction | None = None
    by_wave_speed: Prediction | None = None
    by_both: Prediction | None = None
    candidates: tuple[Candidate, ...]
    sensitivities: tuple[Sensitivity, ...]
    optimum: Optimum
    paper: Optimum
    why: str
    note: str

    @property
    def gain(self) -> float:
        """Part by which the score would grow, infinite if there is none now. [-]"""
        return self.score / self.now_score - 1.0 if self.now_score > 0.0 else math.inf

    def values(self) -> dict[str, float | str]:
        """Return everything by name, with a dot between the name of a part and of its value."""
        flat: dict[str, float | str] = {}
        for item in fields(self):
            value = getattr(self, item.name)
            if isinstance(value, (Prediction, Optimum)):
                flat.update({f'{item.name}.{name}': part for name, part in vars(value).items()})
            elif item.name == 'sensitivities':
                for part in value:
                    flat.update({
                        f'{part.name}.{name}': getattr(part, name)
                        for name in ('elasticity', 'low', 'high', 'tolerance', 'edge')
                    })  # fmt: skip
            elif item.name == 'candidates':
                flat.update({f'candidate.{part.layer}': part.score for part in value})
            elif item.name != 'rig' and value is not None:
                flat[item.name] = value
        return flat


@dataclass(frozen=True, kw_only=True)
class _Choice:
    """A layer to choose, as part of the rig."""

    rig: Rig
    prediction: Prediction
    score: float
    layer: str


def recommend(
    rig: Rig,
    *,
    vary: Vary = 'both',
    objective: Objective | None = None,
    limits: Limits | None = None,
    materials: Mapping[str, Material] | None = None,
) -> Recommendation:
    """
    Recommend the layer that throws best.

    All of the rig but the layer stays. Of the layer thickness and wave speed may change, its
    density and loss tangent not: another wave speed is another modulus. Or all of it is picked
    from a library.

    Parameters
    ----------
    rig : Rig
        With the layer that it has now.
    vary : {'thickness', 'wave_speed', 'both', 'library'}
        What may change.
    objective : Peak, Robust or Versatile, optional
        What is to be largest; the energy of the throw if not given.
    limits : Limits, optional
        What must not be exceeded. What may not change need not be within.
    materials : mapping of str to Material, optional
        From which one is picked, if `vary` is 'library'.

    Returns
    -------
    Recommendation
        The present layer if no other is better, and the thinner one of equals.

    Raises
    ------
    ValueError
        If a choice is unknown, the layer is graded, or an uncertainty is as large as what is
        uncertain.
    ThrowUnresolvedError
        If no throw with a layer within the limits can be computed: too many crossings, gravity
        holds the projectile, or every layer exceeds strain or acceleration.

    Notes
    -----
    The score is not lower than the highest of a scan of 10^4 layers by more than 1e-3, in 10^3
    random rigs and limits, except as said in `soft_throw_ros.design.search`. The same holds under
    strong gravity, of 0.1 to 3.5 times the plate's largest acceleration: seen against scans of
    3600 to 6400 layers in 115 random rigs, and of 400 to 900 for all objectives, and with a loss
    tangent of 0.08, in 60. All numbers returned but those of `Optimum` are with gravity and loss.

    Examples
    --------
    >>> best = recommend(Rig(), vary='thickness')
    >>> best.why
    'thickness 16.8 -> 13.4 mm: 5.4 % more energy (alpha 3.64 -> 3.83); +-2.1 mm costs 2 %'

    """
    objective, limits = objective or Peak(), limits or Limits()
    if vary not in get_args(Vary):
        raise ValueError(f'vary must be one of {", ".join(get_args(Vary))}, got {vary!r}')
    if type(rig.layer) is not Layer:  # a graded one is a kind of it
        raise ValueError(f'only layers of one material are recommended, got {rig.layer!r}')
    spans = {
        'thickness': (limits.thickness, None),
        'wave_speed': (None, limits.wave_speed),
        'both': (limits.thickness, limits.wave_speed),
    }
    found = {
        name: _best(rig, objective, limits, *span)
        for name, span in spans.items()
        if isinstance(objective, Peak) or name == vary
    }
    picked = _pick(rig, objective, limits, materials or {}) if vary == 'library' else []
    best = (picked[0] if picked else None) if vary == 'library' else found[vary]
    if best is None:
        raise ThrowUnresolvedError(_why_none(rig, vary, objective, limits, materials or {}))
    now = _choice(rig, objective, limits)
    optimum = best_ratios(rig.engine.damping_ratio)
    paper = _paper_ratios(rig.engine.damping_ratio)
    sensitivities = tuple(_sensitivities(best.rig, problem_of(best.rig, objective, limits)))
    return Recommendation(
        **vars(best.prediction),
        rig=best.rig,
        objective=objective.name,
        vary=vary,
        layer=best.layer,
        score=best.score,
        now=_prediction(now),
        now_score=0.0 if now is None else now.score,
        by_thickness=_prediction(found.get('thickness')),
        by_wave_speed=_prediction(found.get('wave_speed')),
        by_both=_prediction(found.get('both')),
        candidates=tuple(
            Candidate(
                layer=choice.layer, thickness=choice.prediction.thickness, score=choice.score
            )
            for choice in picked[:_CANDIDATES]
        ),
        sensitivities=sensitivities,
        optimum=optimum,
        paper=paper,
        why=_why(rig, now, best, vary, objective, limits, sensitivities),
        note=_note(best.rig, optimum, paper),
    )


@functools.lru_cache(maxsize=64)
def _paper_ratios(damping_ratio: float) -> Optimum:
    mass_ratio, speed_ratio = PAPER_RATIOS
    return Optimum.at(mass_ratio=mass_ratio, speed_ratio=speed_ratio, damping_ratio=damping_ratio)


def _prediction(choice: _Choice | None) -> Prediction | None:
    return None if choice is None else choice.prediction


def _choice(rig: Rig, objective: Objective, limits: Limits, *, layer: str = '') -> _Choice | None:
    """Predict the throw of a rig and compute its score; None if there is no throw."""
    try:
        prediction = predict(rig)
    except ThrowUnresolvedError:
        return None
    if isinstance(objective, Peak):
        transfer = prediction.energy_transfer
    else:
        transfer = max(score(problem_of(rig, objective, limits)), 0.0) ** 2
    return _Choice(rig=rig, prediction=prediction, score=transfer, layer=layer)


def _best(
    rig: Rig,
    objective: Objective,
    limits: Limits,
    thickness: Span | None,
    wave_speed: Span | None,
    *,
    layer: str = '',
) -> _Choice | None:
    """Choose the best layer within limits, None for what may not change; None if there is none."""
    given = rig.layer
    thickness = thickness or (given.thickness, given.thickness)
    wave_speed = wave_speed or (given.wave_speed, given.wave_speed)
    problem = problem_of(rig, objective, limits)
    is_within = (
        thickness[0] <= given.thickness <= thickness[1]
        and wave_speed[0] <= given.wave_speed <= wave_speed[1]
        and not math.isnan(find_summit(problem).score)
    )
    now = _choice(rig, objective, limits, layer=layer) if is_within else None
    summit = find_summit(
        problem,
        thickness_factors=(thickness[0] / given.thickness, thickness[1] / given.thickness),
        wave_speed_factors=(wave_speed[0] / given.wave_speed, wave_speed[1] / given.wave_speed),
    )
    if math.isnan(summit.score):
        return now
    found: list[_Choice] = []
    for thicker, faster in _BESIDE:
        # the edge of a cliff, which a search by steps sees in a slightly other place
        place = replace(
            given,
            thickness=_within(
                thickness, given.thickness * summit.thickness_factor * (1.0 + thicker)
            ),
            wave_speed=_within(
                wave_speed, given.wave_speed * summit.wave_speed_factor * (1.0 + faster)
            ),
        )
        choice = _choice(replace(rig, layer=place), objective, limits, layer=layer)
        if choice is not None:
            found.append(choice)
            if choice.score >= (1.0 - _NEAR) * summit.score**2:
                break
    best = max(found, key=lambda choice: choice.score, default=None)
    if now is not None and (best is None or now.score >= best.score * (1.0 - _EQUAL)):
        return now
    return best


def _within(limits: Span, value: float) -> float:
    return min(max(value, limits[0]), limits[1])


def _pick(
    rig: Rig, objective: Objective, limits: Limits, materials: Mapping[str, Material]
) -> list[_Choice]:
    """
    Rank the layers of a library, the best first.

    Nothing is better than without limits of the loads, or than with nothing uncertain; that is
    quickly known, and where it is not what is asked, what can be no better than the best so far
    is left out.
    """
    bound_objective = Peak() if isinstance(objective, Robust) else objective
    bound_limits = replace(limits, max_strain=math.inf, max_acceleration=math.inf)
    bounded: list[tuple[_Choice, Place]] = []
    for place in places(rig, limits, materials):
        choice = _best(
            place.rig, bound_objective, bound_limits, place.thickness, None, layer=place.layer
        )
        if choice is not None:
            bounded.append((choice, place))
    bounded.sort(key=lambda item: -item[0].score)
    if (bound_objective, bound_limits) == (objective, limits):
        return [choice for choice, _ in bounded]
    found: list[_Choice] = []
    for bound, place in bounded:
        if found and bound.score <= max(choice.score for choice in found):
            break
        aim = objective
        if isinstance(objective, Robust):
            spread = max(objective.uncertainties.wave_speed, place.spread)
            uncertainties = replace(objective.uncertainties, wave_speed=spread)
            aim = replace(objective, uncertainties=uncertainties)
        choice = _best(place.rig, aim, limits, place.thickness, None, layer=place.layer)
        if choice is not None:
            found.append(choice)
    return sorted(found, key=lambda choice: -choice.score)


class Place(NamedTuple):
    """A layer of the library: its name, the rig with it, what may vary, and how sure it is."""

    layer: str
    rig: Rig
    thickness: Span | None
    spread: float  # of the wave speed, up or down


def places(rig: Rig, limits: Limits, materials: Mapping[str, Material]) -> Iterator[Place]:
    """Yield the layers of a library that are within the limits."""
    for material in materials.values():
        speed = material.wave_speed
        if (
            material.loss_tangent.value > limits.max_loss_tangent
            or not limits.wave_speed_min <= speed.value <= limits.wave_speed_max
        ):
            continue
        layer = replace(
            rig.layer,
            wave_speed=speed.value,
            density=material.density.value,
            loss_tangent=material.loss_tangent.value,
            diameter=material.diameter or rig.layer.diameter,
        )
        spread = 0.5 * (speed.high - speed.low)
        for thickness in material.thicknesses:
            if limits.thickness_min <= thickness <= limits.thickness_max:
                place = replace(rig, layer=replace(layer, thickness=thickness))
                yield Place(material.layer_name(thickness), place, None, spread)
        if not material.thicknesses:
            yield Place(material.name, replace(rig, layer=layer), limits.thickness, spread)


def _sensitivities(rig: Rig, problem: Problem) -> Iterator[Sensitivity]:
    """Find out how much each parameter matters for the score of the rig's layer."""
    values = {
        'thickness': rig.layer.thickness,
        'wave_speed': rig.layer.wave_speed,
        'mass': rig.projectile.mass,
        'frequency': rig.engine.frequency,
        'damping_ratio': rig.engine.damping_ratio,
    }
    best = score(problem) ** 2

    def part(name: str, change: float) -> float:
        """Compute the score after a change, in logarithms, over what it was."""
        throws = problem.throws.copy()
        column, factor = _COLUMNS[name], math.exp(change)
        if name in ('thickness', 'wave_speed'):
            throws[:, column] += factor - 1.0
        else:
            throws[:, column] *= factor
        throws[:, 2] = np.minimum(throws[:, 2], 0.999)
        return max(score(problem._replace(throws=throws)), 0.0) ** 2 / best

    def reach(name: str, sign: float) -> tuple[float, float]:
        """Find how far a parameter may change, one way, until TOLERATED and WITHIN are lost."""
        ends: list[float] = []
        good = 0.0
        for lost in (TOLERATED, WITHIN):
            bad = good
            while bad <= good < _FARTHEST:
                bad = min(good + _STEP, _FARTHEST)
                if part(name, sign * bad) >= 1.0 - lost:
                    good = bad
            while bad - good > 1e-5:
                middle = 0.5 * (good + bad)
                if part(name, sign * middle) >= 1.0 - lost:
                    good = middle
                else:
                    bad = middle
            ends.append(good)
        return ends[0], ends[1]

    for name, value in values.items():
        if value > 0.0:
            less, more = part(name, -_SMALL), part(name, _SMALL)
            down, up = reach(name, -1.0), reach(name, 1.0)
            yield Sensitivity(
                name=name,
                value=value,
                elasticity=(part(name, _SLIGHT) - part(name, -_SLIGHT)) / (2.0 * _SLIGHT),
                low=value * math.exp(-down[1]),
                high=value * math.exp(up[1]),
                tolerance=value * min(1.0 - math.exp(-down[0]), math.exp(up[0]) - 1.0),
                edge='less' if less < 1.0 - _DEAR else 'more' if more < 1.0 - _DEAR else '',
            )


def _why_none(
    rig: Rig,
    vary: Vary,
    objective: Objective,
    limits: Limits,
    materials: Mapping[str, Material],
) -> str:
    """Say why nothing can be recommended."""
    low, high = limits.thickness if vary != 'wave_speed' else (rig.layer.thickness,) * 2
    slow, fast = limits.wave_speed if vary != 'thickness' else (rig.layer.wave_speed,) * 2
    text = f'a thickness from {low:g} to {high:g} m and a wave speed from {slow:g} to {fast:g} m/s'
    if vary == 'library':
        text += ' from the library'
        if limits.max_loss_tangent < math.inf:
            text += f' and a loss tangent of at most {limits.max_loss_tangent:g}'
    free = replace(limits, max_strain=math.inf, max_acceleration=math.inf)
    if free != limits:
        with contextlib.suppress(ThrowUnresolvedError):
            best = recommend(rig, vary=vary, objective=objective, limits=free, materials=materials)
            return (
                f'no layer with {text} keeps a strain of at most {limits.max_strain:g} and an '
                f'acceleration of at most {limits.max_acceleration:g} m/s2; the best without '
                f'these limits has {best.peak_strain:.3g} and {best.peak_acceleration:.4g} m/s2'
            )
    return (
        f'no throw with {text} can be computed: the projectile stays on the layer for too many '
        f'crossings, or gravity ({rig.gravity_ratio:.2g} of the largest acceleration of the '
        'plate) holds it'
    )


def _why(
    rig: Rig,
    now: _Choice | None,
    best: _Choice,
    vary: Vary,
    objective: Objective,
    limits: Limits,
    sensitivities: tuple[Sensitivity, ...],
) -> str:
    """Say what changes, what that gives, and how exactly it has to be met."""
    words = objective.words
    if best.rig.layer == rig.layer:
        text = (
            f'the layer as it is cannot be bettered within the limits ({words} {best.score:.2f})'
        )
    else:
        before = f'{now.score:.2f}' if now else 'nothing'
        gain = _gain_in_words(now.score if now else 0.0, best.score, vary)
        changes = ' and '.join(_changes(rig, best, vary, limits))
        text = f'{changes}: {gain} ({words} {before} -> {best.score:.2f})'
    names = ('thickness', 'wave_speed') if vary == 'both' else (vary,)
    names = ('thickness',) if vary == 'library' else names
    parts = [item for item in sensitivities if item.name in names]
    within = ' or '.join(f'+-{item.deviation}' for item in parts if not item.edge)
    text += f'; {within} costs {100.0 * TOLERATED:g} %' if within else ''
    for item in parts:
        if item.edge:
            text += f'; a little {item.edge} {item.name.replace("_", " ")} falls off an edge'
    return text


def _changes(rig: Rig, best: _Choice, vary: Vary, limits: Limits) -> Iterator[str]:
    """Name what changes, with what it was and will be."""
    old, new = rig.layer, best.rig.layer
    if best.layer:
        yield f'layer {best.layer}'
    if vary != 'wave_speed':
        limit = _at_limit(new.thickness, limits.thickness)
        yield f'thickness {1e3 * old.thickness:.4g} -> {1e3 * new.thickness:.4g} mm{limit}'
    if vary in ('wave_speed', 'both'):
        limit = _at_limit(new.wave_speed, limits.wave_speed)
        yield (
            f'wave speed {old.wave_speed:.4g} -> {new.wave_speed:.4g} m/s{limit}, that is '
            f'modulus {1e-3 * old.youngs_modulus:.4g} -> {1e-3 * new.youngs_modulus:.4g} kPa'
        )


def _gain_in_words(before: float, after: float, vary: Vary) -> str:
    if before <= 0.0:
        return 'as it is, the layer throws nothing'
    gain = after / before - 1.0
    percent = 100.0 * abs(gain)
    amount = f'{percent:.1f} %' if percent < 9.95 else f'{percent:.0f} %'
    if gain >= 1.0:
        return f'{1.0 + gain:.3g} times the energy'
    if percent < 0.05:
        return 'practically the same energy'
    if gain > 0.0:
        return f'{amount} more energy'
    if vary == 'library':
        return f'{amount} less energy, for the layer as it is is not to be had within the limits'
    return f'{amount} less energy, for the layer as it is exceeds the limits'


def _at_limit(value: float, limits: Span) -> str:
    """Say which limit a value has run into, if any."""
    for limit, name in zip(limits, ('smallest', 'largest'), strict=True):
        if math.isclose(value, limit, rel_tol=1e-4):
            return f' (the {name} allowed)'
    return ''


def _note(rig: Rig, optimum: Optimum, paper: Optimum) -> str:
    """Say what has to be known besides."""
    note = (
        f'for a plate of damping {optimum.damping_ratio:g} the best is a projectile of '
        f'{optimum.mass_ratio:.3f} times the mass of the layer and c_s / (L_s f) = '
        f'{optimum.speed_ratio:.3f}, with alpha {optimum.energy_transfer:.3f}; '
        f'the paper says {paper.mass_ratio:g} and {paper.speed_ratio:g}, which mix two density '
        f'ratios and give {paper.energy_transfer:.3f}'
    )
    if rig.layer.loss_tangent > 0.0:
        note += (
            f'; these are without loss, whereas the loss tangent of {rig.layer.loss_tangent:g} '
            'counts in what is recommended'
        )
    if rig.gravity_ratio > _LARGE_GRAVITY:
        note += (
            f'; gravity is {rig.gravity_ratio:.2g} of the largest acceleration of the plate, so '
            f'that later swings throw as well: {LATEST:g} periods are waited for'
        )
    return note
