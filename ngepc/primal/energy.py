"""The energy of the displacement alone on P1 (or multilinear) elements, gradient and tangent."""

import numpy as np
from ngsolve import (
    H1,
    BilinearForm,
    GridFunction,
    IfPos,
    InnerProduct,
    Integrate,
    LinearForm,
    Norm,
    dx,
    specialcf,
    sqrt,
)

from ngepc.discretisation.return_mapping import ReturnMapping, at_plastic_points
from ngepc.discretisation.spaces import displacement_space, prescribed_displacement
from ngepc.model.problem import Problem, as_scalar
from ngepc.model.tensors import coordinates, tensor
from ngepc.results.equilibrium import applied_forces

INVERSE = "sparsecholesky"


class ReducedEnergy:
    """min over p of J(u, p), (2.14), for nodal displacements u of shape (N, vertices).

    Parameters
    ----------
    problem
        Data of the time step.

    Attributes
    ----------
    space
        V_h, ``spaces.displacement_space``.
    displacement
        The GridFunction that holds the displacement looked at last.
    mapping
        ``ReturnMapping`` at ``displacement``.
    free
        Boolean, shape (N, vertices): components that no support holds.
    lift
        Prescribed boundary values, zero elsewhere, shape (N, vertices).
    load
        Nodal forces of tractions and body force, shape (N, vertices).
    yield_forces
        Norm of nodal forces of size beta/h, those of stresses at the yield bound.
    """

    def __init__(self, problem: Problem) -> None:
        self.problem = problem
        self.space = displacement_space(problem)
        self.shape = (problem.N, problem.mesh.nv)
        self.free = np.array(list(self.space.FreeDofs()), dtype=bool).reshape(self.shape)
        self.lift = self.array(prescribed_displacement(problem, self.space)).copy()
        self.displacement = GridFunction(self.space, name="displacement")
        self.mapping = ReturnMapping(problem, self.displacement)
        self.load = applied_forces(problem, self.space)
        self._dx = at_plastic_points(problem, dx)
        u, v = self.space.TnT()
        self._forces = LinearForm(self.space)
        self._forces += self.mapping.power(v) * self._dx
        self._tangent = BilinearForm(self.space, symmetric=False)
        self._tangent += self.mapping.tangent(u, v) * self._dx
        self._density = self.mapping.energy_density.Compile()
        self._plastic = self.mapping.plastic.Compile()
        self._stiffness, self._initial_forces, yielding = self._assemble_trial_forces()
        self.yield_forces = float(np.linalg.norm(yielding))
        self._inverse = None

    def array(self, function: GridFunction) -> np.ndarray:
        """Nodal values of a displacement as an array (N, vertices) on the same memory."""
        return function.vec.FV().NumPy().reshape(self.shape)

    def set(self, u: np.ndarray) -> None:
        """Look at the nodal displacements ``u``."""
        self.array(self.displacement)[:] = u

    def energy(self, u: np.ndarray) -> float:
        """J(u) smallest over p (force times length)."""
        self.set(u)
        stored = Integrate(self._density * self._dx, self.problem.mesh)
        return float(stored - np.vdot(self.load, u))

    def internal_forces(self, u: np.ndarray) -> np.ndarray:
        """Nodal forces of the stress, shape (N, vertices); minus ``load`` it is the gradient."""
        self.set(u)
        self._forces.Assemble()
        return self._forces.vec.FV().NumPy().reshape(self.shape).copy()

    def trial_forces(self, u: np.ndarray) -> float:
        """Norm of nodal forces of size |C| (|u|/h + |p_0|), from which the true ones are cancelled.

        What rounding leaves of the forces is about the machine precision times this number.
        """
        size = np.linalg.norm(u, axis=0) * self._stiffness + self._initial_forces
        return float(np.linalg.norm(size))

    def factorise(self, u: np.ndarray) -> None:
        """Assemble and factorise the tangent at ``u`` for ``solve``."""
        self.set(u)
        self._tangent.Assemble()
        if self._inverse is None:
            self._inverse = self._tangent.mat.Inverse(self.space.FreeDofs(), inverse=INVERSE)
            self._right = self._tangent.mat.CreateColVector()
            self._solution = self._tangent.mat.CreateRowVector()
        else:
            self._inverse.Update()

    def solve(self, forces: np.ndarray) -> np.ndarray:
        """Displacements, zero at the supports, that the last tangent answers ``forces`` with."""
        self._right.FV().NumPy()[:] = forces.ravel()
        self._solution.data = self._inverse * self._right
        return np.where(self.free, self._solution.FV().NumPy().reshape(self.shape), 0.0)

    def plastic_measure(self, u: np.ndarray) -> float:
        """Area or volume of the part of the body that yields in this step."""
        self.set(u)
        return float(Integrate(self._plastic * self._dx, self.problem.mesh))

    def first_order_energy(self, u: np.ndarray) -> float:
        """l(u, p) + int beta |p| of (2.15), (2.16) at the plastic strain of ``u``."""
        self.set(u)
        problem, N = self.problem, self.problem.N
        p = self.mapping.plastic_increment
        _, alpha_2 = problem.alpha_0
        e_minus_p = self.mapping.elastic_strain_trial + problem.p_0 - tensor(p, N)
        two_mu = 2 * problem.material.lame_mu
        density = (
            problem.beta * Norm(p)
            + InnerProduct(coordinates(alpha_2, N), p)
            - two_mu * InnerProduct(e_minus_p, problem.p_0)
        )
        stored = Integrate(density.Compile() * self._dx, problem.mesh)
        return float(stored - np.vdot(self.load, u))

    def _assemble_trial_forces(self) -> list[np.ndarray]:
        problem, h = self.problem, specialcf.mesh_size
        modulus = problem.N * as_scalar(problem.material.lame_lambda)
        modulus = IfPos(modulus, modulus, 0.0) + 2 * as_scalar(problem.material.lame_mu)
        p_0 = InnerProduct(problem.p_0, problem.p_0)
        nodal = []
        beta = as_scalar(problem.beta)
        for density in (modulus / (h * h), modulus * sqrt(p_0) / h, beta / h):
            form = LinearForm(H1(problem.mesh, order=1))
            form += density * form.space.TestFunction() * self._dx
            nodal.append(form.Assemble().vec.FV().NumPy().copy())
        return nodal
