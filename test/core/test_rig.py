# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""The components of a rig, also a layer of sheets: derived quantities and refused values."""

from dataclasses import replace
import math

from hypothesis import given
from hypothesis import strategies as st
import pytest
from soft_throw_ros.core.material import relaxation
from soft_throw_ros.core.rig import Engine, Layer, Projectile, Rig
from soft_throw_ros.core.wave_stepper import WaveStepper


def test_derived_quantities_agree_with_the_rig_of_the_paper():
    rig = Rig(layer=Layer(thickness=16.8e-3, wave_speed=7.8))
    assert rig.mass_ratio == pytest.approx(1.3 * 8.2 / 16.8)
    assert rig.speed_ratio == pytest.approx(7.8 / (16.8e-3 * 63.2))
    assert rig.crossing_time == pytest.approx(16.8e-3 / 7.8)
    assert rig.relaxation_time == pytest.approx(rig.mass_ratio * rig.crossing_time)
    assert rig.layer.youngs_modulus == pytest.approx(1000.0 * 7.8**2)
    ratio = rig.speed_ratio / (2.0 * math.pi * math.sqrt(rig.mass_ratio))
    assert rig.natural_frequency / 63.2 == pytest.approx(ratio)
    acceleration = 2e-3 * (2.0 * math.pi * 63.2) ** 2
    assert rig.gravity_ratio == pytest.approx(9.81 / acceleration)


@pytest.mark.parametrize(
    ('component', 'name', 'bad'),
    [
        *((Engine, name, math.nan) for name in ('frequency', 'amplitude')),
        *((Layer, name, math.inf) for name in ('thickness', 'wave_speed', 'density', 'diameter')),
        *((Projectile, name, 0.0) for name in ('mass', 'length')),
        (Engine, 'damping_ratio', 1.0), (Engine, 'damping_ratio', -0.1),
        (Layer, 'loss_tangent', -0.02), (Layer, 'stress_strain_law', 'rubber'),
        (Layer, 'thickness', '16.8 mm'), (Layer, 'thickness', True), (Layer, 'loss', 'none'),
    ],
)
def test_components_refuse_and_quote_bad_values(component, name, bad):
    with pytest.raises(ValueError, match=f'{component.__name__.lower()}.{name}.*got {bad!r}'):
        component(**{name: bad})


@pytest.mark.parametrize(
    ('loss', 'relaxed'), [('kelvin_voigt', 1.0), ('constant', relaxation(0.2)[0])]
)
def test_soft_thick_layer_rests_on_its_relaxed_modulus(loss, relaxed):
    rig = Rig(layer=Layer(thickness=0.05, wave_speed=3.0, loss_tangent=0.2, loss=loss))
    sag = rig.projectile.mass * rig.gravity / (relaxed * rig.layer.stiffness)
    assert rig.rest_height == pytest.approx(0.05 - sag, rel=1e-12)
    assert relaxed in (1.0, pytest.approx(0.673, abs=1e-3))


def test_neo_hookean_layer_carries_the_weight_at_rest():
    layer = Layer(thickness=0.05, wave_speed=3.0, stress_strain_law='neo_hookean')
    weight = 0.1 * layer.youngs_modulus * layer.section
    stretch = 1.0 - layer.static_strain(weight)
    assert (stretch**-2 - stretch) / 3.0 == pytest.approx(0.1, rel=1e-12)
    assert Layer.of_sheets((layer, layer)).static_strain(weight) == pytest.approx(1.0 - stretch)


def test_equal_sheets_agree_with_a_layer_of_one_material():
    layer = Layer(thickness=0.012, wave_speed=9.0, density=1100.0, loss_tangent=0.03)
    stack = Layer.of_sheets((replace(layer, thickness=0.004),) * 3)
    for name in (
        'thickness', 'wave_speed', 'density', 'diameter', 'loss_tangent', 'section', 'mass',
        'youngs_modulus', 'impedance', 'stiffness', 'crossing_time',
    ):
        assert getattr(stack, name) == pytest.approx(getattr(layer, name), rel=1e-14), name
    assert layer.sheets == (layer,)
    assert stack.needs_cells
    assert Layer.of_sheets([layer]) is layer


@given(
    thicknesses=st.lists(st.floats(1e-4, 0.05), min_size=2, max_size=5),
    speed=st.floats(1.0, 100.0),
)
def test_sheets_add_up(thicknesses, speed):
    sheets = tuple(
        Layer(thickness=thickness, wave_speed=speed * (1 + n), density=500.0 * (1 + n))
        for n, thickness in enumerate(thicknesses)
    )
    stack = Layer.of_sheets((Layer.of_sheets(sheets[:-1]), sheets[-1]))
    assert stack.sheets == sheets
    for name in ('thickness', 'mass', 'crossing_time'):
        total = sum(getattr(sheet, name) for sheet in sheets)
        assert getattr(stack, name) == pytest.approx(total)
    assert 1.0 / stack.stiffness == pytest.approx(sum(1.0 / sheet.stiffness for sheet in sheets))
    assert stack.impedance == pytest.approx(sheets[-1].impedance)


@pytest.mark.parametrize(
    ('make', 'argument', 'message'),
    [
        (lambda gravity: Rig(gravity=gravity), -1.0, '^gravity .*-1'),
        (lambda layer: Rig(layer=layer), 5, '^layer .*Layer.*5'),
        (lambda engine: Rig(engine=engine), Layer(), '^engine .*Engine'),
        (lambda projectile: Rig(projectile=projectile), None, '^projectile .*None'),
        (Layer.of_sheets, (Layer(), Layer(diameter=0.02)), r'0\.012 m and 0\.02 m'),
        (Layer.of_sheets, (Layer(), Layer(loss='constant')), 'one loss, got kelvin_voigt and con'),
        (WaveStepper, Rig(layer=Layer.of_sheets((Layer(), Layer(wave_speed=20.0)))), '2 sheets'),
    ],
)
def test_what_does_not_fit_together_is_refused_with_the_value(make, argument, message):
    with pytest.raises(ValueError, match=message):
        make(argument)
