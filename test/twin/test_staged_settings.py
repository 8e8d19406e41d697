# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Changes of settings that wait until the rig is put back."""

from __future__ import annotations

import numpy as np
import pytest
from soft_throw_ros.configuration import motions
from soft_throw_ros.configuration.twin_config import TwinConfig
from soft_throw_ros.core.plate import SampledMotion
from soft_throw_ros.twin.prepared_rig import PreparedRig
from soft_throw_ros.twin.staged_settings import StagedSettings
from twin_runs import complete_settings, PLATE

CONFIG = TwinConfig.from_settings(complete_settings())
TIMES = np.arange(0.0, 0.1, 2e-4)  # [s]


def stage(staged: StagedSettings, values, motion_of=motions.read) -> PreparedRig:
    """Stage a change and return its rig."""
    wanted = staged.change(values, motion_of)
    prepared = staged.prepare(wanted)
    staged.stage(wanted, prepared)
    return prepared


@pytest.mark.parametrize(
    ('name', 'value'),
    [('gravity', 5.0), ('layer.loss_tangent', 0.1), ('projectile.mass', 3e-3),
     ('engine.amplitude', 1e-3), ('measured.latency', 1e-3), ('rate.field', 20.0),
     ('time_scale', 0.5)],
)
def test_change_of_rig_measurement_or_rate_waits_for_the_commit(name, value) -> None:
    staged = StagedSettings(CONFIG, CONFIG)
    before = staged.prepared
    wanted = staged.change({name: value}, motions.read)
    prepared = staged.prepare(wanted)
    assert (staged.wanted, staged.prepared) == (CONFIG, before)
    staged.stage(wanted, prepared)
    assert staged.pending == {name: value}
    assert staged.config.settings == CONFIG.settings
    assert staged.prepared is before
    staged.commit()
    assert staged.pending == {}
    assert staged.config is staged.wanted is prepared.config
    assert staged.config.settings == {**CONFIG.settings, name: value}
    assert staged.prepared is prepared


def test_other_change_is_effective_at_once_beside_one_that_waits() -> None:
    staged = StagedSettings(CONFIG, CONFIG)
    prepared = stage(staged, {'projectile.mass': 3e-3, 'throw.period': 0.7})
    assert stage(staged, {'throw.max_events': 3}) is prepared
    assert staged.pending == {'projectile.mass': 3e-3}
    assert (staged.config.throw_period, staged.config.max_events) == (0.7, 3)
    assert staged.config.rig is staged.prepared.rig is CONFIG.rig
    staged.commit()
    assert staged.config.rig.projectile.mass == staged.prepared.rig.projectile.mass == 3e-3


def test_change_that_is_taken_back_leaves_the_others_or_the_rig_as_it_was() -> None:
    staged = StagedSettings(CONFIG, CONFIG)
    before = staged.prepared
    for values in ({'gravity': 5.0}, {'time_scale': 0.5}, {'time_scale': 1.0}):
        stage(staged, values)
    assert staged.pending == {'gravity': 5.0}
    assert stage(staged, {'gravity': CONFIG.rig.gravity}) is before
    staged.commit()
    assert staged.prepared is before


def test_motions_of_both_configurations_are_known_by_their_paths() -> None:
    read, staged = [], StagedSettings(CONFIG, CONFIG)
    files = {
        path: SampledMotion.from_positions(TIMES, factor * PLATE.position(TIMES))
        for path, factor in (('a.csv', 1.0), ('b.csv', 2.0))
    }
    for path in ('a.csv', 'b.csv', 'a.csv', 'b.csv'):
        values = {'engine.motion': 'file', 'engine.motion_file': path}
        stage(staged, values, lambda path: read.append(path) or files[path])
        if read == ['a.csv']:
            staged.commit()
    assert read == ['a.csv', 'b.csv', 'b.csv']  # the motion in effect is not read again
    encoded = staged.encoded_motions
    assert set(encoded) == set(files)
    for path, text in encoded.items():
        np.testing.assert_array_equal(motions.decode(text).states, files[path].states)
    staged.commit()
    assert set(staged.encoded_motions) == {'b.csv'}
