# SPDX-License-Identifier: Apache-2.0
"""A rig cut into cells."""

from hypothesis import given, settings
from hypothesis import strategies as st
import numpy as np
import pytest
from soft_throw_ros.core.graded_layer import GradedLayer
from soft_throw_ros.core.grid import cut, massless
from soft_throw_ros.core.rig import Layer, Projectile, Rig

STACK = GradedLayer.stack(
    Layer(thickness=6e-3, wave_speed=7.8),
    Layer(thickness=5e-5, wave_speed=100.0, density=7800.0),
    Layer(thickness=9e-3, wave_speed=20.0, loss_tangent=0.2),
)
GRADED = GradedLayer.sample(
    thickness=16.8e-3,
    youngs_modulus=lambda y: 3e4 * (1.0 + 200.0 * y) ** 2,
    density=lambda y: 1000.0 + 3e4 * y,
)
LAYERS = pytest.mark.parametrize(
    'layer',
    [Layer(), Layer(loss_tangent=0.1), STACK, GRADED],
    ids=['', 'lossy', 'stack', 'graded'],
)


@LAYERS
@pytest.mark.parametrize('options', [{}, {'is_elastic': True}, {'glued_to': 'projectile'}])
@pytest.mark.parametrize('cells', [2, 33, 200])
def test_mass_and_stiffness_are_all_there(layer, options, cells):
    rig = Rig(layer=layer)
    grid = cut(rig, cells=cells, **options)
    assert grid.mass.sum() == pytest.approx(layer.mass + rig.projectile.mass, rel=1e-12)
    springs = grid.stiffness[grid.bottom : grid.top]
    assert (1.0 / springs).sum() == pytest.approx(1.0 / layer.stiffness, rel=1e-12)
    above = grid.stiffness[grid.face :]
    spring = rig.projectile.youngs_modulus * layer.section / rig.projectile.length
    if above.size:
        assert (1.0 / above).sum() == pytest.approx(1.0 / spring, rel=1e-12)
    assert grid.stiffness[grid.joint] == 0.0
    assert grid.heights[-1] == pytest.approx(layer.thickness)


@LAYERS
@pytest.mark.parametrize('in_contact', [True, False])
@pytest.mark.parametrize('options', [{}, {'is_elastic': True}, {'glued_to': 'projectile'}])
def test_factors_solve_the_equations_of_motion(layer, in_contact, options):
    grid = cut(Rig(layer=layer), cells=12, **options)
    last = grid.mass.size - 1
    matrix = np.diag(grid.mass)
    for j, implicit in enumerate(grid.implicit_masses(in_contact=in_contact)):
        matrix[j : j + 2, j : j + 2] += implicit * np.array([[1.0, -1.0], [-1.0, 1.0]])
    # in contact both nodes of the joint are one
    merge = np.eye(last + 1)
    if in_contact:
        merge = np.delete(merge, grid.joint + 1, axis=1)
        merge[grid.joint + 1, grid.joint] = 1.0
    load = np.random.default_rng(3).normal(size=last + 1)
    plate = 0.7
    inside = merge.T @ matrix @ merge
    right = merge.T @ load
    inside[0], right[0] = 0.0, plate
    inside[0, 0] = 1.0
    expected = merge @ np.linalg.solve(inside, right)

    share, gain = grid.factors(in_contact=in_contact)
    value = load.copy()
    for j in range(last - 1, 0, -1):
        value[j] += share[j] * value[j + 1]
    value[0] = plate
    for j in range(1, last + 1):
        value[j] = gain[j] * value[j] + share[j - 1] * value[j - 1]
    assert value == pytest.approx(expected, rel=1e-9)


@LAYERS
@pytest.mark.parametrize('is_elastic', [False, True])
@settings(max_examples=20)
@given(cells=st.integers(1, 60))
def test_step_is_stable(layer, is_elastic, cells):
    """The fastest mode must not turn by more than pi in a step: h^2 K <= 4 M."""
    for glued_to in ('plate', 'projectile'):
        grid = cut(Rig(layer=layer), cells=cells, is_elastic=is_elastic, glued_to=glued_to)
        n = grid.mass.size - 1
        matrix, stiffness = np.diag(grid.mass), np.zeros((n + 1, n + 1))
        newmark = grid.implicit - 0.5 * grid.step * grid.viscosity
        for j in range(n):
            ends = np.ix_((j, j + 1), (j, j + 1))
            matrix[ends] += newmark[j] * np.array([[1.0, -1.0], [-1.0, 1.0]])
            stiffness[ends] += grid.stiffness[j] * np.array([[1.0, -1.0], [-1.0, 1.0]])
        surplus = 4.0 * matrix - grid.step**2 * stiffness
        assert np.linalg.eigvalsh(surplus).min() > -1e-6 * grid.mass.max()


def test_uniform_layer_has_the_longest_step_there_is():
    grid = cut(Rig(), cells=50)
    assert grid.step == pytest.approx(Rig().crossing_time / 50, rel=1e-14)
    assert grid.cells == 50
    assert not grid.implicit.any()


def test_slabs_get_whole_cells_and_thin_stiff_ones_an_implicit_one():
    grid = cut(Rig(layer=STACK), cells=100)
    counts = [np.count_nonzero(grid.slabs == slab) for slab in range(3)]
    times = [piece.crossing_time for piece in STACK.pieces()]
    assert counts == [int(times[0] / grid.step), 1, int(times[2] / grid.step)]
    stiff = grid.stiffness * grid.step**2 / 4.0
    assert np.flatnonzero(grid.is_stiff).tolist() == [counts[0]]
    assert grid.implicit[counts[0]] == pytest.approx(stiff[counts[0]])
    lossy = grid.implicit[counts[0] + 1 : grid.top]
    assert lossy == pytest.approx(0.5 * grid.step * grid.viscosity[counts[0] + 1 : grid.top])
    # interfaces are nodes
    assert grid.heights[counts[0]] == pytest.approx(6e-3)
    assert grid.heights[counts[0] + 1] == pytest.approx(6.05e-3)


def test_viscosity_gives_the_loss_tangent_at_the_engines_frequency():
    rig = Rig(layer=Layer(loss_tangent=0.07))
    for grid in (cut(rig, cells=10), massless(rig, step=1e-5)):
        cell = slice(grid.bottom, grid.top)
        ratio = grid.viscosity[cell] * rig.engine.angular_frequency / grid.stiffness[cell]
        assert ratio == pytest.approx(0.07)


def test_elastic_projectile_has_its_own_cells():
    soft = Rig(projectile=Projectile(youngs_modulus=1e5, length=0.02))
    grid = cut(soft, cells=100, is_elastic=True)
    bar = grid.mass.size - 1 - grid.face
    assert bar == int(100 * soft.crossing_ratio) > 20
    assert not grid.is_stiff.any()
    grid = cut(Rig(), cells=100, is_elastic=True)
    assert grid.mass.size - 1 - grid.face == 2
    assert grid.is_stiff[grid.face :].all()
    assert grid.bodies() == (grid.joint, grid.mass.size - 1)


def test_step_too_long_to_be_stable_is_refused_with_the_limit():
    with pytest.raises(
        ValueError, match=r'at most 2\.15385e-05 s for 100 cells .* got 2\.2e-05 s'
    ):
        cut(Rig(), cells=100, step=2.2e-5)
    with pytest.raises(ValueError, match=r'step must be finite and positive, got 0\.0'):
        cut(Rig(), cells=100, step=0.0)
    assert cut(Rig(), cells=100, step=1e-6).step == 1e-6
    # a thin stiff slab does not count
    assert cut(Rig(layer=STACK), cells=100, step=1.2e-5).is_stiff.any()


def test_endless_cells_of_a_slow_projectile_are_refused():
    rig = Rig(projectile=Projectile(youngs_modulus=1.0))
    with pytest.raises(ValueError, match=r'modulus 1 Pa takes \d+ cells, the limit is 65536; fe'):
        cut(rig, cells=1000, is_elastic=True)


@LAYERS
def test_linear_functions_are_read_exactly_within_slabs(layer):
    grid = cut(Rig(layer=layer), cells=40)
    middles = 0.5 * (grid.heights[1:] + grid.heights[:-1])
    offsets = np.where(grid.slabs == 2, 1.0, 0.0)  # a jump beyond the second slab
    for height in np.linspace(0.0, layer.thickness, 77).tolist():
        cell, beside, weight, part = grid.neighbours(height)
        assert grid.slabs[cell] == grid.slabs[beside]
        assert 0.0 <= part <= 1.0
        values = 3.0 * middles + offsets
        read = values[cell] + weight * (values[beside] - values[cell])
        if cell != beside:
            assert read == pytest.approx(3.0 * height + offsets[cell])
        below, above = grid.heights[cell : cell + 2]
        assert below + part * (above - below) == pytest.approx(height)
