# SPDX-License-Identifier: Apache-2.0
"""Layers of more than one material."""

from dataclasses import replace
import math

from hypothesis import given
from hypothesis import strategies as st
import numpy as np
import pytest
from scipy.integrate import quad
from soft_throw_ros.core.graded_layer import GradedLayer
from soft_throw_ros.core.method_of_steps import follow
from soft_throw_ros.core.rig import Layer, Rig
from soft_throw_ros.core.stepper import Stepper


def make_graded(**changes):
    """Modulus, density and loss that change with the height, smoothly."""
    return GradedLayer.sample(
        **{
            'thickness': 0.02,
            'youngs_modulus': lambda y: 5e4 * math.exp(40.0 * y),
            'density': lambda y: 1000.0 + 2e4 * y,
            'loss_tangent': lambda y: 0.1 - 2.0 * y,
            'points': 2001,
            **changes,
        }
    )


def test_equal_slabs_are_the_uniform_layer():
    layer = Layer(thickness=0.012, wave_speed=9.0, density=1100.0, loss_tangent=0.03)
    stack = GradedLayer.stack(*[replace(layer, thickness=0.004)] * 3)
    for name in (
        'thickness', 'wave_speed', 'density', 'diameter', 'loss_tangent', 'section', 'mass',
        'youngs_modulus', 'impedance', 'stiffness', 'crossing_time',
    ):  # fmt: skip
        assert getattr(stack, name) == pytest.approx(getattr(layer, name), rel=1e-14)
    assert layer.is_uniform
    assert not stack.is_uniform


def test_means_are_the_integrals_of_the_functions():
    layer = make_graded()

    def integral(function):
        return quad(function, 0.0, 0.02, epsabs=0.0, epsrel=1e-12)[0]

    def modulus(y):
        return 5e4 * math.exp(40.0 * y)

    def rho(y):
        return 1000.0 + 2e4 * y

    assert layer.crossing_time == pytest.approx(
        integral(lambda y: math.sqrt(rho(y) / modulus(y))), rel=1e-7
    )
    assert layer.mass == pytest.approx(layer.section * integral(rho), rel=1e-12)
    compliance = integral(lambda y: 1.0 / modulus(y))
    assert layer.stiffness == pytest.approx(layer.section / compliance, rel=1e-7)
    assert layer.youngs_modulus == pytest.approx(0.02 / compliance, rel=1e-7)
    assert layer.loss_tangent == pytest.approx(
        integral(lambda y: (0.1 - 2.0 * y) / modulus(y)) / compliance, rel=1e-6
    )
    assert layer.impedance == pytest.approx(layer.section * math.sqrt(rho(0.02) * modulus(0.02)))


@given(
    thicknesses=st.lists(st.floats(1e-4, 0.05), min_size=1, max_size=5),
    speed=st.floats(1.0, 100.0),
)
def test_slabs_add_up(thicknesses, speed):
    slabs = [
        Layer(thickness=thickness, wave_speed=speed * (1 + n), density=500.0 * (1 + n))
        for n, thickness in enumerate(thicknesses)
    ]
    stack = GradedLayer.stack(*slabs)
    assert stack.thickness == pytest.approx(sum(slab.thickness for slab in slabs))
    assert stack.mass == pytest.approx(sum(slab.mass for slab in slabs))
    assert stack.crossing_time == pytest.approx(sum(slab.crossing_time for slab in slabs))
    assert 1.0 / stack.stiffness == pytest.approx(sum(1.0 / slab.stiffness for slab in slabs))
    assert stack.impedance == pytest.approx(slabs[-1].impedance)
    cut = [np.ptp(piece.heights) for piece in stack.pieces()]
    assert cut == pytest.approx(thicknesses)


@pytest.mark.parametrize('count', [1, 2, 7, 100])
def test_pieces_are_cut_into_equal_travel_times(count):
    (piece,) = make_graded().pieces()
    edges = piece.cut(count)
    assert edges.size == count + 1
    assert (edges[0], edges[-1]) == (0.0, 0.02)
    times = np.diff(piece.integrals(edges)[0])
    assert times == pytest.approx(np.full(count, piece.crossing_time / count), rel=1e-9)


def test_rig_takes_a_graded_layer_and_the_exact_models_refuse_it():
    rig = Rig(layer=make_graded())
    assert rig.mass_ratio == pytest.approx(rig.projectile.mass / rig.layer.mass)
    assert rig.static_sag == pytest.approx(rig.projectile.mass * 9.81 / rig.layer.stiffness)
    for model in (follow, Stepper):
        with pytest.raises(ValueError, match=r'needs a layer of one material; .*GradedLayer'):
            model(rig)


def test_what_is_derived_cannot_be_replaced():
    layer = make_graded()
    assert replace(layer, diameter=0.02).mass == pytest.approx(layer.mass / 0.36)
    with pytest.raises(ValueError, match='thickness'):
        replace(layer, thickness=0.01)


def table(**changes):
    return GradedLayer(
        **{
            'heights': (0.0, 0.01, 0.01, 0.02),
            'densities': (1e3,) * 4,
            'youngs_moduli': (6e4, 6e4, 9e4, 9e4),
            **changes,
        }
    )


@pytest.mark.parametrize(
    ('make', 'message'),
    [
        (lambda: table(heights=(0.001, 0.01, 0.01, 0.02)), r'must begin at 0, got 0\.001'),
        (
            lambda: table(heights=(0.0, 0.01, 0.005, 0.02)),
            r'must increase.* got 0\.005 after 0\.01',
        ),
        (lambda: table(heights=(0.0, 0.01, 0.01, 0.01)), r'got 0\.01 after 0\.01'),
        (lambda: table(heights=(0.0, 0.0, 0.01, 0.02)), r'a slab at both ends, got 0 after 0'),
        (lambda: table(heights=(0.0, 0.01, 0.02, 0.02)), r'a slab at both ends, got 0\.02 after'),
        (lambda: table(heights=(0.0,)), 'layer.heights must have .* at least 2, got 1 and 1'),
        (lambda: table(densities=(1e3, 1e3)), 'layer.densities must have .* got 2 and 4'),
        (lambda: table(densities=(1e3, -1.0, 1e3, 1e3)), r'layer.densities .* got -1\.0'),
        (lambda: table(youngs_moduli=(6e4, 0.0, 9e4, 9e4)), r'youngs_moduli .* got 0\.0'),
        (lambda: table(loss_tangents=(0.0, -0.1, 0.0, 0.0)), r'loss_tangents .* got -0\.1'),
        (lambda: table(diameter=math.nan), 'layer.diameter must be finite, got nan'),
        (GradedLayer.stack, 'at least one slab, got none'),
        (
            lambda: GradedLayer.stack(Layer(), Layer(diameter=0.02)),
            r'of one diameter, got 0\.012 m and 0\.02 m',
        ),
        (lambda: make_graded(points=1), 'points must be at least 2, got 1'),
        (lambda: make_graded(thickness=-1.0), r'thickness must be .* got -1\.0'),
    ],
)
def test_nonsense_is_refused_with_the_value(make, message):
    with pytest.raises(ValueError, match=message):
        make()
