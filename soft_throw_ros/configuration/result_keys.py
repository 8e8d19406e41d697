# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Table of the keys of the values in `~/throw_result`, for docs/topics.md."""

from __future__ import annotations

from typing import NamedTuple


class Key(NamedTuple):
    """The key of a value in the message of a result; a dot separates the name of a group."""

    name: str
    meaning: str
    unit: str = ''


_OF_RELEASE = {
    'ejection_time': ('time from the start of the throw to the release', 's'),
    'ejection_speed': ('speed at the release', 'm/s'),
    'energy_transfer': ('energy transfer factor alpha', ''),
    'release_ns': ('stamp of the release', 'ns'),
}

RESULT_KEYS = (
    Key('throw', 'number of the throw, from 1'),
    Key('step', 'step of the session at which the result is reported'),
    Key('stage', '`predicted` (measured plate, before the release), `release` or `final`'),
    Key('ended_by', 'empty while the throw goes on; `rest`, `max_events`, `period`, `duration` or '
        '`reset`; with a measured plate also `next` (it jumps again), `gap` (samples are missing) '
        'or `noise` (they scatter too much): after these two a throw is invalid and has no '
        'release'),
    Key('start_ns', 'stamp of the start', 'ns'),
    *(Key(name, f'first release: {meaning}', unit)
      for name, (meaning, unit) in _OF_RELEASE.items()),
    *(Key(f'last_{name}', 'the same of the last release before the projectile falls back')
      for name in _OF_RELEASE),
    Key('peak_plate_speed', 'largest speed of the plate', 'm/s'),
    Key('peak_strain', 'largest strain of the layer up to the first release'),
    Key('max_strain', 'strain at which the linear range of the layer ends'),
    Key('is_linear', 'whether the peak strain is within this range'),
    Key('peak_acceleration', 'largest acceleration of the projectile up to the first release',
        'm/s2'),
    Key('peak_plate_force', 'largest force of the layer on the plate up to the first release',
        'N'),
    Key('plate_work', 'work of the plate up to the first release', 'J'),
    Key('apex_height', 'largest height of the projectile by its last release', 'm'),
    Key('recontacts', 'contacts before the projectile fell back'),
    Key('landings', 'contacts after the projectile fell back'),
    *(Key(f'uncertainty.{name}.{end}', 'ends of the 95 % intervals of the first release')
      for name in _OF_RELEASE if name != 'release_ns' for end in ('low', 'high')),
    Key('uncertainty.stuck_fraction',
        'fraction of throws without release within the uncertainties'),
    Key('uncertainty.jumps', 'whether the release jumps within the uncertainties'),
    Key('lead', 'measured plate: time from the first prediction to the release', 's'),
    Key('accuracy.is_certain', 'whether the plate cannot change the release any more'),
    Key('accuracy.release_time_error', 'standard error of the time of the release', 's'),
    Key('accuracy.ejection_speed_error', 'standard error of the speed at the release', 'm/s'),
    Key('accuracy.energy_transfer_error', 'standard error of alpha'),
    Key('accuracy.samples', 'samples of the plate since the start'),
    Key('accuracy.samples_left_out', 'outliers among these samples'),
    Key('residual.samples', 'samples of the projectile that were compared'),
    Key('residual.position_rms', 'rms of model position minus measured position', 'm'),
    Key('residual.position_max', 'largest magnitude of this difference', 'm'),
    Key('residual.threshold', 'upper bound of a normal rms', 'm'),
    Key('residual.ejection_time_error',
        'ejection time of the model minus that of the measurement', 's'),
    Key('residual.ejection_speed_error',
        'ejection speed of the model minus that of the measurement', 'm/s'),
    Key('measurement.clock_offset_ns', 'correction added to the stamps of the samples', 'ns'),
    Key('measurement.samples_missing', 'samples that were lost or came too late'),
    Key('measurement.time_skipped', 'time of skipped ticks', 's'),
)
"""Keys of `~/throw_result`; those of values that are unknown or not measured are missing."""
