# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
The states of a rig without a throw: at rest, and returning to rest.

The third state is `throws.OngoingThrow`. Before `advance` gives the outputs of the present step,
`start_next` enters the next state if it is due. `request_throw` returns the reason of a refusal,
or an empty text.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, TypeAlias

import numpy as np
from soft_throw_ros.twin.prepared_rig import FIELD_POINTS
from soft_throw_ros.twin.results import LayerState, Outputs, Phase, State
from soft_throw_ros.twin.sample_buffer import Onset
from soft_throw_ros.twin.throws import OngoingThrow

if TYPE_CHECKING:
    from soft_throw_ros.twin.session import Session


@dataclass
class AtRest:
    """Plate and projectile are at rest; the next throw starts when it is due or requested."""

    session: Session
    is_requested: bool = False
    start_step: int | None = None  # of the next throw, whose motion is commanded already
    onset: Onset | None = None  # of a measured throw that a journal starts with

    def start_next(self) -> None:
        """Start the next throw, or put back a rig with pending changes first."""
        session = self.session
        if self.start_step is not None:
            if session.step >= self.start_step:
                session.begin_throw()
        elif self.is_requested or session.step >= session.next_start:
            if session.pending:
                session.put_back(is_requested=self.is_requested)
            else:
                session.command_plate()

    def advance(self) -> Outputs:
        """Return the rest, of a measured plate as it is measured."""
        session = self.session
        rest, monitor = session.prepared.rest, session.monitor
        state = rest if monitor is None else monitor.state(rest)
        return Outputs(session.step, session.throws, state)

    def layer(self) -> LayerState:
        """Return the layer at rest."""
        return self.session.prepared.rest_layer

    def request_throw(self) -> str:
        """Start a throw with the next step."""
        if self.is_requested or self.start_step is not None:
            return f'throw {self.session.throws + 1} is about to start'
        self.is_requested = True
        return ''


@dataclass
class Returning:
    """
    Plate and projectile return to rest between two steps.

    A measured plate returns by itself: it is at rest when its monitor is armed.
    """

    session: Session
    begin: int
    end: int
    origin: State
    is_requested: bool = False  # the next throw starts when they have arrived

    def start_next(self) -> None:
        """Start a throw that is due, or else rest."""
        session = self.session
        if session.step >= self.end:
            if self.is_requested or session.step >= session.next_start:
                session.command_plate()
            else:
                session.enter(AtRest(session), Phase.REST)

    def advance(self) -> Outputs:
        """
        Return a point of the way to rest with the least jerk [1]_, or that of a measured plate.

        Plate and projectile have covered the same share of their ways at any time, so that they
        do not collide. Forces are zero, because the layer is left out.

        References
        ----------
        .. [1] Flash and Hogan, "The coordination of arm movements", J. Neurosci. 5 (1985) 1688.

        """
        session, origin, goal = self.session, self.origin, self.session.prepared.rest
        if session.monitor is not None:
            return Outputs(session.step, session.throws, session.monitor.state(goal))
        ticks = self.end - self.begin
        time = (session.step - self.begin) / ticks  # over the duration
        share = time**3 * (10.0 - 15.0 * time + 6.0 * time**2)
        speed = 30.0 * (time * (1.0 - time)) ** 2 / (ticks * session.prepared.tick)
        plate = goal.plate_position - origin.plate_position
        projectile = goal.projectile_position - origin.projectile_position
        state = State(
            plate_position=origin.plate_position + share * plate,
            projectile_position=origin.projectile_position + share * projectile,
            plate_velocity=speed * plate,
            projectile_velocity=speed * projectile,
            plate_force=0.0,
            projectile_force=0.0,
        )
        return Outputs(session.step, session.throws, state)

    def layer(self) -> LayerState:
        """Return the layer lying on the plate without force."""
        prepared, state = self.session.prepared, self.session.state
        rest, gap = prepared.rest, state.projectile_position - state.plate_position
        scale = min(1.0, gap / (rest.projectile_position - rest.plate_position))
        height = prepared.rest_layer.height - rest.plate_position
        return LayerState(
            state.plate_position + scale * height,
            np.full(FIELD_POINTS, state.plate_velocity),
            np.zeros(FIELD_POINTS),
        )

    def request_throw(self) -> str:
        """Refuse a throw until the rig is at rest."""
        return self.session.refusal('resetting the rig', self.end)


RigState: TypeAlias = AtRest | OngoingThrow | Returning
