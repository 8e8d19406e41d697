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
"""The parts of a rig: what is derived from them, and what they refuse."""

import math

import pytest
from soft_throw_ros.core.rig import Engine, Layer, Projectile, Rig


def test_derived_quantities_are_those_of_the_papers_rig():
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
    ('part', 'name'),
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
def test_parts_refuse_what_is_not_positive_and_quote_it(part, name, bad):
    with pytest.raises(ValueError, match=f'{part.__name__.lower()}.{name}.*got {bad}'):
        part(**{name: bad})


@pytest.mark.parametrize(
    ('make', 'message'),
    [
        (lambda: Engine(damping_ratio=1.0), r'engine\.damping_ratio .*got 1\.0'),
        (lambda: Engine(damping_ratio=-0.1), r'engine\.damping_ratio .*got -0\.1'),
        (lambda: Layer(loss_tangent=-0.02), r'layer\.loss_tangent .*got -0\.02'),
        (lambda: Rig(gravity=-9.81), r'rig\.gravity .*got -9\.81'),
        (lambda: Layer(thickness='16.8 mm'), r"layer\.thickness must be a number, got '16.8 mm'"),
        (lambda: Layer(thickness=True), r'layer\.thickness must be a number, got True'),
    ],
)
def test_parts_refuse_other_nonsense_and_quote_it(make, message):
    with pytest.raises(ValueError, match=message):
        make()
