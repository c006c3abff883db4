"""Derivatives with respect to the shape of the body: its mesh moves with a field V.

With nodal displacements and forces of the rows kept, everything else of the discrete problem is an
explicit function of the vertices x + t V(x).  It is built for a few small t, and differences of
fourth order give the change of its data: no solution is differenced.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager

import numpy as np
from ngsolve import Grad, GridFunction, Mesh, Norm, VectorH1

from ngepc.checks.arguments import require_coefficient
from ngepc.local.system import DiscreteProblem, State
from ngepc.model.problem import Problem, as_vector
from ngepc.sensitivity.functionals import Functional
from ngepc.sensitivity.radial import Data, RadialDerivative, paired

STENCIL = {-2: 1 / 12, -1: -8 / 12, 1: 8 / 12, 2: -1 / 12}
"""Central difference of fourth order."""

STEP = 1e-5
"""Its step: largest change of a length in the mesh, relative."""


class MovingBody:
    """A solution on a mesh whose vertices move with V; displacements and contact forces stay.

    ``motion`` is V at the vertices, shape (vertices, N) (length per unit of the parameter).
    """

    def __init__(self, state: State, motion: np.ndarray) -> None:
        self.state, self.motion = state, motion
        mesh = state.discrete.problem.mesh
        V = GridFunction(VectorH1(mesh, order=1))
        V.vec.FV().NumPy()[:] = motion.T.ravel()
        slope = float(state.discrete.points.at(Norm(Grad(V))).max())
        size = np.ptp(np.asarray(mesh.ngmesh.Coordinates()), axis=0).max()
        fastest = max(slope, float(np.abs(motion).max()) / size)
        self._step = STEP / fastest if fastest > 0 else 1.0

    def derivative(self, read: Callable[[State], Data]) -> dict[str, np.ndarray]:
        """d/dt of what is read off the state on the mesh x + t V."""
        found: dict[str, np.ndarray] = {}
        problem, old = self.state.discrete.problem, self.state
        for k, weight in STENCIL.items():
            with moved_mesh(problem.mesh, k * self._step * self.motion):
                discrete = DiscreteProblem(problem)
                x = turned(old.contact, old.discrete, discrete)
                state = discrete.state(old.u, contact=x)
                for name, value in read(state).items():
                    found[name] = found.get(name, 0.0) + weight / self._step * value
        return found

    def data(self) -> Data:
        """The change of the discrete data per unit; "shape" has the motion itself."""
        return self.derivative(self._geometry) | {"shape": self.motion}

    def _geometry(self, state: State) -> Data:
        """Data, strains of the same displacements, and forces and gaps that they leave."""
        discrete, old = state.discrete, self.state
        law, points, contact = discrete.law, discrete.points, discrete.contact
        names = ("two_mu", "bulk", "hardening", "beta", "back", "initial")
        material = discrete.problem.material
        isotropic = material.hardening_stiffness * material.hardening_modulus
        mean, stress = old.discrete.law.bulk * old.volume, old.discrete.law.stress(old.at)
        forces = points.forces(mean, stress) + discrete.supports.pull(old.u)
        found = {name: getattr(law, name) for name in names} | {
            "kinematic": points.at(material.hardening),
            "isotropic": points.at(isotropic * material.yield_stress),
            "volume": state.volume,
            "strain": state.deviator,
            "load": discrete.load - forces - contact.forces(state.contact),
            "gaps": contact.normal(state.gaps),
            "origin": contact.tangential(turned(state.gaps, discrete, old.discrete)),
            "values": discrete.supports.values,
        }
        if contact.friction.d:
            found |= {"cap": contact.friction.cap, "coefficient": contact.friction.coefficient}
            found["cap"] = np.where(np.isfinite(found["cap"]), found["cap"], 0.0)
        return found

    def explicit(self, functional: Functional, data: Data) -> float:
        """The part of a functional's derivative that the discrete data do not carry."""
        slope, state = functional.slope(self.state), self.state
        whole = self.derivative(lambda there: {"value": functional.slope(there).value})
        changes = RadialDerivative(state).forward(np.zeros_like(state.u), data)
        carried = slope.of_points(state, *changes)
        return float(whole["value"]) - carried - paired(state.discrete.points, slope.explicit, data)


def turned(x: np.ndarray, here: DiscreteProblem, there: DiscreteProblem) -> np.ndarray:
    """Forces or gaps of rows on one mesh in the tangents of the same rows on a mesh close by."""
    if not here.contact.friction.d:
        return x
    corner = np.einsum("mik,mjk->mij", here.rows.tangents, there.rows.tangents)
    left, _, right = np.linalg.svd(corner)
    t = np.einsum("mi,mij->mj", here.contact.tangential(x), left @ right)
    return np.concatenate([here.contact.normal(x), t.ravel()])


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
