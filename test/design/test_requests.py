# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Design requests made from the settings of the twin, and their results."""

from dataclasses import replace
import math
import sys
import types

import pytest
from soft_throw_ros.configuration import TWIN
from soft_throw_ros.configuration.twin import OBJECTIVES
from soft_throw_ros.core.rig import Rig
from soft_throw_ros.core.throws import SearchCancelledError
from soft_throw_ros.design.objective import Limits, Objective
from soft_throw_ros.design.objectives.peak import Peak
from soft_throw_ros.design.recommendation import recommend
from soft_throw_ros.design.requests import limits_of, objective_of, solve_request
from soft_throw_ros.design.uncertainty import Uncertainties, Variants
from twin_runs import complete_settings


def test_defaults_request_the_peak_without_limits():
    settings = TWIN.defaults()
    assert objective_of(settings) == Peak()
    assert limits_of(settings) == Limits()
    assert Uncertainties.from_settings(settings) == Uncertainties()
    assert solve_request(settings) == recommend(Rig())


@pytest.mark.parametrize(
    ('changes', 'message'),
    [
        ({'vary': 'amplitude'}, "recommendation.vary 'amplitude' .* got 'peak'"),
        ({'objective': 'aim', 'target_height': 0.0}, 'target_height .*target_speed .* got 0'),
        ({'objective': 'versatile', 'masses': [1e-3] * 17}, 'masses .* 16'),
    ],
)
def test_impossible_requests_are_refused(changes, message):
    request = {f'recommendation__{name}': value for name, value in changes.items()}
    with pytest.raises(ValueError, match=message):
        solve_request(complete_settings(**request))


@pytest.mark.parametrize('objective', ['peak', 'robust', 'versatile', 'aim'])
@pytest.mark.parametrize('batches', [0, 3])
def test_search_ends_when_cancelled_between_batches(objective, batches):
    calls = []

    def cancelled():
        calls.append(True)
        return len(calls) > batches

    with pytest.raises(SearchCancelledError):
        solve_request(complete_settings(recommendation__objective=objective), cancelled=cancelled)
    assert len(calls) == batches + 1


def test_every_limit_counts():
    limits = {
        'thickness_min': 0.002, 'wave_speed_max': 30.0, 'max_strain': 0.1,
        'max_acceleration': 500.0, 'max_loss_tangent': 0.2,
    }
    named = {f'recommendation__{name}': value for name, value in limits.items()}
    settings = complete_settings(**named)
    assert limits_of(settings) == Limits(**limits)
    assert limits_of(complete_settings(recommendation__max_strain=0.0)).max_strain == math.inf


class Heavy(Objective):
    """Example of an objective: the most energy of a projectile of twice the mass."""

    name = 'heavy'

    @classmethod
    def from_settings(cls, _settings):
        return cls()

    def variants(self, rig):
        variants = Variants.of(rig)
        return variants._replace(mass=2.0 * variants.mass)


def test_objective_is_added_by_one_file(monkeypatch):
    name = 'soft_throw_ros.design.objectives.heavy'
    monkeypatch.setitem(sys.modules, name, types.SimpleNamespace(Heavy=Heavy))
    settings = complete_settings(recommendation__vary='thickness')
    best = solve_request({**settings, 'recommendation.objective': 'heavy'})
    rig = replace(Rig(), projectile=replace(Rig().projectile, mass=2.0 * Rig().projectile.mass))
    assert best.score == pytest.approx(recommend(rig, vary='thickness').score, rel=1e-6)


@pytest.mark.parametrize('name', OBJECTIVES)
def test_every_objective_in_the_table_has_its_file(name):
    assert objective_of(complete_settings(recommendation__objective=name)).name == name
