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
"""The configuration in effect, and the one that waits until the rig is put back."""

from __future__ import annotations

from collections.abc import Mapping

from soft_throw_ros.configuration import motions, Settings, TWIN
from soft_throw_ros.configuration.motions import MotionSource
from soft_throw_ros.configuration.twin_config import TwinConfig
from soft_throw_ros.twin.prepared_rig import PreparedRig


class StagedSettings:
    """
    The configuration in effect, with its `prepared` rig, and the `wanted` one.

    A change of the rig, of the measurement, of rates or of the time scale waits for `commit`, and
    all that wait take effect together. Every other change is effective at once. Rigs are built,
    and files read, in `prepare` only.

    Raises
    ------
    ValueError
        If the rig cannot be stepped in real time, with the number.

    """

    def __init__(self, config: TwinConfig, wanted: TwinConfig | None = None) -> None:
        self.config = self.wanted = config
        self.prepared = self._wanted_prepared = PreparedRig.from_config(config)
        self._motions = _encode_motions(config, {})
        if wanted is not None:
            self.stage(wanted, self.prepare(wanted))

    @property
    def pending(self) -> Settings:
        """The changes that wait, by name."""
        wanted, present = self.wanted.settings, self.config.settings
        return {name: value for name, value in wanted.items() if value != present[name]}

    @property
    def encoded_motions(self) -> Mapping[str, str]:
        """The motions of files of both configurations, encoded, by their paths."""
        return {
            path: self._motions[path]
            for path in (_motion_file(self.config), _motion_file(self.wanted))
            if path
        }

    def change(self, values: Settings, motion_of: MotionSource) -> TwinConfig:
        """Return the wanted configuration after a change; motions that are known stay as known."""
        known = {
            _motion_file(config): config.rig.engine.motion for config in (self.config, self.wanted)
        }
        return self.wanted.change(values, lambda path: known.get(path) or motion_of(path))

    def prepare(self, wanted: TwinConfig) -> PreparedRig | None:
        """
        Prepare the rig of a wanted configuration, which takes milliseconds.

        Nothing changes until the result is given to `stage`. It is None if the rig that has been
        wanted before will do.
        """
        self._motions = {**self.encoded_motions, **_encode_motions(wanted, self._motions)}
        before, after = self.wanted.settings, wanted.settings
        if any(_waits(name) and after[name] != before[name] for name in after):
            return PreparedRig.from_config(wanted)
        return None

    def stage(self, wanted: TwinConfig, prepared: PreparedRig | None) -> None:
        """Stage a wanted configuration and its rig, the result of `prepare`."""
        self.wanted = wanted
        self.config = self.config.change(
            {name: value for name, value in wanted.settings.items() if not _waits(name)}
        )
        if not self.pending:
            self._wanted_prepared = self.prepared
        elif prepared is not None:
            self._wanted_prepared = prepared

    def commit(self) -> None:
        """Put the changes that wait in effect."""
        self.prepared = self._wanted_prepared
        self.config = self.wanted


def _waits(name: str) -> bool:
    """Whether a change of a setting waits until the rig is put back."""
    entry = TWIN.by_name[name]
    return entry.is_of_rig or entry.group in ('rate', 'time_scale', 'measured')


def _motion_file(config: TwinConfig) -> str:
    """Return the path of the file with the plate's motion; empty for other motions."""
    return str(config.settings[motions.PARAMETER]) if config.motion == 'file' else ''


def _encode_motions(config: TwinConfig, known: Mapping[str, str]) -> dict[str, str]:
    """Encode the motion of a file by its path, unless it is known already."""
    path, motion = _motion_file(config), config.rig.engine.motion
    if not path or motion is None:
        return {}
    return {path: known.get(path) or motions.encode(motion)}
