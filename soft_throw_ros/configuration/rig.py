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
"""The parameters of the node that plays a rig, and of the one that finds them out."""

from __future__ import annotations

from soft_throw_ros.configuration.table import NAME, row, Settings, Table
from soft_throw_ros.configuration.twin import TWIN

_LIKE_THE_TWIN = (
    'engine.frequency', 'engine.amplitude', 'engine.damping_ratio',
    'layer.thickness', 'layer.wave_speed', 'layer.density', 'layer.diameter',
    'layer.loss_tangent', 'layer.elasticity', 'layer.loss', 'layer.stack', 'layer.library',
    'projectile.mass', 'gravity', 'throw.period',
)

_CAUGHT = 1  # landing, after which all is put back, and rests until the next throw

RIG = Table(
    node='rig',
    entries=(
        *(TWIN.by_name[name] for name in _LIKE_THE_TWIN),
        row('rate', 5000.0, 'How often plate and projectile are measured',
            unit='Hz', low=100.0, high=5000.0),
        row('noise', 5e-6, 'Standard deviation of measured positions',
            unit='m', low=0.0, high=1e-2),
        row('jitter', 1e-5, 'Largest deviation of the times of measurements from an even rate',
            unit='s', low=0.0, high=1e-3),
        row('faults.outlier_rate', 0.0, 'Share of the heights that are far off',
            low=0.0, high=0.5),
        row('faults.outlier_size', 3e-3, 'How far they are off at most; at least a tenth of that',
            unit='m', low=0.0, high=1.0),
        row('faults.missing_rate', 0.0, 'Share of the measurements that are lost',
            low=0.0, high=0.9),
        row('faults.stamp_error', 0.0, 'Largest error of a stamp', unit='s', low=0.0, high=1e-3),
        row('faults.rounding', 0.0, 'Step to which heights are rounded; 0 for none',
            unit='m', low=0.0, high=1e-3),
        row('faults.drift', 0.0, 'Drift of both heights, which turns round every second',
            unit='m/s', low=-0.1, high=0.1),
        row('faults.projectile_scale', 1.0,
            'Height of the projectile that is measured over the true one', low=0.5, high=2.0),
        row('faults.projectile_delay', 0.0,
            "How much older the projectile's heights are than their stamps",
            unit='s', low=-2e-3, high=2e-3),
        row('faults.ringing', 0.0,
            'Amplitude with which the plate rings before a throw by the period, over that of the '
            'engine', low=0.0, high=0.5),
        row('faults.second_mode', 0.0,
            'Amplitude of a second mode of the plate, over that of the engine',
            low=0.0, high=0.5),
        row('faults.second_mode_frequency', 310.0, 'Its frequency',
            unit='Hz', low=10.0, high=2000.0),
        row('faults.stiffening', 0.0,
            'k of a layer whose stress is E (e + k e^2) at a compression e; negative softens',
            low=-2.0, high=5.0),
        row('faults.sticking', 0.0, 'How long the layer holds a projectile that wants to leave',
            unit='s', low=0.0, high=2e-3),
        row('wear.throws', 0, 'After how many throws the layer has aged; 0 for never',
            low=1, high=1_000_000, or_zero=True),
        row('wear.wave_speed', 0.95, 'What is left of its wave speed then, as a part of it',
            low=0.1, high=2.0),
    ),
)
"""The parameters of the rig; those shared with the twin mean the same."""

_OF_SENSORS = (
    'outlier_rate', 'outlier_size', 'missing_rate', 'stamp_error', 'rounding', 'drift',
    'projectile_scale', 'projectile_delay',
)
_OF_RIG = ('ringing', 'second_mode', 'second_mode_frequency', 'stiffening', 'sticking')


def sensor_faults_of(settings: Settings) -> dict[str, float]:
    """Return what the sensors get wrong, by the names that `SensorFaults` has for it."""
    return {name: settings[name] for name in ('noise', 'jitter')} | {
        name: settings[f'faults.{name}'] for name in _OF_SENSORS
    }


def imperfections_of(settings: Settings) -> dict[str, float]:
    """Return what the rig does that no model does, by the names of `Imperfections`."""
    return {name: settings[f'faults.{name}'] for name in _OF_RIG}


CALIBRATOR = Table(
    node='calibrator',
    entries=(
        row('twin', 'twin',
            'The twin that is kept true to its rig, below the namespace of the calibrator unless '
            'it begins with /', kind='the name of a node', pattern=NAME),
        row('rig', '',
            'A node `rig` that is given the layer which the twin recommends, named likewise; '
            'without, the layer is left alone',
            kind='the name of a node, or empty', pattern=f'|{NAME}'),
        row('throws', 3,
            'How many throws in a row have to be beyond `measured.band` of the twin; from those '
            'the rig is identified', low=1, high=100),
    ),
)
"""The parameters of the calibrator."""


def to_twin(settings: Settings) -> Settings:
    """Return settings of a twin whose states are those of the rig."""
    return {
        **TWIN.defaults(),
        'layer.name': 'custom',
        'throw.max_events': _CAUGHT,
        'rate.state': settings['rate'],
        **{name: settings[name] for name in _LIKE_THE_TWIN},
    }
