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
"""What comes out of a throw."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields
from enum import Enum
from typing import Any, NamedTuple
from zlib import crc32

import numpy as np
from numpy.typing import NDArray
from soft_throw_ros.configuration import Scalar
from soft_throw_ros.core.rig import Rig
from soft_throw_ros.core.stepper import Event

Floats = NDArray[np.float64]


MOST_LEFT_OUT = 0.05
"""Part of the samples of a throw that may be left out before it is marked [-]."""


class Phase(str, Enum):
    """What the rig is doing."""

    REST = 'rest'
    CONTACT = 'contact'
    FLIGHT = 'flight'
    LANDED = 'landed'
    RETURNING = 'returning'


class State(NamedTuple):
    """Where plate and projectile are, z up from the plate's rest position."""

    plate_position: float
    projectile_position: float
    plate_velocity: float
    projectile_velocity: float
    plate_force: float
    projectile_force: float


class LayerState(NamedTuple):
    """The layer, from plate to top, each of shape (points,)."""

    height: Floats  # [m]
    velocity: Floats  # [m/s]
    force: Floats  # through each height, of what is below on what is above, z up [N]


class ThrowField(NamedTuple):
    """Strain of the layer over time and height."""

    times: Floats  # since the start of the throw, shape (rows,) [s]
    strain: Floats  # from plate to top, shape (rows, points) [-]
    checksum: int  # CRC-32 of the two
    start_ns: int = 0  # when the throw began, by the clock of the ticks [ns]

    @classmethod
    def of(cls, times: Floats, strain: Floats, *, start_ns: int = 0) -> ThrowField:
        """Make it with its checksum, which takes a tenth of a millisecond."""
        return cls(times, strain, crc32(strain.data, crc32(times.data)), start_ns)


@dataclass(frozen=True, kw_only=True)
class Release:
    """How the projectile left."""

    ejection_time: float  # from the start of the throw [s]
    ejection_speed: float  # [m/s]
    energy_transfer: float  # square of the latter over the peak speed of the plate [-]


@dataclass(frozen=True, kw_only=True)
class Comparison:
    """
    A throw by the model against what was measured, until a plate period after the release.

    The errors are how much later, and faster, the projectile passes the height of its release by
    the model than measured; None if it was not followed long enough.
    """

    samples: int  # of the projectile, that were compared
    position_rms: float  # of the differences of its position [m]
    position_max: float  # [m]
    threshold: float  # within which `position_rms` should be [m]
    ejection_time_error: float | None = None  # [s]
    ejection_speed_error: float | None = None  # [m/s]

    @property
    def is_within_threshold(self) -> bool:
        """Whether the model is as good as it should be."""
        return self.position_rms <= self.threshold

    def describe(self) -> str:
        """Say it for people to read."""
        rms, threshold = 1e6 * self.position_rms, 1e6 * self.threshold
        if self.is_within_threshold:
            return f'the projectile went as by the model, to {rms:.3g} um rms'
        return (
            f'the projectile was {rms:.3g} um rms off the model, beyond measured.band '
            f'{threshold:.3g} um: the layer has aged or slipped, or the parameters are wrong'
        )


@dataclass(frozen=True, kw_only=True)
class Accuracy:
    """
    How well the release of a measured plate is known: standard errors, by what was measured.

    What is not known of layer and projectile comes on top of that, see `uncertainty.*`.
    """

    basis: str  # 'engine' if the plate is taken to do as it should, 'plate' if it was smoothed
    is_certain: bool  # whether the plate cannot change the release any more
    release_ns: int  # when the projectile leaves, by the clock of the ticks [ns]
    release_time_error: float  # of that [s]
    ejection_speed_error: float  # [m/s]
    energy_transfer_error: float  # [-]
    samples: int  # of the plate, since the start
    samples_left_out: int  # of these, for having jumped

    @property
    def is_clean(self) -> bool:
        """Whether few enough samples had to be left out."""
        return self.samples_left_out <= MOST_LEFT_OUT * self.samples


@dataclass(frozen=True, kw_only=True)
class ThrowResult:
    """
    What a throw gave, so far or in the end.

    Loads are the largest magnitudes up to the first release; so far, while it has not come. The
    `stage` is 'predicted' when the first release of a measured plate is known beforehand: once
    when it is known well enough if the engine does as it should, and once when it is certain,
    whatever the plate does. It is 'release' after it, or 'final' when the throw is over. It is
    `ended_by` 'rest', 'max_events', 'period', 'duration' or 'reset', and with a measured plate
    'gap', or 'next' if it jumps again.
    """

    throw: int  # number of the throw, from 1
    step: int  # at which it is reported
    stage: str
    ended_by: str  # empty while the throw goes on
    rig: Rig  # what threw
    first: Release | None  # of the ejection, before the projectile falls back; None before it
    last: Release | None
    peak_plate_speed: float  # [m/s]
    peak_strain: float  # anywhere in the layer [-]
    max_strain: float  # where the linear range ends [-]
    peak_acceleration: float  # of the projectile [m/s2]
    peak_force: float  # of the layer on the plate [N]
    plate_work: float  # [J]
    apex_height: float  # of the lower face above the plate's rest; infinite without gravity [m]
    recontacts: int  # the layer caught up with the projectile before that had fallen back
    landings: int  # it came down on the layer
    lead: float | None = None  # how long before the release of a measured plate it was known [s]
    accuracy: Accuracy | None = None  # of the first release of a measured plate
    comparison: Comparison | None = None  # with what was measured of the projectile, if it was

    @property
    def is_valid(self) -> bool:
        """Whether the plate was known all the time."""
        return self.ended_by != 'gap'

    @property
    def is_ahead(self) -> bool:
        """Whether the release was known before it came."""
        return self.lead is not None and self.lead > 0.0

    @property
    def is_linear(self) -> bool:
        """Whether the layer stayed in its linear range."""
        return self.peak_strain <= self.max_strain

    def values(self) -> dict[str, Scalar]:
        """
        Return what is known, each by the name under which it is published; the rig is left out.

        What has not happened, or was not measured, is left out, too.
        """
        values = {name: getattr(self, name) for name in _SIMPLE if getattr(self, name) is not None}
        values['is_linear'] = self.is_linear
        for part, (prefix, _) in _PARTS.items():
            known = known_values(getattr(self, part))
            values |= {prefix + name: value for name, value in known.items()}
        return values

    @classmethod
    def from_values(cls, values: Mapping[str, Scalar], rig: Rig) -> ThrowResult:
        """Make the result of a rig whose `values` are known."""
        parts: dict[str, Any] = {}  # values of many types
        for part, (prefix, kind) in _PARTS.items():
            names = (item.name for item in fields(kind) if prefix + item.name in values)
            known = {name: values[prefix + name] for name in names}
            parts[part] = kind(**known) if known else None
        parts |= {name: values.get(name) for name in _SIMPLE}
        return cls(rig=rig, **parts)

    def describe(self) -> str:
        """Say it for people to read."""
        if not self.is_valid:
            return f'throw {self.throw} is invalid: the plate was not measured for too long'
        if self.first is None:
            return f'throw {self.throw}: the projectile has not left the layer'
        verb = 'will leave' if self.stage == 'predicted' else 'left'
        text = (
            f'throw {self.throw}: {verb} after {1e3 * self.first.ejection_time:.3f} ms '
            f'at {self.first.ejection_speed:.4f} m/s, alpha {self.first.energy_transfer:.3f}'
        )
        if self.accuracy is not None:
            text += f' +- {self.accuracy.energy_transfer_error:.3f}'
        if self.last is not None and self.recontacts:
            times = 're-contact' if self.recontacts == 1 else 're-contacts'
            text += f', after {self.recontacts} {times} {self.last.energy_transfer:.3f}'
        if not self.is_linear:
            strain, limit = 100.0 * self.peak_strain, 100.0 * self.max_strain
            text += f'; strain {strain:.1f} % is beyond the linear {limit:.3g} %'
        if self.accuracy is not None and not self.accuracy.is_clean:
            out, count = self.accuracy.samples_left_out, self.accuracy.samples
            text += f'; {out} of {count} samples of the plate jumped and were left out'
        return text

    def describe_lead(self) -> str:
        """Say how long before the release that was known, if it was predicted."""
        lead = 1e3 * (self.lead or 0.0)
        return f'known {lead:.2f} ms before' if self.is_ahead else f'known {-lead:.2f} ms too late'


def known_values(part: object) -> dict[str, Scalar]:
    """Return what is known of a part of a result, by name; nothing if there is no such part."""
    return {} if part is None else {k: v for k, v in vars(part).items() if v is not None}


_PARTS: dict[str, tuple[str, type[Any]]] = {
    'first': ('', Release),
    'last': ('last_', Release),
    'accuracy': ('accuracy.', Accuracy),
    'comparison': ('residual.', Comparison),
}
"""What of a result may be there, with values of its own, and how their names begin."""

_SIMPLE = tuple(item.name for item in fields(ThrowResult) if item.name not in ('rig', *_PARTS))
"""What of a result is one value."""


class PredictedState(NamedTuple):
    """The projectile, as far ahead as it is known."""

    stamp_ns: int  # the time of it [ns]
    position: float
    velocity: float
    force: float
    lead_ns: int  # how far that is ahead of the step [ns]


class Residual(NamedTuple):
    """Positions of plate and projectile by the model less those measured, at a stamp [m]."""

    stamp_ns: int
    plate: float
    projectile: float


class Outputs(NamedTuple):
    """What one step gives."""

    step: int
    throw: int  # how many have started
    state: State  # at the end of the step
    phases: tuple[Phase, ...] = ()  # entered in this step
    events: tuple[Event, ...] = ()  # in this step
    results: tuple[ThrowResult, ...] = ()  # of the throw under way, or just over
    layer: LayerState | None = None  # at `rate.field`
    throw_field: ThrowField | None = None  # once per throw
    prediction: PredictedState | None = None  # in a throw of a measured plate
    residual: Residual | None = None  # when the projectile has been measured, too
    notices: tuple[str, ...] = ()  # what is to be said about the measurement
