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
"""
The same first throw by well-known libraries: JiTCDDE, MuJoCo, diffrax.

`requirements/bench.txt` has them; what is not installed is left out. Units and conditions are
those of `bench.peers`. Each function prepares what is needed once, compilation included, and
returns what throws.
"""

from __future__ import annotations

from collections.abc import Callable
import math
from typing import Any

from bench.peers import Case, LONGEST, Release
import numpy as np

Throw = Callable[[], Release]


def jitcdde(case: Case, *, tolerance: float = 1e-6) -> Throw:
    """
    Let JiTCDDE integrate the delay equation of the projectile.

    Waves that come up to the projectile left the plate one crossing ago, and those before have
    come down from it and been reflected: `v' = (2 (p(t-1) + p(t-3) - v(t-2)) - v) / mu`, with the
    plate's velocity p. That holds for five crossings.
    """
    import jitcdde as jit

    w, zeta, mu = case.omega, case.zeta, case.mu
    t, y = jit.t, jit.y
    motion = [
        -(w**2) * y(1) - 2.0 * zeta * w * y(0),
        y(0),
        (2.0 * (y(0, t - 1.0) + y(0, t - 3.0) - y(2, t - 2.0)) - y(2)) / mu,
    ]
    equation = jit.jitcdde(motion, max_delay=3.0, verbose=False)
    equation.compile_C(simplify=False)
    equation.set_integration_parameters(rtol=tolerance, atol=1e-3 * tolerance, first_step=1e-3)

    def throw() -> Release:
        equation.purge_past()
        equation.constant_past([0.0, -1.0, 0.0], time=0.0)
        equation.adjust_diff()
        while equation.t < 5.0:
            equation.integrate(equation.t + 0.1)
            if equation.t > 1.5 and equation.get_state()[-1].diff[2] < 0.0:
                break
        else:
            return Release(math.nan, math.nan)
        spline = equation.get_state()
        extrema = spline.extrema(beginning=spline[-1].time - 0.5, end=spline[-1].time)
        time, speed = extrema.arg_max[2], extrema.maxima[2]
        return case.release(float(time), float(speed))

    return throw


def mujoco(case: Case, *, cells: int = 25, steps: int = 4) -> Throw:
    """
    Let MuJoCo step a chain of masses on slides with springs, so many steps per cell crossed.

    It is seen from the plate, with a gravity that is what the plate's acceleration makes of it.
    """
    import mujoco as mj

    dt = 1.0 / (cells * steps)
    body = ''
    for number in range(cells, 0, -1):
        mass = 1.0 / cells if number < cells else case.mu + 0.5 / cells
        body = (
            f'<body><inertial pos="0 0 0" mass="{mass!r}" diaginertia="1 1 1"/>'
            f'<joint type="slide" axis="0 0 1" stiffness="{cells}"/>{body}</body>'
        )
    model = mj.MjModel.from_xml_string(
        f'<mujoco><option timestep="{dt!r}" gravity="0 0 0" integrator="Euler">'
        f'<flag contact="disable" constraint="disable"/></option>'
        f'<worldbody>{body}</worldbody></mujoco>'
    )
    data = mj.MjData(model)
    w, zeta = case.omega, case.zeta
    root = math.sqrt(1.0 - zeta * zeta)

    def plate_speed(time: float) -> float:
        return w / root * math.exp(-zeta * w * time) * math.sin(root * w * time)

    def throw() -> Release:
        mj.mj_resetData(model, data)
        pull = 0.0
        for step in range(int(LONGEST / dt)):
            speed = plate_speed(step * dt)
            model.opt.gravity[2] = (speed - plate_speed((step + 1) * dt)) / dt
            mj.mj_step(model, data)
            before, pull = pull, float(data.qpos[-1])
            if before < 0.0 <= pull:
                time = (step + before / (before - pull)) * dt
                return case.release(time, float(data.qvel.sum()) + plate_speed((step + 1) * dt))
        return Release(math.nan, math.nan)

    return throw


def diffrax(case: Case, *, cells: int = 25, tolerance: float = 1e-6) -> Throw:
    """Let diffrax integrate a chain of cells by Tsit5, compiled, up to an event."""
    import diffrax as dx
    import jax
    import jax.numpy as jnp
    import optimistix

    jax.config.update('jax_enable_x64', True)
    w, zeta = case.omega, case.zeta
    root = math.sqrt(1.0 - zeta * zeta)
    mass = np.full(cells, 1.0 / cells)
    mass[-1] = case.mu + 0.5 / cells
    masses = jnp.asarray(mass)

    def motion(t: Any, y: Any, args: Any) -> Any:  # noqa: ARG001  diffrax gives these by name
        angle = root * w * t
        plate = 1.0 - jnp.exp(-zeta * w * t) * (jnp.cos(angle) + zeta / root * jnp.sin(angle))
        heights = jnp.concatenate([plate[None], y[:cells]])
        forces = jnp.concatenate([cells * jnp.diff(heights), jnp.zeros(1)])
        return jnp.concatenate([y[cells:], jnp.diff(forces) / masses])

    def pull(t: Any, y: Any, args: Any, **_: Any) -> Any:  # noqa: ARG001  as above
        return jnp.where(t > 1.0, y[cells - 1] - y[cells - 2], -1.0)

    event = dx.Event(pull, optimistix.Newton(1e-10, 1e-10), direction=True)
    controller = dx.PIDController(rtol=tolerance, atol=1e-3 * tolerance)

    @jax.jit
    def solve() -> Any:
        done = dx.diffeqsolve(
            dx.ODETerm(motion), dx.Tsit5(), 0.0, LONGEST, 1e-3, jnp.zeros(2 * cells),
            stepsize_controller=controller, event=event, max_steps=100_000,
        )
        return done.ts[-1], done.ys[-1, -1]

    def throw() -> Release:
        time, speed = solve()
        return case.release(float(time), float(speed))

    return throw
