"""The finite element spaces of section 7, and nodal values of their functions.

Y_h = V_h x Q_h :  u in vector P1, zero on Gamma_d;  p in P0, d trace-free coordinates,
H_h = Z_h x R_h :  z in P1(Gamma_c), q in P1(Omega)^d, with the boundary conditions that
                   the Tichonov choice asks for.

On elements whose strains vary, quadrilaterals and hexahedra first of all, p is discontinuous of
order one and follows them; constant p would leave all bending of an element elastic.
"""

from __future__ import annotations

import numpy as np
from ngsolve import (
    H1,
    L2,
    BitArray,
    Compress,
    FESpace,
    Mesh,
    Projector,
    VectorH1,
    VectorValued,
)
from ngsolve.la import CreateVVector

from ngepc.model.elements import cells_of, element_facets, facet_keys, plastic_order
from ngepc.model.places import Edge, Place, Point, vertices_at
from ngepc.model.problem import Problem


def displacement_space(problem: Problem) -> FESpace:
    """V_h: continuous vectors of the problem's order; held components are not free."""
    fixed = {axis: [] for axis in range(problem.N)}
    elsewhere = []
    for _, place, axis, _ in problem.held:
        if isinstance(place, str):
            fixed[axis].append(place)
        else:
            elsewhere.append((place, axis))
    conditions = {
        f"dirichlet{'xyz'[a]}": "|".join(names) for a, names in fixed.items() if names
    }
    V = VectorH1(problem.mesh, order=problem.order, **conditions)
    for place, axis in elsewhere:
        for dof in nodes_at(V.components[axis], place).tolist():
            V.FreeDofs().Clear(V.Range(axis).start + dof)
    return V


def as_booleans(bits: BitArray) -> np.ndarray:
    """Which bits are set; without a call for each."""
    ones = CreateVVector(len(bits))
    ones[:] = 1.0
    Projector(bits, True).Project(ones)
    return ones.FV().NumPy() != 0


def nodes_at(scalar: FESpace, place: Place) -> np.ndarray:
    """Degrees of freedom of one displacement component that belong to a place."""
    if isinstance(place, Point):
        return vertices_at(place, scalar.mesh)
    on_edges = isinstance(place, Edge)
    region = (
        scalar.mesh.BBoundaries(place.name)
        if on_edges
        else scalar.mesh.Boundaries(place)
    )
    return np.flatnonzero(as_booleans(scalar.GetDofs(region)))


def plastic_space(problem: Problem) -> FESpace:
    """Q_h: discontinuous plastic strains of ``plastic_order`` in d orthonormal coordinates."""
    mesh = problem.mesh
    return VectorValued(L2(mesh, order=plastic_order(mesh, 1)), problem.kinematics.d)


def outer_boundaries(mesh: Mesh) -> set[str]:
    """Names of the boundaries of the body, without the interfaces between materials."""
    facets, elements = np.unique(element_facets(mesh)[0], return_counts=True)
    nodes, region = cells_of(mesh, mesh.dim - 1)
    corners = nodes[:, : 2 ** (mesh.dim - 1)]
    outer = region[np.isin(facet_keys(corners, mesh), facets[elements == 1])]
    return {mesh.GetBoundaries()[number] for number in np.unique(outer)}


def contact_space(problem: Problem, *, ends_fixed: bool = True) -> FESpace:
    """Z_h: P1 on Gamma_c, by default zero at its ends; empty without contact."""
    region = problem.mesh.Boundaries("|".join(problem.contact_names))
    rest = "|".join(sorted(outer_boundaries(problem.mesh) - set(problem.contact_names)))
    conditions = {"dirichlet": rest} if ends_fixed and rest else {}
    return Compress(H1(problem.mesh, order=1, definedon=region, **conditions))


def plastic_dual_space(problem: Problem, *, boundary_fixed: bool = True) -> FESpace:
    """R_h: continuous P1 with d components, by default zero on the boundary of the body."""
    outer = "|".join(sorted(outer_boundaries(problem.mesh)))
    conditions = {"dirichlet": outer} if boundary_fixed else {}
    return VectorValued(H1(problem.mesh, order=1, **conditions), problem.kinematics.d)


def nodal(vector: np.ndarray, problem: Problem) -> np.ndarray:
    """Coefficients of the displacement space, component by component, as (nodes, N)."""
    return vector.reshape(problem.N, -1).T
