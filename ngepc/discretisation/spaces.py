"""The finite element spaces of section 7.

Y_h = V_h x Q_h :  u in vector P1, zero on Gamma_d;  p in P0, d trace-free coordinates,
H_h = Z_h x R_h :  z in P1(Gamma_c), q in P1(Omega)^d, with the boundary conditions that
                   the Tichonov choice asks for.

On elements whose strains vary, quadrilaterals and hexahedra first of all, p is discontinuous of
order one and follows them; constant p would leave all bending of an element elastic.
"""

import numpy as np
from ngsolve import H1, L2, Compress, FESpace, GridFunction, Mesh, VectorH1, VectorValued

from ngepc.checks.arguments import Coefficient
from ngepc.model.elements import plastic_order
from ngepc.model.places import Edge, Place, Point, values_at, vertices_at
from ngepc.model.problem import Problem, as_scalar


def displacement_space(problem: Problem) -> FESpace:
    """V_h: continuous vectors of the problem's order; held components are not free."""
    fixed = {axis: list(problem.clamped_names) for axis in range(problem.N)}
    elsewhere = []
    for place, axis, _ in _prescribed(problem):
        if isinstance(place, str):
            fixed[axis].append(place)
        else:
            elsewhere.append((place, axis))
    conditions = {f"dirichlet{'xyz'[a]}": "|".join(names) for a, names in fixed.items() if names}
    V = VectorH1(problem.mesh, order=problem.order, **conditions)
    for place, axis in elsewhere:
        for dof in nodes_at(V.components[axis], place).tolist():
            V.FreeDofs().Clear(V.Range(axis).start + dof)
    return V


def _prescribed(problem: Problem) -> list[tuple[Place, int, Coefficient]]:
    """Place, number and value of each prescribed component."""
    given = problem.held_components.items()
    return [(p, axis, c) for p, each in given for axis, c in enumerate(each) if c is not None]


def nodes_at(scalar: FESpace, place: Place) -> np.ndarray:
    """Degrees of freedom of one displacement component that belong to a place."""
    if isinstance(place, Point):
        return vertices_at(place, scalar.mesh)
    on_edges = isinstance(place, Edge)
    region = scalar.mesh.BBoundaries(place.name) if on_edges else scalar.mesh.Boundaries(place)
    return np.flatnonzero(np.array(scalar.GetDofs(region), dtype=bool))


def prescribed_displacement(problem: Problem, V: FESpace) -> GridFunction:
    """A function in ``V`` with the prescribed values, zero at all free nodes.

    On edges it varies linearly between the vertices.
    """
    lift, one = GridFunction(V), GridFunction(V)
    to, source = lift.vec.FV().NumPy(), one.vec.FV().NumPy()
    for place, axis, component in _prescribed(problem):
        first = V.Range(axis).start
        if isinstance(place, str):
            region = problem.mesh.Boundaries(place)
            one.components[axis].Set(as_scalar(component), definedon=region)
            dofs = first + nodes_at(V.components[axis], place)
            to[dofs] = source[dofs]
        else:
            vertices, values = values_at(component, problem.mesh, place)
            to[first + vertices] = values[:, 0]
    return lift


def plastic_space(problem: Problem) -> FESpace:
    """Q_h: discontinuous plastic strains of ``plastic_order`` in d orthonormal coordinates."""
    mesh = problem.mesh
    return VectorValued(L2(mesh, order=plastic_order(mesh, 1)), problem.kinematics.d)


def outer_boundaries(mesh: Mesh) -> set[str]:
    """Names of the boundaries of the body, without the interfaces between materials."""
    facets = "edges" if mesh.dim == 2 else "faces"
    return {
        name
        for name in set(mesh.GetBoundaries())
        if any(
            len(mesh[facet].elements) == 1
            for element in mesh.Boundaries(name).Elements()
            for facet in getattr(element, facets)[:1]
        )
    }


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
