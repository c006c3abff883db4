"""Derivatives with respect to the shape of the body: its mesh moves with a field V.

With nodal displacements and forces of the rows kept, everything else of the discrete problem is an
explicit function of the vertices x + t V(x).  It is built for a few small t, and differences of
fourth order give the change of its data: no solution is differenced.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial

import numpy as np
from ngsolve import GridFunction, Mesh, VectorH1

from ngepc.checks.arguments import require_coefficient
from ngepc.local.system import DiscreteProblem, State
from ngepc.model.problem import Problem, as_vector
from ngepc.sensitivity.functionals import Functional
from ngepc.sensitivity.radial import Data, RadialDerivative

STENCIL = {-2: 1 / 12, -1: -8 / 12, 1: 8 / 12, 2: -1 / 12}
"""Central difference of fourth order."""

STEP = 1e-5
"""Its step: the largest motion of a vertex over the size of the body."""


def on_moving_mesh(old: State, motion: np.ndarray, read: Callable[[State], Data]) -> Data:
    """d/dt of what is read off a state on the mesh x + t V; displacements and forces stay.

    ``motion`` is V at the vertices, shape (vertices, N) (length per unit of the parameter).
    """
    problem, found, fastest = old.discrete.problem, Data(), np.abs(motion).max()
    size = np.ptp(np.asarray(problem.mesh.ngmesh.Coordinates()), axis=0).max()
    step = STEP * float(size / fastest) if fastest > 0 else 1.0
    for k, weight in STENCIL.items():
        with moved_mesh(problem.mesh, k * step * motion):
            discrete = DiscreteProblem(problem)
            state = discrete.state(old.u, contact=turned(old.contact, old.discrete, discrete))
            found += weight / step * read(state)
    return found


def geometry(old: State, state: State) -> Data:
    """Data on a moved mesh, strains of the same displacements, forces and gaps that they leave."""
    discrete, law, points = state.discrete, state.discrete.law, state.discrete.points
    contact, cone, material = discrete.contact, discrete.contact.friction, discrete.problem.material
    mean, stress = old.discrete.law.bulk * old.volume, old.discrete.law.stress(old.at)
    forces = points.forces(mean, stress) + discrete.supports.pull(old.u)
    names = ("two_mu", "bulk", "hardening", "beta", "back", "initial")
    return Data({name: getattr(law, name) for name in names}) + Data(
        kinematic=points.at(material.hardening),
        isotropic=points.at(material.scalar_growth),
        volume=state.volume,
        strain=state.deviator,
        load=discrete.load - forces - contact.forces(state.contact),
        gaps=contact.normal(state.gaps),
        origin=cone.split(turned(state.gaps, discrete, old.discrete))[1],
        values=discrete.supports.values,
        cap=np.where(np.isfinite(cone.cap), cone.cap, 0.0),
        coefficient=cone.coefficient,
    )


def shape_data(state: State, change: object) -> Data:
    """The change of the discrete data per unit of V; "shape" has the motion itself."""
    motion = vertex_motion(state.discrete.problem, change)
    return on_moving_mesh(state, motion, partial(geometry, state)) + Data(shape=motion)


def by_the_mesh(functional: Functional, state: State, data: Data) -> float:
    """The part of a functional's derivative that the other data do not carry."""
    if "shape" not in data:
        return 0.0

    def read(there: State) -> Data:
        """What carries the rest, and the value of the functional."""
        return geometry(state, there) + Data(value=functional.slope(there).value)

    found = on_moving_mesh(state, data["shape"], read)
    found += RadialDerivative(state).forward(np.zeros_like(state.u), found)
    by = functional.slope(state).by
    return float(found["value"]) - by.paired(found, state.discrete.points)


def turned(x: np.ndarray, here: DiscreteProblem, there: DiscreteProblem) -> np.ndarray:
    """Forces or gaps of rows on one mesh in the tangents of the same rows on a mesh close by."""
    if not here.contact.friction.d:
        return x
    corner = np.einsum("mik,mjk->mij", here.rows.tangents, there.rows.tangents)
    left, _, right = np.linalg.svd(corner)
    n, t = here.contact.friction.split(x)
    return np.append(n, np.einsum("mi,mij->mj", t, left @ right))


@contextmanager
def moved_mesh(mesh: Mesh, motion: np.ndarray) -> Iterator[None]:
    """The mesh with its vertices moved, and back where they were afterwards."""
    vertices = np.asarray(mesh.ngmesh.Coordinates())
    before = vertices.copy()
    vertices += motion
    try:
        yield
    finally:
        vertices[:] = before


def vertex_motion(problem: Problem, change: object) -> np.ndarray:
    """V at the vertices, shape (vertices, N).

    TypeError, ValueError if V is missing or not a vector of N components, the mesh is curved, or
    the axis of a body of revolution would move.
    """
    mesh = problem.mesh
    if change is None:
        raise ValueError("parameters='shape': Direction('shape', V) with a vector V is needed")
    if mesh.GetCurveOrder() > 1:
        raise ValueError(f"mesh: curved of order {mesh.GetCurveOrder()}, a straight one is needed")
    V = as_vector(change)
    require_coefficient("change", V, [(mesh.dim,)])
    nodal = GridFunction(VectorH1(mesh, order=1))
    nodal.Set(V, dual=True)
    motion = nodal.vec.FV().NumPy().reshape(mesh.dim, -1).T.copy()
    radii = np.asarray(mesh.ngmesh.Coordinates())[:, 0]
    if problem.kinematics.hoop and np.abs(motion[radii <= 1e-12 * radii.max(), 0]).any():
        raise ValueError(f"change={change!r}: a field that keeps the axis x = 0 is needed")
    return motion
