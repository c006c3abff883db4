"""The finite element spaces of section 7.

Y_h = V_h x Q_h :  u in vector P1, zero on Gamma_d;  p in P0, d trace-free coordinates,
H_h = Z_h x R_h :  z in P1(Gamma_c), q in P1(Omega)^d, with the boundary conditions that
                   the Tichonov choice asks for.

On elements whose strains vary, quadrilaterals and hexahedra first of all, p is discontinuous of
order one and follows them; constant p would leave all bending of an element elastic.
"""

import numpy as np
from ngsolve import (
    H1,
    L2,
    Compress,
    FESpace,
    GridFunction,
    Mesh,
    VectorH1,
    VectorValued,
)

from ngepc.checks.arguments import boundary_names
from ngepc.model.problem import Problem, as_scalar
from ngepc.model.rules import plastic_order

AXES = "xyz"


def displacement_space(problem: Problem) -> FESpace:
    """V_h: continuous vectors of the problem's order; held components are not free."""
    fixed = {axis: list(problem.clamped_names) for axis in AXES[: problem.N]}
    for name, components in single_prescribed(problem).items():
        for axis, component in zip(AXES, components, strict=False):
            if component is not None:
                fixed[axis].append(name)
    conditions = {f"dirichlet{axis}": "|".join(names) for axis, names in fixed.items() if names}
    return VectorH1(problem.mesh, order=problem.order, **conditions)


def single_prescribed(problem: Problem) -> dict[str, tuple]:
    """Single boundary name -> its prescribed components, None for a free one."""
    return {
        name: tuple(components)
        for names, components in (problem.prescribed or {}).items()
        for name in boundary_names("prescribed", names, problem.mesh)
    }


def prescribed_displacement(problem: Problem, V: FESpace) -> GridFunction:
    """A function in ``V`` with the prescribed boundary values, zero at all free nodes."""
    lift = GridFunction(V)
    one = GridFunction(V)
    for name, components in single_prescribed(problem).items():
        for axis, component in enumerate(components):
            if component is not None:
                region = problem.mesh.Boundaries(name)
                one.components[axis].Set(as_scalar(component), definedon=region)
                _copy_dofs(lift, one, V, axis, region)
    return lift


def _copy_dofs(target: GridFunction, source: GridFunction, V: FESpace, axis: int, region) -> None:
    first = V.Range(axis).start
    component = V.components[axis]
    mask = np.array(component.GetDofs(region), dtype=bool)
    dofs = first + np.flatnonzero(mask)
    target.vec.FV().NumPy()[dofs] = source.vec.FV().NumPy()[dofs]


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


def other_boundaries(problem: Problem) -> str:
    """All outer boundaries but Gamma_c, as 'a|b', for conditions at the ends of Gamma_c."""
    return "|".join(sorted(outer_boundaries(problem.mesh) - set(problem.contact_names)))


def contact_space(problem: Problem, *, ends_fixed: bool = True) -> FESpace | None:
    """Z_h: P1 on Gamma_c, by default zero at its ends; None without contact."""
    if not problem.contact_names:
        return None
    region = problem.mesh.Boundaries("|".join(problem.contact_names))
    rest = other_boundaries(problem)
    conditions = {"dirichlet": rest} if ends_fixed and rest else {}
    return Compress(H1(problem.mesh, order=1, definedon=region, **conditions))


def plastic_dual_space(problem: Problem, *, boundary_fixed: bool = True) -> FESpace:
    """R_h: continuous P1 with d components, by default zero on the boundary of the body."""
    outer = "|".join(sorted(outer_boundaries(problem.mesh)))
    conditions = {"dirichlet": outer} if boundary_fixed else {}
    return VectorValued(H1(problem.mesh, order=1, **conditions), problem.kinematics.d)
