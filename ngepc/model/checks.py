"""What makes a problem well posed, checked before any work is done.

NGSolve accepts misspelt boundaries, singular supports and NaN in silence; here each is an error
that names the argument, its value and what is legal.
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial

import numpy as np
from ngsolve import CoefficientFunction, Det, Mesh, specialcf

from ngepc.checks.arguments import (
    Coefficient,
    boundary_names,
    require_coefficient,
    require_components,
    require_field,
    require_finite,
    require_in,
    sample,
)
from ngepc.checks.declared import declared_checks
from ngepc.checks.kinds import require_instance, require_mesh
from ngepc.model.contact import Coulomb
from ngepc.model.elements import SHAPES, element_nodes, plastic_points, vertices_of
from ngepc.model.given import Given
from ngepc.model.hardening import check_law
from ngepc.model.kinematics import Kinematics
from ngepc.model.loading import CHECKS, check_acting
from ngepc.model.material import Material, split_hardening
from ngepc.model.places import Roller
from ngepc.model.processes import require_whole
from ngepc.model.support import check_support


def check_problem(problem: Given) -> None:
    """Raise TypeError or ValueError for the first thing that is wrong with ``problem``."""
    problem.processes.together(partial(check_data, problem))
    check_support(problem)


def check_data(problem: Given) -> None:
    """What is wrong with the data on this process's part of the mesh."""
    check_shared(problem)
    check_material(problem.material, problem.mesh, problem.kinematics)
    check_axis(problem)
    check_acting(problem)
    check_pairs(problem)
    check_gap(problem)
    check_friction(problem)
    check_history(problem)


def check_shared(problem: Given) -> None:
    """What several processes cannot do."""
    given = (getattr(problem, name) for name in CHECKS)
    acting = [item for g in given if isinstance(g, Mapping) for item in g.items()]
    there = {
        "order=2": problem.order == 2,
        "contact of two bodies": bool(problem.contact_pairs),
        "points and edges": not all(isinstance(place, str) for place, _ in acting),
        "rollers": any(isinstance(value, Roller) for _, value in acting),
    }
    for what in (name for name, is_there in there.items() if is_there):
        require_whole(what, problem.mesh)


def check_mesh(mesh: Mesh) -> None:
    """A mesh in two or three dimensions with elements of positive size, all oriented alike."""
    require_mesh("mesh", mesh)
    if mesh.comm.size > 1:
        raise ValueError(
            f"mesh is distributed by NGSolve over {mesh.comm.size} processes: ngepc.distribute is "
            "needed"
        )
    nodes = element_nodes(mesh)
    if len(nodes) == 0:
        raise ValueError("mesh has no elements: a mesh of the body is needed")
    if (nodes[:, 2**mesh.dim :] >= 0).any():
        raise ValueError(
            "mesh has elements of second order: leave SecondOrder() out (mesh.Curve bends elements)"
        )
    strange = set((nodes >= 0).sum(axis=1).tolist()) - {k for N, k in SHAPES if mesh.dim == N}
    if strange:
        raise ValueError(
            f"mesh has elements with {min(strange)} corners: triangles, quadrilaterals, "
            "tetrahedra, prisms or hexahedra are needed"
        )
    determinant = Det(specialcf.JacobianMatrix(mesh.dim))
    size = sample(determinant, mesh)
    if not np.isfinite(size).all() or np.abs(size).min() <= 1e-14 * np.abs(size).max():
        raise ValueError("mesh has degenerate elements (zero area or volume)")
    if (nodes[:, 2**mesh.dim - 1] >= 0).any():
        corner = sample(determinant, mesh, corners=True)
        size = np.append(size, corner[np.abs(corner) > 1e-12 * np.abs(size).max()])
    if size.min() < 0 < size.max():
        raise ValueError("mesh has inverted elements (Jacobian determinants of both signs)")


def check_axis(problem: Given) -> None:
    """An axisymmetric body lies at radii x >= 0."""
    radii = np.asarray(problem.mesh.ngmesh.Coordinates())[:, 0]
    if problem.kinematics.hoop and radii.min() < -1e-12 * np.abs(radii).max():
        raise ValueError(
            f'kinematics="axisymmetric": the mesh reaches to x = {radii.min():g}, radii x >= 0 are '
            "needed"
        )


def check_material(material: Material, mesh: Mesh, kinematics: Kinematics) -> None:
    """Elliptic elasticity, positive yield stress and hardening everywhere on the mesh."""
    require_instance("material", material, Material, "a Material")
    for name, check in declared_checks(Material).items():
        require_finite(name, getattr(material, name), mesh, **check.keywords)
    N = kinematics.size
    name = f"{N} lame_lambda + 2 lame_mu"
    bulk = require_finite(name, N * material.lame_lambda + 2 * material.lame_mu, mesh).min()
    if bulk <= 0:
        raise ValueError(
            f"lame_lambda={material.lame_lambda!r}: the elasticity is not elliptic, "
            f"{N} lambda + 2 mu falls to {bulk:g}, > 0 is needed for {N} x {N} tensors"
        )
    if material.law is not None:
        check_law(material.law, mesh)
    name = "the hardening h = k + (H sigma_y)^2 k_1"
    h = require_finite(name, material.effective_hardening, mesh).min()
    if h <= 0 and material.law is None:
        raise ValueError(
            f"{name} falls to {h:g}: > 0 is needed, "
            "the method is for hardening plasticity (perfect plasticity is a Tabulated law)"
        )


def check_pairs(problem: Given) -> None:
    """Existing names, two different boundaries in each pair, none of them a rigid obstacle's."""
    mesh, rigid = problem.mesh, set(problem.contact_names)
    for pair in problem.contact_pairs:
        one, two = (boundary_names("contact", n, mesh) for n in (pair.first, pair.second))
        if set(one) & set(two) or (set(one) | set(two)) & rigid:
            raise ValueError(
                f"contact={pair!r}: two different boundaries are needed, and no obstacle on them"
            )
        if vertices_of(mesh, one) & vertices_of(mesh, two):
            raise ValueError(
                f"contact={pair!r}: the bodies share nodes; mesh them apart (without Glue)"
            )


def check_gap(problem: Given) -> None:
    """A finite gap on the contact boundary, and none without one."""
    names, given = problem.contact_names, problem.gap
    if not names:
        if given is not None:
            raise ValueError(f"gap={given!r}: name the contact boundary too, or leave gap out")
        return
    if given is None:
        raise ValueError(f"contact={problem.contact!r} needs a gap: a number or coefficient")
    several = isinstance(given, Mapping)
    if several and set(given) != set(names):
        raise ValueError(
            f"gap names {sorted(map(str, given))}: the contact boundaries are {sorted(names)}"
        )
    for name in names:
        argument, gap = (f"gap[{name!r}]", given[name]) if several else ("gap", given)
        require_field(argument, gap, problem.mesh, [name], corners=True)


def check_friction(problem: Given) -> None:
    """A finite friction law >= 0, none without contact; no u_0 without friction."""
    if problem.friction is None:
        if problem.initial_displacement is not None:
            raise ValueError(
                "initial_displacement matters for friction alone: give friction too, or leave "
                "initial_displacement out"
            )
        return
    if problem.contact is None:
        raise ValueError(
            f"friction={problem.friction!r}: name the contact boundary too, or leave friction out"
        )
    name, value = "friction", problem.friction
    if isinstance(value, Coulomb):
        name, value = "friction.coefficient", value.coefficient
    require_field(name, value, problem.mesh, problem.touching_names, least=0)
    if problem.initial_displacement is not None:
        u_0 = require_components("initial_displacement", problem.initial_displacement, problem.N)
        require_finite("initial_displacement", u_0, problem.mesh, problem.touching_names)


def check_history(problem: Given) -> None:
    """Initial plastic strain symmetric and trace-free, initial hardening of the right kind."""
    N, hardening = problem.kinematics.size, problem.initial_hardening
    if problem.initial_plastic_strain is not None:
        p = _symmetric("initial_plastic_strain", problem.initial_plastic_strain, problem)
        trace, size = np.abs(np.trace(p, axis1=1, axis2=2)).max(), np.abs(p).max()
        if trace > 1e-10 * max(size, 1e-300):
            raise ValueError(
                f"initial_plastic_strain has trace up to {trace:g}: plastic strains are trace-free"
            )
    if problem.initial_strain is not None:
        require_coefficient("initial_strain", problem.initial_strain, [(), (N, N)])
        _symmetric("initial_strain", problem.eps_0, problem)
    if isinstance(hardening, tuple) and len(hardening) != 2:
        raise ValueError(
            f"initial_hardening={hardening!r}: a scalar, an {N} x {N} "
            "coefficient or the pair of both is needed"
        )
    scalar, back_stress = split_hardening(hardening)
    scalars = {"initial_hardening": scalar, "initial_accumulated": problem.initial_accumulated}
    for name, value in scalars.items():
        if value is not None:
            require_field(name, value, problem.mesh)
            require_in(name, _where_histories_live(value, problem), "the body", least=0)
    if back_stress is not None:
        _symmetric("initial_hardening", back_stress, problem)


def _where_histories_live(value: Coefficient, problem: Given) -> np.ndarray:
    """Values at the integration points, (points, 1); what is below rounding is 0.

    Between them the polynomials that earlier steps leave may fall below what they interpolate.
    """
    if not isinstance(value, CoefficientFunction):
        return np.array([[float(value)]])
    mesh = problem.mesh
    points = mesh.MapToAllElements(plastic_points(mesh, problem.order), mesh.Materials(".*"))
    values = np.reshape(value(points), (-1, 1))
    return np.where(np.abs(values) > 1e-14 * np.abs(values).max(), values, 0.0)


def _symmetric(name: str, value: CoefficientFunction, problem: Given) -> np.ndarray:
    """The samples of a symmetric tensor, shape (points, size, size)."""
    N = problem.kinematics.size
    A = require_field(name, value, problem.mesh, shapes=[(N, N)]).reshape(-1, N, N)
    if np.abs(A - A.transpose(0, 2, 1)).max() > 1e-10 * np.abs(A).max():
        raise ValueError(f"{name} is not symmetric")
    return A
