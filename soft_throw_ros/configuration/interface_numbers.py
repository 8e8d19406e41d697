# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
Table of the numbers in results and recommendations that have a topic of their own.

A new number is one row. Its topic, its publication and docs/topics.md follow from the row.

The table leaves out the numbers of the rig, which are parameters of the twin; step numbers and
stamps; and most numbers of a recommendation, which are in its message. A
recorder needs 0.1 % of a core for every topic, also for a topic without messages.
"""

from __future__ import annotations

from typing import NamedTuple


class Number(NamedTuple):
    """A number in the message of a result or a recommendation."""

    name: str
    """Name in the message; a dot separates the name of a group."""
    meaning: str
    unit: str = ''
    stage: str = 'release'
    """Stage of the result at which the number is published: 'release' or 'final'."""


_RELEASE = {
    'ejection_time': ('Time from the start of the throw to the release', 's'),
    'ejection_speed': ('Speed at the release', 'm/s'),
    'energy_transfer': ('Energy transfer factor alpha', ''),
}
"""Meaning and unit of the numbers of a release."""


THROW_NUMBERS = (
    Number('throw', 'Number of the throw, from 1'),
    Number('ejection_time', 'Time from the start of the throw to its first release', 's'),
    Number('ejection_speed', 'Speed at the first release', 'm/s'),
    Number('energy_transfer', 'Energy transfer factor alpha of the first release'),
    Number('peak_plate_speed', 'Largest speed of the plate', 'm/s'),
    Number('peak_strain', 'Largest strain of the layer up to the first release'),
    Number('max_strain', 'Strain at which the linear range of the layer ends'),
    Number('peak_acceleration', 'Largest acceleration of the projectile up to the first release',
           'm/s2'),
    Number(
        'peak_plate_force', 'Largest force of the layer on the plate up to the first release', 'N'
    ),
    Number('plate_work', 'Work of the plate up to the first release', 'J'),
    Number('lead', 'Time from the first prediction of a measured throw to the release', 's'),
    Number('accuracy.release_time_error', 'Standard error of the time of the release', 's'),
    Number('accuracy.ejection_speed_error', 'Standard error of the speed at the release', 'm/s'),
    Number('accuracy.energy_transfer_error', 'Standard error of alpha'),
    Number('accuracy.samples', 'Samples of the plate since the start'),
    Number('accuracy.samples_left_out', 'Outliers among these samples'),
    *(
        Number(f'uncertainty.{name}.{end}', f'{meaning}: {side} end of the 95 % interval', unit)
        for name, (meaning, unit) in _RELEASE.items()
        for end, side in (('low', 'lower'), ('high', 'upper'))
    ),
    Number('uncertainty.stuck_fraction', 'Fraction of throws without release within the '
           'uncertainties'),
    Number('last_ejection_time', 'Time from the start of the throw to the last release before the '
           'projectile falls back', 's', 'final'),
    Number('last_ejection_speed', 'Speed at this release', 'm/s', 'final'),
    Number('last_energy_transfer', 'Energy transfer factor alpha of this release', '', 'final'),
    Number('apex_height', 'Largest height of the projectile by its last release', 'm', 'final'),
    Number('recontacts', 'Contacts before the projectile fell back', '', 'final'),
    Number('landings', 'Contacts after the projectile fell back', '', 'final'),
    Number('residual.samples', 'Samples of the projectile that were compared', '', 'final'),
    Number('residual.position_rms', 'Rms of model position minus measured position', 'm',
           'final'),
    Number('residual.position_max', 'Largest magnitude of this difference', 'm', 'final'),
    Number('residual.threshold', 'Upper bound of a normal rms', 'm', 'final'),
    Number('residual.ejection_time_error', 'Ejection time of the model minus that of the '
           'measurement', 's', 'final'),
    Number('residual.ejection_speed_error', 'Ejection speed of the model minus that of the '
           'measurement', 'm/s', 'final'),
    Number('measurement.samples_missing', 'Samples that were lost or came too late', '',
           'final'),
    Number('measurement.time_skipped', 'Time of skipped ticks', 's', 'final'),
)
"""Numbers of `~/throw_result`, below `~/throw`."""

RECOMMENDED_NUMBERS = (
    Number('thickness', 'Best thickness', 'm'),
    Number('wave_speed', 'Best wave speed', 'm/s'),
    Number('density', 'Density of the best layer', 'kg/m3'),
    Number('loss_tangent', 'Loss tangent of the best layer'),
    Number('energy_transfer', 'Energy transfer factor alpha of the recommended throw'),
    Number('ejection_speed', 'Ejection speed of the recommended throw', 'm/s'),
    Number('amplitude', 'Amplitude that reaches the target', 'm'),
    Number('peak_strain', 'Largest strain of the layer up to the release'),
)
"""Numbers of `~/recommendation`, below `~/recommended`; they are parameters, too."""
