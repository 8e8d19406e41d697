# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""The parameters of the recorder, the viewer, the simulated rig and the calibrator."""

from __future__ import annotations

from soft_throw_ros.configuration.table import NAME, row, Settings, Table
from soft_throw_ros.configuration.twin import imply, JOINT_ROWS, TWIN

_LIKE_THE_TWIN = (
    'engine.frequency', 'engine.amplitude', 'engine.damping_ratio', 'layer.thickness',
    'layer.wave_speed', 'layer.density', 'layer.diameter', 'layer.loss_tangent',
    'layer.stress_strain_law', 'layer.loss', 'layer.stack', 'layer.library', 'projectile.mass',
    'gravity', 'throw.period', 'joint_names.plate', 'joint_names.projectile',
)

RECORDER = Table(node='recorder', entries=(
    row('topics', ('twin', '/diagnostics', '/parameter_events', '/rosout'),
        'Topics to record, and namespaces with all their topics, relative to the namespace of '
        'the recorder unless they begin with /; `/` records everything',
        kind='the name of a topic or namespace', pattern=f'/|{NAME}'),
    row('folder', '.', 'Folder of the bags'),
    row('name', '', 'Name of the new bag, which must not exist; empty for the current time',
        kind='the name of a folder', pattern=r'(?!\.{1,2}$)[^/]*'),
    row('start', True, 'Start recording at once, without `~/start`'),
    row('compression', 'zstd', 'Compression of the chunks', choices=('none', 'lz4', 'zstd')),
    row('split.size', 0, 'Size after which the bag continues in a new file; 0 for never',
        'byte', 1_000_000, 1_000_000_000_000, or_zero=True),
    row('split.duration', 0.0, 'Time after which the bag continues in a new file; 0 for never',
        's', 1.0, 1e6, or_zero=True),
    row('sync', False, 'Store all data on the disk every second, against power failures'),
    row('buffer', 256_000_000, 'Data that may wait for the disk before messages are dropped',
        'byte', 1_000_000, 16_000_000_000),
    row('rerun.sink', 'none', 'Sink of a viewer that is started with the recorder and shows '
        'its topics; `file` writes a recording beside the bag',
        choices=('none', 'viewer', 'serve', 'file'), is_fixed=True),
))
"""The parameters of the recorder; `rerun.sink` is fixed, the others are for the next recording."""

# The parameters of the viewer; all take effect when it is started
VIEWER = Table(node='viewer', entries=(
    row('topics', ('twin', '/diagnostics', '/rosout'), 'Topics to show; `/` shows every twin',
        kind='the name of a topic or namespace', pattern=f'/|{NAME}'),
    row('sink', 'viewer', '`viewer` opens Rerun, `serve` waits for viewers, `file` writes a '
        'recording', choices=('viewer', 'serve', 'file')),
    row('port', 9876, 'Port of the viewer, or for viewers, on 127.0.0.1', '', 1024, 65535),
    row('file', '', 'Path of the Rerun recording (.rrd) for the sink `file`'),
))

# The parameters of the rig; parameters shared with the twin have the same meaning
RIG = Table(node='rig', entries=(
    *(TWIN.by_name[name] for name in _LIKE_THE_TWIN),
    row('rate', 5000.0, 'Rate of measurements of plate and projectile', 'Hz', 100.0, 5000.0),
    row('noise', 5e-6, 'Standard deviation of the measured positions', 'm', 0.0, 1e-2),
    row('jitter', 1e-5, 'Largest deviation from a constant rate', 's', 0.0, 1e-3),
    row('faults.outlier_rate', 0.0, 'Fraction of the heights that are outliers', '', 0.0, 0.5),
    row('faults.outlier_size', 3e-3, 'Largest outlier; the smallest is a tenth', 'm', 0.0, 1.0),
    row('faults.missing_rate', 0.0, 'Fraction of measurements that are lost', '', 0.0, 0.9),
    row('faults.stamp_error', 0.0, 'Largest error of a stamp', 's', 0.0, 1e-3),
    row('faults.rounding', 0.0, 'Rounding step of the heights; 0 for none', 'm', 0.0, 1e-3),
    row('faults.drift', 0.0, 'Drift of both heights, reversed every second', 'm/s', -0.1, 0.1),
    row('faults.projectile_scale', 1.0, 'Measured over true projectile height', '', 0.5, 2.0),
    row('faults.projectile_delay', 0.0, "Delay of the projectile's heights", 's', -2e-3, 2e-3),
    row('faults.ringing', 0.0, 'Amplitude of the ringing of the plate before a periodic '
        'throw, over that of the engine', '', 0.0, 0.5),
    row('faults.second_mode', 0.0,
        'Amplitude of a second mode of the plate, over that of the engine', '', 0.0, 0.5),
    row('faults.second_mode_frequency', 310.0, 'Frequency of this mode', 'Hz', 10.0, 2000.0),
    row('wear.throws', 0, 'Throws after which the layer ages; 0 for never',
        '', 1, 1_000_000, or_zero=True),
    row('wear.wave_speed', 0.95, 'Wave speed of the aged over the new layer', '', 0.1, 2.0),
), imply=imply)

# The parameters of the calibrator
CALIBRATOR = Table(node='calibrator', entries=(
    row('twin', 'twin', 'Twin to calibrate, relative to the namespace of the calibrator '
        'unless it begins with /', kind='the name of a node', pattern=NAME),
    row('rig', '', 'Node `rig` that receives the recommended layer; empty to keep the layer',
        kind='the name of a node, or empty', pattern=f'|{NAME}'),
    row('throws', 3, 'Throws in a row beyond `measured.residual_threshold` of the twin, or '
        'too noisy for it, after which the rig is identified from them', '', 1, 100),
    row('motion_after', 0,
        'Throws in a row within that threshold after which the twin commands the best motion '
        'of the plate, and the gain is measured; 0 for never', '', 1, 10_000, or_zero=True),
    *JOINT_ROWS,
))


def to_twin(settings: Settings) -> Settings:
    """Return settings of a twin whose states are those of the rig."""
    caught = {'layer.name': 'custom', 'throw.max_events': 1, 'rate.state': settings['rate']}
    return {**TWIN.defaults(), **caught, **{name: settings[name] for name in _LIKE_THE_TWIN}}
