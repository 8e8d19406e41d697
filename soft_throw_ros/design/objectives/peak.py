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
"""The objective `peak`: the most energy from one throw."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from soft_throw_ros.configuration import Settings
from soft_throw_ros.core.rig import Rig
from soft_throw_ros.design.objective import Objective
from soft_throw_ros.design.uncertainty import Variants


@dataclass(frozen=True, kw_only=True)
class Peak(Objective):
    """The most energy from the nominal throw."""

    name: ClassVar[str] = 'peak'
    is_fast: ClassVar[bool] = True

    @classmethod
    def from_settings(cls, _settings: Settings) -> Peak:
        """Return the objective, which has no parameters."""
        return cls()

    @property
    def summary(self) -> str:
        """Name of the score in texts."""
        return 'alpha'

    def variants(self, rig: Rig) -> Variants:
        """Return the one throw that counts."""
        return Variants.of(rig)
