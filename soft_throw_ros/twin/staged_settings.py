# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""The configuration in effect, and the one that waits until the rig is put back."""

from __future__ import annotations

from collections.abc import Mapping

from soft_throw_ros.configuration import Settings
from soft_throw_ros.configuration.motions import MotionSource
from soft_throw_ros.twin.prepared_rig import prepare, PreparedRig, waiting_values


class StagedSettings:
    """
    The configuration in effect, with its `prepared` rig, and the `wanted` rig.

    A change of the rig, of the measurement, of rates or of the time scale waits for `commit`, and
    all that wait take effect together. Every other change is effective at once.
    """

    def __init__(self, prepared: PreparedRig) -> None:
        self.config = prepared.config
        self.prepared = self.wanted = prepared

    @property
    def pending(self) -> Settings:
        """The changes that wait, by name."""
        wanted, present = self.wanted.config.settings, self.config.settings
        return {name: value for name, value in wanted.items() if value != present[name]}

    @property
    def encoded_motions(self) -> Mapping[str, str]:
        """The motions of files of both rigs, encoded, by their paths."""
        return {**self.prepared.encoded_motion, **self.wanted.encoded_motion}

    def prepare(self, values: Settings, motion_of: MotionSource) -> PreparedRig:
        """Return the wanted rig after a change."""
        return prepare({**self.wanted.config.settings, **values}, self.wanted, motion_of)

    def stage(self, wanted: PreparedRig) -> None:
        """Stage a wanted rig, the result of `prepare`."""
        self.wanted = wanted
        waiting = waiting_values(self.config.settings)
        self.config = self.config.change({**wanted.config.settings, **waiting})

    def commit(self) -> None:
        """Put the changes that wait in effect."""
        self.prepared, self.config = self.wanted, self.wanted.config
