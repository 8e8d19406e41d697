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
"""Settings that are in effect, and those that wait until the rig is put back."""

from __future__ import annotations

from soft_throw_ros.configuration import Settings, TWIN
from soft_throw_ros.configuration.twin_config import TwinConfig
from soft_throw_ros.twin.prepared_rig import PreparedRig


class StagedSettings:
    """
    Settings in effect, as one value `config`, with the rig `prepared`; and settings `wanted`.

    A change of the rig, of the measurement, of rates or of the time scale waits for `commit`, and
    all that wait take effect together; every other change is effective at once.

    Parameters
    ----------
    settings : mapping of str to value
        Complete, in effect.
    pending : mapping of str to value
        What waits already.

    Raises
    ------
    ValueError
        If the rig cannot be stepped in real time, with the number.

    """

    def __init__(self, settings: Settings, pending: Settings) -> None:
        self.settings = self.wanted = settings
        self.config = TwinConfig.from_settings(settings)
        self.prepared = self._wanted_prepared = PreparedRig.from_config(self.config)
        if pending:
            self.stage(pending, self.prepare(pending))

    @property
    def pending(self) -> Settings:
        """Return the changes that wait, by name."""
        wanted = self.wanted.items()
        return {name: value for name, value in wanted if value != self.settings[name]}

    def prepare(self, values: Settings) -> PreparedRig | None:
        """
        Make ready what a change asks for, which takes milliseconds and changes nothing yet.

        It is to be handed to `stage`, and None if what has been wanted before will do.
        """
        wanted = {**self.wanted, **values}
        if any(_waits(name) and wanted[name] != self.wanted[name] for name in values):
            return PreparedRig.from_config(TwinConfig.from_settings(wanted))
        return None

    def stage(self, values: Settings, prepared: PreparedRig | None) -> None:
        """Take a change, with what `prepare` returned for it."""
        self.wanted = {**self.wanted, **values}
        self.settings = {
            name: self.settings[name] if _waits(name) else value
            for name, value in self.wanted.items()
        }
        self.config = TwinConfig.from_settings(self.settings)
        if not self.pending:
            self._wanted_prepared = self.prepared
        elif prepared is not None:
            self._wanted_prepared = prepared

    def commit(self) -> None:
        """Put in effect what waits."""
        self.prepared = self._wanted_prepared
        self.settings = self.wanted
        self.config = TwinConfig.from_settings(self.settings)


def _waits(name: str) -> bool:
    """Tell whether a change of a setting waits until things are put back."""
    entry = TWIN.by_name[name]
    return entry.is_of_rig or entry.group in ('rate', 'time_scale', 'measured')
