# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Changes of settings that wait until the rig is put back."""

from __future__ import annotations

import numpy as np
import pytest
from soft_throw_ros.configuration import motions
from soft_throw_ros.core.plate import SampledMotion
from soft_throw_ros.twin.prepared_rig import prepare, PreparedRig
from soft_throw_ros.twin.staged_settings import StagedSettings
from twin_runs import complete_settings, PLATE

SETTINGS = complete_settings()
TIMES = np.arange(0.0, 0.1, 2e-4)  # [s]


def stage(staged: StagedSettings, values, motion_of=motions.read) -> PreparedRig:
    """Stage a change and return its rig."""
    wanted = staged.prepare(values, motion_of)
    staged.stage(wanted)
    return wanted


@pytest.mark.parametrize(
    ('name', 'value'),
    [('gravity', 5.0), ('layer.loss_tangent', 0.1), ('projectile.mass', 3e-3),
     ('engine.amplitude', 1e-3), ('measured.latency', 1e-3), ('rate.field', 20.0),
     ('time_scale', 0.5)],
)
def test_change_of_rig_measurement_or_rate_waits_for_the_commit(name, value) -> None:
    before = prepare(SETTINGS)
    staged = StagedSettings(before)
    wanted = staged.prepare({name: value}, motions.read)
    assert (staged.wanted, staged.prepared) == (before, before)
    staged.stage(wanted)
    assert staged.pending == {name: value}
    assert staged.config.settings == SETTINGS
    assert staged.prepared is before
    staged.commit()
    assert staged.pending == {}
    assert staged.config is staged.wanted.config is wanted.config
    assert staged.config.settings == {**SETTINGS, name: value}
    assert staged.prepared is wanted


def test_other_change_is_effective_at_once_beside_one_that_waits() -> None:
    before = prepare(SETTINGS)
    staged = StagedSettings(before)
    wanted = stage(staged, {'projectile.mass': 3e-3, 'throw.period': 0.7})
    assert stage(staged, {'throw.max_events': 3}).stepper is wanted.stepper
    assert staged.pending == {'projectile.mass': 3e-3}
    assert (staged.config.throw_period, staged.config.max_events) == (0.7, 3)
    assert staged.config.rig is staged.prepared.rig is before.rig
    staged.commit()
    assert staged.config.rig.projectile.mass == staged.prepared.rig.projectile.mass == 3e-3


def test_change_that_is_taken_back_leaves_the_others() -> None:
    staged = StagedSettings(prepare(SETTINGS))
    for values in ({'gravity': 5.0}, {'time_scale': 0.5}, {'time_scale': 1.0}):
        stage(staged, values)
    assert staged.pending == {'gravity': 5.0}
    stage(staged, {'gravity': SETTINGS['gravity']})
    assert staged.pending == {}


def test_motions_of_both_rigs_are_known_by_their_paths() -> None:
    read, staged = [], StagedSettings(prepare(SETTINGS))
    files = {
        path: SampledMotion.from_positions(TIMES, factor * PLATE.position(TIMES))
        for path, factor in (('a.csv', 1.0), ('b.csv', 2.0))
    }
    for path in ('a.csv', 'b.csv', 'a.csv', 'b.csv'):
        values = {'engine.motion': 'file', 'engine.motion_file': path}
        stage(staged, values, lambda path: read.append(path) or files[path])
        if read == ['a.csv']:
            staged.commit()
    stage(staged, {'layer.thickness': 0.02}, read.append)
    assert read == ['a.csv', 'b.csv', 'a.csv', 'b.csv']  # again with another path only
    encoded = staged.encoded_motions
    assert set(encoded) == set(files)
    for path, text in encoded.items():
        np.testing.assert_array_equal(motions.decode(text).states, files[path].states)
    staged.commit()
    assert set(staged.encoded_motions) == {'b.csv'}
