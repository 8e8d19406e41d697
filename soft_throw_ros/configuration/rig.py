# SPDX-License-Identifier: Apache-2.0
"""The parameters of the node that plays a rig, and of the one that finds them out."""

from __future__ import annotations

from typing import Any

from soft_throw_ros.configuration.table import NAME, row, Settings, Table
from soft_throw_ros.configuration.twin import TWIN

_LIKE_THE_TWIN = (
    'engine.frequency', 'engine.amplitude', 'engine.damping_ratio',
    'layer.thickness', 'layer.wave_speed', 'layer.density', 'layer.diameter',
    'layer.loss_tangent', 'projectile.mass', 'gravity', 'throw.period',
)  # fmt: skip

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
        row('wear.throws', 0, 'After how many throws the layer has aged; 0 for never',
             low=1, high=1_000_000, or_zero=True),
        row('wear.wave_speed', 0.95, 'What is left of its wave speed then, as a part of it',
             low=0.1, high=2.0),
    ),
)  # fmt: skip
"""The parameters of the rig; those shared with the twin mean the same."""

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
)  # fmt: skip
"""The parameters of the calibrator."""


def to_twin(settings: Settings) -> dict[str, Any]:
    """Return settings of a twin whose states are those of the rig."""
    return {
        **TWIN.defaults(),
        'layer.name': 'custom',
        'throw.max_events': _CAUGHT,
        'rate.state': settings['rate'],
        **{name: settings[name] for name in _LIKE_THE_TWIN},
    }
