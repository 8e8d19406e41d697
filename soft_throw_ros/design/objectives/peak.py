# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
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
