# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Results of a throw, and the output of a step."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, fields
from enum import Enum
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from soft_throw_ros.configuration import Scalar
from soft_throw_ros.core.plate import SampledMotion
from soft_throw_ros.core.rig import Rig
from soft_throw_ros.core.stepper import Event

Floats = NDArray[np.float64]

INVALID_ENDS = ('gap', 'noise')
"""Values of `ThrowResult.ended_by` of throws that could not be followed."""


class Phase(str, Enum):
    """Phase of the rig."""

    REST = 'rest'
    CONTACT = 'contact'
    FLIGHT = 'flight'
    LANDED = 'landed'
    RETURNING = 'returning'


class PhaseChange(NamedTuple):
    """The start of a phase."""

    phase: Phase
    stamp_ns: int  # time of the change by the clock of the ticks [ns]


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
    force: Floats  # through the layer at each height, positive in compression [N]


class ThrowField(NamedTuple):
    """Strain of the layer over time and height, and the energies over time."""

    times: Floats  # since the start of the throw, shape (rows,) [s]
    heights: Floats  # in the layer at rest, from plate to top, shape (points,) [m]
    strain: Floats  # shape (rows, points) [-]
    energies: Floats  # `interface.ENERGIES` in rows up to the first release [s], [J]
    start_ns: int = 0  # when the throw began, by the clock of the ticks [ns]

    @property
    def points(self) -> Floats:
        """Return t, y and strain for each time and height, shape (rows, points, 3)."""
        axes = np.meshgrid(self.times, self.heights, indexing='ij')
        return np.stack([*axes, self.strain], axis=-1)


@dataclass(frozen=True, kw_only=True)
class Release:
    """Time, speed and energy of a release."""

    ejection_time: float  # from the start of the throw [s]
    ejection_speed: float  # [m/s]
    energy_transfer: float  # square of the ejection speed over the plate's peak speed [-]
    release_ns: int  # when the projectile leaves, by the clock of the ticks [ns]


@dataclass(frozen=True, kw_only=True)
class Comparison:
    """A throw of the model compared with the samples, until a plate period after the release."""

    samples: int  # of the projectile, that were compared
    position_rms: float  # of the differences of its position [m]
    position_max: float  # [m]
    threshold: float  # upper bound of a normal `position_rms` [m]

    @property
    def is_within_threshold(self) -> bool:
        """Whether the differences of model and measurement are normal."""
        return self.position_rms <= self.threshold


@dataclass(frozen=True, kw_only=True)
class Accuracy:
    """
    Standard errors of the release of a measured plate, from the errors of the samples.

    The uncertainties of layer and projectile are not included, see `uncertainty.*`.
    """

    is_certain: bool  # whether the plate cannot change the release any more
    release_time_error: float  # [s]
    ejection_speed_error: float  # [m/s]
    energy_transfer_error: float  # [-]
    samples: int  # of the plate, since the start
    samples_left_out: int  # outliers among the samples


@dataclass(frozen=True, kw_only=True)
class ThrowResult:
    """
    The result of a throw, preliminary or final; docs/results.md has all values of the texts.

    Loads are the largest magnitudes up to the first release, or up to now before the release. The
    `stage` is 'predicted' before the first release of a measured plate: a first result comes when
    its speed is known well enough, a second one when no later motion of the plate can change the
    release. A throw that could not be followed has no releases, accuracy or comparison.
    """

    throw: int  # number of the throw, from 1
    step: int  # at which it is reported
    stage: str  # 'predicted', 'release' or 'final'
    ended_by: str  # empty while the throw goes on
    start_ns: int  # when the throw began, by the clock of the ticks [ns]
    rig: Rig
    first: Release | None  # of the ejection, before the projectile falls back; None before it
    last: Release | None
    peak_plate_speed: float  # [m/s]
    peak_strain: float  # anywhere in the layer [-]
    max_strain: float  # where the linear range ends [-]
    peak_acceleration: float  # of the projectile [m/s2]
    peak_plate_force: float  # of the layer on the plate [N]
    plate_work: float  # [J]
    apex_height: float  # of the lower face above the plate's rest; infinite without gravity [m]
    recontacts: int  # the layer caught up with the projectile before that had fallen back
    landings: int  # it came down on the layer
    lead: float | None = None  # how long before the release of a measured plate it was known [s]
    accuracy: Accuracy | None = None  # of the first release of a measured plate
    comparison: Comparison | None = None  # with a measured projectile
    clock_offset_ns: int | None = None  # added to the stamps of samples of a measured plate [ns]

    @property
    def is_valid(self) -> bool:
        """Whether the plate was known all the time."""
        return self.ended_by not in INVALID_ENDS

    def stamp(self, due_ns: int) -> int:
        """Return the time of the release, or of the end that is reported in a step [ns]."""
        return due_ns if self.stage == 'final' or self.first is None else self.first.release_ns

    @property
    def is_linear(self) -> bool:
        """Whether the layer stayed in its linear range."""
        return self.peak_strain <= self.max_strain

    def values(self) -> dict[str, Scalar]:
        """
        Return the known values by their published names, without the rig.

        Values of events that have not happened, or were not measured, are missing.
        """
        values = {name: getattr(self, name) for name in _SIMPLE if getattr(self, name) is not None}
        values['is_linear'] = self.is_linear
        for group, (prefix, _) in _GROUPS.items():
            known = known_values(getattr(self, group))
            values |= {prefix + name: value for name, value in known.items()}
        return values

    @classmethod
    def from_values(cls, values: Mapping[str, Scalar], rig: Rig) -> ThrowResult:
        """Make the result of a rig whose `values` are known."""
        attributes: dict[str, Any] = {}  # values of many types
        for group, (prefix, kind) in _GROUPS.items():
            names = {prefix + item.name: item.name for item in fields(kind)}
            known = {names[key]: values[key] for key in names.keys() & values.keys()}
            attributes[group] = kind(**known) if known else None
        attributes |= {name: values.get(name) for name in _SIMPLE}
        return cls(rig=rig, **attributes)


def known_values(group: object) -> dict[str, Scalar]:
    """Return the fields of a group of a result that are not None; none without a group."""
    return {} if group is None else {k: v for k, v in vars(group).items() if v is not None}


_GROUPS: dict[str, tuple[str, type[Any]]] = {
    'first': ('', Release),
    'last': ('last_', Release),
    'accuracy': ('accuracy.', Accuracy),
    'comparison': ('residual.', Comparison),
}
"""Optional groups of values of a result: prefix of the published names, and type."""

_SIMPLE = tuple(item.name for item in fields(ThrowResult) if item.name not in ('rig', *_GROUPS))
"""Names of the fields of a result that are single values."""


class PredictedState(NamedTuple):
    """The latest known state of the projectile."""

    stamp_ns: int  # time of the state [ns]
    position: float
    velocity: float
    force: float


class Residual(NamedTuple):
    """Positions of plate and projectile by the model less those measured, at a stamp [m]."""

    stamp_ns: int
    plate: float
    projectile: float


class PlateCommand(NamedTuple):
    """The motion of the plate in the next throw, and the time of its start."""

    start_ns: int
    motion: SampledMotion


@dataclass
class Outputs:
    """Output of one step, to which inputs before the step and the state of the rig add."""

    step: int
    throw: int  # number of throws that have started
    state: State  # at the end of the step, before it of the last one
    phases: list[PhaseChange] = field(default_factory=list)  # that began, or became known
    events: Sequence[Event] = ()  # that happened, or became certain, in this step
    results: list[ThrowResult] = field(default_factory=list)  # of the present or the last throw
    layer: LayerState | None = None  # at `rate.field`
    throw_field: Callable[[], ThrowField] | None = None  # once per throw; it takes milliseconds
    prediction: PredictedState | None = None  # in a throw of a measured plate
    residual: Residual | None = None  # if the projectile is measured as well
    command: PlateCommand | None = None  # before a throw, if the plate is commanded
