"""How far a stress is from one that is exactly in equilibrium: a bound with rounding enclosed.

A stress S that is affine on each cell misses equilibrium by what rounding leaves.  The bound of the
distance has three steps.

1. Each facet gets one traction t: the given load and a reaction that its support or obstacle can
   exert.  The residuals of the forces and moments of each cell under t are enclosed.
2. They are carried along a tree of cells to the supports.  An affine traction q carries a force P
   and a moment M through a facet F, with |q| |F| <= |P| + c |M|, c = 3 / (size of F) in the plane
   and 27 r^3 / |F|^2 in space, r the largest distance of a vertex from the centre.
3. Under t + q each cell is in balance, and S misses its tractions by t + q - S n and its force by a
   residual.  On the cell, cut from its centre, exactly one affine stress with continuous tractions
   makes up for them (Johnson, Mercier, Numer. Math. 30 (1978); Gopalakrishnan, Guzman, Lee 2023 in
   space).  On a unit simplex it is at most ``OF_TRACTIONS`` times the data; a cell with the edges J
   has |J|^2 |J^-1| / det J times as much.

Then S plus a stress of at most this size on each cell is exactly in equilibrium.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ngepc.bounds.simplices import FACETS
from ngepc.limit.data import GROWS, STAYS, LimitData
from ngepc.limit.enclosed import LARGER, Enclosed, cross
from ngepc.limit.outline import Outline, Tree, connected_parts, tree_from

OF_TRACTIONS = {2: 11.0, 3: 66.0}
"""Largest stress on the unit simplex over the largest force on a facet or on the simplex.

The norms are 10.353 and 62.714; ``tests/limit/test_rounding.py`` computes them.
"""

HELD = 1e-9
"""Smallest eigenvalue, relative, of the wrenches of supports that counts as positive."""

PRESSED = 1e-6
"""Contact pressures above this part of the largest take part in the balance of the body."""

LEVER = {2: 6.0, 3: 27.0}
"""Constants of step 2."""


@dataclass(frozen=True, eq=False)
class Defect:
    """What an approximate stress needs to be in equilibrium.

    Parameters
    ----------
    stress
        Bound of the size of the stress to add on each cell, (nc,).
    power
        Bound of the power of its reactions at supports that move.
    """

    stress: np.ndarray
    power: float


class StressDefects:
    """The defects of stresses on some cells.

    Parameters
    ----------
    data
        Loads, supports, obstacles.
    """

    def __init__(self, data: LimitData) -> None:
        self.data = data
        self.outline = Outline(data.cells)
        cells = data.cells
        held = data.held >= cells.N
        self.roots = np.flatnonzero(held & cells.outer)
        self.tree = tree_from(cells, self.roots)
        self.parts = connected_parts(cells)
        self.loose = np.setdiff1d(self.parts, self.parts[cells.owners[self.roots, 0]])
        """Connected parts without a facet that is held in all directions."""
        self.centres = cells.points[cells.nodes].mean(axis=1)
        self.middles = cells.points[cells.facets].mean(axis=1)

    def defect(self, tensors: np.ndarray, factor: float) -> Defect:
        """The defect of a stress (nc, N + 1, N, N) at the vertices of cells, for a load factor."""
        data = self.data
        cells = data.cells
        outline = self.outline
        N = cells.N
        local = np.array(FACETS[N])
        corner = Enclosed(tensors[:, local])
        areas = outline.areas[:, :, None, None]
        own = (corner * areas).sum(axis=4)
        nominal, pressed = self._nominal(own.middle, factor)
        sign = cells.sign[:, :, None, None]
        of_cells = nominal.reshape(-1, N)[cells.slot] * sign
        missed = (of_cells - own).length().max(axis=2)
        load = Enclosed(data.force[STAYS]) + Enclosed(data.force[GROWS]) * factor
        load = load * outline.volumes[:, None]
        slopes = -outline.areas * Enclosed(1 / N, np.spacing(1 / N))
        divergence = (Enclosed(tensors) * slopes[:, :, None]).sum(axis=3).sum(axis=1)
        inside = (divergence + load).length()
        force, moment = self._residuals(of_cells, load)
        through = self._carried(force, moment, pressed)
        missed = (missed + through[cells.facet_of]).max(axis=1) * LARGER
        stress = self._factors() * np.maximum(missed, inside) * LARGER
        fastest = np.linalg.norm(data.motion, axis=2).max(axis=1)
        power = float((fastest[cells.outer] * through[cells.outer]).sum())
        return Defect(stress, power * LARGER)

    def _nominal(self, own: np.ndarray, factor: float) -> tuple[Enclosed, np.ndarray]:
        """Forces of facets at their vertices, (nf, N, N), and which obstacles press firmly."""
        data = self.data
        cells = data.cells
        N = cells.N
        forces = np.zeros((len(cells.facets) * N, N))
        first = np.broadcast_to(cells.sign[:, :, None] > 0, cells.slot.shape)
        forces[cells.slot[first]] = own[first]
        forces = forces.reshape(-1, N, N)
        measures = self.outline.measures()
        given = Enclosed(data.traction[STAYS]) + Enclosed(data.traction[GROWS]) * factor
        given = given * measures[:, None, None]
        reaction = np.einsum("frp,fmp->fmr", data.frame, forces - given.middle)
        touched = data.contact
        rows = np.arange(N) < data.held[:, None]
        rows[touched, 0] = True
        rows[touched, 1:] = (data.friction[touched] > 0).any(axis=1)[:, None]
        reaction = np.where(rows[:, None], reaction, 0.0)
        reaction[touched, :, 0] = np.minimum(reaction[touched, :, 0], 0.0)
        self._drag(reaction, measures)
        pressure = np.where(touched, -reaction[:, :, 0].max(axis=1), 0.0)
        pressed = pressure > PRESSED * np.abs(forces).max()
        parts = Enclosed(reaction)[..., None] * Enclosed(data.frame)[:, None]
        whole = given + parts.sum(axis=2)
        outer = cells.outer[:, None, None]
        return whole.where(outer, Enclosed(forces)), pressed

    def _drag(self, reaction: np.ndarray, measures: Enclosed) -> None:
        """Friction within its bound."""
        data = self.data
        touched = data.contact
        most = data.friction[touched] * measures.least[touched, None]
        sizes = np.linalg.norm(reaction[touched, :, 1:], axis=2)
        part = np.minimum(1.0, most / np.maximum(sizes, 1e-300))
        part = np.where(part < 1, part / LARGER, part)
        reaction[touched, :, 1:] *= part[..., None]

    def _residuals(
        self, of_cells: Enclosed, load: Enclosed
    ) -> tuple[np.ndarray, np.ndarray]:
        """Bounds of the resulting forces and moments on the cells, the latter at their centres."""
        cells = self.data.cells
        N = cells.N
        count = len(cells.nodes)
        share = Enclosed(1 / N, np.spacing(1 / N))
        force = of_cells.reshape(count, -1, N).sum(axis=1) * share + load
        x = Enclosed(cells.points[cells.nodes]) - self.centres[:, None]
        arms = x[:, np.array(FACETS[N])]
        # integrals of products of affine functions over a facet, over its measure
        weight = Enclosed(1 / (N * (N + 1)), np.spacing(1 / (N * (N + 1))))
        both = arms.sum(axis=2), of_cells.sum(axis=2)
        turned = cross(*both) + cross(arms, of_cells).sum(axis=2)
        turned = turned.sum(axis=1) * weight
        middle = x.sum(axis=1) * Enclosed(1 / (N + 1), np.spacing(1 / (N + 1)))
        turned = turned + cross(middle, load)
        return force.length(), turned.length()

    def _carried(
        self, force: np.ndarray, moment: np.ndarray, pressed: np.ndarray
    ) -> np.ndarray:
        """Bounds of the forces at the vertices of facets that the way to supports needs, (nf,)."""
        cells = self.data.cells
        extra = np.zeros(len(cells.facets))
        for part in self.loose:
            extra += self._supported(part, force, moment, pressed)
        owner = cells.owners[:, 0]
        np.add.at(force, owner, extra)
        arm = np.linalg.norm(self.middles - self.centres[owner], axis=1)
        np.add.at(moment, owner, extra * arm * LARGER)
        forces, moments = _ways(self.tree, self.centres, self.middles, force, moment)
        return (forces + self._levers() * moments + extra) * LARGER

    def _levers(self) -> np.ndarray:
        """The factors of moments in step 2 times the size of the facet, (nf,)."""
        cells = self.data.cells
        vertices = cells.points[cells.facets] - self.middles[:, None]
        reach = np.linalg.norm(vertices, axis=2).max(axis=1)
        if cells.N == 2:
            return LEVER[2] / (2 * reach) * LARGER
        least = self.outline.sizes / LARGER**4
        return LEVER[3] * reach**3 / least**2

    def _supported(
        self, part: int, force: np.ndarray, moment: np.ndarray, pressed: np.ndarray
    ) -> np.ndarray:
        """Bounds of forces at facets with single held components that balance the residuals.

        Those of a connected ``part``.
        """
        data = self.data
        cells = data.cells
        N = cells.N
        held = np.arange(N) < data.held[:, None]
        held[pressed, 0] = True
        own = self.parts == part
        held[~cells.outer | ~own[cells.owners[:, 0]]] = False
        facet, row = np.nonzero(held)
        directions = data.frame[facet, row]
        origin = cells.points[np.unique(cells.nodes[own])].mean(axis=0)
        arms = self.middles[facet] - origin
        torques = cross(Enclosed(arms), Enclosed(directions)).middle
        wrenches = np.concatenate([directions, torques], axis=1)
        values = np.linalg.eigvalsh(wrenches.T @ wrenches)
        firm = values[values > HELD * values.max(initial=0.0)]
        away = np.linalg.norm(self.centres[own] - origin, axis=1)
        total = np.hypot(force[own].sum(), (moment[own] + away * force[own]).sum())
        each = np.zeros(len(cells.facets))
        if len(firm):
            each[facet] = total / np.sqrt(firm.min()) * (1 + 1e-3)
        return each

    def _factors(self) -> np.ndarray:
        """The factors of step 3 for each cell."""
        cells = self.data.cells
        size = np.linalg.norm(cells.jacobian, axis=(1, 2))
        inverse = np.linalg.norm(cells.inverse, axis=(1, 2))
        return OF_TRACTIONS[cells.N] * size**2 * inverse / cells.det


def _ways(
    tree: Tree,
    centres: np.ndarray,
    middles: np.ndarray,
    force: np.ndarray,
    moment: np.ndarray,
) -> tuple[np.ndarray, np.ndarray]:
    """Bounds of the forces and moments that go through each facet, the latter at its middle."""
    facet = tree.facet
    above = tree.above
    forces = force.copy()
    moments = moment.copy()
    result = np.zeros((2, len(middles)))
    to_facet = np.linalg.norm(middles[facet] - centres, axis=1)
    from_facet = np.linalg.norm(middles[facet] - centres[above], axis=1)
    forces = forces.tolist()
    moments = moments.tolist()
    ways = zip(
        tree.order.tolist(),
        facet[tree.order].tolist(),
        above[tree.order].tolist(),
        to_facet[tree.order].tolist(),
        from_facet[tree.order].tolist(),
        strict=True,
    )
    for cell, door, behind, arm, next_arm in ways:
        if door < 0:
            continue
        carried = forces[cell]
        turned = moments[cell] + arm * carried
        result[:, door] = carried, turned
        if behind >= 0:
            forces[behind] += carried
            moments[behind] += turned + next_arm * carried
    return tuple(result * (1 + len(force) * 1e-14))
