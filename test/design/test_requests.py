# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Design requests made from the settings of the twin, and their results."""

import math

import pytest
from soft_throw_ros.core.batch import SearchCancelledError
from soft_throw_ros.design.requests import limits_of, solve_request
from soft_throw_ros.design.score import Limits
from twin_runs import complete_settings


@pytest.mark.parametrize(
    ('changes', 'message'),
    [
        ({'vary': 'motion', 'objective': 'robust'}, "vary 'motion' .* got 'robust'"),
        ({'objective': 'aim', 'target_height': 0.0}, 'either a height or a speed'),
    ],
)
def test_impossible_requests_are_refused(changes, message):
    request = {f'recommendation__{name}': value for name, value in changes.items()}
    with pytest.raises(ValueError, match=message):
        solve_request(complete_settings(**request))


@pytest.mark.parametrize('name', ['peak', 'robust', 'versatile', 'aim'])
@pytest.mark.parametrize('batches', [0, 3])
def test_search_ends_when_cancelled_between_batches(name, batches):
    calls = []

    def cancelled():
        calls.append(True)
        return len(calls) > batches

    with pytest.raises(SearchCancelledError):
        solve_request(complete_settings(recommendation__objective=name), cancelled=cancelled)
    assert len(calls) == batches + 1


def test_every_limit_counts():
    limits = {
        'thickness_min': 0.002, 'wave_speed_max': 30.0, 'max_strain': 0.1,
        'max_acceleration': 500.0,
    }
    named = {f'recommendation__{name}': value for name, value in limits.items()}
    settings = complete_settings(**named)
    assert limits_of(settings) == Limits(**limits)
    assert limits_of(complete_settings(recommendation__max_strain=0.0)).max_strain == math.inf
