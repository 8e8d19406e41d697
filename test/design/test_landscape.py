# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Landscapes, against single throws, exact values and other readers of the files."""

from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
import math

import numpy as np
import pytest
from reference.cases import exact_release
from soft_throw_ros.core.closed_form import first_releases
from soft_throw_ros.core.plate import SampledMotion
from soft_throw_ros.core.rig import Engine, Layer, Projectile, Rig
from soft_throw_ros.core.throw import rig_with
from soft_throw_ros.design.landscape import compute_landscape

HARMONIC = Rig(engine=Engine(damping_ratio=0.0), gravity=0.0)
PARAMETERS = {
    'layer.thickness': (2e-3, 0.03),
    'layer.wave_speed': (4.0, 30.0),
    'layer.density': (300.0, 3000.0),
    'layer.diameter': (5e-3, 0.03),
    'projectile.mass': (5e-4, 5e-3),
    'engine.frequency': (20.0, 90.0),
    'engine.amplitude': (5e-4, 5e-3),
    'engine.damping_ratio': (0.0, 0.3),
    'gravity': (0.0, 10.0),
}


def test_axes_of_the_paper_are_equivalent_to_the_ratios():
    rig = Rig(gravity=0.0)
    mu, x = 0.4, 1.3 / 1.7
    for axes, coordinates in (
        ({'mu': [mu], 'kappa': [9.0]}, (mu, 9.0)),
        ({'x': [x], 'C': [9.0 * x]}, (x, 9.0 * x)),
        ({'C': [9.0 * x], 'x': [x]}, (9.0 * x, x)),
        ({'mu': [mu], 'C': [9.0 * x]}, (mu, 9.0 * x)),
        ({'kappa': [9.0], 'x': [x]}, (9.0, x)),
    ):
        landscape = compute_landscape(rig, axes)
        release = first_releases(mass_ratio=mu, speed_ratio=9.0, damping_ratio=0.064)
        assert landscape.energy_transfer[0, 0] == pytest.approx(release.energy_transfer, rel=1e-12)
        like = replace(
            rig,
            projectile=Projectile(mass=mu * rig.layer.mass),
            layer=replace(rig.layer, wave_speed=9.0 * rig.layer.thickness * 63.2),
        )
        assert landscape.coordinates_of(like) == pytest.approx(coordinates, rel=1e-12)


def test_executors_give_the_same_map():
    axes = {'mu': np.geomspace(0.05, 5.0, 20), 'kappa': np.linspace(3.0, 20.0, 21)}
    rig = Rig(layer=Layer(loss_tangent=0.05))
    serial = compute_landscape(rig, axes)
    with ThreadPoolExecutor(3) as executor:
        parallel = compute_landscape(rig, axes, run=executor.map)
    np.testing.assert_array_equal(parallel.energy_transfer, serial.energy_transfer)
    np.testing.assert_array_equal(parallel.ejection_phase, serial.ejection_phase)


def test_netcdf_is_read_back_by_xarray(tmp_path):
    xarray = pytest.importorskip('xarray', reason='comes with the extra [test]')
    landscape = compute_landscape(
        replace(Rig(), engine=Engine(frequency=1.0, amplitude=0.05)),
        {'layer.thickness': [0.005, 0.01, 0.02], 'gravity': [0.0, 0.2, 4.0, 30.0]},
    )
    landscape.save(tmp_path / 'map.nc')
    assert 0 < np.isnan(landscape.energy_transfer).sum() < landscape.energy_transfer.size
    with xarray.open_dataset(tmp_path / 'map.nc', engine='scipy') as data:
        assert data.energy_transfer.dims == ('layer_thickness', 'gravity')
        assert data.layer_thickness.attrs['units'] == 'm'
        assert 'Thickness' in data.layer_thickness.attrs['long_name']
        for name in ('energy_transfer', 'ejection_phase'):
            np.testing.assert_array_equal(data[name], getattr(landscape, name))
        assert data.attrs['engine_frequency'] == 1.0


@pytest.mark.parametrize('name', PARAMETERS)
def test_every_point_agrees_with_a_throw_of_its_rig(name):
    names = list(PARAMETERS)
    other = names[(names.index(name) + 4) % len(names)]
    random = np.random.default_rng(4)
    axes = {key: np.sort(random.uniform(*PARAMETERS[key], 3)) for key in (name, other)}
    landscape = compute_landscape(Rig(), axes)
    for i, j in np.ndindex(3, 3):
        values = (float(axes[name][i]), float(axes[other][j]))
        keys = (key.rpartition('.')[2] for key in (name, other))
        rig = rig_with(Rig(), dict(zip(keys, values, strict=True)))
        release = exact_release(rig)
        results = landscape.ejection_phase[i, j], landscape.energy_transfer[i, j]
        expected = release.ejection_phase, release.energy_transfer
        assert results == pytest.approx(expected, rel=1e-9)
        assert landscape.coordinates_of(rig) == values


def test_loss_may_be_an_axis_that_begins_at_zero():
    axes = {'layer.loss_tangent': [0.0, 0.05], 'layer.thickness': [0.01, 0.0168]}
    rig = replace(HARMONIC, layer=Layer(loss_tangent=0.05))
    landscape = compute_landscape(rig, axes)
    lossless = {'engine.amplitude': [2e-3], 'layer.thickness': axes['layer.thickness']}
    exact = compute_landscape(HARMONIC, lossless).energy_transfer[0]
    np.testing.assert_allclose(landscape.energy_transfer[0], exact, rtol=2e-3)
    # computed with 40 digits and by a second method
    assert landscape.ejection_phase[1, 1] == pytest.approx(0.46694752928793415, abs=1e-3)
    assert landscape.energy_transfer[1, 1] == pytest.approx(1.8077831318189745**2, rel=2e-3)


MOVED = Rig(engine=Engine(motion=SampledMotion(
    np.array([0.0, 0.01]), np.array([[0.0, 0.0, 0.0], [1e-3, 1.0, 0.0]])
)))


@pytest.mark.parametrize(
    ('axes', 'rig', 'message'),
    [
        ({'x': [0.5], 'C': [math.nan]}, Rig(), 'C must be .* got nan'),
        ({'x': [0.5], 'C': [2.0, 1.0]}, Rig(), r'C must be increasing .* got \[2\. 1\.\]'),
        ({'x': [0.5], 'mu': [1.0]}, Rig(), 'x and mu are not independent'),
        ({'mu': [1.0], 'layer.thickness': [0.01]}, Rig(), 'combined with .*, got mu and layer'),
        ({'layer.thickness': [0.2], 'gravity': [5.0]}, Rig(), r'thickness .* 0.1 m, got 0\.2'),
        ({'engine.damping_ratio': [0.1], 'gravity': [9.81]}, MOVED, 'by a file'),
    ],
)
def test_refused_requests_are_quoted(axes, rig, message):
    with pytest.raises(ValueError, match=message):
        compute_landscape(rig, axes)
