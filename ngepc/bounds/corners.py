"""A result on a copy of its mesh that is bisected where the error concentrates.

On uniform meshes most of an error bound comes from a few elements at singular corners, because the
stress that the bound is computed with has the size of the elements; or from needles, along which it
is too coarse.  The displacement of the result is a function on the copy, too, so that a stress on
the copy bounds the same error.
"""

from __future__ import annotations

import numpy as np
from ngsolve import BND, Mesh

from ngepc.bounds.balance import BALANCED, factorise, spring_energy
from ngepc.bounds.bisection import Bisection
from ngepc.bounds.boundary import Boundary
from ngepc.bounds.contact import ContactFacets
from ngepc.bounds.convex import conjugate_of
from ngepc.bounds.coordinates import Displaced, stress_coordinates
from ngepc.bounds.copies import bisected, with_matching
from ngepc.bounds.coverage import COVERS as BOUNDED
from ngepc.bounds.faces import MOST_FACTORISED, is_soft
from ngepc.bounds.held import RigidWorks, pressure_of_works
from ngepc.bounds.rollers import by_nodes
from ngepc.bounds.simplices import Simplices
from ngepc.bounds.transfer import carried_state, check_carried, discrete_on, not_carried
from ngepc.discretisation.factors import Factors
from ngepc.local.indicators import COVERS as ESTIMATED
from ngepc.local.indicators import indicators_of
from ngepc.local.result import ExactResult
from ngepc.local.system import State
from ngepc.model.features import HISTORY_FEATURES, is_covered
from ngepc.model.support import rigid_motions

SHARE = 0.008
TIMES = 10.0
"""Elements are bisected until no indicator is more than this share of the sum of all, or so many
times the mean of all."""
MOST_PASSES = 8
WITHOUT_HISTORY = BOUNDED - HISTORY_FEATURES
LARGEST = 40_000
"""The most elements of a copy that is cut throughout: matrices of tetrahedra need 150 MB then."""
SLENDER = 12.0
"""Longest side over height of triangles that count as needles."""


def state_on_copy(result: ExactResult) -> tuple[State, np.ndarray] | None:
    """The state of a result on a bisected copy of its mesh, and the parents of the elements.

    None where no element stands out, where data belong to the mesh, and where there are no
    indicators.  For two bodies the copy always matches where they meet.  In three dimensions see
    ``state_in_eighths``.
    """
    problem = result.problem
    if problem.N == 3:
        return state_in_eighths(result)
    if not_carried(problem):
        if problem.contact_pairs:
            check_carried(problem)
        return None
    found = None
    if is_covered(problem, ESTIMATED):
        indicators = indicators_of(result.state)
        found = bisected_where_outstanding(problem.mesh, indicators)
    found = with_matching(problem, found)
    if found is None:
        return None
    mesh, parents = found
    discrete = by_nodes(discrete_on(result, mesh, parents))
    return carried_state(result, discrete, parents), parents


def state_in_eighths(result: ExactResult) -> tuple[State, np.ndarray] | None:
    """The state of a result of order two in space on eighths of the tetrahedra, and their parents.

    The stress of its bound is one of order one, which is less accurate than the displacement.  None
    in the plane, for order one, for large meshes, where data belong to the mesh, and with a
    history: polynomials that are not negative at its points may be at those of the parts.  Of
    bodies that harden softly the stress on the mesh itself is better where the faces of the mesh,
    but not those of the copy, are few enough for factors.
    """
    problem = result.problem
    count = problem.mesh.ne
    if problem.N == 2 or problem.order == 1 or 8 * count > LARGEST:
        return None
    if not_carried(problem) or not is_covered(problem, WITHOUT_HISTORY):
        return None
    mesh, parents = bisected(problem.mesh, np.ones(count, dtype=bool))
    factorised = faces_of(problem.mesh) <= MOST_FACTORISED < faces_of(mesh)
    if factorised and hardens_softly(result.state):
        return None
    discrete = by_nodes(discrete_on(result, mesh, parents))
    return carried_state(result, discrete, parents), parents


def faces_of(mesh: Mesh) -> int:
    """The number of faces of tetrahedra; ``nface`` of a bisected mesh has those before, too."""
    return (4 * mesh.ne + mesh.GetNE(BND)) // 2


def hardens_softly(state: State) -> bool:
    """Whether the search of a stress near that of a state in space is ill-conditioned."""
    discrete = state.discrete
    each = len(discrete.points) // discrete.problem.mesh.ne
    conjugate = conjugate_of(discrete.law, each)
    z = stress_coordinates(*discrete.law.stress(state.at))
    at = conjugate.completed(z.reshape(-1, each, z.shape[1]))
    return is_soft(conjugate.compliance(at))


def pressure_on_copy(
    result: ExactResult, copy: State, contact: ContactFacets, parents: np.ndarray
) -> np.ndarray | None:
    """The contact pressure of a result at the vertices of the facets of a copy, (facets, 2).

    Order two: affine on each facet of the mesh, and not continuous.  Order one: that of the forces
    on the ``copy``, with the resultant of those of the result.  None in space and for two bodies.
    """
    problem = result.problem
    if problem.N == 3 or problem.contact_pairs or not problem.contact_names:
        return None
    if problem.order == 1:
        P = contact.from_rows.pressure(copy.multipliers)
        return pressure_with_resultant(result.state, contact, P)
    cells = Simplices.of(problem.mesh)
    old = ContactFacets(result.discrete, Boundary(problem, cells))
    P = old.from_rows.pressure(result.state.multipliers)

    # the facet of the same direction on the parent
    same = parents[contact.owner][:, None] == old.owner
    facet = np.argmax(same * (contact.normal @ old.normal.T), axis=1)
    start, end = np.moveaxis(cells.points[old.nodes[facet, :2]], 1, 0)
    along = end - start
    places = contact.boundary.cells.points[contact.nodes[:, :2]]
    length_squared = np.einsum("ec,ec->e", along, along)
    share = np.einsum("eac,ec->ea", places - start[:, None], along)
    share = share / length_squared[:, None]
    P = (1 - share) * P[facet, :1] + share * P[facet, 1:]
    return pressure_with_resultant(result.state, contact, np.maximum(P, 0.0))


def pressure_with_resultant(
    own: State, contact: ContactFacets, P: np.ndarray
) -> np.ndarray:
    """A pressure on a copy, changed to the resultant of the forces of a state.

    Then stresses around the contact zone balance what is left, see ``strain_nearby``.
    """
    points = contact.boundary.cells.points
    size = np.ptp(points, axis=0).max()  # so that works of all motions are alike
    vertices = rigid_motions((points - points.mean(axis=0)) / size)
    motions = np.zeros((len(contact.discrete.free), *vertices.shape[1:]))
    motions[: len(vertices)] = vertices  # they are affine: edges have no part of them
    pushed = own.discrete.rows.normal.T @ np.maximum(own.multipliers, 0.0)
    pushed = pushed.reshape(len(own.u), -1)[: own.discrete.problem.mesh.nv]
    wanted = np.einsum("ni,nik->k", pushed, motions[: len(pushed)])
    return pressure_of_works(RigidWorks(contact, motions), P, wanted)


def balanced_by_copy(
    own: State, forces: np.ndarray, copy: State, tangent: Factors, parents: np.ndarray
) -> tuple[np.ndarray, float]:
    """A stress (cells, c) near that of a state of order one, in equilibrium with nodal forces.

    The factors of the mesh itself are not needed: ``tangent`` is that on the copy, factorised
    unless the forces are in equilibrium already.  There the residual acts on the same vertices,
    which have the same numbers.  Functions on the mesh are functions on the copy, too, and their
    strains are constant on its cells, so that the mean over the children of a cell does the same
    work.  The second result is the energy of the springs in the change of the displacement.
    """
    z = stress_coordinates(*own.discrete.law.stress(own.at))
    internal = own.internal_forces
    missing = own.discrete.supports.kept(forces - internal)
    if np.abs(missing).max() <= BALANCED * np.abs(internal).max():
        return z, 0.0
    factorise(copy, tangent)
    on_copy = np.zeros_like(copy.u)
    on_copy[: len(missing)] = missing
    moved = tangent.solve(on_copy)
    change = Displaced.of(copy.discrete, moved).stress_change(tangent)
    volume = copy.discrete.points.weights
    cells = own.discrete.points.weights
    sums = [np.bincount(parents, volume * part, len(cells)) for part in change.T]
    z = z + np.stack(sums, axis=1) / cells[:, None]
    return z, spring_energy(copy.discrete, moved)


def bisected_where_outstanding(
    mesh: Mesh, indicators: np.ndarray
) -> tuple[Mesh, np.ndarray] | None:
    """A copy of a mesh without outstanding indicators, and the parents; None if there are none.

    The indicators of children are taken to be proportional to their areas.  Needles are cut, too.
    """
    limit = max(SHARE, TIMES / mesh.ne) * indicators.sum()
    outstanding = indicators > limit
    finer = Bisection(mesh)
    needles = np.empty(0, dtype=int)
    if 4 * mesh.ne <= LARGEST:
        needles = np.flatnonzero(finer.slenderness() > SLENDER)
    if not outstanding.any() and not len(needles):
        return None
    there = np.flatnonzero(outstanding)
    density = np.zeros(len(indicators))
    density[there] = indicators[there] / finer.sizes(there)
    if len(needles):
        finer.cut(needles)
    for _ in range(MOST_PASSES):
        there = np.flatnonzero(outstanding[finer.parents])
        expected = density[finer.parents[there]] * finer.sizes(there)
        if not (expected > limit).any():
            break
        finer.cut(there[expected > limit])
    return finer.built()
