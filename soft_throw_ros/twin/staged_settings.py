# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""The configuration in effect, and the one that waits until the rig is put back."""

from __future__ import annotations

from collections.abc import Mapping

from soft_throw_ros.configuration import Settings, TWIN
from soft_throw_ros.configuration.motions import MotionSource
from soft_throw_ros.configuration.twin_config import TwinConfig
from soft_throw_ros.twin.prepared_rig import PreparedRig

_WAITING = frozenset(
    entry.name
    for entry in TWIN.entries
    if entry.is_of_rig or entry.group in ('rate', 'time_scale', 'measured')
)
"""Parameters whose changes wait until the rig is put back."""


class StagedSettings:
    """
    The configuration in effect, with its `prepared` rig, and the `wanted` one.

    A change of the rig, of the measurement, of rates or of the time scale waits for `commit`, and
    all that wait take effect together. Every other change is effective at once. Rigs are built in
    `prepare` only.
    """

    def __init__(self, config: TwinConfig, wanted: TwinConfig) -> None:
        self.config = config
        self.prepared = self._wanted_prepared = PreparedRig.from_config(config)
        self.stage(wanted, self.prepare(wanted))

    @property
    def pending(self) -> Settings:
        """The changes that wait, by name."""
        wanted, present = self.wanted.settings, self.config.settings
        return {name: value for name, value in wanted.items() if value != present[name]}

    @property
    def encoded_motions(self) -> Mapping[str, str]:
        """The motions of files of both configurations, encoded, by their paths."""
        return {**self.prepared.encoded_motion, **self._wanted_prepared.encoded_motion}

    def change(self, values: Settings, motion_of: MotionSource) -> TwinConfig:
        """Return the wanted configuration after a change; motions that are known stay as known."""
        known = {
            rig.config.motion_file: rig.rig.engine.motion
            for rig in (self.prepared, self._wanted_prepared)
        }
        return self.wanted.change(values, lambda path: known.get(path) or motion_of(path))

    def prepare(self, wanted: TwinConfig) -> PreparedRig:
        """
        Return the rig of a wanted configuration; building another one takes milliseconds.

        Nothing changes until the result is given to `stage`. ValueError if the rig cannot be
        stepped in real time, with the number.
        """
        values = _waiting_values(wanted)
        for prepared in (self.prepared, self._wanted_prepared):
            if _waiting_values(prepared.config) == values:
                return prepared
        return PreparedRig.from_config(wanted)

    def stage(self, wanted: TwinConfig, prepared: PreparedRig) -> None:
        """Stage a wanted configuration and its rig, the result of `prepare`."""
        self.wanted, self._wanted_prepared = wanted, prepared
        self.config = self.config.change(
            {name: value for name, value in wanted.settings.items() if name not in _WAITING}
        )

    def commit(self) -> None:
        """Put the changes that wait in effect."""
        self.prepared = self._wanted_prepared
        self.config = self.wanted


def _waiting_values(config: TwinConfig) -> Settings:
    """Return the settings whose changes wait."""
    return {name: value for name, value in config.settings.items() if name in _WAITING}
