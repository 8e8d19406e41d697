# SPDX-License-Identifier: Apache-2.0
"""
Recommend a layer for a rig: the one that throws best, by the objective that is set.

What counts is the first release, for that is what can be relied on. See
`soft_throw_ros.design.optimise` for how the layer is looked for.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
import contextlib
from dataclasses import dataclass, replace
import functools
import math
from typing import get_args, Literal, NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray
from soft_throw_ros.configuration.layers import Material
from soft_throw_ros.core import checks
from soft_throw_ros.core.closed_form import first_release, ThrowUnresolvedError
from soft_throw_ros.core.rig import Engine, Layer, Projectile, Rig
from soft_throw_ros.design import texts
from soft_throw_ros.design.evaluate import Cancelled, first_throws, require_uniform, SEARCH_CELLS
from soft_throw_ros.design.objective import LayerScore, Limits, Objective, Peak, Robust, Versatile
from soft_throw_ros.design.optimise import find_best_layer, LayerRange, Optimum
from soft_throw_ros.design.search_space import Candidate, search_spaces, SearchSpace
from soft_throw_ros.design.uncertainty import Variants

Floats = NDArray[np.float64]

Vary: TypeAlias = Literal['thickness', 'wave_speed', 'both', 'library']

PAPER_RATIOS = (0.32, 8.4)
"""What the paper quotes for the best mass and speed ratio. See `BestRatios`. [-]"""

WITHIN = 0.05
"""Part of the best score that may be lost within a `Sensitivity`'s interval. [-]"""

TOLERATED = 0.02
"""Part that may be lost within its tolerance. [-]"""

_EQUAL = 1e-9  # relative; of scores so close the present layer is kept
_DRAFT_ERROR = 2e-3  # relative, of scores with `SEARCH_CELLS`; what is worse is searched again ...
_NEARBY = 0.03  # within this part of thickness and wave speed
_SLIGHT = 1e-4  # change of a parameter for its elasticity
_SMALL = 1e-3  # change of a parameter that ...
_AT_EDGE = 0.01  # costs more than this part only at an edge
_FARTHEST = math.log(2.0)  # where the interval of a sensitivity ends
_HALVINGS = 8  # of a step, to find an interval's end
_MAX_CANDIDATES = 8  # materials that are shown

UNITS = {
    'thickness': ('mm', 1e3),
    'wave_speed': ('m/s', 1.0),
    'mass': ('g', 1e3),
    'frequency': ('Hz', 1.0),
    'damping_ratio': ('', 1.0),
}
"""In which units people read the parameters of a `Sensitivity`, and how many make one in SI."""


@dataclass(frozen=True, kw_only=True)
class BestRatios:
    r"""
    Mass and speed ratio, and what they give without gravity and loss.

    Parameters
    ----------
    damping_ratio : float
        Of the plate, :math:`\zeta`. [-]
    mass_ratio, speed_ratio : float
        :math:`\mu = m / (\rho_s S L_s)` and :math:`\kappa = c_s / (L_s f)`. [-]
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
    def at(cls, *, mass_ratio: float, speed_ratio: float, damping_ratio: float) -> BestRatios:
        """Find out what given ratios give."""
        ratios = {
            'mass_ratio': mass_ratio,
            'speed_ratio': speed_ratio,
            'damping_ratio': damping_ratio,
        }
        release = first_release(**ratios)
        return cls(
            **ratios,
            ejection_phase=float(release.ejection_phase),
            energy_transfer=float(release.energy_transfer),
        )


@functools.lru_cache(maxsize=64)
def best_ratios(damping_ratio: float) -> BestRatios:
    r"""
    Find the mass and speed ratio that transfer the most energy, were there no limits.

    Parameters
    ----------
    damping_ratio : float
        Of the plate, :math:`\zeta`. [-]

    Returns
    -------
    BestRatios
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
    checks.require_in_unit_interval('damping_ratio', damping_ratio)
    # a rig whose layer has these very ratios for thickness and wave speed
    rig = Rig(
        engine=Engine(frequency=1.0, amplitude=1.0, damping_ratio=float(damping_ratio)),
        layer=Layer(thickness=1.0, wave_speed=1.0, density=1.0, diameter=2.0 / math.sqrt(math.pi)),
        projectile=Projectile(mass=1.0),
        gravity=0.0,
    )
    layers = LayerRange(thickness=(1.5, 6.0), wave_speed=(15.0, 75.0))
    best = find_best_layer(LayerScore(rig, Peak()), layers, step=0.06, tolerance=1e-7)
    assert best is not None  # without gravity every layer throws
    return BestRatios.at(
        mass_ratio=1.0 / best.thickness,
        speed_ratio=best.wave_speed / best.thickness,
        damping_ratio=float(damping_ratio),
    )


@dataclass(frozen=True, kw_only=True)
class PredictedThrow:
    r"""
    What a throw gives, with the rig's damping, gravity and loss, up to the first release.

    Parameters
    ----------
    thickness, wave_speed, density, youngs_modulus, loss_tangent : float
        Of the layer: :math:`L_s` [m], :math:`c_s` [m/s], :math:`\rho_s` [kg/m3], [Pa], [-].
    mass_ratio, speed_ratio : float
        :math:`\mu` and :math:`\kappa = c_s / (L_s f)`. [-]
    ejection_time, ejection_speed : float
        :math:`t_e` [s] and :math:`V_e` [m/s].
    energy_transfer : float
        :math:`\alpha = (V_e / V_p^*)^2`. [-]
    peak_strain : float
        Largest magnitude of the strain anywhere in the layer. [-]
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
    peak_acceleration: float
    peak_force: float
    plate_work: float
    kinetic_energy: float


def predict(rig: Rig) -> PredictedThrow:
    """
    Predict one throw of a rig.

    Parameters
    ----------
    rig : Rig
        With a layer of one material, with or without loss.

    Raises
    ------
    ValueError
        If the layer is not of one material.
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
    engine, layer, mass = rig.engine, require_uniform(rig).layer, rig.projectile.mass
    ratios, _ = Variants.of(rig).ratios(rig, layer.thickness, layer.wave_speed)
    throws = first_throws(ratios, loads=True)
    phase, speed, transfer, strain, acceleration, force, work = (
        float(values[0]) for values in throws
    )
    if not speed > 0.0:
        raise ThrowUnresolvedError(
            f'the projectile does not leave: mass ratio {rig.mass_ratio:g}, speed ratio '
            f'{rig.speed_ratio:g}, gravity {rig.gravity_ratio:g} of the largest acceleration'
        )
    speed_scale = engine.speed_scale
    return PredictedThrow(
        thickness=layer.thickness,
        wave_speed=layer.wave_speed,
        density=layer.density,
        youngs_modulus=layer.youngs_modulus,
        loss_tangent=layer.loss_tangent,
        mass_ratio=rig.mass_ratio,
        speed_ratio=rig.speed_ratio,
        ejection_time=phase / engine.frequency,
        ejection_speed=speed * speed_scale,
        energy_transfer=transfer,
        peak_strain=strain * speed_scale / layer.wave_speed,
        peak_acceleration=acceleration * speed_scale * engine.angular_frequency,
        peak_force=force * speed_scale * layer.impedance,
        plate_work=work * mass * speed_scale**2,
        kinetic_energy=0.5 * mass * (speed * speed_scale) ** 2,
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
    edge : {'', 'less', 'more', 'less or more'}
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
class LibraryCandidate:
    """A layer from the library by its name, its thickness [m], and what it is ranked by [-]."""

    layer: str
    thickness: float
    score: float


@dataclass(frozen=True, kw_only=True)
class Recommendation(PredictedThrow):
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
    now : PredictedThrow or None
        The rig as it is; None if it does not throw.
    now_score : float
        Its score, 0 if it does not throw. [-]
    by_thickness, by_wave_speed, by_both : PredictedThrow or None
        The best layer if this may change; None if nothing is thrown within the limits, or if it
        was not looked for: another objective than the peak takes its time.
    candidates : tuple of LibraryCandidate
        Layers of the library that came near, if one was to be picked; the best first.
    sensitivities : tuple of Sensitivity
        How much the parameters matter around the recommended layer.
    optimum, paper : BestRatios
        For the engine's damping the best ratios, were there no limits and no loss, and the
        paper's.
    summary : str
        What changes and what is gained, in a sentence.
    remarks : str
        What has to be known besides, about the paper's numbers, loss, gravity and large strain.

    """

    rig: Rig
    objective: str
    vary: Vary
    layer: str
    score: float
    now: PredictedThrow | None
    now_score: float
    by_thickness: PredictedThrow | None = None
    by_wave_speed: PredictedThrow | None = None
    by_both: PredictedThrow | None = None
    candidates: tuple[LibraryCandidate, ...]
    sensitivities: tuple[Sensitivity, ...]
    optimum: BestRatios
    paper: BestRatios
    summary: str = ''
    remarks: str = ''

    @property
    def gain(self) -> float:
        """Part by which the score would grow, infinite if there is none now. [-]"""
        return self.score / self.now_score - 1.0 if self.now_score > 0.0 else math.inf

    def values(self) -> dict[str, float | str]:
        """Return everything by name, with a dot between the name of a part and of its value."""
        flat: dict[str, float | str] = {}
        for name, value in vars(self).items():
            if isinstance(value, (PredictedThrow, BestRatios)):
                flat.update({f'{name}.{part}': each for part, each in vars(value).items()})
            elif isinstance(value, (float, str)):
                flat[name] = value
        for item in self.sensitivities:
            for name in ('elasticity', 'low', 'high', 'tolerance', 'edge'):
                flat[f'{item.name}.{name}'] = getattr(item, name)
        return {**flat, **{f'candidate.{item.layer}': item.score for item in self.candidates}}


def recommend(
    rig: Rig,
    *,
    vary: Vary = 'both',
    objective: Objective | None = None,
    limits: Limits | None = None,
    materials: Mapping[str, Material] | None = None,
    cancelled: Cancelled | None = None,
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
    cancelled : callable, optional
        Asked between batches of throws, some tenths of a second each, whether to give up.

    Returns
    -------
    Recommendation
        The present layer if no other is better, and the thinner one of equals.

    Raises
    ------
    ValueError
        If a choice is unknown, the layer is not of one material, or an uncertainty is as large as
        what is uncertain.
    ThrowUnresolvedError
        If no throw with a layer within the limits can be computed: too many crossings, gravity
        holds the projectile, or every layer exceeds strain or acceleration.
    SearchCancelledError
        If `cancelled` says so.

    Notes
    -----
    The score is within 0.5 % of the best, as seen in random rigs, objectives and limits beside
    fine grids; except as said in `soft_throw_ros.design.optimise`. All numbers returned but those
    of `BestRatios` are with gravity and loss.

    Examples
    --------
    >>> best = recommend(Rig(), vary='thickness')
    >>> best.summary
    'thickness 16.8 -> 13.41 mm: 5.4 % more energy (alpha 3.64 -> 3.83); +-2.1 mm costs 2 %'

    """
    if vary not in get_args(Vary):
        raise ValueError(f'vary must be one of {", ".join(get_args(Vary))}, got {vary!r}')
    search = _Search(objective or Peak(), limits or Limits(), cancelled)
    found: dict[str, Candidate] = {}
    for name in ('thickness', 'wave_speed', 'both'):
        if isinstance(search.objective, Peak) or name == vary:
            (space,) = search_spaces(rig, name, search.limits, {})
            best = search.run(space, starts=tuple(each.rig.layer for each in found.values()))
            if best is not None:
                found[name] = best
    picked: list[Candidate] = []
    if vary == 'library':
        spaces = search_spaces(rig, vary, search.limits, materials or {})
        picked = [each for space in spaces if (each := search.run(space)) is not None]
        picked.sort(key=lambda each: -each.score)
    best = found.get(vary) if vary != 'library' else next(iter(picked), None)
    if best is None:
        free = replace(search.limits, max_strain=math.inf, max_acceleration=math.inf)
        easier: Recommendation | None = None
        if free != search.limits:
            with contextlib.suppress(ThrowUnresolvedError):
                easier = recommend(
                    rig, vary=vary, objective=objective, limits=free, materials=materials,
                    cancelled=cancelled,
                )  # fmt: skip
        raise ThrowUnresolvedError(texts.why_nothing(rig, vary, search.limits, easier))
    of_space = search.objective_for(best.spread)
    score_now = LayerScore(rig, search.objective, cancelled=cancelled)
    now = float(score_now(rig.layer.thickness, rig.layer.wave_speed)[0])
    by = {name: predict(each.rig) for name, each in found.items()}
    damping_ratio = rig.engine.damping_ratio
    answer = Recommendation(
        **vars(predict(best.rig)),
        rig=best.rig,
        objective=search.objective.name,
        vary=vary,
        layer=best.layer,
        score=best.score,
        now=predict(rig) if now > 0.0 else None,
        now_score=now,
        by_thickness=by.get('thickness'),
        by_wave_speed=by.get('wave_speed'),
        by_both=by.get('both'),
        candidates=tuple(
            LibraryCandidate(
                layer=each.layer, thickness=each.rig.layer.thickness, score=each.score
            )
            for each in picked[:_MAX_CANDIDATES]
        ),
        sensitivities=tuple(_sensitivities(best.rig, of_space, cancelled)),
        optimum=best_ratios(damping_ratio),
        paper=BestRatios.at(
            mass_ratio=PAPER_RATIOS[0], speed_ratio=PAPER_RATIOS[1], damping_ratio=damping_ratio
        ),
    )
    summary = texts.summary_of(
        answer, rig.layer, search.limits,
        score_name=search.objective.summary, tolerated=TOLERATED,
    )  # fmt: skip
    return replace(answer, summary=summary, remarks=texts.remarks_of(answer))


class _Search(NamedTuple):
    """What is looked for."""

    objective: Objective
    limits: Limits
    cancelled: Cancelled | None

    def objective_for(self, spread: float) -> Objective:
        """Return the objective for a material whose wave speed may be off so far. [m/s]"""
        objective = self.objective
        if isinstance(objective, Robust) and spread > objective.uncertainties.wave_speed:
            uncertainties = replace(objective.uncertainties, wave_speed=spread)
            return replace(objective, uncertainties=uncertainties)
        return objective

    def run(self, space: SearchSpace, *, starts: tuple[Layer, ...] = ()) -> Candidate | None:
        """Find the best layer of a space, which is that of its rig if no other is better."""
        objective, present = self.objective_for(space.spread), space.rig.layer
        has_loss = present.loss_tangent > 0.0
        exact = LayerScore(space.rig, objective, self.limits, cancelled=self.cancelled)
        draft = exact
        if has_loss:
            draft = LayerScore(
                space.rig, objective, self.limits, cells=SEARCH_CELLS, cancelled=self.cancelled
            )
        known = [
            (layer.thickness, layer.wave_speed)
            for layer in (present, *starts)
            if space.layers.contains(layer.thickness, layer.wave_speed)
        ]
        slowest = min(objective.frequencies) if isinstance(objective, Versatile) else None
        best = find_best_layer(
            draft,
            space.layers,
            step=space.grid_step(slowest),
            starts=tuple(Optimum(*layer, float(draft(*layer)[0])) for layer in known),
            tolerance=5e-4 if has_loss else 1e-5,
        )
        if best is not None and has_loss:
            best = _refine(exact, best, space.layers)
        if space.layers.contains(present.thickness, present.wave_speed):
            now = float(exact(present.thickness, present.wave_speed)[0])
            if now > 0.0 and (best is None or now >= (1.0 - _EQUAL) * best.score):
                best = Optimum(present.thickness, present.wave_speed, now)
        return None if best is None else space.candidate(best)


def _refine(exact: LayerScore, best: Optimum, layers: LayerRange) -> Optimum | None:
    """Make sure that what was found with few cells is not beyond a jump or a limit with many."""
    score = float(exact(best.thickness, best.wave_speed)[0])
    if score >= (1.0 - _DRAFT_ERROR) * best.score:
        return best._replace(score=score)
    nearby = LayerRange(*(
        (max(low, value * (1.0 - _NEARBY)), min(high, value * (1.0 + _NEARBY)))
        for (low, high), value in zip(layers, best, strict=False)
    ))  # fmt: skip
    start = (best._replace(score=score),) if score > 0.0 else ()
    return find_best_layer(exact, nearby, step=_NEARBY, starts=start, tolerance=1e-3)


def _sensitivities(
    rig: Rig, objective: Objective, cancelled: Cancelled | None
) -> Iterator[Sensitivity]:
    """Find out how much each parameter matters for the score of the rig's layer."""
    values = {
        'thickness': rig.layer.thickness,
        'wave_speed': rig.layer.wave_speed,
        'mass': rig.projectile.mass,
        'frequency': rig.engine.frequency,
        'damping_ratio': rig.engine.damping_ratio,
    }
    score = LayerScore(rig, objective, cells=SEARCH_CELLS, cancelled=cancelled)
    best = float(score(values['thickness'], values['wave_speed'])[0])

    def remaining(which: NDArray[np.int64], change: Floats, lost: float = 1.0) -> Floats:
        """Compute the score over `best` after changes of one parameter each, in logarithms."""
        factors = np.exp(np.where(which[:, None] == np.arange(len(values)), change[:, None], 0.0))
        thickness, wave_speed, mass, frequency, damping = factors.T
        return (
            score(
                values['thickness'] * thickness,
                values['wave_speed'] * wave_speed,
                least=(1.0 - lost) * best,
                mass_factor=mass,
                frequency_factor=frequency,
                damping_factor=damping,
            )
            / best
        )

    near = np.array([-_SMALL, _SMALL, -_SLIGHT, _SLIGHT])
    indices = np.arange(len(values))
    beside = remaining(np.repeat(indices, near.size), np.tile(near, len(values)))
    count = 8 if rig.layer.loss_tangent > 0.0 else 70
    steps = np.linspace(0.0, _FARTHEST, count + 1)
    # every parameter down, then every one up
    ends = _reach(remaining, np.tile(indices, 2), np.repeat((-1.0, 1.0), len(values)), steps)
    for i, (name, value) in enumerate(values.items()):
        if value > 0.0:
            less, more, slightly_less, slightly_more = beside[near.size * i :][: near.size]
            down, up = -ends[:, i], ends[:, i + len(values)]
            yield Sensitivity(
                name=name,
                value=value,
                elasticity=float(slightly_more - slightly_less) / (2.0 * _SLIGHT),
                low=value * math.exp(down[1]),
                high=value * math.exp(up[1]),
                tolerance=value * min(1.0 - math.exp(down[0]), math.exp(up[0]) - 1.0),
                edge=' or '.join(
                    side
                    for side, part in (('less', less), ('more', more))
                    if part < 1.0 - _AT_EDGE
                ),
            )


def _reach(
    remaining: Callable[..., Floats], which: NDArray[np.int64], sign: Floats, steps: Floats
) -> Floats:
    """Find how far parameters may change until TOLERATED, and until WITHIN, is lost."""
    changes = np.outer(sign, steps[1:])
    scan = remaining(np.repeat(which, steps.size - 1), changes.ravel(), WITHIN)
    kept = 1.0 - np.repeat((TOLERATED, WITHIN), which.size)
    is_lost = np.tile(scan.reshape(changes.shape), (2, 1)) < kept[:, None]
    first = np.where(is_lost.any(axis=1), is_lost.argmax(axis=1), steps.size - 1)
    good, bad = steps[first], steps[np.minimum(first + 1, steps.size - 1)]
    for _ in range(_HALVINGS):
        middle = 0.5 * (good + bad)
        is_good = remaining(np.tile(which, 2), np.tile(sign, 2) * middle, WITHIN) >= kept
        good, bad = np.where(is_good, middle, good), np.where(is_good, bad, middle)
    return good.reshape(2, -1)
