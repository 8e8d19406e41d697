# Copyright 2026 soft_throw_ros developers
#
# Licensed under the Apache License, Version 2.0 (the "License");
# you may not use this file except in compliance with the License.
# You may obtain a copy of the License at
#
#     http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software
# distributed under the License is distributed on an "AS IS" BASIS,
# WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied.
# See the License for the specific language governing permissions and
# limitations under the License.
"""What is computed, against other ways: throws, maps, seconds, recommendations, motions."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
import math
import os
from pathlib import Path
import sys
from tempfile import TemporaryDirectory
from typing import Any

from bench import others, peers
from bench.race import Case, Table
from mcap.writer import Writer
import numba as nb
import numpy as np
from numpy.typing import NDArray
from soft_throw_ros.core.cell_stepper import CellStepper, first_throws
from soft_throw_ros.core.closed_form import (
    first_release,
    first_release_kernel,
    first_releases,
    MAX_INTERVALS,
)
from soft_throw_ros.core.plate import Underdamped
from soft_throw_ros.core.rig import Layer, Rig
from soft_throw_ros.core.throw import simulate
from soft_throw_ros.core.wave_stepper import WaveStepper
from soft_throw_ros.design.objective import Limits, Robust
from soft_throw_ros.design.plate_motion import find_best_motion, PlateLimits
from soft_throw_ros.design.recommendation import recommend
from soft_throw_ros.recording.bag_reader import BagReader

sys.path.append(str(Path(__file__).resolve().parents[1] / 'test'))

from reference.method_of_lines import first_release as first_release_by_lines  # noqa: E402, I100

Floats = NDArray[np.float64]

TRUE = peers.Release(0.4815082783157032, 3.6373472456471254)
"""First release of the default rig without gravity, with 40 digits and by a second method."""

USABLE_ERROR = 0.01
"""What is further off than this part is no way to get t_e f. [-]"""

LOOP = 1000
"""Throws in a compiled loop."""

TICKS = 1000
"""Of a second."""

SIDE = 128
"""Of a map."""

DENSITY_RATIO = 1.3


# One throw


def one_throw() -> Table:
    """List ways to one first release of the default rig, without gravity."""
    rig = Rig(gravity=0.0)
    case = peers.Case.of(rig)
    work = np.empty((2, MAX_INTERVALS))
    plate_speed = Underdamped.of(rig.engine).peak_velocity

    def in_loop() -> peers.Release:
        phase, speed = _throw_often(case.mu, case.kappa, case.zeta, work)
        return case.release(phase * case.kappa, speed * case.omega)

    def called() -> peers.Release:
        exact = first_release(mass_ratio=case.mu, speed_ratio=case.kappa, damping_ratio=case.zeta)
        return peers.Release(float(exact.ejection_phase), float(exact.energy_transfer))

    def stepped(stepper: Any) -> peers.Release:
        stepper.reset()
        stepper.advance_to(0.5 / rig.engine.frequency)
        event = stepper.events()[0]
        return peers.Release(
            event.time * rig.engine.frequency, (event.velocity / plate_speed) ** 2
        )

    libraries = [
        ('JiTCDDE, rtol 1e-06', others.jitcdde),
        ('MuJoCo, a chain of 25 cells', others.mujoco),
        ('diffrax, Tsit5, 25 cells, rtol 1e-06', others.diffrax),
    ]
    thrown, left_out = _installed(libraries, case)
    cases = [
        Case('closed form, called from Python', called),
        Case('closed form, in a compiled loop', in_loop, LOOP),
        Case('travelling waves, to the release', partial(stepped, WaveStepper(rig))),
        Case('cells, to the release', partial(stepped, CellStepper(rig))),
        *(
            Case(f'finite differences, numba, {cells} cells',
                 partial(peers.rigid_numba, case, cells=cells))
            for cells in (25, 100, 800)
        ),
        Case('finite differences, numpy, 25 cells', partial(peers.rigid_numpy, case, cells=25)),
        Case('solve_ivp, DOP853, 50 cells, rtol 1e-06',
             partial(peers.method_of_lines, case, cells=50, tolerance=1e-6)),
        *thrown,
    ]

    def error(found: peers.Release) -> float:
        return abs(found.ejection_phase - TRUE.ejection_phase)

    with_errors = [each._replace(error=error) for each in cases]
    return Table('one throw', 'throw', 'error of t_e f', with_errors, left_out=left_out)


def _installed(
    libraries: list[tuple[str, Callable[[peers.Case], others.Throw]]], case: peers.Case
) -> tuple[list[Case], tuple[str, ...]]:
    """Return the libraries that are installed and give the right answer, and why others do not."""
    cases, left_out = [], []
    for name, prepare in libraries:
        try:
            throw = prepare(case)
            off = abs(throw().ejection_phase / TRUE.ejection_phase - 1.0)
        except Exception as error:  # noqa: BLE001  whatever a library of others raises
            left_out.append(f'{name} ({type(error).__name__}: {error})')
            continue
        if off < USABLE_ERROR:
            cases.append(Case(name, throw))
        else:
            left_out.append(f'{name} (its t_e f is off by {100.0 * off:.2g} %)')
    return cases, tuple(left_out)


def one_gel() -> Table:
    """List ways to one first release from a neo-Hookean layer with a constant loss tangent."""
    rig = Rig(layer=Layer(elasticity='neo_hookean', loss='constant', loss_tangent=0.05))
    true, _ = first_release_by_lines(rig, cells=400)

    def many() -> float:
        return float(first_throws(**rig.cell_ratios).ejection_phase) / rig.engine.frequency

    return Table(
        'one throw from a gel', 'throw', 'error of t_e, relative',
        [
            Case('cells, to the release', many, error=lambda time: abs(time / true - 1.0)),
            Case('solve_ivp, RK45, 64 cells',
                 lambda: first_release_by_lines(rig, cells=64)[0],
                 error=lambda time: abs(time / true - 1.0)),
        ],
    )


@nb.njit(error_model='numpy')
def _throw_often(mu, kappa, zeta, work):
    """Throw many times, each a little different; the last is the one asked for."""
    phase = speed = 0.0
    for i in range(LOOP):
        nearby = mu * (1.0 + 1e-9 * (LOOP - 1 - i))
        phase, speed, _ = first_release_kernel(nearby, kappa, zeta, 0.0, work)
    return phase, speed


# A map


def landscape() -> Table:
    """List ways to a map of first releases over the paper's (x, C), with its densities."""
    x = (np.arange(SIDE) + 0.5) / SIDE
    c = 14.0 * (np.arange(SIDE) + 1.0) / SIDE
    x, c = map(np.ravel, np.meshgrid(x, c))
    mu, kappa = DENSITY_RATIO * (1.0 - x) / x, c / x
    exact = np.asarray(first_releases(mass_ratio=mu, speed_ratio=kappa).ejection_phase)

    def by_closed_form(threads: int | None) -> Floats:
        found = first_releases(mass_ratio=mu, speed_ratio=kappa, threads=threads)
        return np.asarray(found.ejection_phase)

    def by_cells() -> Floats:
        found = first_throws(mass_ratio=mu, speed_ratio=kappa, unresolved='nan', threads=1)
        return np.asarray(found.ejection_phase)

    some = np.random.default_rng(1).permutation(mu.size)[:12]

    def by_lines() -> Floats:
        phases = np.full(mu.size, math.nan)
        for i in some:
            case = peers.Case(mu[i], kappa[i])
            phases[i] = peers.method_of_lines(case, cells=25, tolerance=1e-6).ejection_phase
        return phases

    def error(phases: Floats) -> float:
        off = np.abs(phases - exact)
        return float(np.percentile(off[np.isfinite(off)], 90))

    whole = float(mu.size)
    cases = [
        Case('closed form, 1 thread', partial(by_closed_form, 1), whole, goal=4e3 / whole),
        Case(f'closed form, all threads ({os.cpu_count()})', partial(by_closed_form, None), whole),
        Case('cells, 1 thread', by_cells, whole),
        *(
            Case(f'finite differences, numba, {cells} cells, 1 thread',
                 partial(_map_by_differences, mu, kappa, cells), whole)
            for cells in (25, 100)
        ),
        Case('solve_ivp, DOP853, 25 cells, rtol 1e-06 (12 throws)', by_lines, float(some.size)),
    ]
    return Table(
        f'map of {SIDE} x {SIDE}', 'throw', 'error of t_e f, 90 %',
        [case._replace(error=error) for case in cases],
    )


@nb.njit(error_model='numpy')
def _map_by_differences(mu, kappa, cells):
    phases = np.empty(mu.size)
    for i in range(mu.size):
        time, _ = peers.rigid_kernel(mu[i], 2.0 * math.pi / kappa[i], 0.0, cells)
        phases[i] = time / kappa[i]
    return phases


# One second


def one_second() -> Table:
    """List ways through a second of the default rig: throw, flight, landings, and the layer."""
    rig = Rig()
    case = peers.Case.of(rig)
    second = 1.0 / rig.crossing_time
    exact = simulate(rig, max_events=1).ejection_time

    def run(stepper: Any, ticks: int, *, reads: bool) -> float:
        read = partial(stepper.read_layer, np.empty((3, stepper.field_points)))
        stepper.reset()
        for tick in range(1, ticks + 1):
            stepper.advance_to(tick / ticks)
            if reads:
                read()
        return float(stepper.events()[0].time)

    def error(time: float, true: float = exact) -> float:
        return abs(time - true) * rig.engine.frequency

    def differences(cells: int) -> float:
        per_frame = round(second * cells / TICKS)
        strain = np.empty((round(second * cells / per_frame), cells))
        arguments = (case.mu, case.omega, case.zeta, case.gravity, per_frame, strain)
        return float(peers.march_kernel(*arguments)) * rig.crossing_time

    def delay_line() -> float:
        arguments = (case.mu, case.omega, case.zeta, case.gravity, 200, second)
        return float(peers.delay_line_kernel(*arguments)) * rig.crossing_time

    waves = WaveStepper(rig, steps=200)
    usual = WaveStepper(rig)
    cells = CellStepper(rig, cells=64)
    elastic = CellStepper(rig, model='finite_difference_elastic')
    gels = {
        'loss': (Layer(loss_tangent=0.05), 150.0),
        'constant loss': (Layer(loss_tangent=0.05, loss='constant'), 100.0),
        'large strain': (Layer(elasticity='neo_hookean'), 100.0),
        'large strain and loss': (Layer(elasticity='neo_hookean', loss_tangent=0.05), 100.0),
        'large strain and constant loss': (
            Layer(elasticity='neo_hookean', loss_tangent=0.05, loss='constant'), 100.0
        ),
    }

    def of_gel(gel: Rig) -> Callable[[float], float]:
        fine = simulate(gel, model='finite_difference', max_events=1, cells=1024)
        return partial(error, true=fine.ejection_time)

    cases = [
        Case('waves, 200 steps per crossing, one call', partial(run, waves, 1, reads=False),
             goal=2000.0),
        Case('waves, default steps, 1000 ticks with the layer',
             partial(run, usual, TICKS, reads=True), goal=1000.0 / 1.6),
        Case('waves, default steps, 1000 ticks', partial(run, usual, TICKS, reads=False)),
        Case('64 cells, 1000 ticks with the layer', partial(run, cells, TICKS, reads=True),
             goal=300.0),
        *(
            Case(f'64 cells with {name}, the same',
                 partial(run, CellStepper(Rig(layer=layer), cells=64), TICKS, reads=True),
                 error=of_gel(Rig(layer=layer)), goal=goal)
            for name, (layer, goal) in gels.items()
        ),
        Case('elastic projectile, default cells, the same',
             partial(run, elastic, TICKS, reads=True)),
        Case('a plain delay line, 200 steps per crossing, numba', delay_line),
        *(
            Case(f'finite differences, {count} cells, strain at 1 kHz, numba',
                 partial(differences, count))
            for count in (64, 200)
        ),
    ]
    return Table(
        'one second', 'second', 'error of t_e f',
        [case._replace(error=case.error or error) for case in cases], is_factor=True,
    )


# Recommendations


def recommendation() -> Table:
    """List ways to the best layer: thickness and wave speed within the usual limits."""
    rig = Rig(gravity=0.0)
    lossy = Rig(layer=Layer(loss_tangent=0.1))

    def brute_force() -> float:
        thickness = np.geomspace(1e-3, 0.05, 400)[:, None]
        speed = np.geomspace(1.0, 50.0, 400)
        layer = rig.layer.density * rig.layer.section * thickness
        found = first_releases(
            mass_ratio=rig.projectile.mass / layer + 0.0 * speed,
            speed_ratio=speed / (thickness * rig.engine.frequency),
            damping_ratio=rig.engine.damping_ratio,
            unresolved='nan',
        )
        return float(np.nanmax(found.energy_transfer))

    best = brute_force()

    def plain() -> float:
        return float(recommend(rig).energy_transfer)

    limits = Limits(max_strain=0.1)
    cases = [
        Case('plain', plain, error=lambda alpha: max(best - alpha, 0.0) / best, goal=5e4),
        Case('brute force, 400 x 400 by the closed form', brute_force, error=lambda _: 0.0),
        Case('robust', lambda: recommend(rig, objective=Robust())),
        Case('with a limit of strain', lambda: recommend(rig, limits=limits)),
        Case('with loss and a limit of strain',
             lambda: recommend(lossy, limits=limits), goal=2e6),
    ]
    return Table('one recommendation', 'answer', 'alpha lost, relative', cases)


def motion() -> Table:
    """List ways to the motion of the plate that throws best, within what it does now."""
    rig = Rig()
    limits = PlateLimits.of(rig.engine)
    best = find_best_motion(rig, limits).energy_transfer

    def found() -> float:
        return float(find_best_motion(rig, limits).energy_transfer)

    cases = [
        Case('linear programmes, to rest and without a re-contact', found),
        *(
            Case(f'differential evolution of {pieces} accelerations, 50 cells, numba',
                 partial(peers.searched_motion, rig, limits, pieces=pieces, cells=50))
            for pieces in (8, 24)
        ),
    ]
    return Table(
        'one motion', 'motion', 'alpha lost, relative',
        [case._replace(error=lambda alpha: 1.0 - alpha / best) for case in cases],
    )


# How cost grows


def growth_with_cells() -> Table:
    """Step a second by more and more cells."""
    steppers = {count: CellStepper(Rig(), cells=count) for count in (16, 32, 64, 128, 256)}
    return _growth('cells', 'second', {n: partial(_pass, s, 1.0) for n, s in steppers.items()})


def growth_with_crossings() -> Table:
    """Step for more and more crossings of the wave."""
    rig = Rig()
    stepper = WaveStepper(rig)
    return _growth('crossings', 'run', {
        count: partial(_pass, stepper, count * rig.crossing_time)
        for count in (100, 400, 1600)
    })


def growth_with_bag_length() -> Table:
    """Read longer and longer bags."""
    folder = TemporaryDirectory()
    paths = {seconds: Path(folder.name) / f'{seconds}.mcap' for seconds in (10, 40, 160)}
    for seconds, path in paths.items():
        _record(path, seconds)

    def read(path: Path) -> int:
        with BagReader(path) as bag:
            return sum(1 for _ in bag.messages())

    calls = {seconds: partial(read, path) for seconds, path in paths.items()}
    table = _growth('seconds in a bag', 'bag', calls)
    return table._replace(close=folder.cleanup)


def _growth(what: str, unit: str, calls: dict[int, Callable[[], object]]) -> Table:
    cases = [Case(f'{count} {what}', call) for count, call in calls.items()]
    return Table(f'growth with {what}', unit, '-', cases)


def _pass(stepper: Any, seconds: float) -> None:
    """Let a stepper go on for so long, in ticks of 10 ms: they are few for any length."""
    stepper.reset()
    for tick in range(1, max(round(100.0 * seconds), 1) + 1):
        stepper.advance_to(min(tick / 100.0, seconds))


def _record(path: Path, seconds: int) -> None:
    """Write a file of so many seconds of states at 1 kHz, as others would."""
    states = np.random.default_rng(1).bytes(200 * 1000)
    with path.open('wb') as stream:
        writer = Writer(stream)
        writer.start('ros2', 'bench')
        schema = writer.register_schema('sensor_msgs/msg/JointState', 'ros2msg', b'')
        channel = writer.register_channel('/twin/joint_states', 'cdr', schema)
        for number in range(seconds * TICKS):
            place = number % 1000 * 200
            time = number * 1_000_000
            writer.add_message(channel, time, states[place:place + 200], time)
        writer.finish()


TABLES = (
    one_throw,
    one_gel,
    landscape,
    one_second,
    recommendation,
    motion,
    growth_with_cells,
    growth_with_crossings,
    growth_with_bag_length,
)
"""What makes each table; its name is that of the part."""
