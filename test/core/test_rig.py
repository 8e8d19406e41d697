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
"""The components of a rig: their derived quantities and refused values."""

import math

import numpy as np
import pytest
from soft_throw_ros.core.material import relaxation
from soft_throw_ros.core.plate import SampledMotion, Underdamped
from soft_throw_ros.core.rig import Engine, Layer, Projectile, Rig, Stack


def test_derived_quantities_agree_with_the_rig_of_the_paper():
    rig = Rig(layer=Layer(thickness=16.8e-3, wave_speed=7.8))
    assert rig.mass_ratio == pytest.approx(1.3 * 8.2 / 16.8)
    assert rig.speed_ratio == pytest.approx(7.8 / (16.8e-3 * 63.2))
    assert rig.crossing_time == pytest.approx(16.8e-3 / 7.8)
    assert rig.relaxation_time == pytest.approx(rig.mass_ratio * rig.crossing_time)
    assert rig.layer.youngs_modulus == pytest.approx(1000.0 * 7.8**2)
    ratio = rig.speed_ratio / (2.0 * math.pi * math.sqrt(rig.mass_ratio))
    assert rig.natural_frequency / 63.2 == pytest.approx(ratio)
    stiffness = rig.layer.youngs_modulus * rig.layer.section / rig.layer.thickness
    assert rig.static_sag == pytest.approx(rig.projectile.mass * 9.81 / stiffness)
    assert Rig(engine=Engine(damping_ratio=0.0), gravity=0.0).gravity_ratio == 0.0


@pytest.mark.parametrize('bad', [math.nan, math.inf, 0.0])
@pytest.mark.parametrize(
    ('component', 'name'),
    [
        (Engine, 'frequency'),
        (Engine, 'amplitude'),
        (Layer, 'thickness'),
        (Layer, 'wave_speed'),
        (Layer, 'density'),
        (Layer, 'diameter'),
        (Projectile, 'mass'),
        (Projectile, 'length'),
        (Projectile, 'youngs_modulus'),
    ],
)
def test_components_refuse_and_quote_values_that_are_not_positive(component, name, bad):
    with pytest.raises(ValueError, match=f'{component.__name__.lower()}.{name}.*got {bad}'):
        component(**{name: bad})


@pytest.mark.parametrize(
    ('component', 'name', 'bad'),
    [
        (Engine, 'damping_ratio', 1.0),
        (Engine, 'damping_ratio', -0.1),
        (Layer, 'loss_tangent', -0.02),
        (Rig, 'gravity', -9.81),
        (Layer, 'thickness', '16.8 mm'),
        (Layer, 'thickness', True),
        (Layer, 'stress_strain_law', 'rubber'),
        (Layer, 'loss', 'none'),
    ],
)
def test_components_refuse_and_quote_other_bad_values(component, name, bad):
    with pytest.raises(ValueError, match=f'{component.__name__.lower()}.{name}.*got {bad!r}'):
        component(**{name: bad})


@pytest.mark.parametrize(
    ('loss', 'relaxed'), [('kelvin_voigt', 1.0), ('constant', relaxation(0.2).relaxed)]
)
def test_soft_thick_layer_rests_on_its_relaxed_modulus(loss, relaxed):
    layer = Layer(thickness=0.05, wave_speed=3.0, loss_tangent=0.2, loss=loss)
    rig = Rig(layer=layer)
    sag = rig.projectile.mass * rig.gravity / (relaxed * layer.stiffness)
    assert rig.static_sag == pytest.approx(sag, rel=1e-12)
    assert rig.rest_height == pytest.approx(0.05 - sag, rel=1e-12)
    assert relaxed in (1.0, pytest.approx(0.673, abs=1e-3))


def test_neo_hookean_layer_carries_the_weight_at_rest():
    layer = Layer(thickness=0.05, wave_speed=3.0, stress_strain_law='neo_hookean')
    weight = 0.1 * layer.youngs_modulus * layer.section
    stretch = 1.0 - layer.static_strain(weight)
    assert (stretch**-2 - stretch) / 3.0 == pytest.approx(0.1, rel=1e-12)
    assert Stack(sheets=(layer, layer)).static_strain(weight) == pytest.approx(1.0 - stretch)


def test_waves_become_shocks_after_c_over_a_except_in_linear_layers():
    layer = Layer(stress_strain_law='neo_hookean')
    acceleration = 2e-3 * (2.0 * math.pi * 63.2) ** 2
    assert Rig().shock_time == math.inf
    assert Rig(layer=layer).shock_time == pytest.approx(7.8 / acceleration)
    assert Rig(layer=Stack(sheets=(layer, layer))).shock_time == pytest.approx(7.8 / acceleration)
    plate, times = Underdamped.of(Engine(damping_ratio=0.0)), np.arange(0.0, 0.05, 2e-4)
    motion = SampledMotion.from_positions(times, plate.position(times))
    shock_time = Rig(engine=Engine(motion=motion), layer=layer).shock_time
    assert shock_time == pytest.approx(7.8 / acceleration, rel=0.05)
