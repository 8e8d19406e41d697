# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Throws by cells."""

from dataclasses import replace

from hypothesis import given, settings
from hypothesis import strategies as st
import numpy as np
import pytest
from reference import method_of_lines, normal_modes
from reference.cases import exact_release, FREQUENCY, log_uniform, make_rig, order, released
from reference.method_of_steps import follow
from soft_throw_ros.core.cell_stepper import CellStepper
from soft_throw_ros.core.plate import Underdamped
from soft_throw_ros.core.rig import Engine, Layer, Projectile, Rig
from soft_throw_ros.core.stepper import PROJECTILE_FORCE, PROJECTILE_POSITION, PROJECTILE_VELOCITY
from soft_throw_ros.core.throw import simulate, throw_many

SHEETS = (Layer(thickness=6e-3), Layer(thickness=4e-3, wave_speed=20.0, loss_tangent=0.1))
GEL = {'stress_strain_law': 'neo_hookean', 'loss': 'constant', 'loss_tangent': 0.1}
CASES = {
    'neo_hookean': Rig(layer=Layer(stress_strain_law='neo_hookean')),
    'constant': Rig(layer=Layer(loss_tangent=0.1, loss='constant')),
    'gel': Rig(layer=Layer(**GEL)),
    'gels': Rig(layer=Layer.of_sheets(replace(sheet, **GEL) for sheet in SHEETS)),
    'uniform': Rig(),
    'lossy': Rig(layer=Layer(loss_tangent=0.1)),
    'stacked': Rig(layer=Layer.of_sheets(SHEETS)),
}
# Loss tangent 0.05, computed with 40-digit closed forms, checked by a second method
EXACTLY_LOSSY = make_rig(0.6345238095238095, 7.34629294755877, loss_tangent=0.05)
LOSSY_PHASE, LOSSY_SPEED = 0.46694752928793415, 1.8077831318189745


def throw(rig, **options):
    """Advance until the projectile has left, and return the stepper."""
    return released(CellStepper(rig, **options), periods=4.0)


def test_release_with_loss_is_exact_to_1e_4_at_the_default_and_1e_3_with_16_cells():
    release = throw(EXACTLY_LOSSY).events()[0]
    speed = release.velocity / EXACTLY_LOSSY.engine.speed_scale
    assert release.time * FREQUENCY == pytest.approx(LOSSY_PHASE, rel=1e-5)
    assert speed**2 == pytest.approx(LOSSY_SPEED**2, rel=1e-4)
    coarse = throw_many(EXACTLY_LOSSY, cells=16)
    assert coarse.ejection_time * FREQUENCY == pytest.approx(LOSSY_PHASE, rel=1e-3)
    assert coarse.energy_transfer == pytest.approx(LOSSY_SPEED**2, rel=1e-3)


def stack(text, **options):
    """Make a layer of sheets, each by thickness [m], wave speed [m/s] and density [kg/m3]."""
    return Layer.of_sheets([
        Layer(thickness=thickness, wave_speed=speed, density=density, **options)
        for thickness, speed, density in (map(float, sheet.split()) for sheet in text.split(','))
    ])


LOSSLESS = Rig(  # no number of cells makes the crossing times of its sheets whole steps
    engine=Engine(damping_ratio=0.09472), projectile=Projectile(mass=0.858904e-3), gravity=0.0,
    layer=stack('0.0089396 4.86995 494.27, 0.0033307 27.2999 2965.9'),
)
SHORTLY_LEFT = Rig(  # until the wave comes again
    engine=Engine(frequency=106.24, amplitude=1.448e-3, damping_ratio=0.1618),
    layer=stack('0.0094 7.205 1261.7', stress_strain_law='neo_hookean'),
    projectile=Projectile(mass=3.244e-4),
)


# t_e f by 2048 cells
@pytest.mark.parametrize(('rig', 'phase'), [(LOSSLESS, 0.58743), (SHORTLY_LEFT, 0.39242)])
def test_lossless_cells_are_exact_to_1e_4_offline(rig, phase):
    exact, many, one = throw_many(rig, cells=2048), throw_many(rig), simulate(rig)
    for time, speed in (many[:2], (one.ejection_time, one.ejection_speed)):
        assert time == pytest.approx(float(exact.ejection_time), rel=2e-4)
        assert speed == pytest.approx(float(exact.ejection_speed), rel=2e-4)
    assert exact.ejection_time * rig.engine.frequency == pytest.approx(phase, abs=1e-4)


def test_sheets_that_the_projectile_leaves_for_microseconds_agree_with_the_closed_form():
    layer = Layer.of_sheets([Layer(thickness=8.4e-3)] * 2)
    rig = Rig(engine=Engine(damping_ratio=0.99), layer=layer)
    uniform, throws = exact_release(replace(rig, layer=Layer())), throw_many(rig)
    assert throws.ejection_time * FREQUENCY == pytest.approx(uniform.ejection_phase, rel=1e-4)
    for computed in (throws, simulate(rig)):
        assert computed.energy_transfer == pytest.approx(uniform.energy_transfer, rel=1e-4)


@pytest.mark.parametrize(('mu', 'kappa'), [(0.2342, 8.242), (5.2, 3.75)])
def test_every_event_is_of_second_order(mu, kappa):
    rig = make_rig(mu, kappa, gravity=20.0)
    history = follow(rig, max_events=6)
    cells = np.array([64, 96, 128, 192, 256, 384, 512])
    errors = []
    for count in cells:
        stepper = CellStepper(rig, cells=int(count))
        stepper.advance_to(history.end_time + 1e-4)
        pairs = list(zip(stepper.events(), history.events, strict=False))
        assert len(pairs) == 6
        assert all((a.kind == 'release') == (b.kind == 'release') for a, b in pairs)
        errors.append([computed.velocity - exact.velocity for computed, exact in pairs])
    assert (order(cells, errors) > 1.6).all()


@settings(max_examples=60)
@given(
    mass_ratio=log_uniform(0.01, 30.0),
    speed_ratio=log_uniform(0.3, 60.0),
    damping_ratio=st.sampled_from([0.0, 0.064, 0.3]),
    gravity_ratio=st.sampled_from([0.0, 0.01]),
    loss_tangent=log_uniform(3e-3, 2.0),
)
def test_release_with_loss_agrees_with_the_sum_over_modes(**case):
    exact = normal_modes.first_release(**case)
    if exact is None:
        return
    rig = make_rig(**case)
    throws = throw_many(rig)
    assert throws.ejection_time * FREQUENCY == pytest.approx(exact[0], rel=1e-3)
    speed = throws.ejection_speed / rig.engine.speed_scale
    assert speed == pytest.approx(exact[1], rel=3e-4, abs=1e-4)


# The default rig, without gravity (PHYSICS: the same equations, solved independently)
def test_large_strain_of_the_default_rig_has_its_reference_value():
    linear, curved = (
        throw(Rig(layer=Layer(stress_strain_law=law), gravity=0.0), cells=256).events()[0]
        for law in ('linear', 'neo_hookean')
    )
    plate = Underdamped.of(Engine()).peak_velocity
    assert (linear.velocity / plate) ** 2 == pytest.approx(3.637, abs=5e-4)
    assert (curved.velocity / plate) ** 2 == pytest.approx(3.785, abs=5e-4)
    assert curved.time / linear.time == pytest.approx(0.97, abs=5e-3)


# These sheets have cells of one crossing time, so that grids can be compared
EVEN = Rig(layer=Layer.of_sheets((Layer(thickness=7.8e-3), replace(SHEETS[1], thickness=1e-2))))


@pytest.mark.parametrize('case', ['neo_hookean', 'constant', 'gel', 'even'])
def test_energy_transfer_is_of_second_order_and_1e_4_at_the_default(case):
    rig = CASES.get(case, EVEN)
    cells = np.array([36, 72, 144, 288])
    speeds = [throw(rig, cells=int(count)).events()[0].velocity for count in cells]
    finest = throw(rig, cells=2304).events()[0].velocity
    assert order(cells, np.array(speeds) - finest) > 1.6
    default = throw(rig).events()[0].velocity
    assert default**2 == pytest.approx(finest**2, rel=1e-4 if case == 'even' else 6e-4)


def test_shocks_are_resolved():
    """A wave in a soft and thick layer steepens long before it is at the top."""
    layer = Layer(thickness=0.06, wave_speed=5.0, stress_strain_law='neo_hookean')
    rig = Rig(engine=Engine(amplitude=5e-3), layer=layer)
    (release,), (better,) = (throw(rig, cells=cells).events() for cells in (256, 1024))
    assert release.time == pytest.approx(better.time, rel=2e-3)
    assert release.velocity == pytest.approx(better.velocity, rel=5e-4)


@pytest.mark.parametrize(('text', 'alpha'), [
    ('0.04624 19.3 1350, 0.003755 4.005 1033', 8.056),
    ('0.007025 4.024 1274, 0.004281 6.153 1296, 0.009703 15.64 1188', 2.513),
])
def test_every_sheet_of_a_neo_hookean_stack_follows_its_law(text, alpha):
    """As by 1024 cells with a bound of strain that no sheet reaches."""
    rig = Rig(layer=stack(text, stress_strain_law='neo_hookean'))
    assert throw_many(rig).energy_transfer == pytest.approx(alpha, rel=5e-4)
    assert throw_many(rig, cells=512).energy_transfer == pytest.approx(alpha, rel=1e-4)


@pytest.mark.parametrize(('amplitude', 'layer'), [
    (2e-3, {**GEL, 'thickness': 0.01}),
    (0.05, {**GEL, 'thickness': 0.01}),
    (0.1, {'stress_strain_law': 'neo_hookean', 'wave_speed': 2.0}),
])
def test_large_throws_can_be_simulated(amplitude, layer):
    """Hard cases: a bare layer in resonance, and a plate faster than the waves."""
    rig = Rig(engine=Engine(amplitude=amplitude), layer=Layer(**layer))
    stepper = CellStepper(rig, cells=32)
    assert stepper.advance_to(0.08) >= 1
    assert np.isfinite([*stepper.state, stepper.stored_energy()]).all()
    assert (simulate(rig).loads.strain > rig.layer.linear_range) is (amplitude > 0.02)


@pytest.mark.parametrize(
    'case', ['lossy', pytest.param('stacked', marks=pytest.mark.slow), 'constant', 'gel']
)
def test_heat_agrees_with_the_method_of_lines(case):
    heat = method_of_lines.first_release(CASES[case], cells=50)[2]
    stepper = throw(CASES[case], cells=128)
    release, work = stepper.events()[0], stepper.plate_work
    stepper.reset()
    stepper.advance_to(release.time)
    assert stepper.plate_work - stepper.stored_energy() == pytest.approx(heat, abs=3e-4 * work)
    assert heat > 1e-3 * work


@pytest.mark.parametrize('case', CASES)
def test_work_of_the_plate_is_stored_without_loss(case):
    rig = CASES[case]
    lossless = Layer.of_sheets(replace(sheet, loss_tangent=0.0) for sheet in rig.layer.sheets)
    rig, errors, counts = replace(rig, layer=lossless), [], np.array([32, 64, 128])
    for count in counts:
        stepper = CellStepper(rig, cells=int(count))
        end = throw(rig, cells=int(count)).events()[0].time
        worst = 0.0
        for time in np.linspace(1e-3, end, 90):
            stepper.advance_to(time)
            worst = max(worst, abs(stepper.stored_energy() - stepper.plate_work))
        errors.append(worst / stepper.plate_work)
    assert errors[1] < 2e-4
    assert errors[2] < 1e-4
    assert order(counts, errors) > 1.6


@pytest.mark.parametrize('case', ['uniform', 'neo_hookean', 'gels', 'capped'])
def test_energy_never_grows_while_bouncing(case):
    rig = CASES.get(case, Rig(layer=stack('8e-3 7.8 1000, 1e-4 200 5000')))
    rig = replace(rig, engine=replace(rig.engine, damping_ratio=0.5), gravity=30.0)
    stepper = CellStepper(rig, cells=40)
    stepper.advance_to(0.1)  # the plate rests
    energy = stepper.stored_energy()
    for time in np.linspace(0.1, 1.0, 50):
        stepper.advance_to(time)
        assert stepper.stored_energy() < 1.01 * energy
    assert stepper.event_count > 10


def test_events_appear_at_their_time():
    stepper = CellStepper(Rig(), cells=64)
    stepper.advance_to(0.02)
    (release,) = stepper.events()
    stepper.reset()
    assert stepper.advance_to(release.time - 1e-3 * stepper.step) == 0
    assert stepper.in_contact
    assert stepper.state[PROJECTILE_FORCE] == pytest.approx(0.0, abs=1e-4)
    assert stepper.advance_to(release.time) == 1
    assert not stepper.in_contact
    assert stepper.state[PROJECTILE_FORCE] == 0.0
    assert stepper.state[PROJECTILE_VELOCITY] == pytest.approx(release.velocity, rel=1e-4)
    assert stepper.state[PROJECTILE_POSITION] == pytest.approx(release.position, rel=1e-6)


def test_layer_is_read_within_its_sheets():
    """At rest, where each sheet has a strain of its own."""
    rig = Rig(layer=stack('6e-3 7.8 1000, 5e-5 100 7800, 9e-3 20 1000'))
    layer = CellStepper(rig, cells=40, field_points=77).read_layer()
    weight, depths = rig.projectile.mass * rig.gravity, np.linspace(0.0, rig.layer.thickness, 77)
    lengths = np.array([sheet.thickness for sheet in rig.layer.sheets])
    strains = np.array([-sheet.static_strain(weight) for sheet in rig.layer.sheets])
    bounds, heights = (np.append(0.0, np.cumsum(x)) for x in (lengths, lengths * (1.0 + strains)))
    assert layer[0] == pytest.approx(np.interp(depths, bounds, heights), rel=1e-9)
    sheets = np.minimum(np.searchsorted(bounds, depths, side='right') - 1, 2)
    assert layer[3] == pytest.approx(strains[sheets], rel=1e-9)


def test_contact_that_ends_in_the_step_of_its_landing_has_a_time() -> None:
    layer = Layer(
        thickness=0.0262085577, wave_speed=10.8084425, density=1070.0, loss_tangent=0.15
    )
    stepper = CellStepper(Rig(engine=Engine(amplitude=1.9e-3), layer=layer))
    stepper.advance_to(0.7)
    times = [event.time for event in stepper.events()]
    assert times == sorted(times)
    assert min(times) > 0.0
