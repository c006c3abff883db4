"""The change of a discrete problem with the shape of its body.

The mesh moves with a field V.  For fixed nodal displacements and contact forces the discrete
problem is an explicit function of the vertices x + t V.  It is assembled for a few small t, and
differences of fourth order give the change of its data: solutions are not differenced.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager

import numpy as np
from ngsolve import GridFunction, Mesh, VectorH1

from ngepc.checks.arguments import require_components
from ngepc.checks.sentences import in_words
from ngepc.discretisation.hill_law import HillLaw
from ngepc.local.system import DiscreteProblem, State
from ngepc.model.problem import Problem
from ngepc.sensitivity.equations import STENCIL, Data

STEP = 1e-5  # of differences: the largest motion of a vertex over the size of the body


def on_moving_mesh(
    old: State, motion: np.ndarray, functional: Callable[[State], float] | None = None
) -> Data:
    """d/dt of the data on the mesh x + t V, and "value" of a functional; u and forces stay.

    ``motion`` is V at the vertices, shape (vertices, N) (length per unit of the parameter).
    """
    problem = old.discrete.problem
    found = Data()
    fastest = np.abs(motion).max()
    size = np.ptp(np.asarray(problem.mesh.ngmesh.Coordinates()), axis=0).max()
    step = STEP * float(size / fastest) if fastest > 0 else 1.0
    for k, weight in STENCIL.items():
        with moved_mesh(problem.mesh, k * step * motion):
            discrete = DiscreteProblem(problem)
            state = discrete.state(
                old.u, contact=_turned(old.contact, old.discrete, discrete)
            )
            data = geometry(old, state) + Data(
                {"value": functional(state)} if functional else {}
            )
            found += weight / step * data
    return found


def geometry(old: State, state: State) -> Data:
    """Data on a moved mesh, with strains, forces and gaps for the same nodal displacements."""
    discrete = state.discrete
    law = state.discrete.law
    points = state.discrete.points
    contact = discrete.contact
    cone = discrete.contact.friction
    material = law.material
    stress = old.discrete.law.stress(old.at)
    forces = points.forces(*stress) + discrete.supports.pull(old.u)
    before = old.discrete.law.resistance
    after = law.resistance
    with_data = before.with_law(after.isotropic).with_rate(after.rate)
    names = ("two_mu", "bulk", "hardening", "back", "initial")
    more = law.own_memory()
    if isinstance(law, HillLaw):
        more |= {"form": law.form, "linear": after.linear}
    return Data({name: getattr(law, name) for name in names} | more) + Data(
        beta=after.beta - before.growth * after.accumulated,
        accumulated=after.accumulated,
        radius=with_data.bound(old.at.gained),
        hardened=with_data.energy(old.at.gained),
        kinematic=points.at(material.hardening),
        isotropic=points.at(material.scalar_growth),
        volume=state.volume,
        strain=state.deviator,
        load=discrete.load - forces - contact.forces(state.contact),
        gaps=_turned(state.gaps, discrete, old.discrete),
        values=discrete.supports.values,
        cap=np.where(np.isfinite(cone.cap), cone.cap, 0.0),
        coefficient=np.where(cone.given, 0.0, cone.coefficient),
    )


def _turned(x: np.ndarray, here: DiscreteProblem, there: DiscreteProblem) -> np.ndarray:
    """Forces or gaps of rows on one mesh in the tangents of the same rows on a mesh close by."""
    if not here.contact.friction.d:
        return x
    corner = np.einsum("mik,mjk->mij", here.rows.tangents, there.rows.tangents)
    left, _, right = np.linalg.svd(corner)
    n, t = here.contact.friction.split(x)
    return np.append(n, np.einsum("mi,mij->mj", t, left @ right))


@contextmanager
def moved_mesh(mesh: Mesh, motion: np.ndarray) -> Iterator[None]:
    """A context in which the vertices of the mesh are moved."""
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
        raise ValueError(
            "parameters='shape': Direction('shape', V) with a vector V is needed"
        )
    if mesh.GetCurveOrder() > 1:
        raise ValueError(
            f"mesh: curved of order {mesh.GetCurveOrder()}, a straight one is needed"
        )
    nodal = GridFunction(VectorH1(mesh, order=1))
    nodal.Set(require_components("change", change, mesh.dim), dual=True)
    motion = nodal.vec.FV().NumPy().reshape(mesh.dim, -1).T.copy()
    radii = np.asarray(mesh.ngmesh.Coordinates())[:, 0]
    if (
        problem.kinematics.hoop
        and np.abs(motion[radii <= 1e-12 * radii.max(), 0]).any()
    ):
        raise ValueError(
            f"change={in_words(change)}: a field that keeps the axis x = 0 is needed"
        )
    return motion
