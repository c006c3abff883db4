"""The data of a problem, and the state of a result, on a bisected copy of the mesh.

``parents`` maps each of its elements to the number of the one that it lies in.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from copy import copy
from dataclasses import fields, replace
from functools import cache

import numpy as np
from ngsolve import L2, CoefficientFunction, GridFunction, Mesh, VectorH1, VectorValued

from ngepc._deprecated import old_names
from ngepc.bounds.copies import with_matching
from ngepc.bounds.coverage import check_covered, varies_inside
from ngepc.bounds.displacements import carried_displacements, shares_in_parents
from ngepc.bounds.rollers import by_nodes
from ngepc.discretisation.points import Points, on_children
from ngepc.discretisation.polynomials import is_polynomial
from ngepc.discretisation.spaces import displacement_space, nodal
from ngepc.local.result import ExactResult
from ngepc.local.system import DiscreteProblem, State
from ngepc.model.data import ACTING
from ngepc.model.material import Material
from ngepc.model.own import MeshState
from ngepc.model.problem import Problem
from ngepc.results.outcome import History, Status

HISTORY = ("initial_plastic_strain", "initial_hardening", "initial_accumulated")

CARRIED = (*HISTORY, "initial_strain")
"""Data inside the body, apart from the material and the body force."""

Transfer = Callable[[np.ndarray, Points, Points, np.ndarray], np.ndarray]


def check_carried(problem: Problem) -> None:
    """Refuse problems that no bound covers, and boundary data of finite element functions."""
    check_covered(problem)
    check_free_of_functions(problem)


def check_free_of_functions(problem: Problem) -> None:
    """Refuse boundary data of finite element functions."""
    names = not_carried(problem)
    if names:
        raise ValueError(
            f"{names[0]} is made of a GridFunction, which belongs to one mesh: numbers or "
            "functions of position are needed"
        )


def not_carried(problem: Problem) -> list[str]:
    """The data of finite element functions that another mesh does not know."""
    names = [*ACTING, "gap", "friction"]
    if not is_displacement(problem.initial_displacement, problem):
        names.append("initial_displacement")
    if problem.f is not None and varies_inside(problem, problem.f):
        names.append("body_force")
    return [
        name
        for name in names
        if any(
            "gridfunction" in str(v).lower() for v in values_in(getattr(problem, name))
        )
    ]


def values_in(value: object) -> list[CoefficientFunction]:
    """The coefficient functions in a value, a mapping or a sequence."""
    if isinstance(value, Mapping):
        value = list(value.values())
    if isinstance(value, list | tuple):
        return [one for item in value for one in values_in(item)]
    return [value] if isinstance(value, CoefficientFunction) else []


def on_mesh(
    problem: Problem,
    mesh: Mesh,
    parents: np.ndarray,
    order: int | None = None,
    transfer: Transfer = on_children,
) -> Problem:
    """The problem on a mesh whose simplices lie in the elements of its own with these numbers.

    Data that are constant on the elements are transferred exactly, for order two affine plastic
    strains and back stresses as well, and displacements at the start of the step that are functions
    of the displacement space.  The data are not checked again.  ``order`` is that of the
    displacements, by default the same; ``transfer`` maps values at the points of the elements to
    those at the points of the simplices.
    """
    order = problem.order if order is None else order

    def carried(value: object) -> object:
        """A number, a coefficient or several."""
        return mapped(value, on_children_of)

    @cache
    def points_of_both() -> tuple[Points, Points]:
        """The points of both meshes, which are made if a coefficient needs them."""
        before = Points(problem.mesh, problem.kinematics, problem.order)
        return before, Points(mesh, problem.kinematics, order)

    def on_children_of(value: CoefficientFunction) -> CoefficientFunction:
        """A coefficient by its values at the points of the children."""
        before, after = points_of_both()
        values = transfer(before.at(value), before, after, parents)
        if is_polynomial(value, problem.mesh, 0):
            return shaped_like(value, piecewise_constant(values, after))
        return shaped_like(value, after.functions.function(values))

    names = [*CARRIED]
    start = problem.initial_displacement
    if is_displacement(start, problem):
        start = carried_function(start, problem, mesh, parents)
    if problem.f is not None and not varies_inside(problem, problem.f):
        names.append("body_force")
    material = problem.material
    finer = copy(problem)
    changes = {f.name: carried(getattr(material, f.name)) for f in fields(Material)}
    vars(finer).update({name: carried(getattr(problem, name)) for name in names})
    vars(finer).update(mesh=mesh, order=order, material=replace(material, **changes))
    vars(finer).update(initial_displacement=start)
    return finer.as_solved_on(MeshState.of(mesh))


def piecewise_constant(values: np.ndarray, points: Points) -> GridFunction:
    """The function of order zero with these values at the points of simplices.

    Products of such functions are constant, those of affine functions of a high degree.
    """
    columns = values[points.blocks[0].points[:, 0]].reshape(points.mesh.ne, -1)
    space = L2(points.mesh, order=0)
    if values.ndim > 1:
        space = VectorValued(space, columns.shape[1])
    result = GridFunction(space)
    result.vec.FV().NumPy()[:] = columns.T.ravel()
    return result


def discrete_on(old: ExactResult, mesh: Mesh, parents: np.ndarray) -> DiscreteProblem:
    """The discrete problem of a result on a bisected mesh, see ``on_mesh``.

    Supports hold the same parts of the body on both meshes.
    """
    discrete = DiscreteProblem(on_mesh(old.problem, mesh, parents))
    if not old.discrete.floating.centres:
        discrete.floating = discrete.floating_parts([])
    return discrete


def mapped(
    value: object, change: Callable[[CoefficientFunction], CoefficientFunction]
) -> object:
    """A number, a coefficient or several, with coefficients changed."""
    if isinstance(value, tuple | list):
        return tuple(mapped(one, change) for one in value)
    return change(value) if isinstance(value, CoefficientFunction) else value


def shaped_like(
    value: CoefficientFunction, function: CoefficientFunction
) -> CoefficientFunction:
    """A function with the same components as a coefficient, as a matrix where that is one."""
    dims = tuple(value.dims)
    return function.Reshape(dims) if len(dims) == 2 else function


def lowered_problem(problem: Problem) -> Problem:
    """The problem with displacements of order one, and a history that is constant on elements.

    Affine data are replaced by their values at the centres of the elements, the displacement at the
    start of the step by its interpolant.
    """
    points = Points(problem.mesh, problem.kinematics, 1)

    def constant(value: CoefficientFunction) -> CoefficientFunction:
        """The coefficient with one value on each element."""
        return shaped_like(value, points.functions.function(points.at(value)))

    history = {name: mapped(getattr(problem, name), constant) for name in HISTORY}
    if problem.u_0 is not None:
        start = GridFunction(VectorH1(problem.mesh, order=1))
        start.Set(problem.u_0)
        history["initial_displacement"] = start
    return problem.changed(order=1, **history)


def is_displacement(value: object, problem: Problem) -> bool:
    """Whether a value is a function of the displacement space of a problem."""
    if not (isinstance(value, GridFunction) and value.space.mesh is problem.mesh):
        return False
    return len(value.vec) == displacement_space(problem).ndof


def carried_function(
    u: GridFunction, problem: Problem, mesh: Mesh, parents: np.ndarray
) -> GridFunction:
    """The same function on a bisected mesh; ``u`` is one of the displacement space of a problem."""
    before, after = (
        Points(m, problem.kinematics, problem.order) for m in (problem.mesh, mesh)
    )
    values = nodal(u.vec.FV().NumPy(), problem)
    shares = shares_in_parents(before, after, parents)
    values = carried_displacements(values, shares, before, after, parents)
    found = GridFunction(VectorH1(mesh, order=problem.order), name=u.name)
    found.vec.FV().NumPy()[:] = values.T.ravel()
    return found


def carried_state(
    old: ExactResult, discrete: DiscreteProblem, parents: np.ndarray
) -> State:
    """The state on a bisected mesh: the same displacements, forces from the contact pressures."""
    problem = discrete.problem
    supports = discrete.supports
    ends = problem.N + 1
    before = old.discrete.points
    after = discrete.points
    shares = shares_in_parents(before, after, parents)
    u = carried_displacements(old.state.u, shares, before, after, parents)
    stress = np.zeros((problem.mesh.nv, 1 + problem.N))
    if len(discrete.contact):
        known = tractions_at_vertices(old)
        stress[: len(known)] = known
        cells, share = shares
        corners = before.blocks[0].nodes[parents[cells], :ends]
        nodes = after.blocks[0].nodes[cells, :ends]
        stress[nodes] = np.matmul(share, known[corners])
    contact = forces_of_rows(discrete, stress)
    return discrete.state(supports.admissible(u), contact=contact)


def tractions_at_vertices(result: ExactResult) -> np.ndarray:
    """Contact pressure and friction on the obstacle (stress), (vertices, 1 + N)."""
    tangents = result.rows.tangents
    friction = np.einsum("md,mdj->mj", result.nodal_friction_forces, tangents)
    forces = np.column_stack([result.pressing, friction])
    return result.discrete.contact.densities(forces)


def forces_of_rows(discrete: DiscreteProblem, stress: np.ndarray) -> np.ndarray:
    """Contact forces of the rows, as those of a state, from ``tractions_at_vertices``."""
    rows = discrete.rows
    forces = rows.between(stress) * rows.weights[:, None]
    dragged = np.einsum("mdc,mc->md", rows.tangents, forces[:, 1:])
    return np.concatenate([forces[:, 0], dragged.ravel()])[: len(discrete.contact)]


def on_matching(result: ExactResult) -> tuple[ExactResult, np.ndarray | None]:
    """The displacement of a result on a copy of its mesh that matches between two bodies.

    The second result are the parents; the result itself and None where the mesh matches already.
    """
    found = with_matching(result.problem, None)
    if found is None:
        return result, None
    check_carried(result.problem)
    mesh, parents = found
    discrete = by_nodes(discrete_on(result, mesh, parents))
    state = carried_state(result, discrete, parents)
    return ExactResult(state, Status.STOPPED, "", History()), parents


__getattr__ = old_names(__name__)
