# SPDX-License-Identifier: Apache-2.0
"""Landscapes, against single throws, exact values and other readers of the files."""

from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
import json
import math
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.io import netcdf_file
from soft_throw_ros.configuration import TWIN
from soft_throw_ros.core import spring_mass
from soft_throw_ros.core.rig import Engine, Layer, Projectile, Rig
from soft_throw_ros.core.throw import simulate
from soft_throw_ros.core.travelling_wave import first_release
from soft_throw_ros.design import landscape as module
from soft_throw_ros.design.landscape import AXES, Axis, MODELS, survey
from soft_throw_ros.design.recommendation import predict
from soft_throw_ros.design.sweep import Checkpoint

HARMONIC = Rig(engine=Engine(damping_ratio=0.0), gravity=0.0)


def changed(rig, name, value):
    """Return a rig with another value of a parameter."""
    part, _, field = name.rpartition('.')
    if not part:
        return replace(rig, **{field: value})
    return replace(rig, **{part: replace(getattr(rig, part), **{field: value})})


def release_of(rig):
    return first_release(
        mass_ratio=rig.mass_ratio,
        speed_ratio=rig.speed_ratio,
        damping_ratio=rig.engine.damping_ratio,
        gravity_ratio=rig.gravity_ratio,
    )


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


@pytest.mark.parametrize('shift', range(1, 5))
@pytest.mark.parametrize('name', PARAMETERS)
def test_every_point_is_the_throw_of_that_rig(name, shift):
    names = list(PARAMETERS)
    other = names[(names.index(name) + shift) % len(names)]
    random = np.random.default_rng(shift)
    axes = {key: np.sort(random.uniform(*PARAMETERS[key], 3)) for key in (name, other)}
    landscape = survey(Rig(), axes)
    for i, first in enumerate(axes[name].tolist()):
        for j, second in enumerate(axes[other].tolist()):
            rig = changed(changed(Rig(), name, first), other, second)
            release = release_of(rig)
            assert landscape.ejection_phase[i, j] == pytest.approx(
                release.ejection_phase, rel=0.0, abs=1e-13
            )
            assert landscape.energy_transfer[i, j] == pytest.approx(
                release.energy_transfer, rel=1e-13
            )
            assert landscape.place(rig) == (first, second)


def test_axes_of_the_paper_are_the_ratios_by_other_names():
    rig = Rig(gravity=0.0)
    mu, x = 0.4, 1.3 / 1.7
    for axes, place in (
        ({'mu': [mu], 'kappa': [9.0]}, (mu, 9.0)),
        ({'x': [x], 'C': [9.0 * x]}, (x, 9.0 * x)),
        ({'C': [9.0 * x], 'x': [x]}, (9.0 * x, x)),
        ({'mu': [mu], 'C': [9.0 * x]}, (mu, 9.0 * x)),
        ({'kappa': [9.0], 'x': [x]}, (9.0, x)),
    ):
        landscape = survey(rig, axes, density_ratio=1.3)
        release = first_release(mass_ratio=mu, speed_ratio=9.0, damping_ratio=0.064)
        assert landscape.energy_transfer[0, 0] == pytest.approx(release.energy_transfer, rel=1e-12)
        like = replace(
            rig,
            projectile=Projectile(mass=mu * rig.layer.mass),
            layer=replace(rig.layer, wave_speed=9.0 * rig.layer.thickness * 63.2),
        )
        assert landscape.place(like) == pytest.approx(place, rel=1e-12)


def test_density_ratio_is_that_of_the_rig_unless_given():
    assert survey(Rig(), {'x': [0.5], 'C': [5.0]}).density_ratio == pytest.approx(1.3)
    assert survey(Rig(), {'x': [0.5], 'C': [5.0]}, density_ratio=1.0).density_ratio == 1.0


# Maxima that the paper reports or should have, computed with 40 digits: PHYSICS of the paper's
# equal densities, those of its rig, and with damping.
@pytest.mark.parametrize(
    ('axes', 'damping_ratio', 'density_ratio', 'place', 'phase', 'alpha'),
    [
        (('mu', 'kappa'), 0.0, 1.3, (0.234231, 8.242210), 0.399440, 4.123215),
        (('mu', 'kappa'), 0.064, 1.3, (0.255397, 8.575921), 0.386675, 4.142897),
        (('mu', 'kappa'), 0.2, 1.3, (0.295132, 9.243476), 0.363366, 4.185170),
        (('x', 'C'), 0.0, 1.0, (0.810221, 6.678011), 0.399440, 4.123215),
        (('x', 'C'), 0.0, 1.3, (0.847336, 6.983917), 0.399440, 4.123215),
    ],
)
def test_summit_is_where_it_should_be(axes, damping_ratio, density_ratio, place, phase, alpha):
    rig = Rig(engine=Engine(damping_ratio=damping_ratio), gravity=0.0)
    wide = {'mu': (0.02, 2.0), 'kappa': (2.0, 20.0), 'x': (0.02, 0.99), 'C': (0.1, 14.0)}
    landscape = survey(
        rig, {name: np.linspace(*wide[name], 150) for name in axes}, density_ratio=density_ratio
    )
    assert landscape.summit.place == pytest.approx(place, rel=0.05)
    near = {
        name: np.linspace(0.99 * value, 1.01 * value, 41)
        for name, value in zip(axes, place, strict=True)
    }
    summit = survey(rig, near, density_ratio=density_ratio).summit
    assert summit.place == pytest.approx(place, rel=1e-3)
    assert summit.ejection_phase == pytest.approx(phase, abs=3e-4)
    assert summit.energy_transfer == pytest.approx(alpha, rel=1e-6)


def test_last_release_is_that_of_the_throw_after_its_recontacts():
    # The paper's rig at 31.1 Hz: alpha 0.499 first, and 1.241 in the end, with 2.0 mm
    rig = replace(HARMONIC, engine=Engine(frequency=31.1, damping_ratio=0.0))
    axes = {'layer.thickness': [2e-3, 5.6e-3], 'layer.wave_speed': [5.0, 7.8]}
    first = survey(rig, axes)
    last = survey(rig, axes, release='last')
    assert first.energy_transfer[0, 1] == pytest.approx(0.499, abs=5e-4)
    assert last.energy_transfer[0, 1] == pytest.approx(1.241, abs=5e-4)


@pytest.mark.parametrize('gravity', [0.0, 9.81])
def test_last_release_agrees_with_the_method_of_steps(gravity):
    rig = Rig(engine=Engine(frequency=31.1), gravity=gravity)
    thicknesses, speeds = np.array([2e-3, 7e-3, 0.02]), np.array([1.5, 8.0])
    landscape = survey(
        rig, {'layer.thickness': thicknesses, 'layer.wave_speed': speeds}, release='last'
    )
    recontacts = 0
    for i, thickness in enumerate(thicknesses):
        for j, speed in enumerate(speeds):
            throw = simulate(
                replace(rig, layer=Layer(thickness=float(thickness), wave_speed=float(speed)))
            )
            recontacts += throw.recontacts
            assert landscape.energy_transfer[i, j] == pytest.approx(
                throw.last_energy_transfer, rel=1e-6
            )
            assert landscape.ejection_phase[i, j] == pytest.approx(
                throw.last_release.time * 31.1, abs=1e-6
            )
    assert recontacts >= 2


@pytest.mark.parametrize('model', ['finite_difference', 'finite_difference_elastic'])
def test_last_release_by_finite_differences_agrees_with_the_travelling_wave(model):
    # 2 mm at 31.1 Hz: released, caught again, and released
    rig = replace(HARMONIC, engine=Engine(frequency=31.1, damping_ratio=0.0))
    axes = {'layer.thickness': [2e-3, 9.5e-3], 'layer.wave_speed': [7.8, 9.0]}
    exact = survey(rig, axes, release='last')
    first = survey(rig, axes)
    assert (exact.energy_transfer > first.energy_transfer + 0.5).any()
    landscape = survey(rig, axes, model=model, release='last')
    np.testing.assert_allclose(landscape.energy_transfer, exact.energy_transfer, rtol=2e-4)
    np.testing.assert_allclose(landscape.ejection_phase, exact.ejection_phase, rtol=2e-4)


def test_last_release_with_loss_is_that_of_a_throw_simulated_finely():
    rig = replace(
        HARMONIC,
        engine=Engine(frequency=31.1, damping_ratio=0.0),
        layer=Layer(thickness=2e-3, loss_tangent=0.005),
    )
    axes = {'layer.loss_tangent': [0.0, 0.005], 'engine.amplitude': [2e-3]}
    landscape = survey(rig, axes, model='finite_difference', release='last')
    throw = simulate(rig, model='finite_difference', cells=300)
    assert throw.recontacts > 0
    assert landscape.energy_transfer[1, 0] == pytest.approx(throw.last_energy_transfer, rel=1e-4)
    assert landscape.energy_transfer[0, 0] > landscape.energy_transfer[1, 0]


def test_loss_may_be_an_axis_that_begins_without():
    axes = {'layer.loss_tangent': [0.0, 1e-4, 0.1], 'layer.thickness': [0.01, 0.0168]}
    landscape = survey(Rig(), axes, model='normal_modes')
    for thickness, transfer in zip((0.01, 0.0168), landscape.energy_transfer.T, strict=True):
        layer = Layer(thickness=thickness)
        assert transfer[0] == pytest.approx(simulate(Rig(layer=layer)).energy_transfer, rel=1e-9)
        assert transfer[1] == pytest.approx(transfer[0], rel=1e-3)
        lossy = replace(layer, loss_tangent=0.1)
        assert transfer[2] == predict(Rig(layer=lossy)).energy_transfer


def test_projectile_that_is_held_or_too_light_is_nan():
    # Gravity five times what the plate's acceleration is
    rig = replace(Rig(), engine=Engine(frequency=1.0, amplitude=1e-3))
    axes = {'layer.thickness': [0.01], 'layer.wave_speed': [5.0, 10.0]}
    for release in ('first', 'last'):
        held = survey(rig, axes, release=release)
        assert np.isnan(held.energy_transfer).all()
        assert np.isnan(held.ejection_phase).all()
        assert held.summit is None
    light = survey(HARMONIC, {'mu': [1e-9, 0.2], 'kappa': [8.0]}, release='last')
    np.testing.assert_array_equal(np.isnan(light.energy_transfer), [[True], [False]])


def test_spring_mass_is_a_line_in_one_number_and_says_what_it_leaves_out():
    axes = {'mu': np.geomspace(0.1, 10.0, 5), 'kappa': np.geomspace(2.0, 40.0, 6)}
    landscape = survey(Rig(), axes, model='spring_mass')
    ratios = axes['kappa'][None, :] / (2.0 * math.pi * np.sqrt(axes['mu'][:, None]))
    expected = spring_mass.first_release(frequency_ratio=ratios)
    np.testing.assert_allclose(landscape.energy_transfer, expected.energy_transfer, rtol=1e-13)
    assert landscape.left_out == ('engine.damping_ratio', 'gravity')
    assert survey(HARMONIC, axes, model='spring_mass').left_out == ()
    assert survey(Rig(), axes).left_out == ()


def test_loss_is_that_of_exact_values():
    # Computed with 40 digits and by a second method; the best without loss is no longer
    rig = replace(HARMONIC, layer=Layer(loss_tangent=0.05))
    axes = {'mu': [0.6345238095238095], 'kappa': [7.34629294755877]}
    for model, accuracy in (('normal_modes', 1e-8), ('finite_difference', 1e-3)):
        landscape = survey(rig, axes, model=model)
        assert landscape.ejection_phase[0, 0] == pytest.approx(0.46694752928793415, abs=accuracy)
        assert landscape.energy_transfer[0, 0] == pytest.approx(
            1.8077831318189745**2, rel=2 * accuracy
        )


def test_loss_moves_the_summit_to_the_thick_soft_layer():
    axes = {'mu': np.geomspace(0.005, 1.0, 24), 'kappa': np.linspace(4.0, 10.0, 25)}
    lossy = survey(
        replace(HARMONIC, layer=Layer(loss_tangent=0.02)), axes, model='normal_modes'
    ).summit
    assert lossy.place == pytest.approx((0.005, 5.75), abs=0.3)
    assert lossy.energy_transfer == pytest.approx(3.91, abs=0.01)


def test_finite_differences_agree_with_the_exact_landscape():
    axes = {'x': np.linspace(0.2, 0.9, 6), 'C': np.linspace(2.0, 12.0, 5)}
    exact = survey(Rig(), axes)
    for model in ('finite_difference', 'finite_difference_elastic'):
        landscape = survey(Rig(), axes, model=model)
        np.testing.assert_allclose(landscape.energy_transfer, exact.energy_transfer, rtol=2e-3)
        np.testing.assert_allclose(landscape.ejection_phase, exact.ejection_phase, atol=1e-3)
    assert (landscape.energy_transfer != survey(Rig(), axes, model='finite_difference')).any()


def test_elastic_projectile_gets_the_crossing_time_of_its_bar():
    # c_r is 1664 m/s and L_r 8.2 mm, by the density of 1300 kg/m3
    rig = Rig()
    assert module._ratios(rig, {}, 1.3)['crossing_ratio'] == pytest.approx(
        (8.2e-3 / 1664.1) / rig.crossing_time, rel=1e-4
    )


def test_executors_give_the_same_map():
    axes = {'mu': np.geomspace(0.05, 5.0, 20), 'kappa': np.linspace(3.0, 20.0, 21)}
    here = survey(Rig(), axes, release='last')
    with ThreadPoolExecutor(3) as executor:
        there = survey(Rig(), axes, release='last', executor=executor)
    np.testing.assert_array_equal(there.energy_transfer, here.energy_transfer)
    np.testing.assert_array_equal(there.ejection_phase, here.ejection_phase)


def test_map_that_was_broken_off_goes_on_and_is_the_same(tmp_path):
    axes = {'mu': np.geomspace(0.05, 5.0, 30), 'kappa': np.linspace(3.0, 20.0, 21)}
    done = []

    def break_off(count):
        done.append(count)
        raise KeyboardInterrupt

    def compute(progress, **options):
        with Checkpoint(tmp_path / 'map.nc') as checkpoint:
            return survey(
                Rig(), axes, release='last', progress=progress, checkpoint=checkpoint, **options
            )

    with pytest.raises(KeyboardInterrupt):
        compute(break_off)
    assert len(list(tmp_path.iterdir())) == 1
    with pytest.raises(KeyboardInterrupt):
        compute(break_off)  # tells first what was done before
    assert done == [32, 32]
    again = []
    landscape = compute(again.append)
    assert (again[0], sum(again)) == (32, 630)
    uninterrupted = survey(Rig(), axes, release='last')
    np.testing.assert_array_equal(landscape.energy_transfer, uninterrupted.energy_transfer)
    assert list(tmp_path.iterdir()) == []


@pytest.fixture(scope='module')
def saved(tmp_path_factory):
    """Save a landscape in both forms; give it and the folder."""
    landscape = survey(
        replace(Rig(), engine=Engine(frequency=1.0, amplitude=0.05)),
        {'layer.thickness': [0.005, 0.01, 0.02], 'gravity': [0.0, 0.2, 4.0, 30.0]},
    )
    folder = tmp_path_factory.mktemp('landscape')
    landscape.save(folder / 'map.npz')
    landscape.save(folder / 'map.nc')
    return landscape, folder


def test_saved_map_has_gaps(saved):
    landscape, folder = saved
    assert 0 < np.isnan(landscape.energy_transfer).sum() < landscape.energy_transfer.size
    assert {path.name for path in folder.iterdir()} == {'map.npz', 'map.nc'}


def test_npz_is_read_back_by_numpy(saved):
    landscape, folder = saved
    with np.load(folder / 'map.npz') as file:
        np.testing.assert_array_equal(file['energy_transfer'], landscape.energy_transfer)
        np.testing.assert_array_equal(file['ejection_phase'], landscape.ejection_phase)
        attributes = json.loads(str(file['attributes']))
        for key, axis in zip(attributes['dimensions'], landscape.axes, strict=True):
            np.testing.assert_array_equal(file[key], axis.values)
    assert attributes['model'] == 'travelling_wave'
    assert attributes['engine_frequency'] == 1.0


@pytest.mark.parametrize('engine', ['scipy', 'netcdf4'])
def test_netcdf_is_read_back_by_xarray(saved, engine):
    xarray = pytest.importorskip('xarray', reason='comes with the extra [test]')
    pytest.importorskip(
        {'netcdf4': 'netCDF4'}.get(engine, engine), reason='comes with the extra [test]'
    )
    landscape, folder = saved
    with xarray.open_dataset(folder / 'map.nc', engine=engine) as data:
        assert data.energy_transfer.dims == ('layer_thickness', 'gravity')
        assert data.layer_thickness.attrs['units'] == 'm'
        assert 'Thickness' in data.layer_thickness.attrs['long_name']
        np.testing.assert_array_equal(data.energy_transfer, landscape.energy_transfer)
        chosen = data.energy_transfer.sel(layer_thickness=0.01, gravity=0.2)
        assert float(chosen) == landscape.energy_transfer[1, 1]
        assert data.attrs['release'] == 'first'
        ours = landscape.to_xarray()
        xarray.testing.assert_identical(data.drop_attrs(), ours.drop_attrs())
        assert {name: data.attrs[name] for name in ours.attrs} == ours.attrs


def test_netcdf_is_read_back_without_xarray(saved):
    landscape, folder = saved
    with netcdf_file(folder / 'map.nc', mmap=False) as data:
        np.testing.assert_array_equal(
            data.variables['ejection_phase'][:], landscape.ejection_phase
        )
        assert data.Conventions.startswith(b'CF-')


def test_other_endings_are_quoted(saved):
    with pytest.raises(ValueError, match=r"\.npz or \.nc, got 'map\.h5'"):
        saved[0].save(Path('map.h5'))


@pytest.mark.parametrize(
    ('axes', 'options', 'message'),
    [
        ({'thicknes': [1.0], 'mu': [1.0]}, {}, "no axis is named 'thicknes'; there are: x, C"),
        ({'mu': [1.0]}, {}, 'a landscape has two axes, got mu'),
        ({}, {}, 'a landscape has two axes, got none'),
        ({'x': [1.0], 'C': [1.0]}, {}, r'x must be at least 0 and below 1, got 1\.0'),
        ({'x': [0.0], 'C': [1.0]}, {}, r'x must be finite and positive, got 0\.0'),
        ({'x': [0.5], 'C': [math.nan]}, {}, 'C must be .* got nan'),
        ({'x': [0.5], 'C': [2.0, 1.0]}, {}, 'C must increase, got 2 and then 1'),
        ({'x': [0.5], 'C': [1.0, 1.0]}, {}, 'C must increase, got 1 and then 1'),
        ({'x': [], 'C': [1.0]}, {}, r'x must be a row of numbers, got shape \(0,\)'),
        ({'x': [[0.5]], 'C': [1.0]}, {}, r'x must be a row of numbers, got shape \(1, 1\)'),
        ({'x': ['wide'], 'C': [1.0]}, {}, 'x must be numbers, got .*wide'),
        ({'x': [0.5], 'mu': [1.0]}, {}, 'x and mu are one and the same'),
        ({'kappa': [0.5], 'C': [1.0]}, {}, 'kappa and C are one and the same'),
        (
            {'mu': [1.0], 'layer.thickness': [0.01]},
            {},
            'mu goes with C, kappa, engine.amplitude, .*, got layer.thickness',
        ),
        (
            {'layer.thickness': [0.01, 0.2], 'layer.wave_speed': [5.0]},
            {},
            r'layer.thickness must be a number from 0.0005 to 0.1 m, got 0\.2',
        ),
        ({'mu': [1.0], 'kappa': [8.0]}, {'model': 'guess'}, "model must be one of .* got 'guess'"),
        ({'mu': [1.0], 'kappa': [8.0]}, {'release': 'second'}, "'first' or 'last', got 'second'"),
        (
            {'mu': [1.0], 'kappa': [8.0]},
            {'release': 'last', 'model': 'spring_mass'},
            'the last release is known to travelling_wave, finite_difference, '
            "finite_difference_elastic, got model 'spring_mass'",
        ),
        (
            {'mu': [1.0], 'engine.damping_ratio': [0.1]},
            {'model': 'spring_mass'},
            'engine.damping_ratio is an axis, but the model spring_mass does not know it',
        ),
        ({'x': [0.5], 'C': [8.0]}, {'density_ratio': 0.0}, r'density_ratio must be .* got 0\.0'),
    ],
)
def test_what_is_refused_is_quoted(axes, options, message):
    with pytest.raises(ValueError, match=message):
        survey(Rig(), axes, **options)


def test_loss_is_refused_by_models_without():
    rig = Rig(layer=Layer(loss_tangent=0.05))
    with pytest.raises(ValueError, match=r'must be 0 for the model travelling_wave, .* got 0\.05'):
        survey(rig, {'mu': [1.0], 'kappa': [8.0]})


def test_layers_of_several_materials_are_refused():
    rig = replace(Rig(), layer=SimpleNamespace(materials='gel on rubber'))
    with pytest.raises(ValueError, match=r'of one material, got .*gel on rubber'):
        survey(rig, {'mu': [1.0], 'kappa': [8.0]})


def test_every_axis_has_symbol_and_meaning():
    for name in AXES:
        highest = TWIN.by_name[name].high if name in TWIN.by_name else 0.5
        quantity = Axis(name=name, values=[highest]).quantity
        assert quantity.symbol
        assert quantity.meaning


def test_every_model_tells_a_first_release():
    assert all('first' in methods for methods in MODELS.values())
