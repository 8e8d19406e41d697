# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0

import pytest
from soft_throw_ros.commands.design_texts import summary_of
from soft_throw_ros.configuration import rig_of
from soft_throw_ros.design.requests import solve_request
from twin_runs import complete_settings


def summary_for(**request):
    """Return the summary of the result of a request."""
    named = {
        name if '.' in name else f'recommendation.{name}': value
        for name, value in request.items()
    }
    settings = complete_settings(**named)
    return summary_of(solve_request(settings), rig_of(settings), settings)


@pytest.mark.parametrize(
    ('changes', 'parts'),
    [
        ({'vary': 'thickness'}, ['16.8 -> 13.4', '5.4 % more', '3.64 -> 3.83', '+-2.1 mm']),
        ({'thickness_max': 0.02}, ['-> 20 mm (the largest allowed)', '-> 11.62 m/s']),
        ({'vary': 'thickness', 'thickness_min': 16.8e-3, 'thickness_max': 30e-3},
         ['(alpha 3.64)']),
        ({'engine.amplitude': 0.1}, ['no layer can be compressed by']),
        ({'engine.frequency': 18.0}, ['gravity is 0.38 of']),
    ],
)
def test_summary_has_changes_gain_and_doubts(changes, parts):
    assert [part for part in parts if part not in summary_for(**changes)] == []


@pytest.mark.parametrize(
    ('request_', 'parts'),
    [
        ({'target_height': 0.15}, ['0.15 m', '2 -> 2.453 mm']),
        ({'target_speed': 1.5, 'target_height': 0.0}, ['1.5 m/s', '-> 2.182 mm', 'strain 12.7 %']),
    ],
)
def test_summary_of_an_aim_has_target_amplitude_and_loads(request_, parts):
    summary = summary_for(objective='aim', **request_)
    assert [part for part in parts if part not in summary] == []
