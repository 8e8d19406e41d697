# SPDX-License-Identifier: Apache-2.0
r"""
A rig cut into cells, for finite differences in time.

Notes
-----
Nodes are numbered from the plate up, and link j is between nodes j and j + 1: a cell, which is a
spring :math:`k = S / \int dy / E` beside a dashpot c, with half of its mass on each of its nodes;
or the joint, which is the contact: while it lasts its two nodes move as one.

The layer is cut into cells that a wave crosses in the same time each, so that all of them can take
the longest step that is stable, :math:`h \le \sqrt{M k^{-1}}` with the mass M of a cell. Where a
cell lies in one material this is its crossing time, and else (by Schwarz's inequality) more. At
that step a uniform layer has no dispersion. Slabs begin and end with a cell; a slab or projectile
that is too thin, or too stiff, for one cell (two, of a projectile) and an explicit step gets an
implicit one.

"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from soft_throw_ros.core import checks
from soft_throw_ros.core.graded_layer import GradedLayer, Piece
from soft_throw_ros.core.rig import Rig

Floats = NDArray[np.float64]

AVERAGE_ACCELERATION = 0.25
"""Newmark's parameter for cells that a wave crosses in less than a step."""

MAX_PROJECTILE_CELLS = 1 << 16
"""Most cells of an elastic projectile."""

_FEWEST_PROJECTILE_CELLS = 2
_ROUNDING = 1e-9


@dataclass(frozen=True, kw_only=True, eq=False)
class Grid:
    """
    Masses, springs and dashpots in a row, on a plate whose motion is given.

    Parameters
    ----------
    step : float
        Time step. [s]
    heights : ndarray, shape (cells + 1,)
        Of the layer's nodes, unloaded. [m]
    slabs : ndarray, shape (cells,)
        A number for each cell of the layer, other beyond a jump of the material.
    bottom : int
        The layer's lowest node: 0, which is the plate, or 1 if it is not glued on.
    joint : int
        The link that is the contact.
    face : int
        The lowest node of the projectile.
    face_mass : float
        Its part of the mass of that node. [kg]
    mass : ndarray, shape (n + 1,)
        Of the nodes. [kg]
    stiffness, viscosity : ndarray, shape (n,)
        Of the links; 0 for the joint. [N/m], [N s/m]
    implicit : ndarray, shape (n,)
        What a link adds to the matrix of masses since it is solved implicitly. [kg]
    is_stiff : ndarray, shape (n,)
        Whether a wave crosses the link in less than a step.

    """

    step: float
    heights: Floats
    slabs: NDArray[np.int64]
    bottom: int
    joint: int
    face: int
    face_mass: float
    mass: Floats
    stiffness: Floats
    viscosity: Floats
    implicit: Floats
    is_stiff: NDArray[np.bool_]

    @property
    def cells(self) -> int:
        """Cells of the layer."""
        return self.heights.size - 1

    @property
    def top(self) -> int:
        """The layer's highest node."""
        return self.bottom + self.cells

    @property
    def thrown_mass(self) -> float:
        """All above the joint. [kg]"""
        return float(self.mass[self.joint + 1 :].sum())

    def bodies(self) -> tuple[int, int]:
        """
        Find what meets as one in a collision: nodes that only stiff links part.

        A jump of the velocity of one of them alone would be a jump of stress that a wave has
        levelled out long before the end of the step.

        Returns
        -------
        lowest, uppermost : int
            The first of the nodes below the joint, and the last of those above it.

        """
        lowest, uppermost = self.joint, self.joint + 1
        while lowest > 1 and self.is_stiff[lowest - 1]:
            lowest -= 1
        while uppermost < self.mass.size - 1 and self.is_stiff[uppermost]:
            uppermost += 1
        return lowest, uppermost

    def neighbours(self, height: float) -> tuple[int, int, float, float]:
        """
        Find what to interpolate from at a height, or to extrapolate from at the end of a slab.

        Returns
        -------
        cell, beside : int
            The cell of the layer at this height, and one beside it of the same slab.
        weight : float
            Of the latter, for what is known in the middle of cells; 0 if there is none.
        part : float
            Of the cell that is below.

        """
        edges = self.heights
        cell = min(int(np.searchsorted(edges, height, side='right')) - 1, self.cells - 1)
        middles = 0.5 * (edges[1:] + edges[:-1])
        order = (-1, 1) if height < middles[cell] else (1, -1)
        beside = cell
        for candidate in (cell + order[0], cell + order[1]):
            if 0 <= candidate < self.cells and self.slabs[candidate] == self.slabs[cell]:
                beside = candidate
                break
        weight = 0.0
        if beside != cell:
            weight = float((height - middles[cell]) / (middles[beside] - middles[cell]))
        part = float((height - edges[cell]) / (edges[cell + 1] - edges[cell]))
        return cell, beside, weight, part

    @property
    def calming(self) -> Floats:
        """
        Viscosity that keeps the ends quiet which are free in flight, below and above the joint.

        What the end of a cell does from step to step, it would go on doing in turns for ever. A
        dashpot that takes half of its momentum in half a step ends that at once. [N s/m]
        """
        joint = self.joint
        below = self.mass[joint] if joint > 0 else 0.0
        above = self.mass[joint + 1] if joint + 2 < self.mass.size else 0.0
        return 2.0 / self.step * np.array([below, above])

    def implicit_masses(self, *, in_contact: bool) -> Floats:
        """Return what all links add to the matrix of masses. [kg]"""
        masses: Floats = self.implicit.copy()
        if not in_contact:
            for link, viscosity in zip(
                (self.joint - 1, self.joint + 1), self.calming, strict=True
            ):
                if viscosity > 0.0:
                    masses[link] += 0.5 * self.step * viscosity
        return masses

    def factors(self, *, in_contact: bool) -> tuple[Floats, Floats]:
        """
        Solve the equations of motion for accelerations, from the top down.

        Returns
        -------
        share : ndarray, shape (n,)
            What a node gives of its load to the one below, and takes of its acceleration.
        gain : ndarray, shape (n + 1,)
            Acceleration over what is left of the load. [1/kg]

        """
        last = self.mass.size - 1
        joint, implicit = self.joint, self.implicit_masses(in_contact=in_contact)
        share, gain = np.zeros(last), np.zeros(last + 1)
        pivot = 0.0
        for j in range(last, 0, -1):
            added = 0.0  # by the node above
            if j == joint:
                share[j] = 1.0 if in_contact else 0.0
                added = share[j] * pivot
            elif j < last:
                share[j] = implicit[j] / pivot
                added = implicit[j] * (1.0 - share[j])
            pivot = self.mass[j] + implicit[j - 1] + added
            gain[j] = 1.0 / pivot if pivot > 0.0 else 0.0
        share[0] = implicit[0] * gain[1]
        if in_contact:  # the upper node goes with the lower one,
            share[joint], gain[joint + 1] = 1.0, 0.0
        elif joint > 0 and self.mass[joint] == 0.0:  # and a free end without mass with the plate
            share[joint - 1], gain[joint] = 1.0, 0.0
        return share, gain


def cut(
    rig: Rig,
    *,
    cells: int,
    step: float | None = None,
    is_elastic: bool = False,
    glued_to: Literal['plate', 'projectile'] = 'plate',
) -> Grid:
    """
    Cut a rig into cells.

    Parameters
    ----------
    rig : Rig
        Of any layer.
    cells : int
        Of the layer, about; slabs get whole numbers, and at least one.
    step : float, optional
        Time step; the longest stable one if not given. [s]
    is_elastic : bool
        Whether the projectile is cut, too, or rigid.
    glued_to : {'plate', 'projectile'}
        Where the layer is glued; on the other side is the contact.

    Returns
    -------
    Grid

    Raises
    ------
    ValueError
        If the step is not positive, or too long to be stable, or an elastic projectile so slow
        that it takes more than `MAX_PROJECTILE_CELLS`; with the number.

    """
    pieces = _pieces(rig)
    crossing = sum(piece.crossing_time for piece in pieces)
    usual = crossing / cells
    counts = [max(1, int(piece.crossing_time / usual * (1.0 + _ROUNDING))) for piece in pieces]
    longest = min(
        (
            piece.crossing_time / count
            for piece, count in zip(pieces, counts, strict=True)
            if piece.crossing_time >= usual * (1.0 - _ROUNDING)
        ),
        default=usual,
    )
    if step is None:
        step = usual
    elif checks.positive('step', step) > longest * (1.0 + _ROUNDING):
        raise ValueError(
            f'step must be at most {longest:.6g} s for {sum(counts)} cells to be stable, since a '
            f'wave must not pass one in less, got {step:g} s'
        )
    columns = [
        _cut_piece(piece, count, rig, step) for piece, count in zip(pieces, counts, strict=True)
    ]
    mass, *columns = np.concatenate(columns, axis=1)
    heights = np.concatenate(
        [piece.cut(count)[:-1] for piece, count in zip(pieces, counts, strict=True)]
        + [pieces[-1].heights[-1:]]
    )
    bar = _cut_projectile(rig, step) if is_elastic else np.zeros((5, 0))
    on_plate = glued_to == 'plate'
    joint = mass.size if on_plate else 0
    layer_nodes = _halves(mass)
    bar_nodes = _halves(bar[0]) if is_elastic else np.array([rig.projectile.mass])
    if on_plate:
        nodes = np.concatenate((layer_nodes, bar_nodes))
    else:
        merged = layer_nodes[-1:] + bar_nodes[:1]
        nodes = np.concatenate(([0.0], layer_nodes[:-1], merged, bar_nodes[1:]))
    links = np.insert(np.concatenate((np.stack(columns), bar[1:]), axis=1), joint, 0.0, axis=1)
    return Grid(
        step=step,
        heights=heights,
        slabs=np.repeat(np.arange(len(pieces)), counts),
        bottom=0 if on_plate else 1,
        joint=joint,
        face=mass.size + 1,
        face_mass=float(bar_nodes[0]),
        mass=nodes,
        stiffness=links[0],
        viscosity=links[1],
        implicit=links[2],
        is_stiff=links[3] > 0.0,
    )


def massless(rig: Rig, *, step: float) -> Grid:
    """Make a grid of one cell that has no mass: a spring and a dashpot (App. A)."""
    layer, mass = rig.layer, rig.projectile.mass
    viscosity = layer.stiffness * layer.loss_tangent / rig.engine.angular_frequency
    return Grid(
        step=step,
        heights=np.array([0.0, layer.thickness]),
        slabs=np.zeros(1, np.int64),
        bottom=0,
        joint=1,
        face=2,
        face_mass=mass,
        mass=np.array([0.0, 0.0, mass]),
        stiffness=np.array([layer.stiffness, 0.0]),
        viscosity=np.array([viscosity, 0.0]),
        implicit=np.array([0.5 * step * viscosity, 0.0]),
        is_stiff=np.zeros(2, np.bool_),
    )


def _pieces(rig: Rig) -> list[Piece]:
    """Return the parts of the layer without jumps."""
    layer = rig.layer
    if isinstance(layer, GradedLayer):
        return list(layer.pieces())
    return list(GradedLayer.stack(layer).pieces())


def _cut_piece(piece: Piece, count: int, rig: Rig, step: float) -> Floats:
    """Return mass, links' stiffness, viscosity, implicit mass, and if stiff, of a piece."""
    edges = piece.cut(count)
    if piece.is_uniform:
        whole = piece.integrals(edges[-1:])
        slowness, mass, compliance, loss = np.repeat(whole / count, count, axis=1)
    else:
        slowness, mass, compliance, loss = np.diff(piece.integrals(edges), axis=1)
    section = rig.layer.section
    stiffness = section / compliance
    viscosity = stiffness * loss / compliance / rig.engine.angular_frequency
    too_fast = slowness * (1.0 + _ROUNDING) < step
    implicit = 0.5 * step * viscosity + np.where(
        too_fast, AVERAGE_ACCELERATION * step**2 * stiffness, 0.0
    )
    return np.stack((section * mass, stiffness, viscosity, implicit, too_fast))


def _cut_projectile(rig: Rig, step: float) -> Floats:
    """Return the same of the projectile."""
    projectile = rig.projectile
    crossing = rig.crossing_ratio * rig.crossing_time
    count = max(_FEWEST_PROJECTILE_CELLS, int(crossing / step * (1.0 + _ROUNDING)))
    if count > MAX_PROJECTILE_CELLS:
        stiffer = projectile.youngs_modulus * (count / MAX_PROJECTILE_CELLS) ** 2
        raise ValueError(
            f'projectile.youngs_modulus {projectile.youngs_modulus:g} Pa takes {count} cells, the '
            f'limit is {MAX_PROJECTILE_CELLS}; feasible: {1.001 * stiffer:.4g} Pa or more'
        )
    mass = projectile.mass / count
    stiffness = projectile.youngs_modulus * rig.layer.section / projectile.length * count
    too_fast = crossing / count * (1.0 + _ROUNDING) < step
    implicit = AVERAGE_ACCELERATION * step**2 * stiffness if too_fast else 0.0
    return np.repeat([[mass], [stiffness], [0.0], [implicit], [too_fast]], count, axis=1)


def _halves(mass: Floats) -> Floats:
    """Give half of the mass of each cell to each of its nodes."""
    return 0.5 * (np.append(mass, 0.0) + np.insert(mass, 0, 0.0))
